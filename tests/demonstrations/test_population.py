"""Ranges of a population's traits, and drift from window to window."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hmi_marl.demonstrations.dataset import numbers
from hmi_marl.demonstrations.population import PopulationTraits
from hmi_marl.demonstrations.recording import CollectSettings, collect
from hmi_marl.envs.drivers import DRIVERS, TRAIT_NAMES, TraitDistributions
from hmi_marl.experiments.latent_traits.ceiling import NoCeilingError
from hmi_marl.experiments.latent_traits.posterior import evaluate_posteriors

WINDOWS = 4


def settings_of(**settings: Any) -> CollectSettings:
    base: dict[str, Any] = {"drivers": (), "population": 3, "windows": WINDOWS, "num_teams": 5}
    return CollectSettings(**(base | {"duration": 1.0, "vehicles": (1, 2)} | settings))


def traits_of(**settings: Any) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Traits of each recorded window, (E, 4), and its driver, (E,)."""
    parts = list(collect(settings_of(**settings)))
    assert len(parts) > 1  # so that a driver's windows lie in several
    traits = [part.truth.traits for part in parts if part.truth is not None]
    return np.concatenate(traits), np.concatenate([part.observed.driver for part in parts])


def test_by_default_traits_come_from_the_whole_population() -> None:
    assert PopulationTraits().distributions == TraitDistributions()


def test_drift_moves_beta_up_and_alpha_down_around_the_drawn_values() -> None:
    drawn = np.array([[0.5, 0.4, 0.3, 2.0]] * 5)
    moved = PopulationTraits(drift=0.4).drifted(drawn, np.arange(5), 5)
    np.testing.assert_allclose(moved[:, 0], [0.3, 0.4, 0.5, 0.6, 0.7])
    np.testing.assert_allclose(moved[:, 1], [0.6, 0.5, 0.4, 0.3, 0.2])
    np.testing.assert_array_equal(moved[:, 2:], drawn[:, 2:])
    np.testing.assert_array_equal(drawn[:, 0], 0.5)  # which are not written to


def test_drift_ends_where_a_share_does_and_keeps_the_mean() -> None:
    drawn = np.array([[0.05, 0.9, 0.3, 2.0]] * 3)
    moved = PopulationTraits(drift=1.0).drifted(drawn, np.arange(3), 3)
    np.testing.assert_allclose(moved[:, 0], [0.0, 0.05, 0.1], atol=1e-12)
    np.testing.assert_allclose(moved[:, 1], [1.0, 0.9, 0.8])
    alone = PopulationTraits(drift=1.0).drifted(drawn[:1], np.zeros(1, np.int64), 1)
    np.testing.assert_array_equal(alone, drawn[:1])


def test_recorded_windows_have_the_drifted_traits_in_the_truth() -> None:
    steady, driver = traits_of()
    moved, same = traits_of(traits=PopulationTraits(drift=0.3))
    np.testing.assert_array_equal(driver, same)
    expected = PopulationTraits(drift=0.3).drifted(steady, numbers(driver), WINDOWS)
    np.testing.assert_array_equal(moved, expected)
    for who in range(3):
        assert (np.diff(moved[driver == who, 0]) > 0).all()
        np.testing.assert_allclose(moved[driver == who].mean(axis=0), steady[driver == who][0])


def test_drivers_who_are_named_do_not_drift() -> None:
    traits, driver = traits_of(
        drivers=("homer",), steps=WINDOWS * 5, population=1, traits=PopulationTraits(drift=0.3)
    )
    assert (traits[driver == 0] == DRIVERS["homer"].traits).all()
    assert len(np.unique(traits[driver == 1, 0])) == WINDOWS


def test_a_range_moves_one_trait_and_leaves_the_others() -> None:
    whole, _ = traits_of()
    narrow, _ = traits_of(traits=PopulationTraits(inflation=(9.0, 13.0)))
    assert (narrow[:, 3] >= 9.0).all()
    np.testing.assert_allclose((narrow[:, 3] - 9) / 4, (whole[:, 3] - 1) / 8)
    np.testing.assert_array_equal(narrow[:, :3], whole[:, :3])


@pytest.mark.parametrize("trait", TRAIT_NAMES)
def test_ranges_are_checked(trait: str) -> None:
    low, high = (2.0, 3.0) if trait == "inflation" else (0.2, 0.3)
    with pytest.raises(ValueError, match=f"{trait} of the population: the range {high:g} {low:g}"):
        PopulationTraits(**{trait: (high, low)})
    with pytest.raises(ValueError, match=rf"{trait}\[1\] lies in"):
        PopulationTraits(**{trait: (low, 21.0)})


def test_mean_traits_of_pools_are_exact_if_they_do_not_drift() -> None:
    pools = np.arange(3 * WINDOWS).reshape(3, WINDOWS)
    (steady,) = collect(settings_of(num_teams=100))
    (moved,) = collect(settings_of(num_teams=100, traits=PopulationTraits(drift=0.3)))
    assert steady.truth is not None
    assert moved.truth is not None
    np.testing.assert_array_equal(steady.truth.traits_of(pools), steady.truth.traits[::WINDOWS])
    np.testing.assert_allclose(moved.truth.traits_of(pools), steady.truth.traits[::WINDOWS])
    assert (moved.truth.traits[::WINDOWS, 0] != steady.truth.traits[::WINDOWS, 0]).all()


def test_any_hmi_collects_and_is_named() -> None:
    (watched,) = collect(settings_of(num_teams=100, hmi="when-distracted"))
    assert watched.observed.about["hmi"] == "when-distracted"
    assert watched.truth is not None
    before = watched.truth.distracted[:, :-1]
    np.testing.assert_array_equal(watched.observed.alerts[:, 1:], before)
    assert settings_of(alert_rate=0.4).hmi_name == "random:0.4"


def test_an_hmi_has_no_alert_rate_and_has_to_be_there() -> None:
    with pytest.raises(ValueError, match="alert_rate is of the HMI 'random', not of 'average'"):
        settings_of(hmi="average", alert_rate=0.4)
    with pytest.raises(ValueError, match="unknown HMI 'nope'"):
        settings_of(hmi="nope")
    with pytest.raises(ValueError, match="name a driver model"):
        settings_of(hmi="optimal")


def test_posteriors_refuse_alerts_that_depend_on_the_driver() -> None:
    (data,) = collect(settings_of(num_teams=100, hmi="average"))
    with pytest.raises(NoCeilingError, match="alerts at random, but they came from 'average'"):
        evaluate_posteriors(data, windows=WINDOWS)
