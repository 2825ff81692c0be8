"""Measure the speed of training, from collecting to learning, against stable-baselines3 (SB3).

Ours is the training loop of ``hmi-marl train two-stage`` with its default settings on the batched
world: the driver's stage, then the HMI's stage with the learned driver. The alternative is
stable-baselines3's PPO on highway-env's own ``merge-generic-v1`` with its own lidar, in a process
for each core. Both drive the same road with as many other vehicles, and both learn with two
networks of the same layers, as many epochs and as many mini-batches. (SB3's networks read only the
lidar, since plain highway-env has no human.) A step is one policy step of one car, resets included.
The two alternate, round by round, after a warm-up that is not counted. Ours runs in one process,
once more in each other number of processes, in which the weights are the same, and with other
numbers of shards: more shards allow more processes, and cost some time in one.

Columns are shares of the time. Of several processes the first one's are shown, with the time in
which it waits for the others, and the first batch of a stage, in which a fresh process loads the
compiled world, is left out. Seconds of the processor are less sensitive to what else is running.

Writes JSON beside what it prints. Needs two extras: pip install 'hmi-marl[train,interop]'

Run: python benchmarks/training.py --rounds 2 --steps 1200000 --sb3-steps 2048
"""

import os

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # spinning threads slow each other down

import argparse
import platform
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import gymnasium
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.utils import set_random_seed
from stable_baselines3.common.vec_env import SubprocVecEnv

from hmi_marl import Scene
from hmi_marl.agents.learned.policy import LearnedPolicy
from hmi_marl.envs.vector import TeamVecEnv
from hmi_marl.envs.worlds.highway import highway_config
from hmi_marl.files import write_json
from hmi_marl.training.jobs import train_together
from hmi_marl.training.ppo.learner import PPOLearner
from hmi_marl.training.ppo.run import train
from hmi_marl.training.protocols.two_stage import TwoStage
from hmi_marl.training.runs.folder import read_curve
from hmi_marl.workers import cores

STAGES = {"driver": "driver", "vehicle_ai": "hmi"}
"""Name of the stage in a run's curve, by the seat that learns."""
PARTS = ("world", "partner", "policy", "record", "learn")
"""Parts of a stage's time: the world's step with the human model, rewards and observations; the
learned driver in it; acting; storing; learning."""
WAIT = "wait"
"""Part of the time of several processes: waiting for each other."""

Seconds = dict[str, dict[str, float]]
"""Seconds spent in each part of each stage."""


class Stopwatch:
    """Add up the time of each part of our loop, by timing a few methods within a context."""

    def __init__(self) -> None:
        self.seconds: Seconds = {stage: dict.fromkeys(PARTS, 0.0) for stage in STAGES.values()}
        self._stage = "driver"
        self._in_world = False

    @contextmanager
    def running(self) -> Iterator[None]:
        """Time the block."""
        with ExitStack() as stack:
            for owner, method, part in (
                (TeamVecEnv, "reset", "world"),
                (TeamVecEnv, "step", "world"),
                (LearnedPolicy, "act", "partner"),
                (PPOLearner, "act", "policy"),
                (PPOLearner, "record", "record"),
                (PPOLearner, "learn", "learn"),
            ):
                timed = self._timed(getattr(owner, method), part)
                stack.enter_context(patch.object(owner, method, timed))
            yield

    def _timed(self, function: Callable[..., Any], part: str) -> Callable[..., Any]:
        def timed(subject: Any, *args: Any, **kwargs: Any) -> Any:
            if part == "partner" and not self._in_world:  # an environment is being made
                return function(subject, *args, **kwargs)
            if part == "world":
                self._stage, self._in_world = STAGES[subject.seat], True
            start = time.perf_counter()
            result = function(subject, *args, **kwargs)
            spent = time.perf_counter() - start
            self.seconds[self._stage][part] += spent
            if part == "partner":  # it acts inside the world's step
                self.seconds[self._stage]["world"] -= spent
            if part == "world":
                self._in_world = False
            return result

        return timed


