import numpy as np
import pytest
from demonstrations import LAYOUT
from trait_models import untrained

from hmi_marl.agents.learned.trait_encoder import Latent
from hmi_marl.agents.learned.trait_model import TraitModel
from hmi_marl.experiments.latent_traits import strangers
from hmi_marl.experiments.latent_traits.probes import predict_traits
from hmi_marl.experiments.latent_traits.strangers import log_likelihoods, name_types

MODEL = untrained(LAYOUT, pool=3)
DRIVER = np.repeat([0, 1, -1], [12, 9, 2])
SUMS = np.ones((23, 1))


def told_by_place(monkeypatch, wrong=()):
    """z of a pool is its windows' driver, but for windows that are wrong."""
    z = np.where(DRIVER == 0, 0.0, 4.0)
    z[list(wrong)] = 4.0 - z[list(wrong)]

    def latents(model, sums, pools):
        mean = z[pools].mean(axis=1)[:, None]
        return Latent(mean, np.ones_like(mean))

    monkeypatch.setattr(TraitModel, "latents", latents)


def test_likelihoods_by_hand():
    of = Latent(np.array([[0.0, 1.0]]), np.array([[1.0, 3.0]]))
    kinds = Latent(np.array([[2.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 1.0], [3.0, 1.0]]))
    two_pi = np.log(2 * np.pi)
    expected = [[-0.5 * (4 / 2 + np.log(2 * 4) + 2 * two_pi), -0.5 * (np.log(16) + 2 * two_pi)]]
    np.testing.assert_allclose(log_likelihoods(of, kinds), expected)


def test_types_that_are_apart_are_named(monkeypatch):
    told_by_place(monkeypatch)
    one, pools = name_types(MODEL, SUMS, DRIVER, (1, 3))
    assert (one.windows, pools.windows) == (1, 3)
    assert one.named.mean == pools.named.mean == 1.0
    assert one.chance == 0.5
    # 9 + 6 windows are left beside the labelled ones, and count once whatever the draws.
    assert one.named.low == pytest.approx(15 / (15 + 1.96**2), abs=1e-3)


def test_what_is_wrong_counts_by_its_share(monkeypatch):
    # One window of 15 that are left looks like the other type, unless it is among the labelled.
    told_by_place(monkeypatch, wrong=[0])
    (one,) = name_types(MODEL, SUMS, DRIVER, (1,))
    assert 13.9 / 15 < one.named.mean < 1.0


def test_labelled_windows_are_not_named(monkeypatch):
    asked = []

    def latents(model, sums, pools):
        asked.append(pools)
        return Latent(np.zeros((len(pools), 1)), np.ones((len(pools), 1)))

    monkeypatch.setattr(TraitModel, "latents", latents)
    name_types(MODEL, SUMS, DRIVER, (2,))
    assert len(asked) == 2 * strangers.DRAWS
    for labelled, named in zip(asked[::2], asked[1::2], strict=True):
        assert labelled.shape == (2, 3)
        assert (DRIVER[labelled] == [[0], [1]]).all()
        assert not np.intersect1d(labelled, named).size
    assert any((one != other).any() for one, other in zip(asked[:-2:2], asked[2::2], strict=True))


def test_too_few_to_name_are_refused():
    with pytest.raises(ValueError, match="takes two or more who are known by name"):
        name_types(MODEL, SUMS, np.zeros(23, int), (1,))
    with pytest.raises(ValueError, match="takes 10 windows of each, but of one there are 9"):
        name_types(MODEL, SUMS, DRIVER, (7,))


def test_a_small_network_reads_what_a_line_does_not():
    rng = np.random.default_rng(0)
    z = rng.uniform(-1, 1, (400, 2))
    traits = np.column_stack([100 + 5 * z[:, 0] ** 2, z[:, 1]])
    found = predict_traits(z[:200], traits[:200], z[200:], seed=1)
    assert found.shape == (200, 2)
    left = ((found - traits[200:]) ** 2).mean(axis=0) / traits[200:].var(axis=0)
    assert (left < 0.1).all()
    np.testing.assert_array_equal(found, predict_traits(z[:200], traits[:200], z[200:], seed=1))
