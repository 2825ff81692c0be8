"""Plan a comparison of protocols at equal environment steps over several seeds, and play it.

Every pair of driver and HMI plays the same seeded episodes on the batched world, with the driver
of each drawn from the population.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import permutations, product
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from hmi_marl.checks import Checked, Count, OpenShare, Steps
from hmi_marl.envs.config import Duration, TeamConfig, VehicleRange
from hmi_marl.envs.drivers import PAPER_DRIVERS, get_driver
from hmi_marl.envs.rewards import ATTENTION_TERMS, TERMS
from hmi_marl.envs.scene import Scene
from hmi_marl.envs.streams import Seed, part_seed
from hmi_marl.experiments.episodes import Episodes, play_named
from hmi_marl.registry import unknown
from hmi_marl.training.jobs import Job
from hmi_marl.training.protocols.registry import compared
from hmi_marl.training.protocols.settings import Budget, TrainSettings
from hmi_marl.workers import results

Protocol = str
"""Name of a protocol or of a variant, as :func:`compared` lists them."""
TWO_STAGE: Protocol = "two-stage"
ALL_DRIVERS = "all"
"""In place of a driver's name: all drivers of the population together."""
QUICK = {"steps": 300_000, "seeds": 2, "episodes": 200, "num_teams": 128}
"""Settings of a coarse comparison."""


@dataclass(frozen=True)
class PlannedRun:
    """One training run."""

    protocol: Protocol
    number: int
    """Number of the run among those of its protocol, 0 for the first."""
    standing: bool = False
    """Whether it is trained with ``end_at_crash=False``: a crashed car stands until the end."""

    @property
    def name(self) -> str:
        """Name of the run and of its folder."""
        return f"{self.protocol}-run{self.number}" + ("-standing" if self.standing else "")


@dataclass(frozen=True)
class Pair:
    """Driver and HMI that play together."""

    driver: str
    """Name of a run, or of a driver policy in the catalogue."""
    hmi: str
    """Name of a run, or of an HMI in the catalogue."""
    end_at_crash: bool = True


