"""Coverage and width of measured traits, and the size and power of the tests of the model.

Simulated persons with known traits drive calibrations: the four named drivers and random ones, each
by the chain of their traits. Each calibration is measured after 5, 10 and 20 minutes::

    python benchmarks/calibration.py --people 200 --out runs/calibration.json

prints, by trait, how many intervals hold the true value, and their median width; and how often the
tests reject, of persons who fulfil the model and of others: dwell times of Weibull's distribution,
and an effect of alerts that fades within the window. All of it is simulated.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import DRIVERS, PAPER_DRIVERS, TraitDistributions, Traits
from hmi_marl.envs.scene import Scene
from hmi_marl.envs.streams import part_seed
from hmi_marl.files import write_json
from hmi_marl.people.measure.assumptions import LEVEL, check_assumptions
from hmi_marl.people.measure.scripted import ScriptedPeople, simulate_calibrations
from hmi_marl.people.measure.steps import SEEN_AFTER, ChainCounts, ChainSteps, chain_steps
from hmi_marl.people.measure.traits import ATTENTION_TRAITS, intervals
from hmi_marl.people.record import TripRecord

MINUTES = (5, 10, 20)
TRIPS_PER_MINUTE = 3
QUIET = TeamConfig(driver="average", scene=Scene(vehicles=(1, 1)), end_at_crash=False)
"""Teams of the calibrations: the road does not matter to the chain, so there is one other car."""
SETTLED = Traits.from_array([[0.1, 0.2, 0.15, 6.0]])
"""Traits of those who violate the model in one way."""


class WeibullPeople(ScriptedPeople):
    """Persons for whom a change becomes likelier with time: Weibull's distribution of shape 2."""

    shape = 2.0
    _age = 0.0

    def chance(self, away: NDArray[np.int64], helped: NDArray[np.int64]) -> NDArray[np.float64]:
        """Raise the chance of a change with the steps since the last one."""
        self._age = np.where(self._changed(away), 1.0, self._age + 1.0)
        power = self.shape * (self._age / 5.0) ** (self.shape - 1.0)
        chance = super().chance(away, helped)
        change = np.where(away == 1, 1.0 - chance, chance)
        change = 1.0 - (1.0 - change) ** power
        return np.where(away == 1, 1.0 - change, change)

    def _changed(self, away: NDArray[np.int64]) -> NDArray[np.bool_]:
        before, self._before = getattr(self, "_before", np.zeros_like(away)), away
        return before != away


class FadingPeople(ScriptedPeople):
    """Persons whom an alert helps twice as much at first, and no more at the end of its window."""

    def chance(self, away: NDArray[np.int64], helped: NDArray[np.int64]) -> NDArray[np.float64]:
        """Scale η by the step since the alert."""
        left = 1.0 - self._counter / (self._window - 1)
        return super().chance(away, 2.0 * left * helped)


def steps_of(trips: list[TripRecord]) -> ChainSteps:
    """Steps of one person's trips."""
    pairs = [(trip.looking_away or (), trip.alerts) for trip in trips]
    return chain_steps(pairs, QUIET.alert_window, SEEN_AFTER)


def share(count: int, total: int) -> str:
    """Write a share of persons and its 95 % interval in percent."""
    low, high = stats.binomtest(count, total).proportion_ci(method="wilson")
    return f"{100 * count / total:.1f} [{100 * low:.1f}, {100 * high:.1f}]"


def persons(count: int, seed: int) -> tuple[Traits, NDArray[np.str_]]:
    """Half named drivers, half random ones, and the name of each one's group."""
    named = [PAPER_DRIVERS[k % 4] for k in range(count // 2)]
    rows = [DRIVERS[name].traits for name in named]
    seeds = part_seed(seed, np.arange(1, count - len(named) + 1))
    drawn = TraitDistributions().draw(seeds).as_array()
    traits = Traits.from_array(np.concatenate([np.reshape(rows, (-1, 4)), drawn]))
    return traits, np.array([*named, *["random"] * len(drawn)])


def measure(count: int, seed: int) -> list[dict[str, object]]:
    """Coverage and width by minutes, group of persons and trait."""
    traits, groups = persons(count, seed)
    calibrations = simulate_calibrations(traits, QUIET, MINUTES[-1] * TRIPS_PER_MINUTE, seed)
    rows: list[dict[str, object]] = []
    for minutes in MINUTES:
        trips = minutes * TRIPS_PER_MINUTE
        steps = [steps_of(own[:trips]) for own in calibrations]
        found = intervals(ChainCounts.stack([ChainCounts.of(each) for each in steps]))
        tests = [check_assumptions(each, person) for person, each in enumerate(steps)]
        wrong = sum(any(test.rejected for test in own) for own in tests)
        print(
            f"\n{minutes} minutes; any test rejects {share(wrong, count)} %, by design {LEVEL:.0%}"
        )
        by_test = {t.name: sum(own[k].rejected for own in tests) for k, t in enumerate(tests[0])}
        print("  " + ", ".join(f"{name} {number}" for name, number in by_test.items()))
        for group in ("all", *dict.fromkeys(groups.tolist())):
            own = (groups == group) | (group == "all")
            line = [f"  {group:8}"]
            for trait in ATTENTION_TRAITS:
                each = found[trait]
                covered = each.covers(getattr(traits, trait))[own]
                width = float(np.median(each.width[own]))
                held = share(int(covered.sum()), int(own.sum()))
                line.append(f"{trait} holds {held} %, width {width:.3f}")
                rows.append(
                    {
                        "minutes": minutes,
                        "group": group,
                        "trait": trait,
                        "covered": int(covered.sum()),
                        "people": int(own.sum()),
                        "median_width": width,
                    }
                )
            print("; ".join(line))
        rows.append({"minutes": minutes, "any_test_rejects": wrong, "people": count, **by_test})
    return rows


def violations(count: int, minutes: int, seed: int) -> list[dict[str, object]]:
    """How often the tests notice persons who are not as the model assumes."""
    traits = Traits.from_array(np.repeat(SETTLED.as_array(), count, axis=0))
    rows: list[dict[str, object]] = []
    print(f"\nnot as the model assumes, {minutes} minutes; rejected in % of {count}")
    for name, kind in (
        ("as assumed", ScriptedPeople),
        ("Weibull, shape 2", WeibullPeople),
        ("effect fades", FadingPeople),
    ):
        trips = minutes * TRIPS_PER_MINUTE
        calibrations = simulate_calibrations(traits, QUIET, trips, seed, kind)
        tests = [check_assumptions(steps_of(own), k) for k, own in enumerate(calibrations)]
        by_test = {t.name: sum(own[k].rejected for own in tests) for k, t in enumerate(tests[0])}
        print(f"  {name:18}" + "; ".join(f"{t} {share(n, count)}" for t, n in by_test.items()))
        rows.append({"people": count, "kind": name, "minutes": minutes, **by_test})
    return rows


def main() -> None:
    """Simulate, measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--people", type=int, default=200)
    parser.add_argument("--violators", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("runs/calibration.json"))
    options = parser.parse_args()
    rows = measure(options.people, options.seed)
    rows += violations(options.violators, 10, options.seed + 1)
    write_json(options.out, {"simulated": True, "seed": options.seed, "rows": rows})


if __name__ == "__main__":
    main()
