import json
from dataclasses import replace

import numpy as np
import pytest
from evidence_models import save_trained, small_evaluation

from hmi_marl.agents.adaptive.hmis import TYPES
from hmi_marl.envs.drivers import DRIVERS
from hmi_marl.experiments.adaptation import evaluation as adapt
from hmi_marl.experiments.adaptation.evaluation import (
    POPULATION,
    TRIPS,
    AdaptSettings,
    Group,
    evaluate,
    groups,
    summarise,
    tasks,
)
from hmi_marl.experiments.adaptation.hmis import (
    ADAPTIVE,
    AVERAGE,
    EXPECTED,
    KNOWING,
    LEARNED_KNOWING,
    NONE,
    hmi_names,
)
from hmi_marl.experiments.adaptation.trips import Trips
from hmi_marl.files import json_value

TINY = AdaptSettings(drivers=2, population=2, repeats=2, candidates=1, changes=3)
LISA, MARGE, BART, HOMER = TYPES


# Who drives.


def test_the_groups_are_the_types_the_population_and_changes_to_each_type():
    found = {group.name: group for group in groups(TINY)}
    assert list(found) == [
        *("lisa", "marge", "bart", "homer", POPULATION),
        *(f"change to {name}" for name in ("lisa", "marge", "bart", "homer")),
    ]
    bart, change, population = (found[name] for name in ("bart", "change to bart", POPULATION))
    assert (bart.drivers, bart.teams, bart.all_drivers) == ((BART,), 2, (BART,))
    assert (change.drivers, change.changes_to) == ((LISA, MARGE, HOMER), BART)
    assert set(change.all_drivers) == set(TYPES)
    assert change.first_drivers.tolist() == [0, 1, 2]
    assert population.teams == 4
    assert population.first_drivers.tolist() == [0, 1, 0, 1]
    for group in found.values():
        if group.name != POPULATION:
            assert group.candidates == TYPES


def test_random_drivers_are_not_among_the_candidates():
    (population,) = (
        g for g in groups(replace(TINY, population=50, candidates=60)) if g.name == POPULATION
    )
    chains = {driver.traits[:3] for driver in population.candidates}
    assert len(population.drivers) == 50
    assert len(chains) == 60
    assert not chains & {driver.traits[:3] for driver in population.drivers}
    inflations = {driver.inflation for driver in population.candidates}
    assert min(inflations) == pytest.approx(1.5)
    assert max(inflations) == pytest.approx(8.5)
    assert len(population.candidates) == 60 * len(inflations)


def test_other_seeds_draw_other_drivers():
    found = []
    for seed in (1, 1, 5):
        (population,) = (g for g in groups(replace(TINY, seed=seed)) if g.name == POPULATION)
        found.append({driver.traits for driver in population.drivers})
    assert found[0] == found[1]
    assert not found[0] & found[2]


# What is made of their trips, by hand.


def constant(group, value, crash=0, **changes):
    """Trips that earn ``value`` a step; the first team's first ends after ``crash`` steps."""
    shape = group.teams, TRIPS, 100
    rewards, driving = np.full(shape, float(value)), np.ones(shape, np.bool_)
    if crash:
        rewards[0, 0, crash:], driving[0, 0, crash:] = 0.0, False
    return Trips(rewards, driving, **changes)


def summary(group, **played):
    """With HMIs of which all but those told earn nothing."""
    every = {hmi: constant(group, 0) for hmi in hmi_names(group.all_drivers)}
    return summarise(group, every | played, TINY)


@pytest.fixture
def no_exact_worth(monkeypatch):
    monkeypatch.setattr(adapt, "rule_return", lambda *_: 0.0)


@pytest.mark.usefixtures("no_exact_worth")
def test_shares_returns_and_regret_of_a_type():
    group = Group("bart", (BART,), 3, TYPES)
    played = {
        KNOWING: constant(group, 5),
        AVERAGE: constant(group, 1),
        EXPECTED: constant(group, 4),
    }
    found = summary(group, **played)
    assert found.group == "bart"
    assert [estimate.mean for estimate in found.returns[EXPECTED]] == [400.0] * 4
    for when in ("10 s", "20 s", "1 trip", "3 trips"):
        closed = found.shares[EXPECTED][when]
        assert closed.share.mean == pytest.approx(0.75)
        assert closed.gap.mean == pytest.approx(400.0)
        assert closed.regret.mean == pytest.approx(100.0)
    assert found.first_seconds[EXPECTED].mean == pytest.approx(25 * 3)
    assert found.first_seconds[AVERAGE].mean == 0.0
    assert found.regret[EXPECTED] == [1.0] * 80
    total = {when: regret.mean for when, regret in found.total_regret[EXPECTED].items()}
    assert total == pytest.approx({"5 s": 25.0, "10 s": 50.0, "20 s": 100.0, "60 s": 300.0})
    assert found.after_change == {}
    assert found.belief == {}


