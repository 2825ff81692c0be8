"""Numbers of a whole reproduction that are made up, for tests of what is said of them.

Every quantity has a true value; what a run measures of it is drawn as from so many episodes, pools
or training seeds. :func:`report` takes changes of the true values by name.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from hmi_marl.envs.drivers import PAPER_DRIVERS
from hmi_marl.experiments import criteria
from hmi_marl.experiments.hidden_attention import BAYES_AVERAGE
from hmi_marl.experiments.metrics_table.differences import ALL, AVERAGE, METRICS, NONE, OWN, PAIRS
from hmi_marl.reporting import statistics
from hmi_marl.reporting.statistics import Estimate

SIZES = {"distraction_return": -100.0, "speed_return": 450.0, "attention_return": 900.0}
EPISODES, POOLS = 2000, 300
CENTRES = {"lisa": (0.0, 0.0), "marge": (0.0, 9.0), "bart": (9.0, 0.0), "homer": (9.0, 9.0)}
SETTINGS = ("none", "id", "preference")


class World:
    """True values by name, and draws around them."""

    def __init__(self, seed: int, spread: float, noise: float, true: Mapping[str, float]) -> None:
        self.rng, self.spread, self.true = np.random.default_rng(seed), spread, dict(true)
        self.noise = noise
        self.used: set[str] = set()

    def value(self, name: str, default: float = 0.0) -> float:
        """True value: that of the name, or of its last words, or the default."""
        for known in self.true:
            if name.endswith(known):
                self.used.add(known)
                return self.true[known]
        return default

    def mean(self, name: str, default: float = 0.0, sd: float = 20.0) -> dict[str, Any]:
        """A mean over episodes: the t statistic of so many is drawn, which is as good as normal."""
        error = self.noise * sd / math.sqrt(EPISODES)
        middle = self.value(name, default) + self.spread * self.rng.normal() * error
        ends = statistics.t_interval(middle, error, EPISODES)
        return Estimate(middle, *ends, error, EPISODES).as_json()

    def share(self, name: str, default: float, trials: int = POOLS) -> dict[str, Any]:
        """A share of so many trials."""
        true = self.value(name, default)
        hits = self.rng.binomial(trials, true) if self.spread else round(trials * true)
        return statistics.share(int(hits), trials).as_json()


def table(world: World) -> dict[str, Any]:
    """Numbers of the table; both variants, nothing differs unless it is said."""
    rows = (OWN, AVERAGE, NONE)

    def cells(variant: str) -> list[dict[str, Any]]:
        found = []
        for row in rows:
            for driver in PAPER_DRIVERS:
                size = {
                    metric: {"mean": world.value(f"{variant} {row} {driver} {metric}", whole)}
                    for metric, whole in SIZES.items()
                }
                exact = world.value(f"{row} {driver} exact", -100.0)
                about = {"hmi": driver if row == OWN else row, "driver": driver}
                same = world.value(f"{row} {driver} same steps", 0.95 * exact)
                about |= {"exact_distraction_return_same_steps": same}
                found.append(about | size | {"exact_distraction_return": exact})
        return found

    def differences(variant: str) -> dict[str, Any]:
        return {
            "rows": {row: {m: {"mean": SIZES.get(m, 1.0)} for m in METRICS} for row in rows},
            "between_rows": {
                f"{one} - {other}": {
                    metric: {
                        who: world.mean(f"{variant} {one} - {other} {metric} {who}")
                        for who in (*PAPER_DRIVERS, ALL)
                    }
                    for metric in METRICS
                }
                for one, other in PAIRS
            },
            "between_drivers": {
                row: {
                    one: {
                        other: world.mean(f"{row} {one} less {other}")
                        for other in PAPER_DRIVERS
                        if other != one
                    }
                    for one in PAPER_DRIVERS
                }
                for row in rows
            },
            "extra_speed_lost": {"homer": {"marge": world.mean("homer loses more speed")}},
            "spared": {d: world.mean(f"{d} spared", 0.0, 0.5) for d in PAPER_DRIVERS},
            "average_share": {d: world.mean(f"{d} average share", 0.0, 0.5) for d in PAPER_DRIVERS},
        }

    variants = ("printed", "eta-1")
    return {
        "tables": {variant: cells(variant) for variant in variants},
        "differences": {variant: differences(variant) for variant in variants},
    }


def hidden(world: World) -> dict[str, Any]:
    """Numbers of the experiment with attention hidden."""
    return {
        "rows": [
            {
                "driver": driver,
                "attention_return": {BAYES_AVERAGE: {"mean": 900.0}},
                "own_minus_bayes_average": world.mean(f"{driver} hidden own - Bayes AvgHMI"),
                "bayes_own_minus_average": world.mean(f"{driver} hidden Bayes own - AvgHMI"),
                "own_minus_average": world.mean(f"{driver} hidden own - AvgHMI"),
                "exact_worth": world.value(f"{driver} exact worth, whole trips"),
                "exact_worth_same_steps": world.value(f"{driver} exact worth"),
            }
            for driver in (*PAPER_DRIVERS, "average")
        ]
    }


def driver(world: World) -> dict[str, Any]:
    """Numbers of the drivers without distraction."""
    log, error = math.log(world.value("headway ratio", 1.0)), 0.4 / math.sqrt(EPISODES)
    log += world.spread * world.rng.normal() * error
    ratio = Estimate(math.exp(log), math.nan, math.nan, error, EPISODES).as_json()
    rows = [{"time_headway": 1.0}, {"time_headway": math.exp(log), "headway_ratio": ratio}]
    return {"rows": rows}


def graded(world: World) -> dict[str, Any]:
    """Numbers of HMIs with graded alerts; by default they earn exactly the least that is asked."""
    return {
        "rows": [
            {
                "case": {"name": name},
                "optimum": 1000.0,
                "least": 970.0,
                "learned": world.mean(f"{name} learned", 970.0),
            }
            for name in ("homer-graded", "homer-weary", "bart-weary")
        ]
    }


def traits(world: World, seeds: int, pools: int = 20) -> dict[str, Any]:
    """Numbers of the latent traits; no setting tells anything unless it is said."""

    def seed_of(setting: str) -> dict[str, Any]:
        scale = world.value(f"{setting} apart", 0.0)
        names = [name for name in PAPER_DRIVERS for _ in range(pools)]
        centres = np.array([CENTRES[name] for name in names])
        if f"{setting} by preference alone" in world.true:
            centres = centres * [0.0, 1.0]
        if f"{setting} by distraction alone" in world.true:
            centres = centres * [1.0, 0.0]
        if f"{setting} bart and homer further" in world.true:
            centres = centres + [[0.0, 40.0 * (name == "homer")] for name in names]
        if f"{setting} lisa and marge further" in world.true:
            centres = centres - [[0.0, 40.0 * (name == "lisa")] for name in names]
        means = scale * centres + world.rng.normal(0.0, 0.5, (len(names), 2))
        kl = world.value(f"{setting} KL", 10.0) * math.exp(world.spread * world.rng.normal(0, 0.2))
        true = world.value(f"{setting} accuracy", 0.5)
        each = min(1.0, max(0.0, true + world.spread * world.rng.normal(0.0, 0.02)))

        def row(windows: int) -> dict[str, Any]:
            right = statistics.share(round(each * POOLS), POOLS).as_json()
            exact = world.share("exact from many", criteria.APART)
            average_kl = statistics.by_logarithm(kl, 0.1, POOLS).as_json()
            types = {"linear_probe": right, "chance": 0.25, "average_kl": average_kl}
            return {"windows": windows, "types": types, "ceilings": {"identity": exact}}

        embedding = {"means": means.tolist(), "drivers": names}
        return {"identified": [row(1), row(8)], "embedding": embedding}

    return {
        "pool": 8,
        "one_step": {"identity": world.share("exact from one", criteria.HIDES, 2400)},
        "supervisions": {
            name: {"seeds": [seed_of(name) for _ in range(seeds)]} for name in SETTINGS
        },
    }


def report(
    true: Mapping[str, float] = {},
    seeds: int = 5,
    seed: int = 0,
    spread: float = 0.0,
    noise: float = 1.0,
    pools: int = 20,
) -> dict[str, dict[str, Any]]:
    """Numbers of all experiments by name; ``spread`` 1 draws, 0 is the true values but for z.

    Standard errors of means over episodes are ``noise`` times as large. Of each driver z embeds so
    many ``pools``.

    Raises:
        ValueError: a true value was given for something that is nowhere.
    """
    world = World(seed, spread, noise, true)
    found = {
        "table": table(world),
        "hidden": hidden(world),
        "driver": driver(world),
        "graded": graded(world),
        "traits": traits(world, seeds, pools),
        "adapt": {},
    }
    if odd := {n for n in set(true) - world.used if "alone" not in n and "further" not in n}:
        raise ValueError(f"nothing is called {odd}")
    return found
