r"""Exact references for a pair of driver and HMI, scores between them, and the regret in parts.

For each driver and the lengths L_e of its E episodes, three attention returns are known exactly:
without alerts, of the Bayes filter that knows the driver's traits and share of revealing steps
(attention hidden), and of the optimum with attention seen. Each is a mean over the same lengths,

.. math:: \frac{1}{E} \sum_e \sum_{t < L_e} E[r_t]

where E[r_t] is the expected reward of step t of the rule made for the whole time. An HMI does not
know when a crash will end the episode, so this is what the HMIs ``never``, ``belief`` and
``optimal`` earn on average over such lengths. It is no more than the optimum for a length known
before, and equal to it where the rule is the same for every length: the paper's drivers are best
alerted exactly when distracted, whatever the length. Lengths are taken as given, as if they were
independent of attention (:mod:`hmi_marl.exact.episode_lengths`): a crash that an alert would have
prevented counts as driving.

Parts of the regret, all per episode:

- **hiding** costs the optimum less the Bayes filter, exactly;
- **the HMI** falls short by the Bayes filter less what it achieved. It can be below 0: the filter
  assumes that steps reveal d independently, and an HMI may profit from a driver who reveals d where
  it matters;
- **the driver** gives up the driving terms of a natural driver less its own, on the same seeds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.agents.rollout import Observer
from hmi_marl.envs.alerts import need_plain
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import Driver
from hmi_marl.envs.rewards import DRIVING_TERMS
from hmi_marl.exact import oracle
from hmi_marl.exact.hidden_attention import follow_rule, solve_belief
from hmi_marl.experiments.episodes import (
    Episodes,
    driven_by,
    exact_settings,
    listed_drivers,
    play_named,
)
from hmi_marl.experiments.signalling import SignalCounter, Signalling
from hmi_marl.reporting import statistics
from hmi_marl.reporting.blocks import Table
from hmi_marl.reporting.statistics import Estimate, number

_NOTHING = 1e-6
"""Gain per episode below which alerts can gain nothing but rounding."""


def filter_returns(
    team: TeamConfig,
    lengths: ArrayLike,
    revealing: float,
    sequential: bool = True,
    model: str | Driver | None = None,
) -> NDArray[np.float64]:
    """Exact attention returns of a Bayes filter over episodes of these lengths, attention hidden.

    Two assumptions: each step but the first reveals d independently with one probability, and the
    length of an episode is independent of attention.

    Args:
        team: settings with one driver, who is at the wheel.
        lengths: of the episodes, steps from 0 to the horizon, of any shape.
        revealing: share of steps, after the first, in which a^H reveals d.
        sequential: whether the filter sees a^H_t before its alert.
        model: driver whose traits the filter assumes; by default the one at the wheel.

    Returns:
        Expected returns, of the shape of ``lengths``.

    Raises:
        ValueError, TypeError: a population, graded alerts, fatigue, lengths or a share out of
            range.
    """
    driver = exact_settings(team)["driver"]
    need_plain(team.alerts, "the Bayes filter")
    game = team.alert_window, team.horizon, team.weights
    rule = solve_belief(driver if model is None else model, *game, revealing, sequential)
    return follow_rule(rule, driver, team.weights).return_after(lengths)


@dataclass(frozen=True)
class References:
    """Exact attention returns of one driver, means over the lengths of its episodes."""

    none: float
    """Without alerts."""
    filter: float | None
    """Of the Bayes filter that knows the traits and the share of revealing steps, attention hidden;
    None where the vehicle AI sees attention, and with graded alerts or fatigue."""
    optimum: float
    """Of the optimum with attention seen."""


@dataclass(frozen=True)
class ReferenceReturns:
    """The same for each of E episodes. Arrays of shape (E,)."""

    none: NDArray[np.float64]
    filter: NDArray[np.float64] | None
    optimum: NDArray[np.float64]

    @classmethod
    def of(
        cls,
        team: TeamConfig,
        lengths: NDArray[np.int64],
        revealing: float,
        sequential: bool = True,
    ) -> ReferenceReturns:
        """Compute them for the team's driver.

        Args:
            team: settings with one driver.
            lengths: of the episodes, steps from 0 to the horizon, shape (E,).
            revealing: share of steps, after the first, in which a^H reveals d.
            sequential: whether the Bayes filter sees a^H_t before its alert.

        Raises:
            ValueError, TypeError: a population, lengths or a share out of range.
        """
        problem = exact_settings(team)
        optimum = oracle.solve_alerts(**problem).return_after(lengths)
        none = oracle.evaluate(0.0, **problem).return_after(lengths)
        if team.ai_sees_attention or not team.alerts.plain:
            return cls(none, None, optimum)
        return cls(none, filter_returns(team, lengths, revealing, sequential), optimum)

    def means(self) -> References:
        """Average over the episodes."""
        known = None if self.filter is None else float(self.filter.mean())
        return References(float(self.none.mean()), known, float(self.optimum.mean()))


def reference_returns(
    team: TeamConfig, episodes: Episodes, revealing: Mapping[str, float], sequential: bool = True
) -> dict[str, ReferenceReturns]:
    """Compute the references of each driver that has any of the episodes, by name.

    Args:
        team: its population lists the drivers.
        episodes: of a pair.
        revealing: share of steps in which a^H reveals d, by driver.
        sequential: whether the HMI sees a^H_t before its alert.

    Raises:
        ValueError: the population is no list of drivers, or a share is out of range.
    """
    drivers = listed_drivers(team)
    return {
        name: ReferenceReturns.of(
            replace(team, driver=drivers[name]), episodes.length[which], revealing[name], sequential
        )
        for name, which in driven_by(team, episodes.seeds).items()
        if which.any()
    }


@dataclass(frozen=True)
class GivenUp:
    """Driving return that one driver gives up against another, per episode, paired by episode."""

    driving: Estimate
    """The driving terms together: natural driver less this one."""
    by_term: Mapping[str, Estimate]
    """The same for each driving term."""
    crash_rate: Estimate
    """Crash rate of this driver less that of the natural one."""

    @classmethod
    def of(cls, episodes: Episodes, natural: Episodes, which: NDArray[np.bool_]) -> GivenUp:
        """Compare the marked episodes, bool, shape (E,), with a natural driver's.

        Raises:
            ValueError: these are not the same seeds.
        """
        if not np.array_equal(episodes.seeds, natural.seeds):
            raise ValueError(
                "what a driver gives up is paired by episode: play the natural driver on the same "
                "seeds in the same order"
            )
        lost = {
            name: (natural.returns[name] - episodes.returns[name])[which] for name in DRIVING_TERMS
        }
        crashes = episodes.crashed.astype(np.float64) - natural.crashed
        return cls(
            driving=statistics.mean(np.sum([*lost.values()], axis=0)),
            by_term={name: statistics.mean(values) for name, values in lost.items()},
            crash_rate=statistics.mean(crashes[which]),
        )


@dataclass(frozen=True)
class PairScore:
    """Attention returns of one driver's episodes with an HMI, against the exact references.

    All are means per episode; the references are over the lengths of these episodes.
    """

    driver: str
    revealing: float
    """Share of steps in which a^H reveals d that the Bayes filter knows."""
    attention_return: Estimate
    references: References
    score: Estimate
    """(return - none) / (optimum - none): 0 without alerts, 1 for the optimum with attention seen;
    NaN where alerts can gain nothing."""
    regret: Estimate
    """Optimum with attention seen less the return: hiding and shortfall together."""
    hiding: float | None
    """Cost of hiding attention: optimum with attention seen less the Bayes filter, if any."""
    shortfall: Estimate | None
    """The HMI's own part of the regret: Bayes filter, if there is one, less the return."""
    given_up: GivenUp | None
    """The driver's part; None without a natural driver."""

    @classmethod
    def of(
        cls,
        driver: str,
        returns: NDArray[np.float64],
        exact: ReferenceReturns,
        revealing: float,
        given_up: GivenUp | None = None,
    ) -> PairScore:
        """Score the attention returns of one driver's episodes, shape (E,)."""
        gain = exact.optimum - exact.none
        counted = gain if gain.mean() > _NOTHING else np.zeros_like(gain)
        known = exact.filter
        return cls(
            driver=driver,
            revealing=revealing,
            attention_return=statistics.mean(returns),
            references=exact.means(),
            score=statistics.ratio(returns - exact.none, counted),
            regret=statistics.mean(exact.optimum - returns),
            hiding=None if known is None else float((exact.optimum - known).mean()),
            shortfall=None if known is None else statistics.mean(known - returns),
            given_up=given_up,
        )


