"""Trait models and driver policies for the tests, with weights as they come."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.agents.learned.policy import make_card, save_policy
from hmi_marl.agents.learned.trait_encoder import EncoderConfig
from hmi_marl.agents.learned.trait_model import TraitCard, TraitModel
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.observations import Layout

SMALL = EncoderConfig(
    3, 4, 3, 5, head=NetworkConfig((4,), "tanh"), average=NetworkConfig((4,), "tanh")
)
"""Sizes of a small encoder: 3 features of the state, 4 of a step, 3 steps, 5 features averaged."""


def untrained(
    layout: Layout,
    seed: int = 0,
    change: Callable[[str, Any], Any] = lambda name, values: values,
    **settings: Any,
) -> TraitModel:
    """A small model; ``settings`` are of its card."""
    small = NetworkConfig((4,), "tanh")
    reads = tuple((part.name, part.size) for part in layout.parts)
    sizes: dict[str, Any] = {"encoder": SMALL, "reward": small, "potential": small}
    card = TraitCard(reads, **{**sizes, "policy": small, **settings})
    rng = np.random.default_rng(seed)
    drawn = {name: rng.standard_normal(size) for name, size in card.shapes.items()}
    weights = {name: change(name, values).astype(np.float32) for name, values in drawn.items()}
    return TraitModel(card, weights | {"state.scale": np.ones(card.state_size, np.float32)})


def save_driver(folder: Path, seed: int = 0, knows_traits: bool | tuple[str, ...] = True) -> Path:
    """A driver that reads the traits, or some of them."""
    card = make_card("driver", TeamConfig(), NetworkConfig((8,)), knows_traits)
    rng = np.random.default_rng(seed)
    weights = {
        name: 0.4 * rng.standard_normal(shape).astype(np.float32)
        for name, shape in card.shapes.items()
    }
    save_policy(folder, card, weights)
    return folder
