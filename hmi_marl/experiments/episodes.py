"""Play seeded episodes, and keep their lengths, returns, headways and alerts, and their quality.

Returns of a few hundred episodes differ by luck far more than good HMIs differ from each other. The
loss of each alert (:func:`hmi_marl.exact.oracle.alert_losses`) does not: that of an optimal HMI is
0 in every single step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.agents.catalogue import make_driver_policy, make_hmi
from hmi_marl.agents.hmis import strongest_alert
from hmi_marl.agents.rollout import Observer, begin, play
from hmi_marl.envs.attention import Attention
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import Driver, DriverList
from hmi_marl.envs.rewards import ATTENTION_TERMS, TERMS
from hmi_marl.envs.seats import Policy
from hmi_marl.envs.step_result import StepResult
from hmi_marl.envs.streams import episode_seed
from hmi_marl.envs.teaming import Teaming
from hmi_marl.exact import oracle

EVALUATION_SEED = 10**9
"""Seed of the series of evaluation episodes."""
_NOTHING = 1e-6
"""Difference in attention return below which two exact values are equal but for rounding."""


@dataclass(frozen=True)
class AlertQuality:
    """Sums over the steps of E episodes. Arrays have shape (E,)."""

    followed: NDArray[np.int64]
    """Steps with the strongest alert if the driver was distracted one step before, else none."""
    lost: NDArray[np.float64]
    """Attention return lost against the optimum."""

    @classmethod
    def nothing_yet(cls, count: int) -> AlertQuality:
        """Zeros for ``count`` episodes that begin."""
        return cls(np.zeros(count, np.int64), np.zeros(count))

    def add(self, step: AlertQuality, active: NDArray[np.bool_]) -> AlertQuality:
        """Add one step of the episodes marked in ``active``, shape (E,)."""
        return AlertQuality(
            self.followed + active * step.followed, self.lost + np.where(active, step.lost, 0.0)
        )

    @classmethod
    def join(cls, several: Sequence[AlertQuality]) -> AlertQuality:
        """Put episodes together, in order."""
        return cls(
            np.concatenate([quality.followed for quality in several]),
            np.concatenate([quality.lost for quality in several]),
        )


class AlertJudge:
    """Judge of alerts to one driver; raises ``ValueError`` if it is drawn from a population."""

    def __init__(self, team: TeamConfig) -> None:
        self._losses = oracle.alert_losses(**exact_settings(team))
        self._strongest, self._wearies = team.alerts.strongest, team.fatigue is not None

    def judge(self, step: int, before: Attention, alerts: NDArray[np.int64]) -> AlertQuality:
        """Judge alerts a^A (E,) in the step after ``step`` others, by the attention before it."""
        state = [before.distracted, before.accepted, before.counter]
        if self._wearies:
            state.append(before.fatigue)
        followed = alerts == self._strongest * before.distracted
        return AlertQuality(followed.astype(np.int64), self._losses[step, alerts, *state])


def exact_settings(team: TeamConfig) -> dict[str, Any]:
    """Keywords by which the oracle's functions solve this team's problem.

    Raises:
        ValueError: the driver is drawn from a population.
    """
    if team.only_driver is None:
        raise ValueError("exact values are of one driver; name one, not a population")
    return {
        "driver": team.only_driver,
        "window": team.alert_window,
        "horizon": team.horizon,
        "weights": team.weights,
        "strengths": team.alert_strengths,
        "fatigue": team.fatigue,
    }


@dataclass(frozen=True)
class ExactRules:
    """Exact attention returns over an episode that runs its whole time, for one driver."""

    optimum: float
    """Return of the best alerts, attention seen."""
    when_distracted: float
    """Return of the strongest alert exactly when the driver was distracted one step before."""
    never: float
    """Return without alerts."""

    @classmethod
    def of(cls, team: TeamConfig) -> ExactRules:
        """Compute them for the team's driver."""
        settings = exact_settings(team)
        rule = strongest_alert(team.alerts, 0.0, 1.0)
        return cls(
            oracle.solve_alerts(**settings).total_return,
            oracle.evaluate(rule, **settings).total_return,
            oracle.evaluate(0.0, **settings).total_return,
        )

    def share_of_gain(self, lost_per_episode: float) -> float | None:
        """Share of what the best alerts gain over none: 1 for the optimum, 0 for no alerts.

        Args:
            lost_per_episode: attention return lost in an episode of the whole time.

        Returns:
            None where alerts can gain nothing.
        """
        gain = self.optimum - self.never
        return None if gain < _NOTHING else 1.0 - lost_per_episode / gain


