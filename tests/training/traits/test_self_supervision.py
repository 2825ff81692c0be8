import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from demonstrations import LAYOUT, made_up
from trait_models import SMALL

from hmi_marl.agents.learned.trait_model import TraitCard
from hmi_marl.training.traits.encoder import ContextEncoder
from hmi_marl.training.traits.episodes import Episodes
from hmi_marl.training.traits.self_supervision import AverageLearner, SelfSupervision
from hmi_marl.training.traits.windows import Batch, Windows

CARD = TraitCard(tuple((part.name, part.size) for part in LAYOUT.parts), latent=2, encoder=SMALL)
DRIVERS, EACH = 40, 4


def windows(seed: int = 0) -> Windows:
    """Windows of drivers who take each action as often as is their habit."""
    driver = np.repeat(np.arange(DRIVERS), EACH)
    names = tuple(f"driver {k}" for k in range(DRIVERS))
    data = made_up([12] * len(driver), seed, driver=driver, names=names).observed
    rng = np.random.default_rng(seed)
    habits = rng.dirichlet(np.full(5, 0.3), DRIVERS)
    actions = np.stack([rng.choice(5, 12, p=habits[who]) for who in driver])
    return Windows(Episodes.of(replace(data, actions=actions)), np.full(len(data), np.nan))


WINDOWS = windows()


def batch(windows: Windows, seed: int = 0, size: int = 2) -> Batch:
    return windows.batch(windows.draw_drivers(np.random.default_rng(seed), DRIVERS, size))


@pytest.fixture
def encoder() -> ContextEncoder:
    torch.manual_seed(0)
    return ContextEncoder(CARD)


def test_the_average_driver_learns_how_often_actions_are_taken(encoder: ContextEncoder) -> None:
    learner = AverageLearner(encoder, 1e-2)
    every = batch(WINDOWS)
    before = [weight.clone() for weight in encoder.learning()]
    rows = [learner.learn(every, k / 300) for k in range(300)]
    # The cross-entropy of the frequencies is the best that does not depend on the situation.
    share = np.bincount(every.actions.flatten(), minlength=5) / every.actions.numel()
    assert rows[0]["average"] == pytest.approx(math.log(5), abs=0.3)
    assert rows[-1]["average"] < -(share * np.log(share)).sum() + 0.01
    for weight, old in zip(encoder.learning(), before, strict=True):
        torch.testing.assert_close(weight, old, rtol=0, atol=0)


def test_steps_after_the_end_are_not_imitated(encoder: ContextEncoder) -> None:
    x, actions, length = batch(WINDOWS)
    cut = torch.full_like(length, 5)
    over = torch.arange(x.shape[2]) >= cut[..., None]
    losses = []
    for action in (0, 4):
        torch.manual_seed(0)
        again = ContextEncoder(CARD)
        other = Batch(x, torch.where(over, action, actions), cut)
        losses.append(AverageLearner(again, 1e-2).learn(other, 0.0)["average"])
    assert losses[0] == losses[1]


def test_drivers_are_found_again_by_their_habits(encoder: ContextEncoder) -> None:
    learner = SelfSupervision(encoder, 1e-2, 0.0)
    torch.manual_seed(1)
    with torch.no_grad():
        before, _ = learner.loss(batch(windows(seed=5)))  # of drivers that are never learned from
    rows = [learner.learn(batch(WINDOWS, k), k / 100) for k in range(100)]
    assert rows[-1]["same_driver"] < 0.6 * rows[0]["same_driver"]
    assert rows[-1]["sigma"] > 0
    with torch.no_grad():
        after, _ = learner.loss(batch(windows(seed=5)))
    assert after < 0.85 * before


def test_the_average_driver_is_left_alone(encoder: ContextEncoder) -> None:
    before = [weight.clone() for weight in encoder.average.parameters()]
    SelfSupervision(encoder, 1e-2, 0.1).learn(batch(WINDOWS), 0.0)
    for weight, old in zip(encoder.average.parameters(), before, strict=True):
        torch.testing.assert_close(weight, old, rtol=0, atol=0)


def test_two_windows_each_are_enough(encoder: ContextEncoder) -> None:
    row = SelfSupervision(encoder, 1e-2, 0.0).learn(batch(WINDOWS, size=1), 0.0)
    assert np.isfinite(list(row.values())).all()