def mean_score(scores: Sequence[PairScore]) -> Estimate:
    """Average the normalised scores over drivers; the interval is that of independent episodes."""
    return statistics.average([each.score for each in scores])


def score_pair(
    team: TeamConfig,
    episodes: Episodes,
    revealing: Mapping[str, float],
    natural: Episodes | None = None,
    sequential: bool = True,
) -> list[PairScore]:
    """Score the episodes of a pair for each driver that has any.

    Args:
        team: its population lists the drivers.
        episodes: of the pair.
        revealing: share of steps in which a^H reveals d, by driver.
        natural: episodes of a natural driver on the same seeds, for what the driver gives up.
            Distraction spoils driving too, so the HMI that accompanies it should be as good.
        sequential: whether the HMI sees a^H_t before its alert.

    Raises:
        ValueError: the population is no list of drivers, or the seeds are not the same.
    """
    marked, returns = driven_by(team, episodes.seeds), episodes.attention_return()
    return [
        PairScore.of(
            name,
            returns[marked[name]],
            exact,
            revealing[name],
            None if natural is None else GivenUp.of(episodes, natural, marked[name]),
        )
        for name, exact in reference_returns(team, episodes, revealing, sequential).items()
    ]


@dataclass(frozen=True)
class PairResult:
    """A pair of driver and HMI that has played."""

    episodes: Episodes
    signalling: Mapping[str, Signalling]
    """Signals of each driver that has episodes, by name."""
    scores: list[PairScore]
    """Scores of the same drivers."""


