"""Record demonstrations of drivers, by default with an HMI that alerts at random.

Random alerts show a driver's receptivity: driving with and without an alert in alike situations.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.catalogue import (
    learned_file,
    make_driver_policy,
    make_hmi,
    mixed_names,
)
from hmi_marl.agents.learned.policy import LearnedPolicy
from hmi_marl.agents.mixture import Mixture
from hmi_marl.agents.rollout import Observer, begin, play
from hmi_marl.checks import Checked, Count, CountOrZero, Share, Steps, shown
from hmi_marl.demonstrations.dataset import (
    MISSING,
    STATE_PARTS,
    Demonstrations,
    Observed,
    Truth,
    numbers,
    observed_layout,
)
from hmi_marl.demonstrations.population import PopulationTraits
from hmi_marl.envs.alerts import need_plain
from hmi_marl.envs.config import DRIVER, VEHICLE_AI, TeamConfig, TeamSettings
from hmi_marl.envs.drivers import (
    PAPER_DRIVERS,
    Driver,
    DriverName,
    FixedDrivers,
    Traits,
    get_driver,
)
from hmi_marl.envs.observations import vehicle_ai_layout
from hmi_marl.envs.seats import Policy
from hmi_marl.envs.step_result import StepResult
from hmi_marl.envs.streams import Seed, Stream, episode_seed, mix
from hmi_marl.envs.teaming import Teaming
from hmi_marl.files import json_value, sha256, sha256_of

POPULATION, RANDOM, ALERT_RATE = "population", "random", 0.2


@dataclass(frozen=True)
class CollectSettings(Checked, TeamSettings):
    """Settings of a recording, checked.

    Raises:
        ValueError, TypeError: a value out of its range, saying what to use instead.
    """

    drivers: tuple[DriverName, ...] = PAPER_DRIVERS
    """Drivers: lisa, marge, bart, homer, average, name:beta,alpha,eta,inflation, or files."""
    steps: Steps = 300_000
    """Steps of each driver, rounded up to whole windows. Each driver has separate windows."""
    population: CountOrZero = 0
    """Number of further drivers with traits drawn evenly from the whole range: population-0,
    population-1, ..., to evaluate on drivers that were never seen in training."""
    windows: Count = 16
    """Windows of each driver of the population."""
    traits: PopulationTraits = field(default_factory=PopulationTraits)
    """Traits of the population."""
    hmi: str = RANDOM
    """HMI: random, at --alert-rate, so that the timing of alerts says nothing of the driver; or any
    other by name, such as average or adapt:expected."""
    alert_rate: Share = ALERT_RATE
    """Probability of an alert in each step, with the HMI random."""
    driver_policy: str = "rule"
    """Driver policy: the folder of a training run, trained:driver, rule, random, or
    mixture:NAME,NAME,... of these."""
    greedy: bool = False
    """Whether a trained driver takes the likeliest action; by default it draws, as people vary."""
    seed: Seed = 0
    """Seed of all draws: the same seed gives the same data."""
    end_at_crash: bool = False
    """Whether a crash ends the window. If not, the crashed car stands, so that all windows have the
    same length and the length reveals nothing."""
    num_teams: Count = 512
    """Teams simulated in parallel. Needs memory, but does not change results."""

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_names(self.drivers)
        if not self.drivers and not self.population:
            raise ValueError("there is no driver: name drivers, or set population")
        team = self.team(PAPER_DRIVERS)
        need_plain(team.alerts, "a dataset of demonstrations")
        if self.hmi != RANDOM and self.alert_rate != ALERT_RATE:
            raise ValueError(
                f"alert_rate is of the HMI {RANDOM!r}, not of {shown(self.hmi)}; give one of both"
            )
        self.make_hmi(team)
        counts = Counter(driver.name for driver, _ in self.cast())
        if twice := [name for name, count in counts.items() if count > 1]:
            raise ValueError(f"two drivers have the name {twice[0]!r}; rename one")

    @property
    def hmi_name(self) -> str:
        """Name of the HMI that collects data, with its rate."""
        return f"{RANDOM}:{float(self.alert_rate)!r}" if self.hmi == RANDOM else self.hmi

    def make_hmi(self, config: TeamConfig) -> Policy:
        """Make the HMI that collects data."""
        return make_hmi(self.hmi_name, config)

    def make_driver(self, config: TeamConfig) -> Policy:
        """Make the driver policy, or raise FileNotFoundError or ValueError if there is none."""
        policy = make_driver_policy(self.driver_policy, config)
        for each in policy.policies if isinstance(policy, Mixture) else (policy,):
            if isinstance(each, LearnedPolicy):
                each.greedy = self.greedy
        return policy

    def cast(self) -> list[tuple[Driver, int]]:
        """Return the drivers, each with its number of windows."""
        return list(self._cast)

    @cached_property
    def _cast(self) -> tuple[tuple[Driver, int], ...]:
        horizon = self.team(PAPER_DRIVERS).horizon
        named = [(get_driver(name), -(-self.steps // horizon)) for name in self.drivers]
        names = [f"{POPULATION}-{k}" for k in range(self.population)]
        traits = self.traits.distributions.draw(self._series(names)).as_array().tolist()
        drawn = (Driver(name, *row) for name, row in zip(names, traits, strict=True))
        return (*named, *((driver, self.windows) for driver in drawn))

    @property
    def total_steps(self) -> int:
        """Steps in all windows, if no crash ends one."""
        horizon = self.team(PAPER_DRIVERS).horizon
        return horizon * sum(windows for _, windows in self.cast())

    def episodes(self) -> tuple[NDArray[np.int64], NDArray[np.uint64]]:
        """Return the driver of every window, an index of :meth:`cast`, and its seed.

        A driver's seeds depend on the seed and the driver's name, not on the other drivers.
        """
        cast = self.cast()
        who = np.repeat(np.arange(len(cast)), [windows for _, windows in cast])
        number = np.concatenate([np.arange(1, windows + 1) for _, windows in cast])
        return who, episode_seed(self._series([driver.name for driver, _ in cast])[who], number)

    def traits_in(self, who: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the traits of each window, shape (E, 4), of :meth:`episodes`' drivers (E,)."""
        drawn = np.array([driver.traits for driver, _ in self.cast()])[who]
        stays = who < len(self.drivers)
        moved = self.traits.drifted(drawn, numbers(who), self.windows)
        return np.where(stays[:, None], drawn, moved)

    def _series(self, names: list[str]) -> NDArray[np.uint64]:
        digests = (bytes.fromhex(sha256(name.encode())) for name in names)
        keys = [int.from_bytes(digest[:8], "little") for digest in digests]
        return mix(self.seed, Stream.EPISODE, np.array(keys, np.uint64))