@dataclass(frozen=True)
class ComparisonSettings(Checked):
    """Settings of a comparison of protocols: its runs, and the pairs that play.

    Raises:
        ValueError, TypeError: a value out of its range, saying what to use instead.
    """

    protocols: tuple[Protocol, ...] = field(default_factory=lambda: tuple(compared()))
    """Protocols to compare; two-stage is the reference."""
    steps: Steps = 3_000_000
    """Environment steps of each run in all, rounded to batches, the same for every protocol."""
    driver_share: OpenShare = 0.8
    """Share of the steps of two-stage and alternating in which the driver learns."""
    rounds: Count = 4
    """Rounds of alternating."""
    seeds: Count = 3
    """Runs of each protocol."""
    seed: Seed = 0
    """Seed of the first run of each protocol; those of the others are mixed from it."""
    episodes: Count = 1000
    """Episodes that each pair of driver and HMI plays."""
    drivers: tuple[str, ...] = PAPER_DRIVERS
    """Drivers, one drawn for each episode: known names, or name:beta,alpha,eta,inflation."""
    reward: Literal["default", "team", "individual"] = "default"
    """Reward to learn from: each protocol's own (where the seats learn one after the other, the
    driver learns from driving and the HMI from the team's reward; where they learn together, both
    from the team's), or one for all but two-stage. (Joint learns from the sum of both agents'
    rewards.)"""
    crash_check: bool = True
    """Train every protocol also with end_at_crash=False, with the first seed, to see whether
    crashing early pays."""
    num_teams: Count = 512
    """Teams that train side by side."""
    duration: Duration = 20.0
    """Length of an episode [s]."""
    vehicles: VehicleRange = (1, 20)
    """Least and most other vehicles."""

    def __post_init__(self) -> None:
        _check_protocols(self.protocols)
        super().__post_init__()
        if not isinstance(self.drivers, tuple) or not self.drivers:
            raise ValueError(f"drivers is a tuple of at least one name, not {self.drivers!r}")
        names = Counter(get_driver(driver).name for driver in self.drivers)
        if names.total() > len(names):
            raise ValueError(f"drivers names {names.most_common(1)[0][0]!r} twice")
        self.jobs(Path())  # checks the rest

    @property
    def driver_names(self) -> tuple[str, ...]:
        """Names of the drivers."""
        return tuple(get_driver(driver).name for driver in self.drivers)

    def team(self, end_at_crash: bool = True) -> TeamConfig:
        """Settings of the teams of an evaluation."""
        return TeamConfig(
            driver=self.drivers,
            duration=self.duration,
            end_at_crash=end_at_crash,
            scene=Scene(vehicles=self.vehicles),
        )

    @property
    def _budget(self) -> Budget:
        reward = None if self.reward == "default" else self.reward
        batch = self.num_teams * self.team().horizon
        return Budget.shared_out(self.steps, self.driver_share, batch, self.rounds, reward)

    @property
    def steps_apart(self) -> tuple[int, int]:
        """Environment steps of the driver and of the HMI where they learn one after the other."""
        return self._budget.driver_steps, self._budget.hmi_steps

    @property
    def steps_each(self) -> int:
        """Environment steps of every run, rounded to batches."""
        return self._budget.steps

    @property
    def main_runs(self) -> tuple[PlannedRun, ...]:
        """Runs of every protocol with every seed."""
        return tuple(
            PlannedRun(protocol, k) for protocol in self.protocols for k in range(self.seeds)
        )

    @property
    def standing_runs(self) -> tuple[PlannedRun, ...]:
        """Runs in which a crash does not end the episode."""
        wanted = self.protocols if self.crash_check else ()
        return tuple(PlannedRun(protocol, 0, standing=True) for protocol in wanted)

    @property
    def runs(self) -> tuple[PlannedRun, ...]:
        """All runs."""
        return self.main_runs + self.standing_runs

    def jobs(self, folder: Path) -> list[Job]:
        """Training of all runs, a folder for each."""
        return [Job(self._training(run), folder / run.name) for run in self.runs]

    def _training(self, run: PlannedRun) -> TrainSettings:
        shared: dict[str, Any] = {
            "drivers": self.drivers,
            "seed": int(part_seed(self.seed, run.number)),
            "end_at_crash": not run.standing,
            "num_teams": self.num_teams,
            "duration": self.duration,
            "vehicles": self.vehicles,
        }
        protocol, variant = compared()[run.protocol]
        return protocol.for_comparison(self._budget, **shared, **variant)

    def driver_terms(self, protocol: Protocol) -> tuple[str, ...]:
        """Reward terms that the driver learns from."""
        return self._training(PlannedRun(protocol, 0)).driver_terms

    def pairs(self) -> list[Pair]:
        """List every pair that plays, each once."""
        by_number = [[run for run in self.main_runs if run.number == k] for k in range(self.seeds)]
        wanted = [Pair(a.name, b.name) for same in by_number for a, b in product(same, same)]
        for protocol in self.protocols:
            own = [run for run in self.main_runs if run.protocol == protocol]
            wanted += [Pair(a.name, b.name) for a, b in permutations(own, 2)]
        for pairs in self.baselines().values():
            wanted += pairs
        for run in self.standing_runs:
            wanted += [Pair(run.name, run.name, ends) for ends in (True, False)]
        return list(dict.fromkeys(wanted))

    def baselines(self) -> dict[str, list[Pair]]:
        """List pairs of known policies, and the two-stage driver with known HMIs, by label.

        "when-distracted" is the exact alert optimum for all of the paper's drivers.
        """
        hmis = "never", "when-distracted"
        known = {f"rule, {hmi}": [Pair("rule", hmi)] for hmi in hmis}
        learned = [run.name for run in self.main_runs if run.protocol == TWO_STAGE]
        if learned:
            known |= {f"{TWO_STAGE}, {hmi}": [Pair(name, hmi) for name in learned] for hmi in hmis}
        return known

    def coarse(self) -> Self:
        """Return the same comparison with the sizes of ``QUICK``.

        Raises:
            ValueError: one of these sizes was chosen.
        """
        default = type(self)()
        chosen = [name for name in QUICK if getattr(self, name) != getattr(default, name)]
        if chosen:
            raise ValueError(f"--quick sets {', '.join(chosen)} itself; leave out one or the other")
        return replace(self, **QUICK)  # type: ignore[arg-type]


def _check_protocols(protocols: Sequence[str]) -> None:
    known = ", ".join(compared())
    if isinstance(protocols, str) or not protocols:
        raise ValueError(f"protocols is a tuple of at least one of {known}; got {protocols!r}")
    for name, times in Counter(protocols).items():
        if name not in compared():
            raise ValueError(unknown("protocol", name, compared(), "hmi-marl compare --help"))
        if times > 1:
            raise ValueError(f"protocols names {name!r} twice")


