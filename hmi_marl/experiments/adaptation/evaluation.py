"""Play unknown drivers with every HMI, and measure what the HMIs earn.

Attention is hidden: with attention seen the best alert rule is the same for the five named drivers
(not for every driver: at low α, β and η it is another). Drivers are of the four types, of a
continuous population, or change in mid-trip. Every HMI meets the same drivers on the same roads.
The gap is between two exact rules: AvgHMI, the optimum for the average driver, and the optimum for
the driver at the wheel; see :mod:`hmi_marl.exact.hidden_attention`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.adaptive.hmis import CAUTION, DOUBT, TYPES, Trained
from hmi_marl.agents.catalogue import make_driver_policy
from hmi_marl.checks import Checked, Count, Share, Whole
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import DRIVERS, Driver, Traits, get_driver
from hmi_marl.envs.streams import Seed, Stream, mix, part_seed
from hmi_marl.exact.hidden_attention import rule_return, solve_belief
from hmi_marl.experiments.adaptation.hmis import (
    ADAPTIVE,
    AVERAGE,
    KNOWING,
    LEARNED_AVERAGE,
    LEARNED_KNOWING,
    Hmis,
    hmi_names,
    read_by,
)
from hmi_marl.experiments.adaptation.trips import (
    Closed,
    HandOver,
    Trips,
    by_second,
    by_turn,
    closed,
    earned_between,
    play_trips,
    ratio,
)
from hmi_marl.reporting import statistics
from hmi_marl.reporting.statistics import Estimate
from hmi_marl.training.conditioned.settings import strangers, with_any_inflation
from hmi_marl.workers import results

TEAM = TeamConfig(ai_sees_attention=False, observe_traits=True)
"""Settings of the teams. The driver's policy reads the driver's traits; no HMI here does."""
TRIPS = 4
"""Trips of each driver: the first as an unknown driver, then after one, two and three trips."""
POPULATION = "population"
CHANGE_TRIP, CHANGE_STEP = 1, 50
"""Drivers change 10 s into their second trip."""
INFLATIONS = 8
"""Inflations tried for each candidate of the population."""
RECOVERED = 100
"""Turns after a change of driver from which regret counts: 20 s."""
FIRST_TURNS = 25
"""The first 5 s of driving."""
REGRET_AT: Mapping[str, int] = {"5 s": 25, "10 s": 50, "20 s": 100, "60 s": 300}
"""Turns driven with an unknown driver up to which regret is summed."""
_DRIVING, _CANDIDATES = 1, 2
"""Added to the seed for the drivers of the population, and for the candidates."""


def _trip(number: int, trips: Trips) -> NDArray[np.float64]:
    returns: NDArray[np.float64] = trips.returns[:, number]
    return returns


WHEN: Mapping[str, Callable[[Trips], NDArray[np.float64]]] = {
    "10 s": lambda trips: earned_between(trips, 50, 150),
    "20 s": lambda trips: earned_between(trips, 100, 200),
    "1 trip": partial(_trip, 1),
    "3 trips": partial(_trip, 3),
}
"""Attention reward (E,) of the 20 s, or the trip, after so much driving."""


Several = Annotated[int, Whole(2, 1_000_000)]
"""Number of things over which an interval is taken."""


@dataclass(frozen=True)
class AdaptSettings(Checked):
    """Size of an evaluation of adaptive HMIs.

    Raises:
        ValueError: too few drivers for an interval, or a number out of its range.
    """

    drivers: Several = 400
    """Drivers of each of the four types."""
    population: Several = 512
    """Drivers of the continuous population, all different."""
    repeats: Count = 1
    """Times that each of them takes their trips."""
    candidates: Count = 128
    """Other drivers of that population, which an estimator considers."""
    changes: Several = 400
    """Changes of driver in mid-trip, to each of the four types."""
    revealing: Share = 0.35
    """Share of steps in which a^H differs from the last applied action, as every HMI assumes it."""
    caution: Annotated[float, DOUBT] = CAUTION
    """Standard deviations of doubt at which the HMI of expected value acts as AvgHMI."""
    seed: Seed = 10**7
    """Seed of the trips."""


QUICK = AdaptSettings(drivers=40, population=24, repeats=2, candidates=48, changes=40)
"""Coarse version that takes a minute or two."""


@dataclass(frozen=True)
class Group:
    """Drivers who are judged together."""

    name: str
    drivers: tuple[Driver, ...]
    """Different drivers, who take turns in E teams."""
    teams: int
    """E."""
    candidates: tuple[Driver, ...]
    """Drivers that an estimator considers."""
    changes_to: Driver | None = None
    """Driver who takes the wheel in mid-trip, if there is a change."""

    @property
    def first_drivers(self) -> NDArray[np.int64]:
        """Index of each team's first driver in ``drivers``, shape (E,)."""
        return np.arange(self.teams) % len(self.drivers)

    @property
    def all_drivers(self) -> tuple[Driver, ...]:
        """All drivers before and after the change."""
        return self.drivers + (() if self.changes_to is None else (self.changes_to,))


