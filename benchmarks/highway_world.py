"""What does a team's step cost on the highway world, beside plain highway-env's own step?

Both drive the same scenes with the same actions, in turns, in one process; the world's physics is
highway-env's in both. Writes JSON beside what it prints.

Run: python benchmarks/highway_world.py --steps 60 --vehicles 5 10 20
"""

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import gymnasium
import highway_env  # noqa: F401 (registers its environments)
import numpy as np

from hmi_marl import Driver, Scene, merge_v0
from hmi_marl.envs.worlds.highway import highway_config

ATTENTIVE = Driver("attentive", beta=0.0, alpha=1.0, eta=0.0, inflation=3.0)


def plain(scene: Scene) -> Callable[[int | None], None]:
    """highway-env's own environment with its own lidar."""
    config = highway_config(scene) | {
        "vehicles_count": scene.vehicles,
        "observation": {"type": "LidarObservation"},
    }
    env = gymnasium.make("merge-generic-v1", config=config).unwrapped
    return lambda seed: env.step(1) if seed is None else env.reset(seed=seed)


def team(scene: Scene) -> Callable[[int | None], None]:
    """Our parallel environment: chain, rewards, both observations."""
    env = merge_v0.parallel_env(driver=ATTENTIVE, scene=scene, end_at_crash=False, duration=100.0)
    actions = {"driver": 1, "vehicle_ai": 0}
    return lambda seed: env.step(actions) if seed is None else env.reset(seed=seed)


def seconds_per_step(run: Callable[[int | None], None], steps: int, seed: int) -> float:
    run(seed)
    start = time.perf_counter()
    for _ in range(steps):
        run(None)
    return (time.perf_counter() - start) / steps


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=60, help="timed in each turn")
    parser.add_argument("--turns", type=int, default=5)
    parser.add_argument("--vehicles", type=int, nargs="+", default=[5, 10, 20])
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/highway_world.json"))
    args = parser.parse_args()
    rows = []
    print(f"{'vehicles':>8}{'highway-env':>14}{'our team':>12}{'ratio':>8}")
    for vehicles in args.vehicles:
        scene = Scene(vehicles=vehicles).fitted(100.0)
        runs = [plain(scene), team(scene)]
        for run in runs:
            seconds_per_step(run, 5, 0)  # warm-up
        times = np.array(
            [
                [seconds_per_step(run, args.steps, turn) for run in runs]
                for turn in range(args.turns)
            ]
        )
        ours, theirs = 1 / np.median(times[:, 1]), 1 / np.median(times[:, 0])
        ratio = float(np.median(times[:, 1] / times[:, 0]))
        rows.append(
            {
                "vehicles": vehicles,
                "highway_env_steps_per_s": theirs,
                "team_steps_per_s": ours,
                "cost_ratio": ratio,
            }
        )
        print(f"{vehicles:>8}{theirs:>10.0f} st/s{ours:>8.0f} st/s{ratio:>7.2f}x")
    args.out.parent.mkdir(parents=True, exist_ok=True)
    args.out.write_text(json.dumps(rows, indent=2) + "\n")
    print(f"written: {args.out}")


if __name__ == "__main__":
    main()
