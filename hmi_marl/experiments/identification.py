"""Experiment "identify": who drives, with a driver policy that reads the traits and with a control.

Drivers differ in how their attention lapses, which is the model of people, and in how the policy
reacts to the traits that it reads, which is a property of the network. The control is learned alike
but reads only its inflation of its traits: it cannot react to β, α and η. What the exact classifier
finds with the trained driver and not with the control is the network's reaction to these.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.learned.policy import find_policy
from hmi_marl.checks import Count, Steps, Whole
from hmi_marl.demonstrations.dataset import disjoint_pools
from hmi_marl.demonstrations.recording import CollectSettings, collect
from hmi_marl.envs.config import DRIVER, TeamConfig
from hmi_marl.envs.drivers import PAPER_DRIVERS, TRAIT_NAMES
from hmi_marl.envs.streams import Seed, part_seed
from hmi_marl.exact.evidence_by_source import SOURCES, evidence_by_source
from hmi_marl.experiments import criteria
from hmi_marl.experiments.episodes import Episodes, play_named
from hmi_marl.experiments.experiment import Agent, Experiment, Place
from hmi_marl.experiments.latent_traits.posterior import PosteriorRow, evaluate_posteriors
from hmi_marl.experiments.metrics_table.experiment import MetricsTable
from hmi_marl.files import json_value
from hmi_marl.reporting import statistics
from hmi_marl.reporting.blocks import Block, Table, Text
from hmi_marl.reporting.statistics import Estimate
from hmi_marl.reporting.verdicts import Part, Verdict
from hmi_marl.training.jobs import Job

CONTROL_RUN = "driver-inflation"
"""Folder of the run of the control, and its name among the shipped agents."""
SECONDS = (0.2, 1.0, 2.0, 5.0, 10.0, 20.0)
"""Lengths of driving that are read of a window [s]."""
POOL = 8
"""Windows of a pool, as trait models pool."""
WINDOWS = "windows"
"""Unit of replication."""
_READ = {
    "intended": "a^H alone, by the policy",
    "chain": "a^H and v, by the attention chain",
    "seen": "a^H and v, by both",
    "hidden": "v with a^H hidden, by both",
}
_EQUAL = 1e-6
"""Difference in log evidence of candidates that are equal but for rounding."""
_STRANGERS_PART, _TIES_PART = 2**32 + 2, 2**32 + 3
"""Parts of the experiment's seed."""


@dataclass(frozen=True)
class NamedRow:
    """Share of windows, or of pools, whose driver the exact classifier names."""

    source: str
    """What is read: one of :data:`SOURCES`."""
    seconds: float
    """Length that is read of each window [s]."""
    windows: int
    """Windows of one driver together."""
    trained: Estimate
    """With the driver policy that reads all traits."""
    control: Estimate
    """With the control."""
    difference: Estimate
    """Share with the first less that with the control, paired by windows of the same seeds."""


@dataclass(frozen=True)
class DrivingRow:
    """Driving of one driver, without alerts, with either policy in the same episodes."""

    driver: str
    speed_return: Estimate
    """With the policy that reads all traits."""
    control_speed_return: Estimate
    speed_difference: Estimate
    """The first less the second, paired by episode."""
    crash_rate: Estimate
    control_crash_rate: Estimate


@dataclass(frozen=True)
class IdentificationResults:
    """What tells drivers apart, with either policy."""

    named: Sequence[NamedRow]
    driving: Sequence[DrivingRow]
    posteriors: Mapping[str, PosteriorRow]
    """The exact posterior over strangers' traits, "trained" and "control"."""

    def row(self, source: str, seconds: float, windows: int = 1) -> NamedRow:
        """Find the row of so much driving."""
        wanted = source, seconds, windows
        (found,) = (r for r in self.named if (r.source, r.seconds, r.windows) == wanted)
        return found


