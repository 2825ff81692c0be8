"""Measure the speed of recording a population against the vector environment of as many teams.

Three take turns, round by round, in one process on the same number of threads, after a warm-up that
is not counted. Each takes the same number of steps, of drivers with independent traits:

- ``collect``: as ``hmi-marl collect`` does it, from the draw of the traits to both files and the
  summary: playing, checks, checksums, compression.
- ``acting``: ``make_vec`` for the driver's seat, with the same driver policy acting and the same
  HMI alerting at random; nothing is recorded.
- ``alone``: the same environment in the same episodes, given the actions that the policy took, so
  that no policy acts. This is the harder bar.

Both environments compute the two observations that a recording needs, and no others. A ratio is the
median over the rounds of collect's speed by the environment's in the same round, by the clock and
by seconds of the processor, which are less sensitive to what else is running.

Writes JSON beside what it prints. Needs two extras: pip install 'hmi-marl[train,data]'

Run: python benchmarks/collecting.py --rounds 5
"""

from __future__ import annotations

import argparse
import os
import platform
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hmi_marl.demonstrations.recording import CollectSettings

CONTESTANTS = ("collect", "acting", "alone")
CLOCKS: dict[str, Callable[[], float]] = {"wall": time.perf_counter, "cpu": time.process_time}


def record(settings: CollectSettings) -> None:
    """Record the population into files that are removed afterwards."""
    from hmi_marl.demonstrations.parquet import write_demonstrations
    from hmi_marl.demonstrations.recording import Summary, collect

    summary = Summary(settings)
    with tempfile.TemporaryDirectory() as folder:
        write_demonstrations(Path(folder), summary.counting(collect(settings)))
    assert sum(row["steps"] for row in summary.as_json()) == settings.total_steps


class Environment:
    """The vector environment with the teams, drivers and HMI of a recording."""

    def __init__(self, settings: CollectSettings) -> None:
        import torch

        import hmi_marl
        from hmi_marl.envs.drivers import TraitDistributions
        from hmi_marl.envs.vector import TeamVecEnv

        config = settings.team(TraitDistributions())
        self._tensor = torch.from_numpy
        self._driver = settings.make_driver(config)
        self._env: TeamVecEnv = hmi_marl.make_vec(
            settings.num_teams,
            seat="driver",
            partner=settings.make_hmi(config),
            **{field.name: getattr(config, field.name) for field in fields(config)},
        )
        self._env.groups = ("driver", "vehicle_ai")
        self._seed = settings.seed
        self._steps = settings.total_steps // settings.num_teams
        self._horizon = config.horizon
        self._taken: NDArray[np.int64] = np.zeros((0, settings.num_teams), np.int64)
        """The driver's actions in each step."""

    def act(self) -> None:
        """Take the steps with the driver policy acting."""
        self._taken = np.array(list(self._acts()))

    def _acts(self) -> Iterator[NDArray[np.int64]]:
        observations, _ = self._env.reset(self._seed)
        for step in range(self._steps):
            if step % self._horizon == 0:  # no crash ends an episode, so all end together
                self._driver.reset(self._env.teaming.seeds)
            actions = self._driver.act(observations["driver"].numpy())
            yield actions
            observations, *_ = self._env.step(self._tensor(actions[:, None]))

    def replay(self) -> None:
        """Take the same steps, given the actions."""
        self._env.reset(self._seed)
        for actions in self._taken:
            self._env.step(self._tensor(actions[:, None]))


def measure(settings: CollectSettings, rounds: int) -> dict[str, Any]:
    """Return steps/s of every contestant by each clock, and the ratios of collect to the others."""
    environment = Environment(settings)
    runs: dict[str, Callable[[], None]] = {
        "collect": lambda: record(settings),
        "acting": environment.act,
        "alone": environment.replay,
    }
    speeds: dict[str, dict[str, list[float]]] = {
        name: {clock: [] for clock in CLOCKS} for name in CONTESTANTS
    }
    for each in range(rounds + 1):
        for name, run in runs.items():
            before = {clock: now() for clock, now in CLOCKS.items()}
            run()
            for clock, now in CLOCKS.items():
                speed = settings.total_steps / (now() - before[clock])
                if each:  # the first is the warm-up
                    speeds[name][clock].append(speed)
    ratios = {
        name: {
            clock: np.quantile(
                np.array(speeds["collect"][clock]) / speeds[name][clock], (0.5, 0, 1)
            ).tolist()
            for clock in CLOCKS
        }
        for name in ("acting", "alone")
    }
    return {"steps_per_s": speeds, "ratios_median_least_most": ratios}


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    whole = {"type": int, "metavar": "N"}
    parser.add_argument("--population", **whole, default=512, help="drivers of a round")
    parser.add_argument("--num-teams", **whole, default=512, help="teams in one batch")
    parser.add_argument("--threads", **whole, help="of the world; all cores by default")
    parser.add_argument("--rounds", **whole, default=5, help="times that each is measured")
    parser.add_argument("--driver-policy", default="trained:driver", help="as of collect")
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/collecting.json"))
    args = parser.parse_args()
    if args.threads is not None:
        os.environ["NUMBA_NUM_THREADS"] = str(args.threads)  # read when numba is imported
    from hmi_marl.demonstrations.recording import CollectSettings
    from hmi_marl.envs.worlds.batched.threads import available
    from hmi_marl.files import write_json

    settings = CollectSettings(
        drivers=(),
        population=args.population,
        driver_policy=args.driver_policy,
        num_teams=args.num_teams,
    )
    if settings.total_steps % (args.num_teams * settings.team("average").horizon):
        parser.error("--num-teams divides the windows, 16 of each driver")
    found = measure(settings, args.rounds)
    print(f"{args.num_teams} teams, {available()} threads, {settings.total_steps:,} steps a round")
    print(f"{'':<10}{'steps/s':>12}{'per s of CPU':>14}{'collect is':>12}{'by CPU':>8}")
    for name in CONTESTANTS:
        wall, cpu = (np.median(found["steps_per_s"][name][clock]) for clock in CLOCKS)
        line = f"{name:<10}{wall:>12,.0f}{cpu:>14,.0f}"
        if name != "collect":
            of = found["ratios_median_least_most"][name]
            line += f"{of['wall'][0]:>12.2f}{of['cpu'][0]:>8.2f}"
        print(line)
    config = {name: value for name, value in vars(args).items() if name != "out"}
    machine = {"machine": platform.machine(), "threads": available()}
    write_json(args.out, {"config": config, "machine": machine} | found)
    print(f"written: {args.out}")


if __name__ == "__main__":
    main()