def _check_names(drivers: Sequence[str]) -> None:
    if isinstance(drivers, str) or not all(isinstance(name, str) for name in drivers):
        raise TypeError(f"drivers takes a tuple of names, not {drivers!r}")


def collect(
    settings: CollectSettings, progress: Callable[[int], Any] = id, command_line: str = ""
) -> Iterator[Demonstrations]:
    """Play and record, chunk by chunk, the windows of one driver after another.

    Args:
        progress: called with the number of steps that were recorded since the last call.
        command_line: the command, kept with the truth.

    Raises:
        FileNotFoundError, ValueError: there is no such driver policy; raised before any step.
    """
    config = settings.team(PAPER_DRIVERS)
    settings.make_driver(config)
    about = _about(settings, config)
    cast = [driver for driver, _ in settings.cast()]
    hidden = about | {"drivers": json_value(cast), "settings": json_value(settings)}
    hidden["command"] = command_line
    who, seeds = settings.episodes()
    traits = settings.traits_in(who)

    def chunks() -> Iterator[Demonstrations]:
        for start in range(0, len(seeds), settings.num_teams):
            part = slice(start, start + settings.num_teams)
            drivers = who[part], traits[part]
            yield _play(settings, cast, drivers, seeds[part], (about, hidden), progress)

    return chunks()


def _about(settings: CollectSettings, config: TeamConfig) -> dict[str, Any]:
    """Describe how the data are made, without traits."""
    name = settings.driver_policy
    policy = {"name": name, "greedy": settings.greedy} | _named(name)
    if mixed := mixed_names(name):
        policy["mixture"] = [_named(each) for each in mixed]
    team = {name: value for name, value in json_value(config).items() if name != "driver"}
    return {
        "environment": "merge_v0",
        "team": team,
        "driver_policy": policy,
        "hmi": settings.hmi_name,
        "seed": settings.seed,
        "population": settings.population,
    }


def _named(driver_policy: str) -> dict[str, Any]:
    """Name of a driver policy, and the checksum of its weights if it is learned."""
    weights = learned_file(driver_policy, DRIVER)
    checksum = {} if weights is None else {"sha256": sha256_of(weights)}
    return {"name": driver_policy} | checksum


def _play(
    settings: CollectSettings,
    cast: list[Driver],
    drivers: tuple[NDArray[np.int64], NDArray[np.float64]],
    seeds: NDArray[np.uint64],
    about: tuple[dict[str, Any], dict[str, Any]],
    progress: Callable[[int], Any],
) -> Demonstrations:
    who, traits = drivers
    config = settings.team(FixedDrivers(Traits.from_array(traits)))
    driver, hmi = settings.make_driver(config), settings.make_hmi(config)
    teaming = begin(config, driver, hmi, seeds, "batched")
    recorder = StepRecorder(config, len(seeds), progress)
    play(teaming, driver, hmi, [recorder])
    names, r = tuple(driver.name for driver in cast), recorder
    steps = r.states, r.applied, r.alerts, teaming.steps.copy(), r.crash_step
    observed = Observed(r.layout, *steps, who, names, seeds, about[0])
    hidden = r.distracted, r.accepted, r.counter, r.intended
    return Demonstrations(observed, Truth(*hidden, traits, about[1]))


