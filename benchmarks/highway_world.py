"""Cost of a team's step on the highway world, compared with highway-env's own step.

Both drive the same scenes with the same actions, turn by turn, in one process. highway-env's step
computes its own lidar and reward; a team's step the attention chain, the eight reward terms and
both seats' observations, with a lidar each. Also writes what it prints as JSON.

Run: python benchmarks/highway_world.py --steps 100 --vehicles 5 10 20
"""

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from hmi_marl import Driver, Scene, merge_v0
from hmi_marl.envs.scene import draw_start
from hmi_marl.envs.worlds.highway import MergeScene

ATTENTIVE = Driver("attentive", beta=0.0, alpha=1.0, eta=0.0, inflation=3.0)
KEEP_SPEED = 1

Step = Callable[[], bool]
"""Takes one step and returns whether the car crashed."""


def highway_env_alone(scene: Scene) -> Callable[[int], Step]:
    """Return highway-env's own step with its own lidar; call with a seed to start an episode."""
    env = MergeScene(scene)
    env.configure({"observation": {"type": "LidarObservation"}})
    env.define_spaces()

    def begin(seed: int) -> Step:
        env.restart(draw_start(scene, seed))
        env.define_spaces()
        return lambda: bool(env.step(KEEP_SPEED)[2] and env.vehicle.crashed)

    return begin


def team(scene: Scene) -> Callable[[int], Step]:
    """Return the parallel environment's step; call with a seed to start an episode."""
    env = merge_v0.parallel_env(driver=ATTENTIVE, scene=scene)
    actions = {"driver": KEEP_SPEED, "vehicle_ai": 0}

    def begin(seed: int) -> Step:
        env.reset(seed=seed)
        return lambda: env.step(actions)[4]["driver"]["crashed"]

    return begin


def seconds_per_step(begin: Callable[[int], Step], seed: int, steps: int) -> float:
    """Mean time of a step over one episode of at most ``steps`` steps, resets left out."""
    step, taken, crashed = begin(seed), 0, False
    start = time.perf_counter()
    while taken < steps and not crashed:
        crashed = step()
        taken += 1
    return (time.perf_counter() - start) / taken


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--steps", type=int, default=100, help="at most, in each episode (1 to 100)"
    )
    parser.add_argument("--episodes", type=int, default=5)
    parser.add_argument("--vehicles", type=int, nargs="+", default=[5, 10, 20])
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/highway_world.json"))
    args = parser.parse_args()
    rows = []
    print(f"{'vehicles':>8}{'highway-env':>16}{'team':>16}{'cost ratio':>12}")
    for vehicles in args.vehicles:
        scene = Scene(vehicles=vehicles).fitted(20.0)
        both = highway_env_alone(scene), team(scene)
        for begin in both:
            seconds_per_step(begin, 0, 5)  # warm-up
        times = np.array(
            [
                [seconds_per_step(begin, seed, args.steps) for begin in both]
                for seed in range(args.episodes)
            ]
        )
        alone, with_team = 1 / np.median(times, axis=0)
        ratio = float(np.median(times[:, 1] / times[:, 0]))
        rows.append(
            {
                "vehicles": vehicles,
                "highway_env_steps_per_s": alone,
                "team_steps_per_s": with_team,
                "cost_ratio": ratio,
            }
        )
        print(f"{vehicles:>8}{alone:>8.0f} steps/s{with_team:>8.0f} steps/s{ratio:>11.2f}x")
    args.out.parent.mkdir(parents=True, exist_ok=True)
    args.out.write_text(json.dumps(rows, indent=2) + "\n")
    print(f"written: {args.out}")


if __name__ == "__main__":
    main()
