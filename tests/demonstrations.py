"""Made-up demonstrations for the tests."""

from __future__ import annotations

from typing import Any

import numpy as np

from hmi_marl.demonstrations.dataset import (
    MISSING,
    Demonstrations,
    Observed,
    Truth,
    observed_layout,
)
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.scene import Scene

LAYOUT = observed_layout(TeamConfig(scene=Scene(lidar_cells=4)))
"""Nineteen columns: 4 rays, 4 lanes and five single ones, and so quick to write."""


def made_up(
    length: list[int],
    seed: int = 0,
    crash_step: list[int] | None = None,
    driver: list[int] | None = None,
    names: tuple[str, ...] = ("lisa",),
    with_seeds: bool = True,
    with_truth: bool = True,
) -> Demonstrations:
    rng = np.random.default_rng(seed)
    count, steps = len(length), max(length)
    real = np.arange(steps) < np.array(length)[:, None]
    states = rng.uniform(0, 1, (count, steps, LAYOUT.size)).astype(np.float32)
    lanes = LAYOUT["lane"]
    states[..., lanes] = np.eye(lanes.stop - lanes.start)[rng.integers(0, 4, real.shape)]
    observed = Observed(
        LAYOUT,
        states * real[..., None],
        np.where(real, rng.integers(0, 5, real.shape), MISSING),
        rng.integers(0, 2, real.shape) * real,
        np.array(length),
        np.full(count, MISSING) if crash_step is None else np.array(crash_step),
        np.zeros(count, np.int64) if driver is None else np.array(driver),
        names,
        rng.integers(0, 2**64, count, dtype=np.uint64) if with_seeds else None,
        {"hmi": "random:0.2"},
    )
    if not with_truth:
        return Demonstrations(observed)
    truth = Truth(
        rng.integers(0, 2, real.shape) * real,
        rng.integers(0, 2, real.shape) * real,
        rng.integers(0, 7, real.shape) * real,
        np.where(real, rng.integers(0, 5, real.shape), MISSING),
        rng.uniform((0, 0, 0, 1), (1, 1, 1, 9), (count, 4)),
        {"drivers": [{"name": "lisa", "beta": 0.2}]},
    )
    return Demonstrations(observed, truth)


def assert_same_observed(one: Observed, other: Observed) -> None:
    assert one.layout == other.layout
    assert one.labels() == other.labels()
    assert one.about == other.about
    for name in ("states", "actions", "alerts", "length", "crash_step"):
        given, expected = getattr(one, name), getattr(other, name)
        assert given.dtype == expected.dtype, name
        np.testing.assert_array_equal(given, expected, err_msg=name)
    assert (one.seeds is None) == (other.seeds is None)
    if one.seeds is not None:
        np.testing.assert_array_equal(one.seeds, other.seeds)


def assert_same_truth(one: Truth | None, other: Truth | None) -> None:
    assert (one is None) == (other is None)
    if one is None or other is None:
        return
    assert one.about == other.about
    for name in ("distracted", "accepted", "counter", "intended", "traits"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


def changed(instance: Any, name: str, at: Any, value: Any) -> Any:
    """A copy of one of its arrays with an entry changed."""
    array = getattr(instance, name).copy()
    array[at] = value
    return array
