"""RLlib's two wrappers of PettingZoo, and PPO over them, here and in a process of its own."""

import numpy as np
import pytest
from fresh import run_example

pytest.importorskip("tree")  # of RLlib; Ray itself is imported for nothing where that is missing
pytest.importorskip("ray.rllib")

from hmi_marl import merge_v0

pytestmark = pytest.mark.filterwarnings("default")
SETTINGS = {"driver": "homer", "world": "batched", "duration": 2.0}
AGENTS = ("driver", "vehicle_ai")


def test_taking_turns() -> None:
    from ray.rllib.env.wrappers.pettingzoo_env import PettingZooEnv

    env, ours = PettingZooEnv(merge_v0.env(**SETTINGS)), merge_v0.env(**SETTINGS)
    assert set(env.possible_agents) == set(AGENTS)
    seen, _ = env.reset(seed=1)
    ours.reset(seed=1)
    turn = 0
    while ours.agents and not (ours.terminations["driver"] or ours.truncations["driver"]):
        agent = AGENTS[turn % 2]
        assert list(seen) == [agent]
        assert env.observation_spaces[agent].contains(seen[agent])
        np.testing.assert_array_equal(seen[agent], ours.observe(agent))
        action = np.int64(turn % env.action_spaces[agent].n)
        seen, rewards, terminated, truncated, _ = env.step({agent: action})
        ours.step(action)
        turn += 1
    assert terminated["__all__"] or truncated["__all__"]
    assert set(seen) == set(rewards) == set(AGENTS), "each learns how it ended"


def test_both_at_once() -> None:
    from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv

    env = ParallelPettingZooEnv(merge_v0.parallel_env(**SETTINGS))
    seen, _ = env.reset(seed=1)
    steps, over = 0, False
    while not over:
        for agent in AGENTS:
            assert env.observation_space[agent].contains(seen[agent])
        actions = {agent: np.int64(steps % 2) for agent in AGENTS}
        seen, rewards, terminated, truncated, _ = env.step(actions)
        assert set(rewards) == set(AGENTS)
        over = terminated["__all__"] or truncated["__all__"]
        steps += 1
    assert 0 < steps <= 10


@pytest.mark.parametrize(
    ("world", "turns", "runners"),
    [
        ("highway", True, "1"),
        ("batched", True, "1"),
        ("batched", False, "1"),
        ("batched", True, "0"),
    ],
)
def test_the_example_learns(world: str, turns: bool, runners: str) -> None:
    size = ["--iterations", "1", "--batch", "40", "--duration", "2", "--runners", runners]
    printed = run_example("rllib_ppo", "--world", world, *size, *["--turns"] * turns)
    assert "'driver':" in printed
    assert "'vehicle_ai':" in printed
