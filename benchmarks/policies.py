"""Measure whether threads of NumPy and torch slow the batched world's, and the other way round.

OpenMP's and BLAS's threads wait actively for a while after a parallel loop, and may take the cores
that the world's threads need. Each policy (a network of two hidden layers) drives N teams in a
process of its own with one thread and with all: once as a user would start it, and once with
OMP_WAIT_POLICY=PASSIVE, which lets OpenMP's threads sleep. All of them run in every round, and
the median over rounds of the ratios within a round counts: "to passive" is the speed relative to
the same run under OMP_WAIT_POLICY=PASSIVE, "to one thread" relative to one thread.

``small product`` is a loop of one matrix product in NumPy and one step of a world.

Also writes what it prints as JSON. Needs an extra: pip install 'hmi-marl[train]'

Run: python benchmarks/policies.py --teams 512 --rounds 5
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

HIDDEN = 64
POLICIES = ("numpy", "torch", "small product")


def numpy_driver(teams: int, threads: int | None) -> Callable[[], int]:
    """A network in NumPy that drives ``make_vec``; each call is one step of all teams."""
    import torch

    import hmi_marl

    env = hmi_marl.make_vec(teams, seat="driver", partner="never", threads=threads)
    observations = env.get_observations()
    rng = np.random.default_rng(0)
    sizes = (observations["driver"].shape[1], HIDDEN, HIDDEN, 5)
    weights = [rng.normal(size=shape) / 8 for shape in pairwise(sizes)]

    def step() -> int:
        nonlocal observations
        values = observations["driver"].numpy().astype(np.float64)
        for weight in weights:
            values = np.tanh(values @ weight)
        observations, *_ = env.step(torch.from_numpy(values.argmax(axis=1)[:, None]))
        return teams

    return step


def torch_driver(teams: int, threads: int | None) -> Callable[[], int]:
    """The same network in torch, with torch's default number of threads."""
    import torch

    import hmi_marl

    if threads is not None:
        torch.set_num_threads(threads)
    env = hmi_marl.make_vec(teams, seat="driver", partner="never", threads=threads)
    observations = env.get_observations()
    network = torch.nn.Sequential(
        torch.nn.Linear(observations["driver"].shape[1], HIDDEN),
        torch.nn.Tanh(),
        torch.nn.Linear(HIDDEN, HIDDEN),
        torch.nn.Tanh(),
        torch.nn.Linear(HIDDEN, 5),
    )

    def step() -> int:
        nonlocal observations
        with torch.no_grad():
            actions = network(observations["driver"]).argmax(dim=1, keepdim=True)
        observations, *_ = env.step(actions)
        return teams

    return step


def small_product(teams: int, threads: int | None) -> Callable[[], int]:
    """One product of small matrices in NumPy, then one step of a world."""
    from hmi_marl import Scene
    from hmi_marl.envs.worlds import make_world

    world = make_world("batched", Scene().fitted(20.0), teams, threads)
    everywhere, keep = np.ones(teams, np.bool_), np.ones(teams, np.int64)
    left, right = np.ones((teams, 64)), np.ones((64, 64))
    steps = 0

    def step() -> int:
        nonlocal steps
        if steps % 100 == 0:
            world.reset(np.arange(teams, dtype=np.uint64), np.ones(teams), everywhere)
        steps += 1
        left @ right
        world.step(keep, everywhere)
        return teams

    return step


DRIVERS = dict(zip(POLICIES, (numpy_driver, torch_driver, small_product), strict=True))


def measure(policy: str, teams: int, threads: int | None, seconds: float) -> float:
    """Steps per second in this process."""
    step = DRIVERS[policy](teams, threads)
    for _ in range(5):
        step()
    taken, start = 0, time.perf_counter()
    while (spent := time.perf_counter() - start) < seconds:
        taken += step()
    return taken / spent


def in_a_process(
    policy: str, threads: int | None, passive: bool, args: argparse.Namespace
) -> float:
    """Steps per second in a fresh process; one thread means one for BLAS and OpenMP too."""
    env = {name: value for name, value in os.environ.items() if name != "OMP_WAIT_POLICY"}
    if passive:
        env["OMP_WAIT_POLICY"] = "PASSIVE"
    if threads is not None:
        env |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), str(threads))
    command = [sys.executable, __file__, "--measure", policy, "--threads", str(threads or 0)]
    command += ["--teams", str(args.teams), "--seconds", str(args.seconds)]
    run = subprocess.run(command, env=env, capture_output=True, text=True, check=True)
    return float(run.stdout.split()[-1])


def compare(args: argparse.Namespace) -> list[dict[str, Any]]:
    """Measure everything round by round and return the rows of the table."""
    runs = [(policy, n, passive) for policy in POLICIES for n in (1, None) for passive in (0, 1)]
    speeds: dict[tuple[str, int | None, int], list[float]] = {run: [] for run in runs}
    for _ in tqdm(range(args.rounds), desc="rounds"):
        for policy, threads, passive in runs:
            speed = in_a_process(policy, threads, bool(passive), args)
            speeds[policy, threads, passive].append(speed)
    rows = []
    for policy in POLICIES:
        for threads in (1, None):
            usual, passive = (np.array(speeds[policy, threads, mode]) for mode in (0, 1))
            rows.append(
                {
                    "policy": policy,
                    "threads": "one" if threads == 1 else "all",
                    "steps_per_s": float(np.median(usual)),
                    "to_passive": float(np.median(usual / passive)),
                    "to_one_thread": float(np.median(usual / np.array(speeds[policy, 1, 0]))),
                }
            )
    return rows


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--teams", type=int, default=512, help="N, cars in one batch")
    parser.add_argument("--rounds", type=int, default=5, help="times that each is measured")
    parser.add_argument("--seconds", type=float, default=3.0, help="that each measurement takes")
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/policies.json"))
    parser.add_argument("--measure", choices=POLICIES, help=argparse.SUPPRESS)
    parser.add_argument("--threads", type=int, default=0, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.measure:
        print(measure(args.measure, args.teams, args.threads or None, args.seconds))
        return
    rows = compare(args)
    print(f"{'policy':<14}{'threads':>8}{'steps/s':>12}{'to passive':>12}{'to one thread':>15}")
    for row in rows:
        print(
            f"{row['policy']:<14}{row['threads']:>8}{row['steps_per_s']:>12,.0f}"
            f"{row['to_passive']:>12.2f}{row['to_one_thread']:>15.2f}"
        )
    args.out.parent.mkdir(parents=True, exist_ok=True)
    args.out.write_text(json.dumps({"teams": args.teams, "rows": rows}, indent=2) + "\n")
    print(f"written: {args.out}")


if __name__ == "__main__":
    main()