@dataclass(frozen=True)
class Sums:
    """Sums over some episodes."""

    episodes: int
    crashes: int
    steps: int
    minutes: float
    """Minutes of driving."""
    alerts: int
    time_headway: float
    """Mean over episodes of the median while a vehicle is ahead [s]; NaN if there was none."""
    terms: dict[str, float]
    """Sum of each reward term."""

    @classmethod
    def of(cls, episodes: Episodes, which: NDArray[np.bool_], frequency: float) -> Sums:
        """Sum up the marked episodes."""
        headways = episodes.median_time_headway[which]
        headways = headways[np.isfinite(headways)]
        steps = int(episodes.length[which].sum())
        return cls(
            episodes=int(which.sum()),
            crashes=int(episodes.crashed[which].sum()),
            steps=steps,
            minutes=steps / frequency / 60.0,
            alerts=int(episodes.alerts[which].sum()),
            time_headway=float(headways.mean()) if len(headways) else math.nan,
            terms={name: float(values[which].sum()) for name, values in episodes.returns.items()},
        )

    @classmethod
    def join(cls, several: Iterable[Sums]) -> Sums:
        """Join one or more sums into one."""
        parts = list(several)
        known = [p for p in parts if math.isfinite(p.time_headway)]
        headways, weights = [p.time_headway for p in known], [p.episodes for p in known]
        counts = ("episodes", "crashes", "steps", "minutes", "alerts")
        return cls(
            **{name: sum(getattr(part, name) for part in parts) for name in counts},
            time_headway=float(np.average(headways, weights=weights)) if known else math.nan,
            terms={name: sum(part.terms[name] for part in parts) for name in parts[0].terms},
        )

    def per_episode(self, names: Sequence[str] = TERMS) -> float:
        """Return the mean return of an episode, of these terms together."""
        return _ratio(sum(self.terms[name] for name in names), self.episodes)

    def per_step(self, names: Sequence[str] = TERMS) -> float:
        """Return the mean reward of a step."""
        return _ratio(sum(self.terms[name] for name in names), self.steps)

    def metrics(self) -> dict[str, float]:
        """Return every metric by name; NaN where there were no episodes."""
        return {
            "team_return": self.per_episode(),
            **{name: self.per_episode([name]) for name in TERMS},
            "attention_return": self.per_episode(ATTENTION_TERMS),
            "team_return_per_step": self.per_step(),
            "crash_rate": _ratio(self.crashes, self.episodes),
            "alerts_per_minute": _ratio(self.alerts, self.minutes),
            "length": _ratio(self.steps, self.episodes),
            "time_headway": self.time_headway,
        }


def _ratio(amount: float, count: float) -> float:
    return amount / count if count else math.nan


Played = Mapping[Pair, Mapping[str, Sums]]
"""Sums of every pair's episodes, by the driver's name and for ``ALL_DRIVERS``."""


def play_pair(settings: ComparisonSettings, folder: Path, pair: Pair) -> dict[str, Sums]:
    """Play a pair's episodes; sum them up for each driver and for ``ALL_DRIVERS``."""
    team = settings.team(pair.end_at_crash)
    runs = {run.name for run in settings.runs}
    driver, hmi = (str(folder / name) if name in runs else name for name in (pair.driver, pair.hmi))
    episodes = play_named(team, driver, hmi, settings.episodes)
    drawn = team.population.draw(episodes.seeds).as_array()
    add = partial(Sums.of, episodes, frequency=team.scene.policy_frequency)
    sums = {ALL_DRIVERS: add(np.ones(settings.episodes, np.bool_))}
    for name in settings.drivers:
        known = get_driver(name)
        sums[known.name] = add((drawn == np.array(known.traits)).all(axis=1))
    return sums


def play_all(
    settings: ComparisonSettings, folder: Path, workers: int, progress: Callable[[int], object] = id
) -> Played:
    """Play every pair of the runs in ``folder``; the result does not depend on ``workers``.

    ``progress`` is called with the number of episodes that have just finished.
    """
    pairs, play_one = settings.pairs(), partial(play_pair, settings, folder)
    played: dict[Pair, Mapping[str, Sums]] = {}
    for pair, sums in zip(pairs, results(play_one, pairs, workers), strict=True):
        played[pair] = sums
        progress(settings.episodes)
    return played