def run_ours(settings: TwoStage) -> dict[str, dict[str, float]]:
    """Train once in a temporary folder; return the time of each stage, and of the whole."""
    watch = Stopwatch()
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        with watch.running():
            train(settings, Path(folder), quiet=True)
        whole = time.perf_counter() - start
        curve = read_curve(Path(folder))
    rows, before = {}, 0
    for name, parts in watch.seconds.items():
        batches = [batch for batch in curve if batch["phase"] == name]
        steps = batches[-1]["steps"] - before
        before = batches[-1]["steps"]
        # All batches of a stage have the same number of steps, so speeds give their times.
        seconds = sum(steps / len(batches) / batch["steps_per_second"] for batch in batches)
        rows[f"ours, {name} stage"] = _row(steps, seconds, parts)
    both = {part: sum(parts[part] for parts in watch.seconds.values()) for part in PARTS}
    rows["ours, both and all else"] = _row(before, whole, both)
    return rows


def run_shards(settings: TwoStage, shards: int) -> dict[str, dict[str, float]]:
    """Train once in one process with so many shards; return the time of all."""
    start = time.process_time()
    rows = run_ours(replace(settings, shards=shards))
    row = rows["ours, both and all else"]
    processor = {"processor_seconds": time.process_time() - start}
    return {f"ours, {shards} shard{'s' * (shards > 1)}": row | processor}


def run_processes(settings: TwoStage, processes: int) -> dict[str, dict[str, float]]:
    """Train once in several processes together; return the time of each stage."""
    settings = replace(settings, shards=max(settings.shards, processes))
    with tempfile.TemporaryDirectory() as folder:
        train_together(settings, Path(folder), processes, quiet=True)
        curve = read_curve(Path(folder))
    rows = {}
    for name in STAGES.values():
        batches = [batch for batch in curve if batch["phase"] == name]
        batches = batches[1:] or batches
        each = settings.num_teams * settings.team("homer").horizon
        seconds = [each / batch["steps_per_second"] for batch in batches]

        def spent(share: str, batches: Any = batches, seconds: Any = seconds) -> float:
            pairs = zip(batches, seconds, strict=True)
            return sum(batch[share] * time_of_it for batch, time_of_it in pairs)

        waiting = spent("share_of_time_waiting")
        parts = {"learn": spent("share_of_time_learning") - waiting, WAIT: waiting}
        rows[f"ours, {name}, {processes} processes"] = _row(
            len(batches) * each, sum(seconds), parts
        )
    return rows


def _row(steps: int, seconds: float, parts: dict[str, float]) -> dict[str, float]:
    shares = {part: spent / seconds for part, spent in parts.items()}
    rest = {"rest": 1 - sum(shares.values())}
    return {"steps": steps, "seconds": seconds, "steps_per_s": steps / seconds} | shares | rest


