"""Stable-Baselines3: its check, its vectors, and PPO over them."""

import gymnasium
import numpy as np
import pytest
from fresh import ALL_THREADS, DRIVE_MANY, run

import hmi_marl  # noqa: F401

pytest.importorskip("stable_baselines3")

SEATS = ("hmi_marl/MergeDriver-v0", "hmi_marl/MergeHMI-v0")
FORKED = (
    DRIVE_MANY.replace("{", "{{").replace("}", "}}")
    + """
import gymnasium, hmi_marl
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import SubprocVecEnv

if __name__ == "__main__":
    alone = drive_many()  # what a process did, in all its threads, before it forked
    for world, seat in {cars!r}:
        settings = {{"driver": "homer", "world": world, "duration": 2.0}}
        here = gymnasium.make(seat, **settings)  # and in one
        here.reset(seed=0)
        here.step(1)
        cars = make_vec_env(
            "hmi_marl:" + seat,  # the module to import in a process of its own
            n_envs={cars_at_once},
            seed=0,
            env_kwargs=settings,
            vec_env_cls=SubprocVecEnv,
            vec_env_kwargs={{"start_method": {method!r}}},
        )
        model = PPO("MlpPolicy", cars, n_steps=16, batch_size=16, n_epochs=1, device="cpu", seed=0)
        model.learn(64)
        action, _ = model.predict(here.reset(seed=1)[0])
        here.step(action)
        cars.close()
        print(model.num_timesteps)
    assert drive_many() == alone
"""
)
CARS = [(world, seat) for world in ("highway", "batched") for seat in SEATS]


@pytest.mark.parametrize("seat", SEATS)
@pytest.mark.parametrize("world", ["highway", "batched"])
def test_its_own_check(world: str, seat: str) -> None:
    from stable_baselines3.common.env_checker import check_env

    check_env(gymnasium.make(seat, world=world, duration=2.0).unwrapped)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_ppo_in_processes(method: str) -> None:
    at_once = 1 if method == "spawn" else 2
    code = FORKED.format(cars=CARS, method=method, cars_at_once=at_once)
    assert run("-c", code, **ALL_THREADS) == "64\n" * len(CARS)


@pytest.mark.parametrize("seat", SEATS)
def test_what_a_policy_predicts_is_taken(seat: str) -> None:
    from stable_baselines3 import DQN

    env = gymnasium.make(seat, world="batched", duration=2.0)
    model = DQN("MlpPolicy", env, device="cpu", seed=0, learning_starts=10, buffer_size=100)
    model.learn(30)
    action, _ = model.predict(env.reset(seed=0)[0], deterministic=True)
    assert np.shape(action) == ()
    env.step(action)