@dataclass(frozen=True)
class DriverIdentification(Experiment[IdentificationResults]):
    """Compare who drives, by exact Bayes, with a control driver who reads inflation alone.

    Raises:
        ValueError: no steps, or too few windows, episodes or strangers.
    """

    driver_steps: Steps = 12_000_000
    """Environment steps in which the control learns, and the driver unless one is given."""
    windows: Annotated[int, Whole(POOL, 1_000_000)] = 1000
    """Windows of 20 s of each of the four drivers, with either policy."""
    strangers: Annotated[int, Whole(3, 1_000_000)] = 100
    """Drivers of a continuous population whose traits are estimated, from eight windows each."""
    episodes: Count = 1000
    """Episodes of each driver in which both policies' driving is compared."""
    num_teams: Count = 512
    """Teams that train side by side."""
    seed: Seed = 0
    """Seed of all training and of the windows."""

    name = "identify"
    title = "Who drives: attention, and the policy's reaction to its traits"
    uses_driver = True
    paper = (
        "The paper learns latent traits of drivers from how they drive (Sec. VIII-B). Its drivers "
        "are one network that reads their traits, so that part of what tells them apart is how the "
        "network reacts to these inputs, and not how people's attention lapses. Below, the exact "
        "classifier of the same four drivers with that network, and with a control: a driver "
        "policy learned alike, which reads its inflation of its traits, and not β, α and η."
    )

    @classmethod
    def quick(cls) -> DriverIdentification:
        """See :meth:`Experiment.quick`."""
        return cls(driver_steps=1_000_000, windows=160, strangers=10, episodes=200)

    def driver_job(self, folder: Path) -> Job:
        """See :meth:`Experiment.driver_job`; the same as of the paper's table."""
        alike = MetricsTable(
            driver_steps=self.driver_steps, num_teams=self.num_teams, seed=self.seed
        )
        return alike.driver_job(folder)

    def control_job(self, folder: Path) -> Job:
        """Training of the control: the same but for what the policy reads."""
        settings = replace(self.driver_job(folder).settings, condition="inflation")
        return Job(settings, folder / CONTROL_RUN)

    def run(self, place: Place) -> IdentificationResults:
        """See :meth:`Experiment.run`."""
        place.train([self.control_job(place.folder)])
        runs = str(place.driver_run), str(place.folder / CONTROL_RUN)
        total = len(runs) * (len(PAPER_DRIVERS) * (self.windows + self.episodes) + self.strangers)
        with place.playing(total, "windows, episodes and strangers") as progress:
            rights = [self._rights(run, progress) for run in runs]
            driving = [self._drive(run, progress) for run in runs]
            posteriors = [self._posterior(run, progress) for run in runs]
        return IdentificationResults(
            [_named_row(key, *(right[key] for right in rights)) for key in rights[0]],
            [_driving_row(who, *(each[who] for each in driving)) for who in driving[0]],
            dict(zip(("trained", "control"), posteriors, strict=True)),
        )

    def _recording(self, run: str) -> CollectSettings:
        """Settings of the windows of the four drivers, with a policy."""
        horizon = TeamConfig().horizon
        return CollectSettings(driver_policy=run, steps=self.windows * horizon, seed=self.seed)

    def _rights(
        self, run: str, progress: Callable[[int], object]
    ) -> dict[tuple[str, float, int], NDArray[np.bool_]]:
        """Whether each window's driver is named, by source, seconds and windows of a pool."""
        settings = self._recording(run)
        team = settings.team(PAPER_DRIVERS)
        policy = settings.make_driver(team)
        steps = [round(seconds * team.scene.policy_frequency) for seconds in SECONDS]
        found: dict[tuple[str, int], list[NDArray[np.float64]]] = {}
        who: list[NDArray[np.int64]] = []
        for chunk in collect(settings):
            seen = chunk.observed
            assert chunk.truth is not None
            data = seen.seeds, seen.actions, seen.alerts, seen.length, chunk.truth.intended
            evidence = evidence_by_source(team, policy, PAPER_DRIVERS, *data, steps)
            for source, several in evidence.items():
                for place, after in enumerate(several):
                    found.setdefault((source, place), []).append(after.log_evidence)
            who.append(seen.driver)
            progress(len(seen))
        driver = np.concatenate(who)
        pools = {1: np.arange(len(driver))[:, None], POOL: disjoint_pools(driver, POOL)}
        rng = np.random.default_rng(int(part_seed(self.seed, _TIES_PART)))
        rights = {}
        for source in SOURCES:
            for place, seconds in enumerate(SECONDS):
                whole = np.concatenate(found[source, place])
                for size, groups in pools.items():
                    if size == 1 or place == len(SECONDS) - 1:
                        evidence = whole[groups].sum(axis=1)
                        rights[source, seconds, size] = named(evidence, driver[groups[:, 0]], rng)
        return rights

    def _drive(self, run: str, progress: Callable[[int], object]) -> dict[str, Episodes]:
        """Play episodes without alerts, by driver."""
        played = {}
        for driver in PAPER_DRIVERS:
            played[driver] = play_named(TeamConfig(driver=driver), run, "never", self.episodes)
            progress(self.episodes)
        return played

    def _posterior(self, run: str, progress: Callable[[int], object]) -> PosteriorRow:
        """Judge the exact posterior of strangers' traits, with a^H hidden."""
        seed = int(part_seed(self.seed, _STRANGERS_PART))
        settings = replace(
            self._recording(run),
            drivers=(),
            population=self.strangers,
            windows=POOL,
            num_teams=self.strangers * POOL,
            seed=seed,
        )
        (strangers,) = collect(settings)
        return evaluate_posteriors(
            strangers, windows=POOL, driver_policy=run, seed=self.seed, progress=progress
        )

    def numbers(self, results: IdentificationResults) -> dict[str, Any]:
        """JSON content."""
        return dict(json_value(results))

    def judge(self, results: IdentificationResults) -> list[Verdict]:
        """Judge what the reaction to traits reveals, and what is left without it."""
        alone, first, last = (
            results.row("intended", 20.0),
            results.row("hidden", 1.0),
            results.row("hidden", 20.0),
        )
        verdicts = []
        for row in (alone, first, last):
            claim = (
                f"the reaction to β, α and η tells drivers apart: {_READ[row.source]}, "
                f"{row.seconds:g} s"
            )
            part = Part.mean(
                "named, less with the control",
                row.difference,
                WINDOWS,
                paired=True,
                above=0.0,
                margin=criteria.NO_MORE_ACCURATE,
                seeds=1,
                form="+.1%",
            )
            verdicts.append(Verdict(claim, (part,)))
        least = criteria.APART
        part = Part.share("named", last.control, WINDOWS, above=least, seeds=1, form="z.1%")
        claim = (
            f"without that reaction: {100 * least:.0f} % of drivers named, {_READ['hidden']}, 20 s"
        )
        return [*verdicts, Verdict(claim, (part,))]

    def blocks(self, results: IdentificationResults) -> Sequence[Block]:
        """Text in short, and tables of drivers named, of traits and of driving."""
        return [
            Text(in_short(results)),
            Table.of(
                "Who drives, by what is read: drivers named [%], four drivers",
                results.named,
                {
                    "read": lambda row: _READ[row.source],
                    "seconds": lambda row: f"{row.seconds:g}",
                    "windows": lambda row: str(row.windows),
                    "with the driver": lambda row: row.trained.percent(),
                    "with the control": lambda row: row.control.percent(),
                    "difference": lambda row: row.difference.percent("+.1f"),
                },
                "By the exact classifier, which knows the policy and the chain. Intervals: 95 %, "
                f"over windows of separate episodes, or pools of {POOL} of them; differences are "
                "paired by windows of the same seed. Candidates that are equal are drawn among.",
            ),
            trait_table(results),
            Table.of(
                "Driving without alerts",
                results.driving,
                {
                    "driver": lambda row: row.driver,
                    "speed return": lambda row: row.speed_return.shown(),
                    "of the control": lambda row: row.control_speed_return.shown(),
                    "difference": lambda row: row.speed_difference.shown("+.1f"),
                    "crashes [%]": lambda row: row.crash_rate.percent(),
                    "of the control [%]": lambda row: row.control_crash_rate.percent(),
                },
                "Intervals: 95 %, over episodes, the same ones for both.",
            ),
        ]

    def agents(self, place: Place) -> list[Agent]:
        """See :meth:`Experiment.agents`."""
        what = "drives as any driver, given their inflation alone: a control"
        return [Agent(CONTROL_RUN, find_policy(place.folder / CONTROL_RUN, DRIVER), what)]