def groups(settings: AdaptSettings) -> tuple[Group, ...]:
    """Return the four types, the continuous population, and changes to each of the four."""
    driving, considered = (int(part_seed(settings.seed, k)) for k in (_DRIVING, _CANDIDATES))
    known = [Group(driver.name, (driver,), settings.drivers, TYPES) for driver in TYPES]
    population = Group(
        POPULATION,
        _random_drivers(settings.population, driving),
        settings.population * settings.repeats,
        with_any_inflation(strangers(settings.candidates, considered), INFLATIONS),
    )
    changing = [
        Group(
            f"change to {driver.name}",
            tuple(other for other in TYPES if other != driver),
            settings.changes,
            TYPES,
            driver,
        )
        for driver in TYPES
    ]
    return (*known, population, *changing)


def _random_drivers(count: int, seed: int) -> tuple[Driver, ...]:
    return tuple(get_driver(text) for text in strangers(count, seed))


@dataclass(frozen=True)
class Play:
    """Play of one HMI with one group."""

    group: Group
    hmi: str
    settings: AdaptSettings
    driver_policy: str
    trained: Trained


def play(task: Play) -> Trips:
    """Play the group's trips with the HMI."""
    group, settings = task.group, task.settings
    assumed = settings.revealing, settings.caution
    hmis = Hmis(TEAM, task.trained, group.all_drivers, group.candidates, *assumed)
    hmi = hmis.make(task.hmi)
    teams = np.arange(group.teams, dtype=np.uint64)
    numbers = teams[:, None] * np.uint64(TRIPS) + np.arange(TRIPS, dtype=np.uint64)
    first = Traits.of([group.drivers[k] for k in group.first_drivers])
    change = None
    if group.changes_to is not None:
        after = Traits.of([group.changes_to] * group.teams)
        change = HandOver(CHANGE_TRIP, CHANGE_STEP, after)
    return play_trips(
        TEAM,
        make_driver_policy(task.driver_policy, TEAM),
        hmi,
        first,
        mix(settings.seed, Stream.TRAINING, numbers),
        change,
        hmis.known.set_drivers if task.hmi == KNOWING else None,
        keep_beliefs=group.candidates == TYPES and task.hmi in ADAPTIVE,
    )


@dataclass(frozen=True)
class Result:
    """Results of one group. Dicts are by the HMI's name."""

    group: str
    exact_worth: float | None
    """Exact gain from knowing the driver in an episode of full length; for single types only."""
    returns: dict[str, list[Estimate]]
    """Attention return of each trip."""
    shares: dict[str, dict[str, Closed]]
    """Closed shares of the gap, after so much driving; empty where drivers change."""
    learned_shares: dict[str, dict[str, Closed]]
    """The same for the gap between learned HMIs, AvgHMI's and the driver's; for types only."""
    first_seconds: dict[str, Estimate]
    """Gain over AvgHMI in the first 5 s."""
    total_regret: dict[str, dict[str, Estimate]]
    """Gain of the knowing HMI in attention reward over the first turns; see ``REGRET_AT``."""
    regret: dict[str, list[float]]
    """Gain of the knowing HMI in attention reward per step, by second driven."""
    belief: dict[str, list[float]]
    """Probability of the true type, by second driven; where the candidates are types."""
    after_change: dict[str, Estimate]
    """Regret as a share of what the knowing HMI earns, from 20 to 40 s after the change."""


def _shares(
    played: Mapping[str, Trips], best: str, average: str, same_driver: NDArray[np.int64]
) -> dict[str, dict[str, Closed]]:
    """Measure what every HMI closes of the gap between two HMIs, after so much driving."""
    return {
        hmi: {
            when: closed(earned(played[best]), earned(played[average]), earned(trips), same_driver)
            for when, earned in WHEN.items()
        }
        for hmi, trips in played.items()
    }


def summarise(group: Group, played: Mapping[str, Trips], settings: AdaptSettings) -> Result:
    """Compute a group's results from its trips with every HMI."""
    knowing, average = played[KNOWING], played[AVERAGE]
    frequency = TEAM.scene.policy_frequency
    distinct = len(group.drivers) > 1 and group.changes_to is None
    same = group.first_drivers if distinct else np.arange(group.teams)
    early = earned_between(average, 0, FIRST_TURNS)
    shares: dict[str, dict[str, Closed]] = {}
    learned: dict[str, dict[str, Closed]] = {}
    after_change: dict[str, Estimate] = {}
    if group.changes_to is not None:
        best = _after_change(knowing)
        for hmi, trips in played.items():
            after_change[hmi] = ratio(best - _after_change(trips), best)
    else:
        shares = _shares(played, KNOWING, AVERAGE, same)
        if LEARNED_KNOWING in played:
            learned = _shares(played, LEARNED_KNOWING, LEARNED_AVERAGE, same)
    return Result(
        group=group.name,
        exact_worth=_exact_worth(group, settings),
        returns={
            hmi: [statistics.mean(_per_driver(column, same)) for column in trips.returns.T]
            for hmi, trips in played.items()
        },
        shares=shares,
        learned_shares=learned,
        first_seconds={
            hmi: statistics.mean(_per_driver(earned_between(trips, 0, FIRST_TURNS) - early, same))
            for hmi, trips in played.items()
        },
        total_regret={
            hmi: {
                when: statistics.mean(
                    _per_driver(
                        earned_between(knowing, 0, turns) - earned_between(trips, 0, turns), same
                    )
                )
                for when, turns in REGRET_AT.items()
            }
            for hmi, trips in played.items()
        },
        regret={hmi: _regret(knowing, trips) for hmi, trips in played.items()},
        belief={
            hmi: by_second(trips, _truth(group, trips), frequency).tolist()
            for hmi, trips in played.items()
            if trips.probabilities is not None
        },
        after_change=after_change,
    )


