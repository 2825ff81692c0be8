"""Unknown drivers with HMIs that get to know them, beside one that knew all along.

Attention is hidden: with attention seen the best alert rule is the same for every driver. Drivers
are of the four types, of a continuous population, or change in mid-trip. Every HMI meets the same
drivers on the same roads. The gap is that between two exact rules: AvgHMI, the optimum for the
average driver, and the optimum for whoever is at the wheel; see :mod:`hmi_marl.exact.hidden_attention`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.adaptive.factory import TYPES, Trained
from hmi_marl.agents.catalogue import make_driver_policy
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import DRIVERS, Driver, TraitDistributions, Traits, get_driver
from hmi_marl.envs.streams import Stream, mix
from hmi_marl.exact.hidden_attention import rule_return, solve_belief
from hmi_marl.experiments.adaptation.hmis import (
    ADAPTIVE,
    AVERAGE,
    KNOWING,
    LEARNED_AVERAGE,
    LEARNED_KNOWING,
    Hmis,
    hmi_names,
)
from hmi_marl.experiments.adaptation.measures import (
    Closed,
    at_the_wheel,
    by_second,
    closed,
    earned_between,
    ratio,
)
from hmi_marl.experiments.adaptation.settings import TRIPS, AdaptSettings
from hmi_marl.experiments.adaptation.trips import HandOver, Trips, play_trips
from hmi_marl.reporting import statistics
from hmi_marl.reporting.statistics import Estimate
from hmi_marl.training.evidence.conditioned import strangers
from hmi_marl.workers import results

TEAM = TeamConfig(ai_sees_attention=False, observe_traits=True)
"""How the teams are set up. The driver's policy reads their traits; no HMI here does."""
POPULATION = "population"
CHANGE_TRIP, CHANGE_STEP = 1, 50
"""Drivers change 10 s into their second trip."""
INFLATIONS = 8
"""Of each candidate of the population."""
RECOVERED = 100
"""Turns after a change from which on it is judged: 20 s."""
FIRST_TURNS = 25
"""5 s at the wheel."""
_OTHERS, _CANDIDATES = 1, 2
"""Which drawing of strangers drives, and which is looked among."""


def _trip(number: int, trips: Trips) -> NDArray[np.float64]:
    returns: NDArray[np.float64] = trips.returns[:, number]
    return returns


WHEN: Mapping[str, Callable[[Trips], NDArray[np.float64]]] = {
    "10 s": lambda trips: earned_between(trips, 50, 150),
    "20 s": lambda trips: earned_between(trips, 100, 200),
    "1 trip": partial(_trip, 1),
    "3 trips": partial(_trip, 3),
}
"""After how long at the wheel, and what is earned in the 20 s, or the trip, that follow; (E,)."""


@dataclass(frozen=True)
class Group:
    """Drivers who are judged together."""

    name: str
    drivers: tuple[Driver, ...]
    """All different; they take turns in E teams."""
    teams: int
    """E."""
    candidates: tuple[Driver, ...]
    """Whom an estimator looks among."""
    changes_to: Driver | None = None
    """Who takes the wheel in mid-trip, if somebody does."""

    @property
    def who(self) -> NDArray[np.int64]:
        """Place of each team's first driver among ``drivers``, shape (E,)."""
        return np.arange(self.teams) % len(self.drivers)

    @property
    def everybody(self) -> tuple[Driver, ...]:
        """All who ever drive."""
        return self.drivers + (() if self.changes_to is None else (self.changes_to,))


def groups(settings: AdaptSettings) -> tuple[Group, ...]:
    """The four types, the continuous population, and changes to each of the four."""
    known = [Group(driver.name, (driver,), settings.drivers, TYPES) for driver in TYPES]
    population = Group(
        POPULATION,
        _strangers(settings.strangers, settings.seed + _OTHERS),
        settings.strangers * settings.repeats,
        _with_any_inflation(_strangers(settings.candidates, settings.seed + _CANDIDATES)),
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


def _strangers(count: int, seed: int) -> tuple[Driver, ...]:
    return tuple(get_driver(text) for text in strangers(count, seed))


def _with_any_inflation(drivers: Sequence[Driver]) -> tuple[Driver, ...]:
    """Each with several inflations: who is told by them alone would else decide about the chain."""
    low, high = TraitDistributions().inflation.support
    middles = np.linspace(low, high, 2 * INFLATIONS + 1)[1::2]
    return tuple(replace(d, inflation=float(inflation)) for d in drivers for inflation in middles)


@dataclass(frozen=True)
class Play:
    """One HMI with one group."""

    group: Group
    hmi: str
    settings: AdaptSettings
    driver_policy: str
    trained: Trained


def play(task: Play) -> Trips:
    """The group's trips with the HMI."""
    group, settings = task.group, task.settings
    hmis = Hmis(
        TEAM, task.trained, group.everybody, group.candidates, settings.revealing, settings.caution
    )
    hmi = hmis.make(task.hmi)
    teams = np.arange(group.teams, dtype=np.uint64)
    numbers = teams[:, None] * np.uint64(TRIPS) + np.arange(TRIPS, dtype=np.uint64)
    first = Traits.of([group.drivers[k] for k in group.who])
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
        hmis.told.tell if task.hmi == KNOWING else None,
        keep_beliefs=group.candidates == TYPES and task.hmi in ADAPTIVE,
    )