def measure_pair(
    team: TeamConfig,
    driver_policy: str,
    hmi: str,
    count: int,
    natural: Episodes | None = None,
    sequential: bool = True,
    observers: Sequence[Observer] = (),
) -> PairResult:
    """Play the first evaluation episodes with policies by name; measure signals and score them.

    Args:
        team: its population lists the drivers.
        driver_policy, hmi: names as in the catalogue.
        count: number of episodes.
        natural: see :func:`score_pair`; for example the ``episodes`` of another result.
        sequential: False for an HMI that moves at the same time as the driver.
        observers: watch the episodes too.

    Raises:
        FileNotFoundError, ValueError: an unknown name, or a population that is no list of drivers.
    """
    counter = SignalCounter()
    listed_drivers(team)  # refuses a population before anything is played
    episodes = play_named(team, driver_policy, hmi, count, [counter, *observers], sequential)
    signalling = counter.by_driver(team, episodes.seeds)
    revealing = {name: each.total.share for name, each in signalling.items()}
    scores = score_pair(team, episodes, revealing, natural, sequential)
    played = {each.driver for each in scores}
    return PairResult(
        episodes, {name: each for name, each in signalling.items() if name in played}, scores
    )


def score_tables(scores: Sequence[PairScore]) -> list[Table]:
    """Show returns between their references, parts of the regret, and what drivers give up."""
    returns = [
        [
            each.driver,
            f"{100 * each.revealing:.1f}",
            number(each.references.none),
            number(each.references.filter),
            number(each.references.optimum),
            each.attention_return.shown(),
            each.score.shown(".3f"),
        ]
        for each in scores
    ]
    parts = [
        [
            each.driver,
            each.regret.shown(),
            number(each.hiding),
            each.shortfall.shown() if each.shortfall else "-",
        ]
        for each in scores
    ]
    tables = [
        Table(
            "Attention return per episode, and exact references over the same lengths",
            [
                "driver",
                "revealing [%]",
                "no alerts",
                "Bayes filter",
                "optimum seen",
                "pair",
                "score",
            ],
            [*returns, ["mean", *["-"] * 5, mean_score(scores).shown(".3f")]],
        ),
        Table(
            "Regret per episode: cost of hiding attention, and the HMI's shortfall",
            ["driver", "regret", "hiding", "HMI"],
            parts,
        ),
    ]
    given_up = [(each.driver, each.given_up) for each in scores if each.given_up]
    if given_up:
        tables.append(
            Table(
                "Driving return per episode that the driver gives up against a natural driver",
                ["driver", "driving", *DRIVING_TERMS, "more crashes [%]"],
                [
                    [
                        driver,
                        given.driving.shown("+.1f"),
                        *(given.by_term[name].shown("+.1f") for name in DRIVING_TERMS),
                        given.crash_rate.percent("+.1f"),
                    ]
                    for driver, given in given_up
                ],
            )
        )
    return tables