@pytest.mark.usefixtures("no_exact_worth")
def test_the_gap_between_learned_hmis_is_a_gap_of_its_own():
    group = Group("bart", (BART,), 2, TYPES)
    played = {LEARNED_KNOWING: constant(group, 4), EXPECTED: constant(group, 3)}
    found = summary(group, **played).learned_shares
    assert found[EXPECTED]["1 trip"].share.mean == pytest.approx(0.75)  # learned AvgHMI earns 0
    assert found[LEARNED_KNOWING]["1 trip"].share.mean == 1.0


@pytest.mark.usefixtures("no_exact_worth")
def test_when_a_share_is_judged():
    group = Group("bart", (BART,), 2, TYPES)
    learns = constant(group, 0)
    learns.rewards[:, 0, 50:] = 2.0  # from 10 s on
    learns.rewards[:, 1:] = 4.0  # from 20 s on
    found = summary(group, **{KNOWING: constant(group, 4), EXPECTED: learns}).shares[EXPECTED]
    shares = {when: found[when].share.mean for when in found}
    assert shares == pytest.approx({"10 s": 0.75, "20 s": 1.0, "1 trip": 1.0, "3 trips": 1.0})


@pytest.mark.usefixtures("no_exact_worth")
def test_regret_is_told_as_long_as_most_drive_with_both():
    group = Group("bart", (BART,), 2, TYPES)
    often = constant(group, 3)
    often.driving[:, :, 10:] = False  # each trip ends after 2 s
    found = summary(group, **{KNOWING: constant(group, 5), EXPECTED: often})
    assert found.regret[EXPECTED] == [2.0] * 8
    assert len(found.regret[AVERAGE]) == 80


@pytest.mark.usefixtures("no_exact_worth")
def test_beliefs_in_the_true_type_follow_a_change():
    group = Group("change to bart", (LISA, MARGE, HOMER), 3, TYPES, BART)
    belief = np.zeros((3, TRIPS, 100, 4))
    for team, type_ in enumerate((0, 1, 3)):
        belief[team, 0, :, type_] = 1.0
        belief[team, 1, :50, type_] = 0.5
    belief[:, 1, 50:, 2] = 0.25
    belief[:, 2:, :, 2] = 0.75
    believing = constant(group, 0, probabilities=belief)
    told = summary(group, **{KNOWING: constant(group, 1), EXPECTED: believing}).belief
    assert list(told) == [EXPECTED]
    assert told[EXPECTED] == [1.0] * 20 + [0.5] * 10 + [0.25] * 10 + [0.75] * 40


@pytest.mark.usefixtures("no_exact_worth")
@pytest.mark.parametrize("crash", [0, 30])
def test_regret_after_a_change_is_judged_from_20_to_40_s_after_it(crash):
    group = Group("change to bart", (LISA, MARGE, HOMER), 3, TYPES, BART)
    late = constant(group, -2, crash)
    late.rewards[:, 2, 50:] = -3.0  # 100 turns after the change, for 100 turns
    late.rewards[:, 3, :50] = -3.0
    found = summary(group, **{KNOWING: constant(group, -2), EXPECTED: late})
    assert found.after_change[EXPECTED].mean == pytest.approx(0.5)
    assert found.after_change[KNOWING].mean == 0.0
    assert found.after_change[AVERAGE].mean == pytest.approx(-1.0)
    assert found.shares == found.learned_shares == {}
    assert found.exact_worth is None


