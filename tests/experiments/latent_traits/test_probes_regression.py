import json
import math

import numpy as np
import pytest

from hmi_marl.envs.drivers import TRAIT_NAMES
from hmi_marl.experiments.latent_traits import probes
from hmi_marl.experiments.latent_traits.probes import trait_r2
from hmi_marl.files import json_value
from hmi_marl.reporting.statistics import UNKNOWN


@pytest.fixture
def two_folds(monkeypatch):
    """Instead of five, where it is not the question how well traits are read."""
    monkeypatch.setattr(probes, "_FOLDS", 2)


def scores(trait, train=200, held_out=200, noise=0.0):
    """R² of one trait that is a function of z in two dimensions."""
    rng = np.random.default_rng(0)
    z, new = rng.normal(size=(train, 2)), rng.normal(size=(held_out, 2))
    known, truth = (trait(each) + noise * rng.normal(size=len(each)) for each in (z, new))
    return trait_r2(z, known[:, None], new, truth[:, None], ["it"])["it"]


@pytest.mark.usefixtures("unmeasured")
def test_a_linear_trait_is_read_exactly():
    found = scores(lambda z: 3.0 + 2.0 * z[:, 0] - z[:, 1])
    assert found.linear.mean == pytest.approx(1.0, abs=1e-6)
    assert found.linear.low == pytest.approx(1.0, abs=1e-6)
    assert found.smooth.mean > 0.98


@pytest.mark.usefixtures("unmeasured")
def test_a_curved_trait_is_read_by_the_smooth_regression_alone():
    found = scores(lambda z: np.cos(2.0 * z[:, 0]))
    assert found.linear.high < 0.2
    assert found.smooth.mean > 0.95


@pytest.mark.usefixtures("unmeasured")
def test_noise_is_not_read():
    found = scores(lambda z: 0.0 * z[:, 0], noise=1.0)
    for estimate in (found.linear, found.smooth):
        assert -0.2 < estimate.mean < 0.1
        assert estimate.low < estimate.mean < estimate.high


@pytest.mark.usefixtures("unmeasured")
def test_half_noise_leaves_half_the_variance():
    # 1 - variance of the noise over that of the whole; its standard error is about 0.05
    found = scores(lambda z: z[:, 0], noise=1.0)
    assert found.linear.mean == pytest.approx(0.5, abs=0.15)
    assert found.linear.low < 0.5 < found.linear.high


@pytest.mark.usefixtures("two_folds")
def test_r2_is_negative_where_a_constant_does_better():
    z = np.arange(10.0)[:, None]
    found = trait_r2(z, z, z, -z, ["it"])["it"]
    # predicted y, true -y: errors 4 y², sum 1140; about the mean 82.5
    assert found.linear.mean == pytest.approx(1.0 - 1140 / 82.5, rel=1e-3)


@pytest.mark.usefixtures("two_folds")
def test_every_trait_has_its_own_score():
    rng = np.random.default_rng(0)
    z, new = rng.normal(size=(60, 2)), rng.normal(size=(60, 2))

    def traits(z):
        return np.stack([z[:, 0], z[:, 1], rng.normal(size=60), np.full(60, 0.3)], axis=1)

    found = trait_r2(z, traits(z), new, traits(new), TRAIT_NAMES)
    assert tuple(found) == TRAIT_NAMES
    assert found["beta"].linear.mean == pytest.approx(found["alpha"].linear.mean, abs=1e-3)
    assert found["eta"].linear.mean < 0.2
    assert math.isnan(found["inflation"].linear.mean), "held-out drivers do not differ"
    content = json.loads(json.dumps(json_value(found["inflation"])))
    assert content["smooth"] == UNKNOWN.as_json()


@pytest.mark.usefixtures("unmeasured", "two_folds")
def test_intervals_count_drivers_not_vectors():
    rng = np.random.default_rng(0)
    traits = rng.uniform(size=(40, 1))
    z = traits + 0.3 * rng.normal(size=(40, 1))
    once = trait_r2(z, traits, z, traits, ["it"])["it"].linear
    many = (np.repeat(each, 10, axis=0) for each in (z, traits))
    often = trait_r2(z, traits, *many, ["it"])["it"].linear
    assert vars(often) == pytest.approx(vars(once), nan_ok=True)
    assert once.count == 40
    assert 3.0 < (once.high - once.low) / once.error < 5.0  # of resamples, nearly normal


@pytest.mark.usefixtures("unmeasured", "two_folds")
def test_the_same_seed_gives_the_same_numbers():
    first, second = (scores(lambda z: z[:, 0], 30, 30, noise=1.0) for _ in range(2))
    assert first == second


@pytest.mark.usefixtures("unmeasured")
@pytest.mark.parametrize("size", [2, 3, 7])
def test_few_drivers_are_enough_to_try(size):
    found = scores(lambda z: z[:, 0], train=size, held_out=size)
    assert math.isfinite(found.linear.mean)
    assert math.isfinite(found.smooth.mean)


@pytest.mark.usefixtures("two_folds")
def test_vectors_that_have_collapsed_tell_nothing():
    traits = np.arange(20.0)[:, None]
    found = trait_r2(np.zeros((20, 2)), traits, np.zeros((20, 2)), traits, ["it"])["it"]
    assert found.linear.mean == pytest.approx(0.0, abs=1e-9)
    assert found.smooth.mean == pytest.approx(0.0, abs=1e-2)


def test_what_does_not_fit_is_refused():
    z, traits = np.arange(12.0).reshape(6, 2), np.arange(6.0)[:, None]
    with pytest.raises(ValueError, match=r"traits of vectors have shape \(6, 1\), not \(5, 1\)"):
        trait_r2(z, traits, z, traits[:5], ["it"])
    with pytest.raises(ValueError, match=r"training vectors have shape \(6, 2\), not \(6, 1\)"):
        trait_r2(z, traits, z, traits, ["it", "other"])
    with pytest.raises(ValueError, match="traits of vectors are finite"):
        trait_r2(z, traits, z, traits * math.nan, ["it"])
    with pytest.raises(ValueError, match="training vectors are finite, but 12 numbers are not"):
        trait_r2(z * math.nan, traits, z, traits, ["it"])
    with pytest.raises(ValueError, match="2 dimensions, held-out ones 1"):
        trait_r2(z, traits, z[:, :1], traits, ["it"])
    with pytest.raises(ValueError, match="two drivers or more"):
        trait_r2(z, traits * 0.0, z, traits, ["it"])
