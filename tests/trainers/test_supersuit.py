"""SuperSuit: its wrappers over both PettingZoo interfaces, and its vectors."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from fresh import ALL_THREADS, DRIVE_MANY, run

from hmi_marl import merge_v0

supersuit = pytest.importorskip("supersuit")

SETTINGS = {"driver": "homer", "world": "batched", "duration": 2.0}
WRAPPERS: dict[str, Callable[[Any], Any]] = {
    "frame_skip": lambda env: supersuit.frame_skip_v0(env, 2),
    "frame_skip of a random number": lambda env: supersuit.frame_skip_v0(env, (1, 3)),
    "frame_stack": lambda env: supersuit.frame_stack_v1(env, 3),
    "sticky_actions": lambda env: supersuit.sticky_actions_v0(env, 0.5),
    "delay_observations": lambda env: supersuit.delay_observations_v0(env, 2),
    "dtype": lambda env: supersuit.dtype_v0(env, np.float64),
    "clip_reward": supersuit.clip_reward_v0,
    "max_observation": lambda env: supersuit.max_observation_v0(env, 2),
    "nan_random": supersuit.nan_random_v0,
    "padded": lambda env: supersuit.pad_action_space_v0(supersuit.pad_observations_v0(env)),
    "indicator": lambda env: supersuit.agent_indicator_v0(supersuit.pad_observations_v0(env)),
    "black_death": supersuit.black_death_v3,
}
OF_PARALLEL_ALONE = {"black_death", "frame_skip of a random number"}
VECTOR = (
    DRIVE_MANY
    + """
import numpy, supersuit
from hmi_marl import merge_v0

if __name__ == "__main__":
    alone = drive_many()  # what a process did, in all its threads, before it forked
    for world in ("highway", "batched"):
        settings = {"driver": "homer", "world": world, "duration": 2.0}
        here = merge_v0.parallel_env(**settings)  # and in one
        here.reset(seed=0)
        here.step({"driver": 1, "vehicle_ai": 1})
        seen = []
        for processes in (1, 2):
            env = merge_v0.parallel_env(**settings)
            env = supersuit.pad_action_space_v0(supersuit.pad_observations_v0(env))
            cars = supersuit.pettingzoo_env_to_vec_env_v1(env)
            cars = supersuit.concat_vec_envs_v1(cars, 2, num_cpus=processes, base_class="gymnasium")
            steps = [cars.reset(seed=3)[0].copy()]
            steps += [cars.step(numpy.array([1, 0, 3, 1]))[0].copy() for _ in range(12)]
            seen.append(numpy.stack(steps))
            cars.close()
        numpy.testing.assert_array_equal(*seen)
        print("equal")
    assert drive_many() == alone
"""
)


def play_at_once(env: Any) -> list[Any]:
    seen = [env.reset(seed=1)[0]]
    actions = np.random.default_rng(0)
    while env.agents:
        chosen = {a: int(actions.integers(env.action_space(a).n)) for a in env.agents}
        observations, rewards, *_ = env.step(chosen)
        seen.append((observations, rewards))
    return seen


def play_in_turn(env: Any) -> list[Any]:
    env.reset(seed=1)
    seen: list[Any] = []
    actions = np.random.default_rng(0)
    for agent in env.agent_iter():
        observation, reward, terminated, truncated, _ = env.last()
        seen.append((observation, reward))
        over = terminated or truncated
        env.step(None if over else int(actions.integers(env.action_space(agent).n)))
    return seen


@pytest.mark.parametrize("name", WRAPPERS)
def test_a_wrapper_plays_whole_episodes_that_follow_the_seed(name: str) -> None:
    plays: list[tuple[Callable[..., Any], Callable[[Any], list[Any]]]]
    plays = [(merge_v0.parallel_env, play_at_once)]
    plays += [(merge_v0.env, play_in_turn)] * (name not in OF_PARALLEL_ALONE)
    for make, play in plays:
        first, second = (play(WRAPPERS[name](make(**SETTINGS))) for _ in range(2))
        assert len(first) > 3
        np.testing.assert_equal(first, second)


def test_two_processes_give_what_one_gives() -> None:
    assert run("-c", VECTOR, **ALL_THREADS) == "equal\nequal\n"