@dataclass(frozen=True)
class Episodes:
    """Results of E episodes. Arrays have shape (E,)."""

    seeds: NDArray[np.uint64]
    length: NDArray[np.int64]
    """Length [steps]."""
    crashed: NDArray[np.bool_]
    alerts: NDArray[np.int64]
    distracted: NDArray[np.int64]
    """Steps with d = 1."""
    min_time_headway: NDArray[np.float64]
    """Shortest time headway [s]; inf if no vehicle was ever ahead."""
    median_time_headway: NDArray[np.float64]
    """Median over the steps with a vehicle ahead [s]; inf if there was none."""
    returns: dict[str, NDArray[np.float64]]
    """Sum of each reward term."""
    alerting: AlertQuality | None = None
    """Quality of the alerts; None without a judge."""

    def attention_return(self) -> NDArray[np.float64]:
        """Distraction, alert and accept-alert terms together."""
        return np.sum([self.returns[name] for name in ATTENTION_TERMS], axis=0)

    @classmethod
    def join(cls, several: Sequence[Episodes]) -> Episodes:
        """Put episodes together, in order."""
        joined: dict[str, Any] = {
            field.name: np.concatenate([getattr(episodes, field.name) for episodes in several])
            for field in fields(cls)
            if field.name not in ("returns", "alerting")
        }
        returns = {
            name: np.concatenate([episodes.returns[name] for episodes in several]) for name in TERMS
        }
        judged = [episodes.alerting for episodes in several if episodes.alerting is not None]
        alerting = AlertQuality.join(judged) if len(judged) == len(several) else None
        return cls(**joined, returns=returns, alerting=alerting)


class _Totals(Observer):
    """Add up the results of N episodes."""

    def __init__(self, count: int, horizon: int, judge: AlertJudge | None) -> None:
        self.returns = {name: np.zeros(count) for name in TERMS}
        self.alerts, self.distracted = np.zeros((2, count), np.int64)
        self.headways = np.full((horizon, count), np.inf)
        self.alerting = None if judge is None else AlertQuality.nothing_yet(count)
        self._judge = judge
        self._step = 0

    def before(self, teaming: Teaming) -> None:
        self._active, self._attention = ~teaming.over, teaming.attention

    def after(self, teaming: Teaming, result: StepResult) -> None:
        active, step = self._active, self._step
        if self._judge is not None and self.alerting is not None:
            judged = self._judge.judge(step, self._attention, teaming.alerted)
            self.alerting = self.alerting.add(judged, active)
        for name, values in result.terms.items():
            self.returns[name] += values
        self.alerts += active & (teaming.alerted > 0)
        self.distracted += active & (teaming.attention.distracted == 1)
        self.headways[step] = np.where(active, teaming.time_headway(), np.inf)
        self._step += 1


def play_episodes(
    config: TeamConfig,
    driver: Policy,
    hmi: Policy,
    seeds: ArrayLike,
    world: str = "highway",
    judge: AlertJudge | None = None,
    observers: Sequence[Observer] = (),
) -> Episodes:
    """Play one episode for each seed, side by side until the last has ended.

    Args:
        config: settings of the teams.
        driver: policy for the driver's seat.
        hmi: policy for the vehicle AI's seat.
        seeds: shape (E,).
        world: world to drive in.
        judge: judges the alerts; by default they are not judged.
        observers: watch these episodes too.
    """
    seeds = np.asarray(seeds, np.uint64)
    totals = _Totals(len(seeds), config.horizon, judge)
    teaming = play(begin(config, driver, hmi, seeds, world), driver, hmi, [totals, *observers])
    return Episodes(
        seeds,
        teaming.steps.copy(),
        teaming.ego.crashed.copy(),
        totals.alerts,
        totals.distracted,
        totals.headways.min(axis=0),
        _medians(totals.headways),
        totals.returns,
        totals.alerting,
    )


def play_named(
    team: TeamConfig,
    driver_policy: str,
    hmi: str,
    count: int,
    observers: Sequence[Observer] = (),
    sequential: bool = True,
) -> Episodes:
    """Play the first ``count`` evaluation episodes, the same ones in every experiment (paired)."""
    seats = make_driver_policy(driver_policy, team), make_hmi(hmi, team, sequential)
    seeds = evaluation_seeds(count)
    return play_episodes(team, *seats, seeds, world="batched", observers=observers)


def listed_drivers(team: TeamConfig) -> dict[str, Driver]:
    """Return the team's drivers by name.

    Raises:
        ValueError: the team's population is no list of drivers, each with a name of its own.
    """
    if not isinstance(team.population, DriverList):
        raise ValueError("episodes are told apart by driver only if driver= lists the drivers")
    by_name = {driver.name: driver for driver in team.population.drivers}
    if len(by_name) < len(set(team.population.drivers)):
        raise ValueError("two different drivers have the same name; give each its own")
    return by_name


def driven_by(team: TeamConfig, seeds: NDArray[np.uint64]) -> dict[str, NDArray[np.bool_]]:
    """Mark the episodes of each of the team's drivers, bool, shape (E,), by the driver's name.

    Raises:
        ValueError: see :func:`listed_drivers`.
    """
    drivers = listed_drivers(team)
    drawn = team.population.draw(seeds).as_array()
    return {
        name: (drawn == np.array(driver.traits)).all(axis=1) for name, driver in drivers.items()
    }


def evaluation_seeds(count: int) -> NDArray[np.uint64]:
    """Seeds of the first evaluation episodes, shape (count,)."""
    return episode_seed(EVALUATION_SEED, np.arange(count))


def _medians(headways: NDArray[np.float64]) -> NDArray[np.float64]:
    """Median of the finite values of each column of (steps, E); inf if there are none."""
    ordered = np.sort(headways, axis=0)
    known = np.isfinite(ordered).sum(axis=0)
    below, above = np.maximum(known - 1, 0) // 2, known // 2
    columns = np.arange(ordered.shape[1])
    return 0.5 * ordered[below, columns] + 0.5 * ordered[above, columns]