def _per_driver(values: NDArray[np.float64], same_driver: NDArray[np.int64]) -> NDArray[np.float64]:
    """Average values (E,) over each driver's teams; drivers are independent."""
    _, driver = np.unique(same_driver, return_inverse=True)
    means: NDArray[np.float64] = np.bincount(driver, values) / np.bincount(driver)
    return means


def _regret(knowing: Trips, trips: Trips) -> list[float]:
    """Compute the regret per step, by second driven, while most teams drive with both HMIs."""
    best, own = (by_second(t, t.rewards, TEAM.scene.policy_frequency) for t in (knowing, trips))
    common = min(len(best), len(own))
    return (best[:common] - own[:common]).tolist()


def _truth(group: Group, trips: Trips) -> NDArray[np.float64]:
    """Return the believed probability of the true type, shape (E, J, T)."""
    assert trips.probabilities is not None
    place = np.array([TYPES.index(group.drivers[k]) for k in group.first_drivers])
    types = np.broadcast_to(place[:, None, None], trips.driving.shape).copy()
    if group.changes_to is not None:
        types[:, CHANGE_TRIP, CHANGE_STEP:] = TYPES.index(group.changes_to)
        types[:, CHANGE_TRIP + 1 :] = TYPES.index(group.changes_to)
    return np.take_along_axis(trips.probabilities, types[..., None], axis=3)[..., 0]


def _after_change(trips: Trips) -> NDArray[np.float64]:
    """Sum the attention reward from 20 to 40 s driven after the change of driver, shape (E,)."""
    before = trips.driving[:, :CHANGE_TRIP].sum(axis=(1, 2))
    before += trips.driving[:, CHANGE_TRIP, :CHANGE_STEP].sum(axis=1)
    turns = np.nan_to_num(by_turn(trips, trips.rewards))
    after = before[:, None] + np.arange(RECOVERED, RECOVERED + TEAM.horizon)
    inside = after < turns.shape[1]
    earned = np.take_along_axis(turns, np.minimum(after, turns.shape[1] - 1), axis=1)
    return np.where(inside, earned, 0.0).sum(axis=1)


def _exact_worth(group: Group, settings: AdaptSettings) -> float | None:
    if len(group.drivers) > 1:
        return None
    own, average = (
        solve_belief(model, TEAM.alert_window, TEAM.horizon, TEAM.weights, settings.revealing)
        for model in (group.drivers[0], DRIVERS["average"])
    )
    return own.total_return - rule_return(average, group.drivers[0], TEAM.weights)


def tasks(settings: AdaptSettings, driver_policy: str, trained: Sequence[Trained]) -> list[Play]:
    """List all plays, by group; an HMI that reads the same models of several is played once.

    Args:
        settings: size of the evaluation.
        driver_policy: the driver policy by name, or its run.
        trained: learned models of each training seed.
    """
    found: list[Play] = []
    for group in groups(settings):
        names = hmi_names(group.all_drivers)
        different = dict.fromkeys((hmi, read_by(hmi, each)) for each in trained for hmi in names)
        found += [Play(group, hmi, settings, driver_policy, read) for hmi, read in different]
    return found


def evaluate(
    plays: Sequence[Play],
    trained: Sequence[Trained],
    workers: int,
    progress: Callable[[int], object] = lambda plays: None,
) -> list[list[Result]]:
    """Play what :func:`tasks` lists for ``trained``, and sum up; the same for any workers.

    Calls ``progress`` after each play.

    Returns:
        Results of every group, for each of ``trained``.
    """
    found: list[list[Result]] = [[] for _ in trained]
    played = zip(plays, results(play, plays, workers), strict=True)
    for group, rows in groupby(played, key=lambda row: row[0].group):
        trips = {}
        for task, its_trips in rows:
            trips[task.hmi, task.trained] = its_trips
            progress(1)
        names = hmi_names(group.all_drivers)
        for each, own in zip(trained, found, strict=True):
            of_each = {hmi: trips[hmi, read_by(hmi, each)] for hmi in names}
            own.append(summarise(group, of_each, task.settings))
    return found