class StableBaselines:
    """SB3's PPO on plain highway-env, one process for each core."""

    def __init__(self, settings: TwoStage, processes: int, batch: int) -> None:
        scene: Scene = settings.team(settings.drivers).scene
        lidar = {"cells": scene.lidar_cells, "maximum_range": scene.lidar_range}
        config = highway_config(scene) | {
            "vehicles_count": scene.vehicle_range[1],
            "observation": {"type": "LidarObservation"} | lidar,
        }
        horizon = settings.team(settings.drivers).horizon
        make = partial(
            gymnasium.make,
            "highway_env:merge-generic-v1",
            config=config,
            max_episode_steps=horizon,
        )
        set_random_seed(settings.seed)
        self._env = SubprocVecEnv([make] * processes)
        activation = {"relu": torch.nn.ReLU, "elu": torch.nn.ELU, "tanh": torch.nn.Tanh}
        ppo, network = settings.ppo, settings.network
        self._model = PPO(
            "MlpPolicy",
            self._env,
            n_steps=batch,
            n_epochs=ppo.num_learning_epochs,
            batch_size=max(2, processes * batch // ppo.num_mini_batches),
            gamma=ppo.gamma,
            gae_lambda=ppo.gae_lambda,
            policy_kwargs={
                "net_arch": list(network.hidden_dims),
                "activation_fn": activation[network.activation],
            },
            seed=settings.seed,
            device="cpu",
        )

    def run(self, steps: int) -> dict[str, float]:
        """Learn for ``steps``, rounded up to whole batches, and return the time."""
        parts = dict.fromkeys(("world", "learn"), 0.0)

        def timed(function: Callable[..., Any], part: str) -> Callable[..., Any]:
            def call(*args: Any, **kwargs: Any) -> Any:
                start = time.perf_counter()
                result = function(*args, **kwargs)
                parts[part] += time.perf_counter() - start
                return result

            return call

        env, model = self._env, self._model
        with (
            patch.object(env, "step", timed(env.step, "world")),
            patch.object(model, "train", timed(model.train, "learn")),
        ):
            start = time.perf_counter()
            model.learn(steps)
            seconds = time.perf_counter() - start
        return _row(model.num_timesteps, seconds, parts)

    def close(self) -> None:
        """End the processes."""
        self._env.close()


def measure(args: argparse.Namespace) -> list[dict[str, Any]]:
    """Measure in alternation; return medians over the rounds, and ratios to SB3 by round."""
    fixed = {
        "vehicles": (args.vehicles, args.vehicles),
        "num_teams": args.num_teams,
        "device": "cpu",
    }
    settings = TwoStage(driver_steps=args.steps // 2, hmi_steps=args.steps // 2, **fixed)
    sb3 = StableBaselines(settings, max(args.processes), args.sb3_batch)
    rounds: list[dict[str, dict[str, float]]] = []
    try:
        run_ours(TwoStage(driver_steps=1, hmi_steps=1, **fixed))  # compiles
        sb3.run(1)
        for number in range(args.rounds):
            print(f"round {number + 1} of {args.rounds}", flush=True)
            ours = run_ours(settings)
            for count in args.processes:
                if count > 1:
                    ours |= run_processes(settings, count)
            for count in args.shards:
                ours |= run_shards(settings, count)
            rounds.append(ours | {"SB3": sb3.run(args.sb3_steps)})
    finally:
        sb3.close()
    rows = []
    for name in rounds[0]:
        measured = {
            key: float(np.median([turn[name][key] for turn in rounds])) for key in rounds[0][name]
        }
        ratios = [turn[name]["steps_per_s"] / turn["SB3"]["steps_per_s"] for turn in rounds]
        spread = {"ratio": float(np.median(ratios)), "ratios": ratios}
        rows.append({"name": name} | measured | spread)
    return rows


def as_text(rows: list[dict[str, Any]]) -> str:
    """Return a table as text."""
    names = (*PARTS, WAIT, "rest")
    head = "".join(f"{name:>9}" for name in names)
    lines = [f"{'':<27}{'steps':>10}{'steps/s':>10}{'ratio':>9}{'s per 1e6':>11}{head}"]
    for row in rows:
        shares = "".join(f"{row[name]:>9.0%}" if name in row else f"{'':>9}" for name in names)
        lines.append(
            f"{row['name']:<27}{row['steps']:>10,.0f}{row['steps_per_s']:>10,.0f}"
            f"{row['ratio']:>9,.1f}{1e6 / row['steps_per_s']:>11,.1f}{shares}"
        )
    return "\n".join(lines)


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    available = cores()
    whole = {"type": int, "metavar": "N"}
    parser.add_argument("--rounds", **whole, default=2, help="rounds")
    parser.add_argument(
        "--steps", **whole, default=1_200_000, help="our steps in a round, half in each stage"
    )
    parser.add_argument(
        "--num-teams", **whole, default=TwoStage().num_teams, help="our teams in a batch"
    )
    parser.add_argument("--sb3-steps", **whole, default=2048, help="SB3's steps in a round")
    parser.add_argument(
        "--sb3-batch", **whole, default=256, help="steps of each process in a batch"
    )
    parser.add_argument(
        "--processes",
        **whole,
        nargs="+",
        default=sorted({1, available}),
        help="processes of our runs; SB3 has the most of them",
    )
    parser.add_argument(
        "--shards", **whole, nargs="*", default=[1, 2, 4], help="shards of runs in one process"
    )
    parser.add_argument(
        "--vehicles",
        **whole,
        default=10,
        help="other vehicles; by default about the mean of 1 to 20",
    )
    parser.add_argument("--out", type=Path, default=Path("runs/bench/training.json"))
    args = parser.parse_args()
    rows = measure(args)
    print(as_text(rows))
    config = {name: value for name, value in vars(args).items() if name != "out"}
    machine = {
        "machine": platform.machine(),
        "system": platform.system(),
        "cores": available,
        "torch": torch.__version__,
        "numpy": np.__version__,
        "threads": 1,
        "shards": TwoStage().shards,
    }
    write_json(args.out, {"config": config, "machine": machine, "rows": rows})
    print(f"written: {args.out}")


if __name__ == "__main__":
    main()
