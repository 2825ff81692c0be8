"""A custom experiment: exact and played returns by N, how long an alert stays in effect.

An experiment is a frozen dataclass of settings with run, numbers, judge and blocks. Registered, it
is a subcommand of hmi-marl reproduce that writes a page, a text and JSON.

Run: python examples/new_experiment.py --episodes 200 --windows 3 7 11
"""

import argparse
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from hmi_marl import TeamConfig, make_driver_policy, make_hmi, oracle
from hmi_marl.checks import Count
from hmi_marl.cli import main
from hmi_marl.envs.streams import Seed, episode_seed
from hmi_marl.experiments.episodes import play_episodes
from hmi_marl.experiments.experiment import Experiment
from hmi_marl.experiments.registry import EXPERIMENTS, Where
from hmi_marl.reporting import statistics
from hmi_marl.reporting.blocks import Table, Text
from hmi_marl.reporting.verdicts import Part, Verdict


@dataclass(frozen=True)
class WindowLength(Experiment):
    """Compare intervention windows N: the exact optimum, and the same played.

    Example: hmi-marl reproduce window --windows 3 7 11
    """

    drivers: tuple[str, ...] = ("marge", "homer")
    """Drivers."""
    windows: tuple[int, ...] = (1, 3, 7, 11)
    """Numbers of steps that an alert stays in effect."""
    episodes: Count = 500
    """Episodes played for each driver and window."""
    seed: Seed = 0
    """First seed of the episodes."""

    name = "window"
    title = "The intervention window"

    @classmethod
    def quick(cls):
        """Return a coarse version, for --quick."""
        return cls(windows=(1, 7), episodes=100)

    def run(self, place):
        """Return, for each driver and window, the exact optimum and the returns played."""
        results = []
        cases = [(name, window) for name in self.drivers for window in self.windows]
        for name, window in place.each(cases, "cases"):
            team = TeamConfig(driver=name, alert_window=window, end_at_crash=False)
            best = oracle.solve_alerts(name, window=window, horizon=team.horizon)
            seats = make_driver_policy("rule", team), make_hmi("optimal", team)
            seeds = episode_seed(self.seed, np.arange(self.episodes))
            played = play_episodes(team, *seats, seeds, world="batched").attention_return()
            results.append((name, window, best, statistics.mean(played)))
        return results

    def numbers(self, results):
        """Return the JSON content."""
        rows = [
            {"driver": name, "N": window, "exact": best.total_return, "alerts": best.alerts}
            | {"played": played.as_json()}
            for name, window, best, played in results
        ]
        return {"rows": rows}

    def judge(self, results):
        """Judge whether the optimum takes fewer alerts with longer windows, for each driver."""
        verdicts = []
        for driver in self.drivers:
            alerts = [(window, best.alerts) for name, window, best, _ in results if name == driver]
            fewer = tuple(
                Part.exact(
                    f"alerts, N = {after[0]} less {before[0]}", after[1] - before[1], below=0.0
                )
                for before, after in pairwise(alerts)
            )
            verdicts.append(Verdict(f"{driver}: fewer alerts", fewer))
        return verdicts

    def blocks(self, results):
        """Return the report in blocks, which render as text, JSON and HTML."""
        head = ["driver", "N", "exact optimum", "played", "alerts"]
        rows = [
            [name, str(window), f"{best.total_return:.1f}", played.shown(), f"{best.alerts:.1f}"]
            for name, window, best, played in results
        ]
        table = Table("By window", head, rows, sources=["/rows"])  # where numbers() has them
        return [Text("Attention returns per episode."), table]


# The registry line: reproduce, its --help and --quick now know the experiment.
EXPERIMENTS.register(
    "window",
    "Compare intervention windows: the exact optimum, and the same played.",
    Where(f"{__name__}:WindowLength", needs=(), in_suite=False),
)

if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--episodes", default="200", help="of each case (default: %(default)s)")
    parser.add_argument(
        "--windows", nargs="+", default=["3", "7", "11"], help="N (default: 3 7 11)"
    )
    args = parser.parse_args()
    main(["reproduce", "window", "--episodes", args.episodes, "--windows", *args.windows])