@pytest.mark.usefixtures("no_exact_worth")
def test_repeats_of_one_random_driver_are_one_driver():
    people = tuple(replace(BART, name=f"s{k}", beta=0.1 * k) for k in range(1, 9))
    group = Group(POPULATION, people, 32, TYPES)
    other = Group("change to homer", people, 32, TYPES, HOMER)
    value = np.random.default_rng(0).normal(4, 1, 8)[group.first_drivers]
    knowing = constant(group, 0)
    knowing.rewards[:] = value[:, None, None]
    gap = summary(group, **{KNOWING: knowing}).shares[NONE]["3 trips"].gap
    assert gap.mean == pytest.approx(100 * value.mean())
    spread = 100 * value[:8].std() / np.sqrt(8)  # 8 drivers, not 32
    assert gap.high - gap.low == pytest.approx(2 * 1.96 * spread, rel=0.15)
    assert summary(other, **{KNOWING: knowing}).shares == {}


@pytest.mark.slow
def test_what_knowing_is_worth_is_exact():
    # With 70 % uninformative steps: bart about -224 against -413, lisa 751 against 727.
    for name, least, most in (("lisa", 20, 28), ("bart", 181, 197), ("marge", 0, 10)):
        group = Group(name, (DRIVERS[name],), 2, TYPES)
        assert least < adapt._exact_worth(group, replace(TINY, revealing=0.3)) < most


# All of it.


@pytest.fixture
def small(monkeypatch):
    small_evaluation(monkeypatch)


@pytest.mark.usefixtures("small")
def test_everybody_meets_every_hmi(tmp_path):
    counted = []
    trained = save_trained(tmp_path)
    (found,) = evaluate(tasks(TINY, "random", [trained]), [trained], 1, counted.append)
    assert [result.group for result in found] == ["lisa", "bart", POPULATION, "change to bart"]
    assert len(counted) == len(tasks(TINY, "random", [trained])) == 11 + 11 + 10 + 10
    for result in found:
        json.dumps(json_value(result), allow_nan=False)
        assert set(ADAPTIVE) < set(result.returns)
        is_change = result.group.startswith("change")
        assert bool(result.shares) != is_change
        assert bool(result.after_change) == is_change
        assert bool(result.belief) == (result.group != POPULATION)
        for beliefs in result.belief.values():
            assert ((np.array(beliefs) >= 0) & (np.array(beliefs) <= 1)).all()
    lisa, bart, *_ = found
    assert bart.exact_worth > lisa.exact_worth > 0
    assert bart.returns[NONE][0].mean < lisa.returns[NONE][0].mean
    # the same HMI is as good as itself
    assert lisa.first_seconds[AVERAGE].mean == 0.0
    assert set(lisa.regret[KNOWING]) == {0.0}


@pytest.mark.usefixtures("small")
def test_several_trainings_share_what_none_of_them_learned(tmp_path, monkeypatch):
    every = adapt.groups
    monkeypatch.setattr(adapt, "groups", lambda size: every(size)[1:3])
    one = save_trained(tmp_path / "one")
    other = replace(one, conditioned=save_trained(tmp_path / "other", seed=7).conditioned)
    counted = []
    both = [one, other]
    together = evaluate(tasks(TINY, "random", both), both, 1, counted.append)
    # Only the HMI conditioned on z is another, with either evidence, in each of the two groups.
    assert len(counted) == 11 + 10 + 2 * 2
    alone = [evaluate(tasks(TINY, "random", [each]), [each], 1)[0] for each in both]
    assert json_value(together) == json_value(alone)
    assert json_value(alone[0]) != json_value(alone[1])


@pytest.mark.usefixtures("small")
def test_drivers_roads_and_hmis_come_back_by_the_seed(tmp_path):
    trained = save_trained(tmp_path)
    group = next(g for g in groups(TINY) if g.name == "change to bart")
    plays = [
        adapt.play(adapt.Play(group, EXPECTED, replace(TINY, seed=seed), "random", trained))
        for seed in (1, 1, 2)
    ]
    np.testing.assert_array_equal(plays[0].rewards, plays[1].rewards)
    assert (plays[0].rewards != plays[2].rewards).any()


@pytest.mark.slow
def test_workers_change_nothing(tmp_path, monkeypatch):
    every = groups
    wanted = "bart", "change to bart"  # the workers are told whom, and play at full length
    monkeypatch.setattr(
        adapt, "groups", lambda size: tuple(g for g in every(size) if g.name in wanted)
    )
    trained = save_trained(tmp_path)
    plays = tasks(TINY, "random", [trained])
    found = [json_value(evaluate(plays, [trained], workers)) for workers in (1, 2)]
    assert found[0] == found[1]
