"""Verdicts of a study: planted differences are found, and none where none were planted."""

import numpy as np
import pytest
from cited import missing
from people.study.studies import a_study

from hmi_marl.people.study.analyse import analyse
from hmi_marl.people.study.mixed import RatingModel
from hmi_marl.people.study.ordinal import fit_ordinal
from hmi_marl.people.study.power import (
    Needed,
    find_power,
    needed_raters,
    simulate_studies,
)
from hmi_marl.people.study.ratings import LeftOut, Ratings, ratings_of
from hmi_marl.people.study.report import SIMULATED, analysis_blocks, power_blocks
from hmi_marl.people.study.settings import Plan, PowerSettings, StudySettings
from hmi_marl.people.study.simulated import (
    planted_means,
    simulated_answers,
    true_difference,
)
from hmi_marl.reporting.blocks import as_html, as_text
from hmi_marl.reporting.statistics import share

pytest.importorskip("statsmodels")
DRIVERS = {"drivers": ("lisa", "marge", "bart", "homer"), "clips": 8, "shown": 2}
SETTINGS = StudySettings(**DRIVERS, controls=(), format="gif")


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    return a_study(tmp_path_factory.mktemp("made") / "study", **DRIVERS)


@pytest.fixture(scope="module")
def planted(study):
    plan = Plan(effect=1.2, clip=0.2)
    return analyse(study, ratings_of(simulated_answers(study, 80, plan, 1), study, "here"))


def test_planted_differences_are_supported_by_both_models(planted):
    assert len(planted.differences) == 8
    assert {str(each.verdict.outcome) for each in planted.differences} == {"supported"}
    assert {str(each.check.outcome) for each in planted.differences} == {"supported"}
    for each in planted.differences:
        assert 0.4 < each.points.low < each.points.mean < each.points.high < 2.2
        assert each.log_odds.low > 0
    assert "Holm over 8 parts" in planted.differences[0].verdict.basis
    # conditions that nothing was planted for
    own = [planted.mean(3, place) for place in range(4)]
    assert max(each.mean for each in own) - min(each.mean for each in own) < 0.7


def test_a_reversed_difference_is_not_supported_and_noise_is_undetermined(study):
    ratings = ratings_of(simulated_answers(study, 80, Plan(effect=1.2, clip=0.2), 1), study, "here")
    turned = Ratings(
        ratings.raters, ratings.rater, ratings.clip, 8 - ratings.values, True, LeftOut()
    )
    found = analyse(study, turned)
    assert {str(each.verdict.outcome) for each in found.differences} == {"not supported"}
    none = ratings_of(simulated_answers(study, 20, Plan(effect=0.0), 1), study, "here")
    outcomes = {str(each.verdict.outcome) for each in analyse(study, none).differences}
    assert outcomes == {"undetermined"}


def test_everything_simulated_says_so(planted):
    blocks = analysis_blocks(planted)
    assert not missing(blocks, planted.as_json())
    text, page = as_text(blocks), as_html(blocks)
    assert SIMULATED in text
    for title in ("Intended differences", "Mean ratings", "Differences by two", "Standard dev"):
        (line,) = [line for line in text.splitlines() if line.startswith(title)]
        assert "(SIMULATED raters)" in line
    assert "(SIMULATED raters)" in page
    assert planted.as_json()["simulated"] is True
    assert f"{planted.raters} raters, who rated {16 // 2 * planted.raters}" in text


def test_a_margin_makes_no_difference_of_noise():
    # Differences that are shown to be small do not make the test of the others more generous.
    found = simulate_studies(SETTINGS, Plan(effect=0.0), 40, 20, seed=3, margin=2.5)
    assert (found.outcomes == "supported").any(axis=1).sum() <= 3
    assert (found.outcomes == "not supported").mean() > 0.95


def test_too_few_raters_are_refused(study):
    ratings = ratings_of(simulated_answers(study, 1, Plan(careless=0.0)), study, "here")
    with pytest.raises(ValueError, match="1 raters passed the attention check"):
        analyse(study, ratings)
    with pytest.raises(ValueError, match="margin lies in"):
        analyse(study, ratings, margin=9.0)


def test_true_differences_allow_for_rounding_at_the_ends():
    plan = Plan(effect=1.0)
    means = planted_means(SETTINGS, plan)
    truths = [true_difference(each, SETTINGS, plan, means) for each in SETTINGS.intended]
    assert all(0.9 < truth < 1.0 for truth in truths)
    narrow = Plan(effect=1.0, rater=0, clip=0, rater_driver=0, residual=0.01)
    # means of 3.5 and 4.5 round to either side alike, in any case one point apart
    shifted = planted_means(SETTINGS, narrow) + 0.25
    assert true_difference(SETTINGS.intended[0], SETTINGS, narrow, shifted) == pytest.approx(1.0)