class StepRecorder(Observer):
    """Record the observable data of each step of N teams and, separately, the truth.

    Args:
        config: of the teams.
        num_teams: N.
        progress: called with the number of steps that were recorded since the last call.
    """

    def __init__(
        self, config: TeamConfig, num_teams: int = 1, progress: Callable[[int], Any] = id
    ) -> None:
        self.layout = observed_layout(config)
        self._columns = _in_one_piece(vehicle_ai_layout(config).columns_of(self.layout))
        shape = num_teams, config.horizon
        self.states = np.zeros((*shape, self.layout.size), np.float32)
        self.alerts, self.distracted, self.accepted, self.counter = np.zeros((4, *shape), np.int64)
        self.applied, self.intended = np.full((2, *shape), MISSING)
        self.crash_step = np.full(num_teams, MISSING)
        self._progress = progress
        self._step = 0

    def before(self, teaming: Teaming) -> None:
        """Record the state in which the driver acts."""
        self._over = teaming.over
        seen = teaming.observe(VEHICLE_AI, STATE_PARTS)
        self.states[:, self._step] = seen[:, self._columns]

    def after(self, teaming: Teaming, result: StepResult) -> None:
        """Record the actions and the hidden attention."""
        t, attention = self._step, teaming.attention
        self.applied[:, t], self.alerts[:, t] = teaming.applied, teaming.alerted
        self.intended[:, t], self.distracted[:, t] = teaming.intended, attention.distracted
        self.accepted[:, t], self.counter[:, t] = attention.accepted, attention.counter
        self.crash_step[~self._over & teaming.crashed & (self.crash_step == MISSING)] = t
        if self._over.any():
            self._blank(self._over)
        self._progress(len(self._over) - int(self._over.sum()))
        self._step += 1

    def _blank(self, over: NDArray[np.bool_]) -> None:
        """Leave the present step empty where the episode had ended before it."""
        for rows in (self.states, self.alerts, self.distracted, self.accepted, self.counter):
            rows[over, self._step] = 0
        for rows in (self.applied, self.intended):
            rows[over, self._step] = MISSING


def _in_one_piece(columns: NDArray[np.int64]) -> slice:
    """Return columns that lie next to each other as a slice, which is selected without a copy."""
    assert (np.diff(columns) == 1).all()
    return slice(int(columns[0]), int(columns[-1]) + 1)


@dataclass
class Tally:
    """Counts of what was recorded of one driver, or of the whole population."""

    driver: str
    minutes_per_step: float
    episodes: int = 0
    steps: int = 0
    crashes: int = 0
    alerts: int = 0
    distracted: int = 0
    """Steps with d = 1."""

    def as_json(self) -> dict[str, Any]:
        """Return counts and rates."""
        return {
            "driver": self.driver,
            "episodes": self.episodes,
            "steps": self.steps,
            "crash_rate": self.crashes / self.episodes,
            "alerts_per_minute": self.alerts / (self.steps * self.minutes_per_step),
            "share_distracted": self.distracted / self.steps,
        }


class Summary:
    """Count the demonstrations that pass through :meth:`counting`, for each driver."""

    def __init__(self, settings: CollectSettings) -> None:
        self._step = 1 / settings.team(PAPER_DRIVERS).scene.policy_frequency / 60
        self._named = len(settings.drivers)
        self._tallies: dict[str, Tally] = {}

    def counting(self, chunks: Iterable[Demonstrations]) -> Iterator[Demonstrations]:
        """Yield the same chunks and count them."""
        for chunk in chunks:
            observed, truth = chunk.observed, chunk.truth
            assert truth is not None
            alerts, distracted = observed.alerts.sum(axis=1), truth.distracted.sum(axis=1)
            rows = np.minimum(observed.driver, self._named)  # the population shares one
            for k in np.unique(rows):
                name = observed.names[k] if k < self._named else POPULATION
                tally = self._tallies.setdefault(name, Tally(name, self._step))
                theirs = rows == k
                tally.episodes += int(theirs.sum())
                tally.steps += int(observed.length[theirs].sum())
                tally.crashes += int(observed.crashed[theirs].sum())
                tally.alerts += int(alerts[theirs].sum())
                tally.distracted += int(distracted[theirs].sum())
            yield chunk

    def as_json(self) -> list[dict[str, Any]]:
        """Return a row for each driver, and one for the population."""
        return [tally.as_json() for tally in self._tallies.values()]

    def as_text(self) -> str:
        """Format the same as a table."""
        head = f"{'driver':<12} {'episodes':>9} {'steps':>10} {'crashed':>8} {'alerts/min':>11}"
        lines = [f"{head} {'distracted':>11}"]
        lines += [
            f"{row['driver']:<12} {row['episodes']:>9} {row['steps']:>10} "
            f"{row['crash_rate']:>8.1%} {row['alerts_per_minute']:>11.1f} "
            f"{row['share_distracted']:>11.1%}"
            for row in self.as_json()
        ]
        return "\n".join(lines)