def named(
    log_evidence: NDArray[np.float64], true: NDArray[np.int64], rng: np.random.Generator
) -> NDArray[np.bool_]:
    """Whether the likeliest candidate is the true one; among equals one is drawn.

    Args:
        log_evidence: shape (E, K).
        true: number of the true candidate, shape (E,).
        rng: draws.
    """
    best = log_evidence >= log_evidence.max(axis=1, keepdims=True) - _EQUAL
    guess = np.where(best, rng.random(best.shape), -1.0).argmax(axis=1)
    return guess == true


def _named_row(
    key: tuple[str, float, int], trained: NDArray[np.bool_], control: NDArray[np.bool_]
) -> NamedRow:
    shares = (statistics.share(int(right.sum()), len(right)) for right in (trained, control))
    return NamedRow(*key, *shares, statistics.mean(trained.astype(float) - control))


def _driving_row(driver: str, trained: Episodes, control: Episodes) -> DrivingRow:
    speeds = [each.returns["speed_reward"] for each in (trained, control)]
    crashes = [statistics.share(int(e.crashed.sum()), len(e.seeds)) for e in (trained, control)]
    return DrivingRow(
        driver,
        statistics.mean(speeds[0]),
        statistics.mean(speeds[1]),
        statistics.mean(speeds[0] - speeds[1]),
        *crashes,
    )


