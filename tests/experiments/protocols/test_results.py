"""Numbers of an arm over its runs and drivers: scores, references, luck and shares."""

import math
from dataclasses import replace

import pytest
from comparisons import FILTER, NONE, OPTIMUM, SEEN, SMALL, comparison, hidden, number_of, sums

from hmi_marl.experiments.episode_sums import Sums
from hmi_marl.experiments.protocols.content import content_of
from hmi_marl.experiments.protocols.cross_play import dependence_of
from hmi_marl.experiments.protocols.findings import (
    way_to_optimum,
)
from hmi_marl.experiments.protocols.results import (
    attainable,
    attention,
    bits,
    hiding,
    regret,
    revealing,
    score,
    shortfall,
)
from hmi_marl.reporting.statistics import Estimate
from hmi_marl.reporting.verdicts import SEEDS, Part


def test_scores_lie_between_no_alerts_and_the_optimum():
    results = comparison(SMALL, lambda pair: OPTIMUM).tasks["hidden"]
    assert results.score(results.own("joint")) == Estimate(1.0, 1.0, 1.0)
    results = comparison(SMALL, lambda pair: NONE).tasks["hidden"]
    assert results.score(results.own("joint")).mean == 0.0
    pair = results.own("joint")[0]
    found = results.played[pair]
    assert attention(found, "bart") == NONE
    assert hiding(found, "bart") == OPTIMUM - FILTER
    assert shortfall(found, "bart").mean == FILTER - NONE
    assert attainable(found, "bart") == FILTER
    assert hiding(found, "bart") + shortfall(found, "bart").mean == OPTIMUM - attention(
        found, "bart"
    )


def test_pairs_are_compared_by_the_episodes_that_all_of_them_play():
    made = comparison(SMALL, lambda pair: 500.0)
    results = made.tasks["hidden"]
    lucky = {
        pair: replace(played, sums=dict.fromkeys(played.sums, sums(600.0))) if pair.own else played
        for pair, played in results.played.items()
    }
    for row in dependence_of(replace(results, played=lucky)):
        assert {found.mean for found in (*row.on_protocol.values(), row.on_seed)} == {0.0}


def test_every_driver_counts_the_same_however_often_it_was_drawn():
    results = comparison(SMALL).tasks["hidden"]
    pair = results.own("joint")[0]
    drawn = {"bart": sums(100.0, episodes=10), "homer": sums(300.0, episodes=90)}
    played = replace(results.played[pair], sums=drawn | {"all": Sums.join(drawn.values())})
    results = replace(results, played={**results.played, pair: played})
    assert results.values([pair], "attention_return").tolist() == [200.0]
    assert results.mean_of([pair], attention).mean == 200.0


def test_luck_of_the_episodes_that_all_runs_share_widens_intervals_against_exact_values():
    results = comparison(SEEN, lambda pair: OPTIMUM).tasks["seen"]
    pairs = results.own("two-stage")
    assert results.against_exact(pairs, regret) == Estimate(0.0, 0.0, 0.0)

    def unlucky(played, name):
        mean = regret(played, name).mean
        return Estimate(mean, mean - 30.0, mean + 30.0, count=250)

    found = results.against_exact(pairs, unlucky)
    luck = 30.0 / math.sqrt(2) / 1.95996  # two drivers' episodes are independent
    assert found.error == found.luck == pytest.approx(luck, rel=1e-5)
    assert (found.count, found.luck_count) == (3, 250)
    assert found.high == pytest.approx(1.96954 * luck, rel=1e-5)  # Student's t of 249 degrees

    spread = comparison(SEEN, lambda pair: OPTIMUM + 9.0 * number_of(pair.driver)).tasks["seen"]
    found = spread.against_exact(spread.own("two-stage"), unlucky)  # 0, -9 and -18
    over_runs = 9.0 / math.sqrt(3)  # of two degrees of freedom, which luck does not share
    half = math.hypot(4.30265 * over_runs, 1.96954 * luck)
    assert (found.low, found.high) == pytest.approx((-9.0 - half, -9.0 + half), rel=1e-5)
    part = Part.mean("a regret", found, SEEDS, below=0.0)
    assert part.interval() == (found.low, found.high)
    assert part.basis() == "t over 3 training seeds and over what they share, 250 units"


def test_luck_of_the_episodes_widens_scores_and_the_way_to_the_optimum():
    made = hidden()
    results = made.tasks["hidden"]
    spread = 0.02  # standard error of each driver's score

    def unlucky(score):
        mean = score.score.mean
        return replace(score, score=Estimate(mean, mean - 0.04, mean + 0.04, spread, 250))

    shaken = replace(
        results,
        played={
            pair: replace(each, scores={n: unlucky(s) for n, s in each.scores.items()})
            for pair, each in results.played.items()
        },
    )
    own = shaken.own("simultaneous")
    errors, episodes = shaken.luck_of_scores(own)
    assert (errors.tolist(), episodes) == (pytest.approx([0.04 / 1.95996] * 2, rel=1e-5), 250)
    luck = 0.04 / math.sqrt(2) / 1.95996  # two drivers' episodes are independent
    before, found = results.score(own), shaken.score(own)
    assert found.mean == before.mean
    assert found.luck == pytest.approx(luck, rel=0.05)
    half = 1.96954 * found.luck
    assert found.high - found.mean == pytest.approx(
        math.hypot(before.high - before.mean, half), rel=1e-5
    )
    assert found.luck_count == 250
    # the two-stage score is 1001 / 1200, so 199 / 1200 are missing
    way = way_to_optimum(shaken, "simultaneous")
    whole = math.hypot(luck, (1.0 - way.mean) * luck) / (199.0 / 1200.0)
    assert way.luck == pytest.approx(whole, rel=1e-4)
    assert way.low < way.mean - 1.9 * whole


def test_signals_are_those_that_were_measured():
    results = hidden(share=lambda pair: 0.25).tasks["hidden"]
    assert results.mean_of(results.own("joint"), revealing).mean == 0.25
    assert results.mean_of(results.own("joint"), score).mean == pytest.approx(1181 / 1200)


def test_intervals_of_shares_end_at_0_and_1_in_text_and_json():
    def share(pair):
        return (1.0, 1.0, 0.7)[number_of(pair.driver)]

    def crashes(pair):
        return (0, 0, 40)[number_of(pair.driver)]

    made = hidden(share=share, crashes=crashes)
    results = made.tasks["hidden"]
    own = results.own("joint")
    found = results.mean_of(own, revealing)
    assert found.mean == pytest.approx(0.9)
    assert found.high == 1.0
    assert results.mean_of(own, bits).high == 1.0
    assert results.over_runs(own, "crash_rate").low == 0.0
    arm = content_of(made)["tasks"]["hidden"]["arms"]["joint"]
    assert arm["mean_over_drivers"]["revealing"]["high"] == 1.0
    crashing = [pair for pair in own for _ in range(2)]  # 0, 0, 0, 0, 1, 1
    sure = {pair: replace(played, sums=played.sums) for pair, played in results.played.items()}
    for pair in own[:2]:
        sure[pair] = replace(sure[pair], sums=dict.fromkeys(sure[pair].sums, sums(crashes=100)))
    many = replace(results, played=sure)
    assert many.over_runs(crashing, "crash_rate").high == 1.0