def test_contrasts_that_contradict_each_other_cannot_be_planted():
    odd = StudySettings(**DRIVERS, contrasts=("safe:lisa>bart", "safe:bart>lisa"))
    with pytest.raises(ValueError, match="contradict each other"):
        planted_means(odd, Plan())


def test_the_ordinal_model_by_hand():
    # Two categories: the proportional odds model is logistic regression, whose log odds ratio is
    # that of the two shares.
    rng = np.random.default_rng(0)
    condition = np.repeat([0, 1], 400)
    rating = np.where(rng.random(800) < np.where(condition == 1, 0.7, 0.4), 2, 1)
    clip, rater = np.arange(800) // 40, np.arange(800) % 100
    fit = fit_ordinal(rater, clip, rating, condition)
    high = np.array([(rating[condition == k] == 2).mean() for k in (0, 1)])
    odds = np.log(high / (1 - high))
    found, error = fit.contrast(1, 0)
    assert found == pytest.approx(odds[1] - odds[0], abs=1e-3)
    alone = np.sqrt((1 / (400 * high * (1 - high))).sum())
    assert 0.6 * alone < error < 1.8 * alone
    assert fit.contrast(0, 1)[0] == pytest.approx(-found)


def test_the_ordinal_model_has_no_solution_without_variation_or_with_separation():
    condition, clip, rater = np.repeat([0, 1], 50), np.arange(100) // 10, np.arange(100) % 20
    assert fit_ordinal(rater, clip, np.full(100, 4), condition) is None
    assert fit_ordinal(rater, clip, np.where(condition == 1, 7, 1), condition) is None


def test_needed_raters_lie_between_those_that_were_tried():
    series = [share(40, 100), share(70, 100), share(90, 100)]
    found = needed_raters((10, 20, 40), series, 0.8)
    assert found.raters == pytest.approx(30.0)
    assert found.low < 30.0 < found.high <= 40.0
    assert needed_raters((10, 20), series[:2], 0.8) == Needed(None, None, None)
    assert needed_raters((10,), [share(99, 100)], 0.8).shown(10) == "10 [10, 10]"
    assert Needed(None, 12.3, None).shown(40) == "> 40 [13, > 40]"


@pytest.mark.slow
def test_more_raters_have_more_power():
    settings = PowerSettings(raters=(10, 60), studies=20, plan=Plan(effect=0.9, clip=0.1))
    power = find_power(SETTINGS, settings)
    few, many = (np.mean([each.mean for each in row]) for row in power.shares)
    assert few < 0.6
    assert many > 0.9
    assert all(10 < power.needed(place).raters <= 60 for place in range(8))
    assert not missing(power_blocks(power), power.as_json())
    blocks = as_text(power_blocks(power))
    assert blocks.count("SIMULATED") >= 3
    assert power.as_json()["simulated"] is True


def test_without_differences_few_simulated_studies_find_one():
    found = simulate_studies(SETTINGS, Plan(effect=0.0), 40, 30, seed=3)
    assert (found.truth == 0).all()
    assert (found.outcomes == "supported").any(axis=1).sum() <= 4  # 5 %: P(> 4 of 30) = 1.6 %
    assert abs(found.found.mean()) < 0.05


@pytest.mark.slow
def test_over_200_studies_differences_are_recovered_and_false_alarms_are_5_percent_at_most():
    none = simulate_studies(SETTINGS, Plan(effect=0.0), 100, 200, seed=1)
    alarms = (none.outcomes == "supported").any(axis=1).mean()
    assert alarms <= 0.05
    assert 0.93 < none.covered.mean() < 0.97
    planted = simulate_studies(SETTINGS, Plan(effect=0.8, clip=0.3), 100, 200, seed=2)
    assert np.abs(planted.found.mean(axis=0) - planted.truth).max() < 0.05
    assert 0.93 < planted.covered.mean() < 0.97
    assert (planted.outcomes == "supported").mean() > 0.9
    assert not (planted.outcomes == "not supported").any()


@pytest.mark.slow
def test_a_study_of_500_raters_takes_seconds(study):
    ratings = ratings_of(simulated_answers(study, 500, Plan()), study, "here")
    condition = np.repeat(np.arange(4), 8)
    fit = RatingModel(
        ratings.rater, ratings.clip, ratings.values[:, 0].astype(float), condition
    ).fit
    assert fit.freedom == 28
