"""Tianshou: its vectors of a seat, and its wrapper of PettingZoo for both."""

import gymnasium
import numpy as np
import pytest
from fresh import run_example

pytest.importorskip("tianshou")

import hmi_marl  # noqa: F401

pytestmark = pytest.mark.filterwarnings("default")
SETTINGS = {"driver": "homer", "world": "batched", "duration": 2.0}


@pytest.mark.parametrize("seat", ["MergeDriver", "MergeHMI"])
def test_a_vector_is_its_environments(seat: str) -> None:
    from tianshou.env import DummyVectorEnv

    def make() -> gymnasium.Env:
        return gymnasium.make(f"hmi_marl/{seat}-v0", **SETTINGS)

    cars, alone = DummyVectorEnv([make, make]), make()
    cars.seed([4, 5])  # which resets each, so that the next reset is their second episode
    seen, _ = cars.reset()
    alone.reset(seed=5)
    np.testing.assert_array_equal(seen[1], alone.reset()[0])
    seen, rewards, *_ = cars.step(np.array([1, 0]))
    expected, reward, *_ = alone.step(0)
    np.testing.assert_array_equal(seen[1], expected)
    assert rewards[1] == pytest.approx(reward)


@pytest.mark.parametrize("processes", [False, True])
@pytest.mark.parametrize("world", ["highway", "batched"])
def test_the_example_learns(world: str, processes: bool) -> None:
    size = ["--steps", "20", "--cars", "2", "--duration", "2"]
    printed = run_example("tianshou_dqn", "--world", world, *size, *["--processes"] * processes)
    assert "one seat 20" in printed
    assert "both seats 20" in printed
