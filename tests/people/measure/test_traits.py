"""β, α and η with their intervals: worked by hand, against a fine grid, and by coverage."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from hmi_marl.people.measure.likelihood import Likelihood, State
from hmi_marl.people.measure.steps import ChainCounts
from hmi_marl.people.measure.traits import intervals, measure_attention, minutes_needed

FINE = np.linspace(0.0, 1.0, 2001)
DROP = stats.chi2.ppf(0.95, 1) / 2


def counts(openings, attentive, helped_openings, helped_attentive, closings, away, hc, ha):
    given = openings, attentive, helped_openings, helped_attentive, closings, away, hc, ha
    return ChainCounts(*(np.asarray(float(each)) for each in given))


def test_shares_are_estimated_where_they_agree_exactly():
    found = intervals(counts(300, 1000, 100, 1000, 400, 1000, 600, 1000))
    assert found["beta"].estimate == pytest.approx(0.3, abs=1e-6)
    assert found["alpha"].estimate == pytest.approx(0.4, abs=1e-6)
    assert found["eta"].estimate == pytest.approx(0.2, abs=2e-4)


def test_without_alerts_it_is_the_interval_of_one_binomial():
    found = intervals(counts(30, 100, 0, 0, 20, 50, 0, 0))
    for trait, events, steps in (("beta", 30, 100), ("alpha", 20, 50)):
        values = FINE[1:-1]
        log_likelihood = stats.binom.logpmf(events, steps, values)
        inside = values[log_likelihood >= log_likelihood.max() - DROP]
        assert found[trait].estimate == pytest.approx(events / steps, abs=1e-6)
        assert found[trait].low == pytest.approx(inside[0], abs=5.1e-4)
        assert found[trait].high == pytest.approx(inside[-1], abs=5.1e-4)
    assert (found["eta"].low, found["eta"].high) == (0.0, 1.0)


def test_few_openings_take_the_exact_interval():
    found = intervals(counts(0, 100, 0, 0, 20, 50, 0, 0))["beta"]
    assert (found.estimate, found.low) == (0.0, 0.0)
    assert found.high == pytest.approx(1 - 0.025 ** (1 / 100))


def test_where_alerts_stop_all_openings_any_larger_effect_is_possible():
    found = intervals(counts(200, 1000, 0, 900, 800, 1000, 100, 100))["eta"]
    assert found.high == 1.0
    assert found.estimate == pytest.approx(0.2, abs=0.01)
    assert 0.17 < found.low < 0.2


def test_nothing_seen_means_nothing_known():
    found = intervals(counts(0, 0, 0, 0, 0, 0, 0, 0))
    for each in found.values():
        assert (each.low, each.high) == (0.0, 1.0)
    assert found["alpha"].estimate == 0.5


NUMBERS = st.tuples(st.integers(0, 40), st.integers(0, 40))


@settings(max_examples=60, deadline=None)
@given(NUMBERS, NUMBERS, st.sampled_from([0.0, 0.001, 0.3, 0.999]))
def test_the_best_probability_is_that_of_a_fine_grid(outside, within, eta):
    numbers = [np.asarray(float(each)) for k, n in (outside, within) for each in (k, k + n)]
    state = State(*numbers)
    best, highest = state.best(eta)
    assert state.log_likelihood(best, eta) == pytest.approx(float(highest), abs=1e-9)
    assert highest >= state.log_likelihood(FINE, eta).max() - 1e-9


@settings(max_examples=12, deadline=None)
@given(NUMBERS, NUMBERS, NUMBERS, NUMBERS)
def test_profiles_are_concave_and_below_the_maximum(a, b, c, d):
    likelihood = Likelihood.of(counts(*(each for k, n in (a, b, c, d) for each in (k, k + n))))
    _, highest = likelihood.maximum()
    places = np.linspace(0.01, 0.99, 33)
    for trait in ("beta", "alpha", "eta"):
        profile = likelihood.profile(trait, places)
        assert profile.max() <= highest + 1e-6
        finite = profile[np.isfinite(profile)]
        assert (np.diff(finite, 2) <= 1e-6).all()
    assert likelihood.saturated() >= highest - 1e-6


def test_persons_measured_together_are_as_each_alone():
    several = [counts(3, 50, 1, 40, 4, 9, 5, 6), counts(200, 1000, 0, 900, 800, 1000, 100, 100)]
    together = intervals(ChainCounts.stack(several))
    for place, own in enumerate(several):
        for trait, found in intervals(own).items():
            for name in ("estimate", "low", "high"):
                alone = float(getattr(found, name))
                assert getattr(together[trait], name)[place] == pytest.approx(alone, abs=1e-9)


def test_minutes_grow_with_the_square_of_narrowness():
    own = counts(300, 1000, 100, 1000, 400, 1000, 600, 1000)
    width = float(intervals(own)["beta"].width)
    assert minutes_needed(own, 10.0, width)["beta"] == pytest.approx(10.0, rel=0.03)
    assert minutes_needed(own, 10.0, width / 2)["beta"] == pytest.approx(40.0, rel=0.05)


def test_some_widths_are_never_reached():
    saturated = counts(200, 1000, 0, 900, 800, 1000, 100, 100)
    assert minutes_needed(saturated, 5.0, 0.5)["eta"] is None
    with pytest.raises(ValueError, match=r"width of an interval lies in \(0, 1\)"):
        minutes_needed(saturated, 5.0, 0.0)


def test_arrays_of_trips_are_measured():
    trips = [([1] * 30, [0] * 30), ([0] * 30, [0] * 30)]
    found = measure_attention(trips, 7)
    assert found.counts.attentive == 31
    assert found.beta.mean == pytest.approx(1 / 31)
    assert found.alpha.mean == 0.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("traits", "steps"),
    [
        ((0.02, 0.15, 0.1), (660, 660, 90, 90)),
        ((0.2, 0.8, 1.0), (600, 600, 150, 40)),
        ((0.05, 0.2, 0.5), (160, 160, 40, 20)),
        ((0.003, 0.2, 0.05), (700, 700, 20, 10)),
        ((0.5, 0.99, 0.3), (300, 300, 200, 200)),
    ],
)
def test_intervals_cover_at_few_events_and_at_edges(traits, steps):
    """At least 92 % of 600: 95 % less 3.4 standard errors."""
    beta, alpha, eta = traits
    rng, people = np.random.default_rng(0), 600
    chances = beta, max(0.0, beta - eta), alpha, min(1.0, alpha + eta)
    drawn = [rng.binomial(n, p, people).astype(float) for n, p in zip(steps, chances, strict=True)]
    numbers = [
        each for k, n in zip(drawn, steps, strict=True) for each in (k, np.full(people, n * 1.0))
    ]
    for trait, found in intervals(ChainCounts(*numbers)).items():
        covered = found.covers({"beta": beta, "alpha": alpha, "eta": eta}[trait]).mean()
        assert covered > 0.92, (trait, covered)
