"""Verdicts by rule, worked by hand."""

import json
import math

import numpy as np
import pytest

from hmi_marl.reporting.statistics import UNKNOWN, Estimate, geometric_ratio, mean, share
from hmi_marl.reporting.verdicts import (
    EPISODES,
    SEEDS,
    Correction,
    Outcome,
    Part,
    Verdict,
    judged_together,
)

SUPPORTED, NOT_SUPPORTED, OPEN = Outcome.SUPPORTED, Outcome.NOT_SUPPORTED, Outcome.UNDETERMINED


def part(value: float, error: float = 1.0, count: int = 10_000, **ends: float) -> Part:
    """A part of so many units that its interval of 95 % is 1.96 standard errors to either side."""
    estimate = Estimate(value, math.nan, math.nan, error, count)
    return Part.mean("x", estimate, EPISODES, **(ends or {"above": 0.0}))


@pytest.mark.parametrize(
    ("value", "outcome"), [(2.0, SUPPORTED), (1.9, OPEN), (-1.9, OPEN), (-2.0, NOT_SUPPORTED)]
)
def test_the_whole_interval_lies_on_one_side_or_nothing_is_said(
    value: float, outcome: Outcome
) -> None:
    assert part(value).outcome() is outcome
    assert part(-value, below=0.0).outcome() is outcome


@pytest.mark.parametrize(
    ("value", "outcome"),
    [(0.0, SUPPORTED), (1.0, SUPPORTED), (1.1, OPEN), (4.9, OPEN), (5.0, NOT_SUPPORTED)],
)
def test_equality_needs_the_whole_interval_within_the_tolerance(
    value: float, outcome: Outcome
) -> None:
    assert part(value, above=-3.0, below=3.0).outcome() is outcome
    assert part(-value, above=-3.0, below=3.0).outcome() is outcome


@pytest.mark.parametrize(
    ("value", "outcome"), [(0.0, NOT_SUPPORTED), (1.1, OPEN), (2.0, SUPPORTED)]
)
def test_a_gain_too_small_to_matter_is_none(value: float, outcome: Outcome) -> None:
    assert part(value, above=0.0, margin=3.0).outcome() is outcome


def test_exact_values_need_no_interval() -> None:
    assert Part.exact("x", 1.0, above=0.0).outcome() is SUPPORTED
    assert Part.exact("x", 0.0, above=0.0).outcome() is NOT_SUPPORTED
    assert Part.exact("x", -85.0, above=-200.0, below=-178.6).outcome() is NOT_SUPPORTED
    assert not Part.exact("x", 1.0, above=0.0).is_tested


@pytest.mark.parametrize("estimate", [mean([5.0]), mean([]), UNKNOWN, Estimate(9.0, 8.0, 10.0)])
def test_without_two_units_or_an_error_nothing_is_said(estimate: Estimate) -> None:
    found = Part.mean("x", estimate, SEEDS, above=0.0, seeds=1)
    assert found.outcome() is OPEN
    assert not found.is_tested
    assert "1 seed: undetermined for training" in Verdict("a", (found,)).summary


def test_intervals_of_every_test_by_hand() -> None:
    values = Part.mean("x", mean([2.0, 4.0]), SEEDS, above=0.0)
    # standard error 1, one degree of freedom: t = 12.7062 for 95 % and 63.6567 for 99 %
    assert values.interval() == pytest.approx((3 - 12.7062, 3 + 12.7062), abs=1e-4)
    assert values.interval(0.99) == pytest.approx((3 - 63.6567, 3 + 63.6567), abs=1e-4)
    few = Part.share("x", share(0, 10), "pools", below=0.5)
    assert few.interval() == pytest.approx((0.0, 3.841459 / 13.841459), abs=1e-5)
    # logarithms 1 and 3: mean 2, standard error 1
    ratio = geometric_ratio(np.exp([1.0, 4.0]), np.exp([0.0, 1.0]))
    logs = Part.ratio("x", ratio, SEEDS, above=1.0)
    assert logs.value == pytest.approx(math.exp(2.0))
    assert np.log(logs.interval()) == pytest.approx((2 - 12.7062, 2 + 12.7062), abs=1e-4)


def test_intervals_of_shares_end_at_0_and_1_in_text_and_json() -> None:
    wide = mean([0.8, 1.0])  # standard error 0.1, t = 12.7062
    found = Part.mean_share("named", wide, SEEDS, above=0.5, form="z.1%")
    assert found.interval() == (0.0, 1.0)
    assert found.shown() == "named 90.0% [0.0%, 100.0%] (> 50.0%?)"
    assert found.basis() == "t of shares over 2 training seeds"
    assert Verdict("a", (found,)).as_json()["intervals"] == [[0.0, 1.0]]
    assert Verdict.from_json(Verdict("a", (found,)).as_json()).parts == (found,)
    low = Part.mean_up_to_1("earned", wide, SEEDS, above=0.5)
    assert low.interval() == (pytest.approx(0.9 - 1.27062, abs=1e-5), 1.0)
    gap = Part.mean("closed", wide, SEEDS, above=0.5)  # of a gap, of which more can be closed
    assert gap.interval() == pytest.approx((0.9 - 1.27062, 0.9 + 1.27062), abs=1e-5)
    inside = Part.mean_share("named", mean([0.5, 0.51]), SEEDS, above=0.4)
    assert inside.interval() == Part.mean("named", mean([0.5, 0.51]), SEEDS).interval()