def trait_table(results: IdentificationResults) -> Table:
    """Show R² of the exact posterior's mean over strangers, with either policy."""
    titles = {"trained": "with the driver", "control": "with the control"}
    rows = [
        [titles[name], *(row.traits[trait].r2.shown("z.2f") for trait in TRAIT_NAMES)]
        for name, row in results.posteriors.items()
    ]
    drivers = next(iter(results.posteriors.values())).drivers
    return Table(
        f"R² of strangers' traits, by the exact posterior from {POOL} windows, a^H hidden",
        ["", *TRAIT_NAMES],
        rows,
        f"Over {drivers} drivers of a continuous population, the same ones; intervals: 95 %, over "
        "drivers.",
    )


def in_short(results: IdentificationResults) -> str:
    """Say which part of who drives is the network's reaction to its trait inputs."""
    hidden, alone = results.row("hidden", 20.0), results.row("intended", 20.0)
    first, chain = results.row("hidden", 1.0), results.row("chain", 20.0)
    share = {
        name: [f"{100 * value.mean:.1f}" for value in (row.trained, row.control, row.difference)]
        for name, row in (("hidden", hidden), ("alone", alone), ("first", first))
    }
    return (
        f"In a window of 20 s, a^H hidden, the exact classifier names {share['hidden'][0]} % of "
        f"the drivers with the policy that reads all traits, and {share['hidden'][1]} % with the "
        f"control: {share['hidden'][2]} points are the network's reaction to β, α and η, the rest "
        "is how attention lapses and what inflation does. After 1 s it is "
        f"{share['first'][0]} and {share['first'][1]} %, {share['first'][2]} points. a^H alone "
        f"names {share['alone'][0]} and {share['alone'][1]} % after 20 s: with the control at most "
        "half, since drivers of the same inflation intend alike. The attention chain alone, a^H "
        f"seen, names {100 * chain.trained.mean:.1f} and {100 * chain.control.mean:.1f} %. One "
        "training seed of each policy."
    )