@dataclass(frozen=True)
class Result:
    """What came out for one group. Dicts are by the HMI's name."""

    group: str
    exact_worth: float | None
    """What knowing the driver is worth in an episode of full length, exactly; of a type alone."""
    returns: dict[str, list[Estimate]]
    """Attention return of each trip."""
    shares: dict[str, dict[str, Closed]]
    """Of the gap, after so much time at the wheel; not where drivers change."""
    learned_shares: dict[str, dict[str, Closed]]
    """The same of the gap between two learned HMIs, AvgHMI's and the driver's; of types alone."""
    first_seconds: dict[str, Estimate]
    """What is earned more than by AvgHMI in the first 5 s."""
    regret: dict[str, list[float]]
    """Attention reward per step that the knowing HMI earns more, by second at the wheel."""
    belief: dict[str, list[float]]
    """Probability of the true type, by second at the wheel; where types are looked among."""
    after_change: dict[str, Estimate]
    """Regret as a share of what the knowing HMI earns, from 20 to 40 s after the change."""

    def as_json(self) -> dict[str, Any]:
        """JSON content."""
        return {
            "group": self.group,
            "exact_worth": self.exact_worth,
            "returns": {h: [e.as_json() for e in trips] for h, trips in self.returns.items()},
            "shares": _shares_json(self.shares),
            "learned_shares": _shares_json(self.learned_shares),
            "first_seconds": {h: e.as_json() for h, e in self.first_seconds.items()},
            "regret": self.regret,
            "belief": self.belief,
            "after_change": {h: e.as_json() for h, e in self.after_change.items()},
        }


def _shares_json(shares: Mapping[str, Mapping[str, Closed]]) -> dict[str, Any]:
    return {
        hmi: {
            when: {name: estimate.as_json() for name, estimate in vars(closed).items()}
            for when, closed in by_time.items()
        }
        for hmi, by_time in shares.items()
    }


def _shares(
    played: Mapping[str, Trips], best: str, average: str, same_driver: NDArray[np.int64]
) -> dict[str, dict[str, Closed]]:
    """What every HMI closes of the gap between these two, after so much time at the wheel."""
    return {
        hmi: {
            when: closed(earned(played[best]), earned(played[average]), earned(trips), same_driver)
            for when, earned in WHEN.items()
        }
        for hmi, trips in played.items()
    }


def summarise(group: Group, played: Mapping[str, Trips], settings: AdaptSettings) -> Result:
    """Everything that is told about a group, from its trips with every HMI."""
    knowing, average = played[KNOWING], played[AVERAGE]
    frequency = TEAM.scene.policy_frequency
    distinct = len(group.drivers) > 1 and group.changes_to is None
    same = group.who if distinct else np.arange(group.teams)
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
        regret={hmi: _regret(knowing, trips) for hmi, trips in played.items()},
        belief={
            hmi: by_second(trips, _truth(group, trips), frequency).tolist()
            for hmi, trips in played.items()
            if trips.probabilities is not None
        },
        after_change=after_change,
    )


def _per_driver(values: NDArray[np.float64], same_driver: NDArray[np.int64]) -> NDArray[np.float64]:
    """Means of values (E,) over the teams that each different driver has: these are independent."""
    _, driver = np.unique(same_driver, return_inverse=True)
    means: NDArray[np.float64] = np.bincount(driver, values) / np.bincount(driver)
    return means


def _regret(knowing: Trips, trips: Trips) -> list[float]:
    """What is missed per step, by second at the wheel, as long as most drive with both."""
    best, own = (by_second(t, t.rewards, TEAM.scene.policy_frequency) for t in (knowing, trips))
    common = min(len(best), len(own))
    return (best[:common] - own[:common]).tolist()


def _truth(group: Group, trips: Trips) -> NDArray[np.float64]:
    """What was believed of the true type, shape (E, J, T)."""
    assert trips.probabilities is not None
    place = np.array([TYPES.index(group.drivers[k]) for k in group.who])
    who = np.broadcast_to(place[:, None, None], trips.driving.shape).copy()
    if group.changes_to is not None:
        new = TYPES.index(group.changes_to)
        who[:, CHANGE_TRIP, CHANGE_STEP:] = new
        who[:, CHANGE_TRIP + 1 :] = new
    return np.take_along_axis(trips.probabilities, who[..., None], axis=3)[..., 0]


def _after_change(trips: Trips) -> NDArray[np.float64]:
    """Earned from 20 to 40 s after the change of driver, at the wheel; shape (E,)."""
    before = trips.driving[:, :CHANGE_TRIP].sum(axis=(1, 2))
    before += trips.driving[:, CHANGE_TRIP, :CHANGE_STEP].sum(axis=1)
    turns = np.nan_to_num(at_the_wheel(trips, trips.rewards))
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


def evaluate(
    settings: AdaptSettings,
    driver_policy: str,
    trained: Trained,
    workers: int,
    progress: Callable[[int], object] = lambda plays: None,
) -> list[Result]:
    """Play every group with every HMI and sum up.

    Args:
        settings: how large.
        driver_policy: who steers.
        trained: what was learned.
        workers: processes. Does not change results.
        progress: is called after each group and HMI.
    """
    tasks = [
        Play(group, hmi, settings, driver_policy, trained)
        for group in groups(settings)
        for hmi in hmi_names(group.everybody)
    ]
    played: dict[str, dict[str, Trips]] = {}
    found = []
    for task, trips in zip(tasks, results(play, tasks, workers), strict=True):
        of_group = played.setdefault(task.group.name, {})
        of_group[task.hmi] = trips
        if len(of_group) == len(hmi_names(task.group.everybody)):
            found.append(summarise(task.group, of_group, settings))
            played.clear()
        progress(1)
    return found


def plays(settings: AdaptSettings) -> int:
    """How often :func:`evaluate` tells its progress."""
    return sum(len(hmi_names(group.everybody)) for group in groups(settings))