def test_a_quantity_that_never_varies_shows_no_interval_of_zero_width() -> None:
    never = Part.mean("gain", mean([0.0] * 5), SEEDS, above=0.0, form="+z.1f")
    assert never.shown() == "gain +0.0 every time (> +0.0?)"
    assert never.interval() == (0.0, 0.0)


def test_a_verdict_is_supported_by_all_its_parts_and_lost_by_one() -> None:
    yes, no, unknown = part(9.0), part(-9.0), part(0.1)
    for parts, outcome in (
        ((yes, yes), SUPPORTED),
        ((yes, unknown), OPEN),
        ((yes, unknown, no), NOT_SUPPORTED),
        ((), OPEN),
    ):
        assert Verdict("a", parts).outcome is outcome
    assert Verdict("a", (yes,)).holds


def holm(p: list[float]) -> list[bool]:
    """Rejections of Holm's method, step by step."""
    order, rejected = sorted(range(len(p)), key=lambda k: p[k]), [False] * len(p)
    for rank, k in enumerate(order):
        if p[k] > 0.05 / (len(p) - rank):
            break
        rejected[k] = True
    return rejected


def test_parts_are_corrected_as_holm_s_method_does() -> None:
    from scipy import stats

    rng = np.random.default_rng(0)
    for _ in range(50):
        z = rng.normal(size=8) * rng.choice([1.0, 3.0], 8)
        degrees = 9_999
        p = [float(2 * stats.t.sf(abs(value), degrees)) for value in z]
        found = judged_together([Verdict(str(k), (part(value),)) for k, value in enumerate(z)])
        decided = [one.outcome is not OPEN for one in found]
        assert decided == holm(p)
        above = [one.outcome is SUPPORTED for one in found]
        assert above == [value > 0 and known for value, known in zip(z, decided, strict=True)]
        assert found[0].correction == Correction(8, max(1, decided.count(False)))


def test_only_tested_parts_count_and_all_verdicts_share_the_correction() -> None:
    exact = Part.exact("x", 1.0, above=0.0)
    one_seed = Part.mean("x", mean([5.0]), SEEDS, above=0.0)
    found = judged_together([Verdict("a", (part(2.1), exact)), Verdict("b", (one_seed, part(2.1)))])
    assert {one.correction for one in found} == {Correction(2, 2)}  # 2.1 is within 2.24 errors
    assert [one.outcome for one in found] == [OPEN, OPEN]
    assert judged_together([Verdict("a", (part(2.1),))])[0].holds
    assert judged_together([Verdict("a", reason="not run")])[0].outcome is OPEN


def test_unit_seeds_test_and_correction_are_named_everywhere() -> None:
    learned = Part.mean("x", mean([1.0, 2.0, 3.0]), EPISODES, paired=True, above=0.0, seeds=1)
    (found,) = judged_together([Verdict("a", (learned,), "because")])
    for words in (
        "paired t over 3 episodes",
        "1 training seed: holds of the agents that were learned here",
        "Holm over 1 parts: intervals of 95 %",
    ):
        assert words in found.basis
    assert found.summary.endswith("; because")
    content = json.loads(json.dumps(found.as_json(), allow_nan=False))
    assert content["outcome"] == "undetermined"
    assert content["outcomes"] == ["undetermined"]
    assert content["basis"] == found.basis
    assert content["parts"][0]["unit"] == "episodes"
    assert Verdict.from_json(content | {"needs": ["table"]}) == found
    with pytest.raises(ValueError, match="claim"):
        Verdict.from_json({"outcome": "supported"})


def test_at_most_one_report_in_twenty_without_effects_decides_anything() -> None:
    rng = np.random.default_rng(1)
    wrong = 0
    for _ in range(400):
        parts = [Part.mean("x", mean(rng.normal(size=5)), SEEDS, above=0.0) for _ in range(30)]
        found = judged_together([Verdict("a", (each,)) for each in parts])
        wrong += any(one.outcome is not OPEN for one in found)
    assert 0 < wrong <= 0.05 * 400


def test_margins_do_not_leave_the_luckiest_part_to_be_judged_alone() -> None:
    rng = np.random.default_rng(3)
    claimed = decided = 0
    for _ in range(400):
        parts = [part(value, above=0.0, margin=4.0) for value in rng.normal(size=20)]
        found = judged_together([Verdict("a", (each,)) for each in parts])
        claimed += any(verdict.holds for verdict in found)
        decided += any(verdict.outcome is NOT_SUPPORTED for verdict in found)
    assert decided > 300  # most are within the margin, whatever chance does
    assert claimed <= 400 * 0.05 + 2.6 * math.sqrt(400 * 0.05 * 0.95)
