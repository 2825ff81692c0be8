"""Strangers' actions predicted from z, from their traits, and from nothing."""

import math
from dataclasses import replace

import numpy as np
import pytest
from demonstrations import LAYOUT, made_up
from trait_models import untrained

from hmi_marl.agents.learned.trait_encoder import Latent
from hmi_marl.agents.learned.trait_model import TraitModel
from hmi_marl.demonstrations.dataset import Demonstrations
from hmi_marl.experiments.latent_traits.prediction import ActionPredictor, has_pairs

MODEL = untrained(LAYOUT, pool=2)
STRANGERS, WINDOWS, STEPS = 60, 4, 50
DRIVER = np.repeat(np.arange(STRANGERS), WINDOWS)
RARE = 0.1


def population() -> Demonstrations:
    """Strangers of two kinds: β tells which of two actions they take in nine of ten steps."""
    made = made_up(
        [STEPS] * len(DRIVER), driver=DRIVER.tolist(), names=tuple(map(str, range(STRANGERS)))
    )
    kind = (np.arange(STRANGERS) // 2 % 2)[DRIVER]  # of both kinds on both sides
    rare = np.random.default_rng(0).random((len(DRIVER), STEPS)) < RARE
    observed = replace(made.observed, actions=np.where(rare, 1 - kind[:, None], kind[:, None]))
    assert made.truth is not None
    traits = np.column_stack([kind, np.tile([0.5, 0.1, 3.0], (len(DRIVER), 1))])
    return Demonstrations(observed, replace(made.truth, traits=traits.astype(np.float64)))


def entropy(chance: float) -> float:
    return -chance * math.log(chance) - (1 - chance) * math.log(1 - chance)


def z_is(monkeypatch: pytest.MonkeyPatch, of_driver: np.ndarray) -> list[np.ndarray]:
    """Let z of a pool be a number of its driver; return the pools that are asked for."""
    asked = []

    def latents(model, sums, pools):
        asked.append(pools)
        mean = of_driver[DRIVER[pools[:, 0]], None].astype(np.float64)
        return Latent(mean, np.ones_like(mean))

    monkeypatch.setattr(TraitModel, "latents", latents)
    return asked


def test_z_that_holds_the_traits_predicts_as_they_do(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = z_is(monkeypatch, np.arange(STRANGERS) // 2 % 2)
    found = ActionPredictor(population(), 2).judge(MODEL)
    assert found.traits.mean == pytest.approx(-entropy(RARE), abs=0.07)
    assert abs(found.traits_minus_z.mean) < 0.02
    # The last action, which everyone reads, tells the kind of nine of ten: it is repeated in
    # 0.9 ** 2 + 0.1 ** 2 of the steps.
    assert found.nothing.mean == pytest.approx(-entropy(0.82), abs=0.07)
    assert found.z.count == STRANGERS // 2
    # z comes from the first pool of each stranger, and the second one is judged.
    np.testing.assert_array_equal(asked[0], DRIVER.reshape(-1, WINDOWS)[:, :1] * WINDOWS + [0, 1])


def test_z_that_holds_nothing_predicts_no_better_than_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    z_is(monkeypatch, np.random.default_rng(1).normal(size=STRANGERS))
    found = ActionPredictor(population(), 2).judge(MODEL)
    assert found.z.mean == pytest.approx(found.nothing.mean, abs=0.05)
    assert found.traits_minus_z.low > 0.05


def test_windows_of_their_own_are_needed_for_z() -> None:
    assert has_pairs(DRIVER, 2)
    assert not has_pairs(DRIVER, 3)
    with pytest.raises(ValueError, match="two pools of 3 windows of each stranger"):
        ActionPredictor(population(), 3)
    with pytest.raises(ValueError, match="only where the truth is known"):
        ActionPredictor(Demonstrations(population().observed), 2)
