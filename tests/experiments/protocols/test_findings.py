"""Differences, the sweep, cross-play, gaming and verdicts of made-up results."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from comparisons import (
    OPTIMUM,
    SEEN,
    SMALL,
    arm_of,
    comparison,
    hidden,
    number_of,
    signalling,
    sums,
    without,
)

from hmi_marl.experiments.episode_sums import Sums
from hmi_marl.experiments.protocols.content import content_of
from hmi_marl.experiments.protocols.cross_play import cell_of, cross_play, dependence_of
from hmi_marl.experiments.protocols.findings import (
    differences,
    judge,
    sweep,
    way_to_optimum,
)
from hmi_marl.experiments.protocols.gaming import find, gaming_of, worst_finding
from hmi_marl.experiments.protocols.results import (
    UNKNOWN,
)
from hmi_marl.reporting.blocks import Verdicts, as_text
from hmi_marl.reporting.statistics import Estimate
from hmi_marl.reporting.verdicts import Outcome


def test_differences_are_paired_by_seed_and_corrected_together():
    made = hidden()
    found = {(c.protocol, c.metric): c.difference for c in differences(made)}
    assert len(found) == 4  # joint and simultaneous, two metrics
    change = found["simultaneous", "attention_return"]
    assert change.estimate == Estimate(180.0, 180.0, 180.0)  # the same with every seed
    assert change.pairs == 3
    assert change.differs


def test_nothing_differs_where_runs_do_not():
    made = comparison(SEEN, lambda pair: 700.0 + number_of(pair.driver))
    assert all(change.difference.differs is False for change in differences(made))


def test_the_way_to_the_optimum_worked_by_hand():
    found = way_to_optimum(hidden().tasks["hidden"], "simultaneous")
    # 600, 601, 602 and 180 more, on the way to 800
    assert found.mean == pytest.approx(180.0 / 199.0)
    assert 0.899 < found.low <= found.mean <= found.high < 0.91


def test_the_sweep_goes_from_the_free_driver_to_the_natural_one():
    def apart(pair):
        return {"simultaneous": 2.0, "anchored-0.1": 0.8, "anchored-1": 0.1}.get(
            arm_of(pair.driver), 0.0
        )

    points = sweep(hidden(apart=apart).tasks["hidden"])
    assert [point.weight for point in points] == [0.0, 0.1, 1.0, math.inf]
    assert [point.divergence.mean for point in points] == pytest.approx([2.0, 0.8, 0.1, 0.0])
    assert [point.attention_return.mean for point in points] == [781.0, 760.0, 602.0, 601.0]
    (falls,) = (v for v in judge(hidden(apart=apart)) if "fall with λ" in v.claim)
    assert falls.outcome is Outcome.SUPPORTED
    assert len(falls.parts) == 1 + 2 * 3  # the whole way, and two quantities from point to point
    alone = replace(SMALL, anchor_kls=())
    assert sweep(comparison(alone).tasks["hidden"]) == []


def test_the_table_of_crashes_has_the_team_return_of_the_summary():
    settings = replace(SMALL, crash_check=True)
    results = comparison(settings).tasks["hidden"]
    drawn = {"bart": sums(100.0, episodes=10), "homer": sums(300.0, episodes=90)}
    drawn |= {"all": Sums.join(drawn.values())}
    uneven = {pair: replace(each, sums=drawn) for pair, each in results.played.items()}
    results = replace(results, played=uneven)
    own = results.own("joint")
    assert results.over_runs(own, "team_return").mean == 600.0
    (row,) = (r for r in gaming_of(results) if (r.protocol, r.driver) == ("joint", "all"))
    assert row.team_return == row.team_return_standing == 600.0


def unscored(made, *names):
    """The same, where alerts gain these drivers nothing."""
    tasks = {}
    for task, results in made.tasks.items():
        emptied = {
            pair: replace(
                each,
                scores=each.scores | {n: replace(each.scores[n], score=UNKNOWN) for n in names},
            )
            for pair, each in results.played.items()
        }
        tasks[task] = replace(results, played=emptied)
    return replace(made, tasks=tasks)


@pytest.mark.parametrize("names", [("homer",), ("bart", "homer")])
def test_drivers_to_whom_alerts_gain_nothing_have_no_score(names):
    made = unscored(hidden(), *names)
    results = made.tasks["hidden"]
    assert results.scored_drivers == tuple(n for n in ("bart", "homer") if n not in names)
    assert math.isnan(results.score(results.own("joint")).mean) == (len(names) == 2)
    text = as_text([*made.settings.blocks(made), Verdicts(judge(made))])
    assert f"alerts gain nothing: {', '.join(names)}" in text
    assert json.dumps(content_of(made), allow_nan=False)


def test_cross_play_tells_seeds_from_protocols():
    results = hidden().tasks["hidden"]
    cell = cell_of(results, "two-stage", "joint")
    assert cell.same_seed.mean == cell.next_seed.mean == 431.0
    own = cell_of(results, "joint", "joint")
    assert own.same_seed.mean == own.next_seed.mean == 781.0
    assert {(c.driver, c.hmi) for c in cross_play(results)} >= {
        ("rule", "joint"),
        ("joint", "two-stage"),
    }


def test_partners_that_fit_only_their_own_kind_depend_on_each_other():
    rows = {row.arm: row for row in dependence_of(hidden().tasks["hidden"])}
    # own 781 and 601; swapped 431 and 601
    assert rows["joint"].on_protocol["two-stage"].mean == pytest.approx((781 + 601 - 431 - 601) / 2)
    assert rows["joint"].on_protocol["simultaneous"].mean == 0.0
    assert rows["joint"].on_seed.mean == 0.0

    def choosy(pair):
        return 700.0 if pair.own else 100.0

    rows = {row.arm: row for row in dependence_of(comparison(SMALL, choosy).tasks["hidden"])}
    assert rows["joint"].on_seed.mean == rows["joint"].on_protocol["two-stage"].mean == 600.0


def test_partners_that_only_differ_in_skill_do_not_depend():
    rng = np.random.default_rng(0)
    skill = {}

    def apart(pair):
        return sum(skill.setdefault(key, rng.normal()) for key in ((0, pair.driver), (1, pair.hmi)))

    for row in dependence_of(comparison(SMALL, apart).tasks["hidden"]):
        for found in (*row.on_protocol.values(), row.on_seed):
            assert found.mean == pytest.approx(0.0, abs=1e-9)


def test_one_run_has_no_next_one():
    made = comparison(replace(SMALL, seeds=1, few_seeds=1, protocols=("joint",)))
    (row,) = dependence_of(made.tasks["hidden"])
    assert math.isnan(row.on_seed.mean)
    assert row.on_protocol == {}


@pytest.mark.parametrize(
    ("low", "worth", "finding"),
    [
        (0.13, 1.0, "fine"),
        (0.13, -1.0, "fine"),  # crashes are no more than two-stage's
        (0.15, -1.0, "fine"),  # not by more than the margin
        (0.16, -1.0, "GAMED"),
        (0.16, 0.0, "crashes more"),
        (0.16, 1.0, "crashes more"),
        (math.nan, 1.0, "unknown"),
        (0.16, math.nan, "unknown"),
    ],
)
def test_the_rule_of_gaming(low: float, worth: float, finding: str) -> None:
    assert find(Estimate(0.2, low, 0.3), Estimate(0.05, 0.0, 0.1), worth) == finding


def crashing(pair):
    return 60 if arm_of(pair.driver) == "simultaneous" else 0


def test_a_driver_who_crashes_to_get_away_games():
    made = comparison(SEEN, lambda pair: -700.0, crashes=crashing)
    found = gaming_of(made.tasks["seen"])
    assert worst_finding(found, "simultaneous") == "GAMED"
    assert worst_finding(found, "two-stage") == "reference"
    row = next(r for r in found if (r.protocol, r.driver) == ("simultaneous", "bart"))
    assert (row.crash_rate.mean, row.two_stage_crash_rate.mean) == (0.6, 0.0)
    assert row.worth_of_a_step == -3.0
    claims = {v.claim: v for v in judge(made)}
    verdict = claims["simultaneous: crashes no more than two-stage, and crashing does not pay"]
    assert verdict.outcome is Outcome.NOT_SUPPORTED
    assert verdict.reason == "GAMED with all, bart, homer"


def test_a_driver_who_would_gain_by_going_on_does_not_game():
    made = comparison(SEEN, lambda pair: 700.0, crashes=crashing)
    assert worst_finding(gaming_of(made.tasks["seen"]), "simultaneous") == "crashes more"


def test_a_driver_who_never_came_is_left_open():
    made = without(comparison(SEEN, crashes=crashing), "homer")
    rows = {(r.protocol, r.driver): r.finding for r in gaming_of(made.tasks["seen"])}
    assert rows["simultaneous", "homer"] == "unknown"


def outcomes(made):
    return {verdict.claim: verdict.outcome for verdict in judge(made)}


def test_the_trial_s_numbers_support_what_it_found():
    def apart(pair):
        return {"simultaneous": 2.0, "anchored-0.1": 1.9, "anchored-1": 0.1}.get(
            arm_of(pair.driver), 0.0
        )

    found = outcomes(hidden(apart=apart))
    assert [outcome for claim, outcome in found.items() if "of the way" in claim] == [
        Outcome.SUPPORTED
    ]
    worse = [o for claim, o in found.items() if "does worse with the stage-1 driver" in claim]
    assert worse == [Outcome.SUPPORTED] * 2


def test_other_numbers_do_not():
    found = outcomes(comparison(SMALL, lambda pair: 600.0 + number_of(pair.driver)))
    assert [outcome for claim, outcome in found.items() if "of the way" in claim] == [
        Outcome.NOT_SUPPORTED
    ]
    worse = [o for claim, o in found.items() if "does worse with the stage-1 driver" in claim]
    assert worse == [Outcome.NOT_SUPPORTED] * 2


def test_the_optimum_is_near_or_it_is_not():
    near = outcomes(comparison(SEEN, lambda pair: OPTIMUM - 10.0))
    far = outcomes(comparison(SEEN, lambda pair: OPTIMUM - 20.0))
    claim = "seen, two-stage: attention return within 2 % of the exact optimum"
    assert near[claim] is Outcome.SUPPORTED
    assert far[claim] is Outcome.NOT_SUPPORTED


def test_a_difference_is_split_into_lengths_of_episodes_and_the_hmi():
    def earns(pair):
        return OPTIMUM - 10.0 * (arm_of(pair.driver) == "two-stage") + number_of(pair.driver)

    made = comparison(SEEN, earns)
    results = made.tasks["seen"]
    for pair in results.own("simultaneous"):  # its episodes are longer, so more can be earned
        scores = results.played[pair].scores
        for driver, found in scores.items():
            known = replace(found.references, optimum=OPTIMUM + 7.0)
            scores[driver] = replace(found, references=known)
    (same,) = (verdict for verdict in judge(made) if "no protocol differs" in verdict.claim)
    told = "simultaneous: of +10.0, +7.0 is the exact optimum over the lengths of its own episodes"
    assert same.reason == f"{told}, +3.0 the HMI"
    alike = comparison(SEEN, lambda pair: OPTIMUM + number_of(pair.driver))
    (same,) = (verdict for verdict in judge(alike) if "no protocol differs" in verdict.claim)
    assert same.reason == ""


def test_noise_supports_no_equality_and_no_threshold():
    rng = np.random.default_rng(1)
    luck = {}

    def noisy(pair):
        return OPTIMUM + luck.setdefault(pair, rng.normal(scale=60.0))

    found = outcomes(comparison(SEEN, noisy))
    near = [o for claim, o in found.items() if "within 2 % of the exact optimum" in claim]
    assert near
    assert Outcome.SUPPORTED not in near, "an interval that holds everything shows nothing"
    same = next(o for claim, o in found.items() if "no protocol differs" in claim)
    assert same is Outcome.UNDETERMINED, "nothing differs, by intervals too wide to see it"

    def apart(pair):
        way = {0: 1.0, 1: 0.3, 2: 1.0}[number_of(pair.driver)]
        return 600.0 + 200.0 * way * (arm_of(pair.driver) == "simultaneous")

    found = outcomes(comparison(SMALL, apart))
    (way,) = (outcome for claim, outcome in found.items() if "of the way" in claim)
    assert way is Outcome.UNDETERMINED, "its mean is above the threshold, its interval is not"


def swept(returns):
    """Outcomes of the sweep for attention returns by arm, spread by the seed."""

    def attention_return(pair):
        return returns.get(arm_of(pair.driver), 500.0) + 0.1 * number_of(pair.driver)

    def apart(pair):
        return {"simultaneous": 2.0, "anchored-0.1": 1.9, "anchored-1": 0.1}.get(
            arm_of(pair.driver), 0.0
        )

    settings = replace(SMALL, seeds=4, few_seeds=4)
    found = outcomes(comparison(settings, attention_return, apart=apart))
    return [outcome for claim, outcome in found.items() if "λ" in claim]


def test_the_sweep_falls_and_ends_where_the_free_and_the_natural_driver_are():
    ends = {"simultaneous": 780.0, "two-stage": 600.0}
    good = swept(ends | {"anchored-0.1": 775.0, "anchored-1": 605.0})
    assert good == [Outcome.SUPPORTED] * 3
    early = swept(ends | {"anchored-0.1": 700.0, "anchored-1": 690.0})
    assert early == [Outcome.SUPPORTED, Outcome.NOT_SUPPORTED, Outcome.NOT_SUPPORTED]
    risen = swept(ends | {"anchored-0.1": 610.0, "anchored-1": 700.0})
    assert risen[0] is Outcome.NOT_SUPPORTED
    flat = swept(dict.fromkeys((*ends, "anchored-0.1", "anchored-1"), 600.0))
    assert flat[0] is not Outcome.SUPPORTED, "no way between the ends"


def test_one_run_leaves_comparisons_open():
    found = outcomes(comparison(replace(SMALL, seeds=1, few_seeds=1), signalling))
    open_ones = [claim for claim, outcome in found.items() if outcome is Outcome.UNDETERMINED]
    assert len(open_ones) == 8  # the way, two conventions, three of the sweep, two of crashes
    assert open_ones == list(found)
