"""HMIs that do not see attention: learned ones against Bayes filters, for each driver.

Here knowing the driver can be worth something. Every HMI plays the same episodes with the same
driver, so that differences between them are paired.

What is played may end at a crash, so each HMI has an exact value over the very lengths that its
episodes had (:func:`hmi_marl.experiments.references.filter_returns`), next to that of whole trips.
With attention hidden this assumes two things: a step reveals d independently, with the share that
was measured, and the length of an episode is independent of attention. What is played less what is
exact, paired by episode, shows how far they hold.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.agents.learned.policy import find_policy
from hmi_marl.checks import Count, Steps, Units
from hmi_marl.envs.config import VEHICLE_AI, TeamConfig
from hmi_marl.envs.streams import Seed, part_seed
from hmi_marl.exact import oracle
from hmi_marl.experiments.criteria import BAYES_MARGIN
from hmi_marl.experiments.episodes import Episodes, evaluation_seeds, exact_settings, play_named
from hmi_marl.experiments.experiment import (
    HIDDEN_EXPERIMENT,
    HIDDEN_RUN,
    MODELS,
    Agent,
    Place,
    driver_job,
)
from hmi_marl.experiments.references import filter_returns
from hmi_marl.experiments.signalling import revealing_share
from hmi_marl.experiments.training_seeds import SeededExperiment, learned_part
from hmi_marl.files import json_value
from hmi_marl.reporting import statistics
from hmi_marl.reporting.blocks import Block, Table
from hmi_marl.reporting.statistics import Estimate
from hmi_marl.reporting.verdicts import Part, Verdict
from hmi_marl.training.conditioned.settings import HMI_READS
from hmi_marl.training.jobs import Job
from hmi_marl.training.protocols.settings import PPOSettings
from hmi_marl.training.protocols.two_stage import TwoStage

HIDDEN_PPO = PPOSettings(learning_rate=2e-3, num_mini_batches=8)
"""PPO for recurrent HMIs."""
LEARNED_OWN, LEARNED_AVERAGE, BAYES_OWN, BAYES_AVERAGE, NONE = (
    "learned, own",
    "learned, AvgHMI",
    "Bayes, own",
    "Bayes, AvgHMI",
    "NoHMI",
)

EXACT_NOTE = (
    "Exact: over the lengths that the episodes of the same HMI had, if each step reveals d "
    "independently with the share that was measured (except for NoHMI) and the length of an "
    "episode is independent of attention; that of a learned HMI is the Bayes filter's for the "
    "driver that it was trained for. Whole trips have the whole number of steps and no crash."
)
"""What exact values assume."""


@dataclass(frozen=True)
class HiddenRow:
    """One driver with every HMI: attention returns over the same episodes."""

    driver: str
    revealing: float
    """Share of steps, after the first, in which a^H differs from the last applied action."""
    attention_return: dict[str, Estimate]
    """Returns by HMI."""
    steps: dict[str, Estimate]
    """Lengths of the episodes by HMI, 100 steps unless a crash ended them."""
    exact_same_steps: dict[str, float]
    """Exact values by HMI over as many steps as its episodes had; of a learned HMI that of the
    Bayes filter for the driver that it was trained for. See the module for what is assumed."""
    played_minus_exact: dict[str, Estimate]
    """Returns less the exact values over as many steps, by HMI, paired by episode."""
    learned_minus_bayes: Estimate
    """Own HMIs, paired by episode."""
    bayes_own_minus_average: Estimate
    """Bayes filters, paired by episode: the worth of knowing the driver, as it is played."""
    worth_minus_exact: Estimate
    """The same less :attr:`exact_worth_same_steps`, paired by episode."""
    own_minus_bayes_average: Estimate
    """Learned own HMI less the Bayes filter for the average driver, paired by episode."""
    own_minus_average: Estimate
    """Learned HMIs, paired by episode; large also where the learned AvgHMI is a poor one."""
    exact_own: float
    """Exact value of the Bayes filter for this driver over a trip of the whole length."""
    exact_average: float
    """The same of the Bayes filter for the average driver, with this driver."""

    @classmethod
    def of(cls, team: TeamConfig, revealing: float, played: Mapping[str, Episodes]) -> HiddenRow:
        """Compare episodes with one another and with exact values.

        Args:
            team: settings with one driver, attention hidden.
            revealing: share of steps in which a^H reveals d, which the Bayes filters know.
            played: episodes with each HMI, on the same seeds.

        Raises:
            ValueError: a population, or a share out of range.
        """

        def exact(hmi: str, steps: ArrayLike) -> NDArray[np.float64]:
            if hmi == NONE:
                return oracle.evaluate(0.0, **exact_settings(team)).return_after(steps)
            model = "average" if hmi in (LEARNED_AVERAGE, BAYES_AVERAGE) else None
            return filter_returns(team, steps, revealing, model=model)

        returns = {hmi: episodes.attention_return() for hmi, episodes in played.items()}
        same_steps = {hmi: exact(hmi, episodes.length) for hmi, episodes in played.items()}
        beyond = {hmi: returns[hmi] - same_steps[hmi] for hmi in played}

        def less(hmi: str, other: str) -> Estimate:
            return statistics.mean(returns[hmi] - returns[other])

        return cls(
            driver=exact_settings(team)["driver"].name,
            revealing=revealing,
            attention_return={hmi: statistics.mean(values) for hmi, values in returns.items()},
            steps={hmi: statistics.mean(each.length, lowest=0.0) for hmi, each in played.items()},
            exact_same_steps={hmi: float(values.mean()) for hmi, values in same_steps.items()},
            played_minus_exact={hmi: statistics.mean(values) for hmi, values in beyond.items()},
            learned_minus_bayes=less(LEARNED_OWN, BAYES_OWN),
            bayes_own_minus_average=less(BAYES_OWN, BAYES_AVERAGE),
            worth_minus_exact=statistics.mean(beyond[BAYES_OWN] - beyond[BAYES_AVERAGE]),
            own_minus_bayes_average=less(LEARNED_OWN, BAYES_AVERAGE),
            own_minus_average=less(LEARNED_OWN, LEARNED_AVERAGE),
            exact_own=float(exact(BAYES_OWN, team.horizon)),
            exact_average=float(exact(BAYES_AVERAGE, team.horizon)),
        )

    @property
    def exact_worth(self) -> float:
        """Exact gain from knowing the driver, in a trip of the whole length."""
        return self.exact_own - self.exact_average

    @property
    def exact_worth_same_steps(self) -> float:
        """Exact gain from knowing the driver, each rule over as many steps as its episodes had."""
        return self.exact_same_steps[BAYES_OWN] - self.exact_same_steps[BAYES_AVERAGE]

    def as_good(self, seeds: int = 1) -> Part:
        """State that the learned HMI does as well as the Bayes filter, within a margin.

        The filter's rule is the optimum if steps reveal d independently, so a learned HMI can earn
        about as much at most.
        """
        most = BAYES_MARGIN * abs(self.attention_return[BAYES_OWN].mean)
        what = "learned less Bayes filter"
        return learned_part(what, self.learned_minus_bayes, seeds, paired=True, above=-most)


@dataclass(frozen=True)
class HiddenAttention(SeededExperiment[list[HiddenRow]]):
    """Compare learned HMIs that do not see attention with Bayes filters, by driver.

    Raises:
        ValueError: no steps or no episodes.
    """

    driver_steps: Steps = 12_000_000
    """Environment steps in which the driver learns, unless one is given."""
    hmi_steps: Steps = 4_000_000
    """Environment steps in which each HMI learns."""
    rnn_hidden_dim: Units = 32
    """Units of the HMIs' recurrent layer."""
    episodes: Count = 2000
    """Episodes of each driver with each HMI."""
    num_teams: Count = 512
    """Teams that train side by side."""
    seed: Seed = 0
    """Seed of the first training, from which the others are mixed."""
    seeds: Count = 5
    """Trainings of the HMIs; the driver policy is the same for all."""

    name = HIDDEN_EXPERIMENT
    title = "Attention hidden: what knowing the driver is worth"
    short = "Attention hidden"
    paper = (
        "The paper's claim is that an HMI for the driver at the wheel does better than one for the "
        "average driver; its HMIs see distraction. Ours below do not: they infer it from what the "
        "car does. That is not in the paper, and it is where knowing the driver can be worth "
        "something. The Bayes filter, which knows the traits, is the ceiling."
    )
    uses_driver = True
    results_format = 2

    @classmethod
    def quick(cls) -> HiddenAttention:
        """Make a coarse version that takes minutes."""
        return cls(hmi_steps=400_000, episodes=400, seeds=1)

    def driver_job(self, folder: Path) -> Job:
        """Training of one driver policy over the four drivers and the average one."""
        return driver_job(MODELS, self.driver_steps, self.num_teams, self.seed, folder)

    def hmi_jobs(self, folder: Path, driver_run: Path) -> list[Job]:
        """Training of a recurrent HMI for each driver model."""
        return [
            Job(
                TwoStage(
                    hmi_for=model,
                    driver_policy=str(driver_run),
                    hmi_steps=self.hmi_steps,
                    ai_sees_attention=False,
                    rnn_hidden_dim=self.rnn_hidden_dim,
                    hmi_reads=HMI_READS,
                    hmi_reward="attention",
                    ppo=HIDDEN_PPO,
                    num_teams=self.num_teams,
                    seed=self.seed,
                ),
                folder / HIDDEN_RUN.format(model),
            )
            for model in MODELS
        ]

    def learn(self, each: Sequence[tuple[HiddenAttention, Place]], place: Place) -> None:
        """Learn the HMIs."""
        place.train(
            [job for alone, where in each for job in alone.hmi_jobs(where.folder, where.driver_run)]
        )

    def play(self, place: Place) -> list[HiddenRow]:
        """Play every driver with every HMI."""
        return [self._play(model, place) for model in place.each(MODELS, "drivers")]

    def _play(self, model: str, place: Place) -> HiddenRow:
        team = TeamConfig(driver=model, ai_sees_attention=False)
        own = part_seed(evaluation_seeds(min(500, self.episodes)), 1)  # others than are judged by
        share = revealing_share(team, str(place.driver_run), own)
        hmis = {
            LEARNED_OWN: str(place.folder / HIDDEN_RUN.format(model)),
            LEARNED_AVERAGE: str(place.folder / HIDDEN_RUN.format("average")),
            BAYES_OWN: f"belief:{model}:{share}",
            BAYES_AVERAGE: f"belief:average:{share}",
            NONE: "never",
        }
        played = {
            label: play_named(team, str(place.driver_run), hmi, self.episodes)
            for label, hmi in hmis.items()
        }
        return HiddenRow.of(team, share, played)

    def numbers_of(self, results: list[HiddenRow]) -> dict[str, Any]:
        """JSON content."""
        return {
            "rows": [
                json_value(row)
                | {name: getattr(row, name) for name in ("exact_worth", "exact_worth_same_steps")}
                for row in results
            ]
        }

    def judge_of(self, results: list[HiddenRow]) -> list[Verdict]:
        """Judge each learned HMI by the Bayes filter."""
        return [
            Verdict(
                f"{row.driver}: learned HMI as good as the Bayes filter, within "
                f"{100 * BAYES_MARGIN:.0f} %",
                (row.as_good(self.seeds),),
            )
            for row in results
        ]

    def blocks_of(self, results: list[HiddenRow]) -> Sequence[Block]:
        """Tables of returns, of what is played less what is exact, and of paired differences."""
        hmis = results[0].attention_return
        returns = [
            [row.driver, f"{100 * row.revealing:.1f} %"]
            + [
                f"{row.attention_return[hmi].shown()}\nexact {row.exact_same_steps[hmi]:.1f}\n"
                f"{row.steps[hmi].mean:.1f} steps"
                for hmi in hmis
            ]
            for row in results
        ]
        from_exact = [
            [row.driver, *(row.played_minus_exact[hmi].shown("+z.1f") for hmi in hmis)]
            + [f"{value:.1f}" for value in (row.exact_own, row.exact_average)]
            for row in results
        ]
        differences: dict[str, Callable[[HiddenRow], str]] = {
            "driver": lambda row: row.driver,
            "exact worth of knowing": lambda row: f"{row.exact_worth_same_steps:+z.1f}",
            "own - AvgHMI, Bayes": lambda row: row.bayes_own_minus_average.shown("+z.1f"),
            "played - exact": lambda row: row.worth_minus_exact.shown("+z.1f"),
            "learned own - Bayes AvgHMI": lambda row: row.own_minus_bayes_average.shown("+z.1f"),
            "own - AvgHMI, learned": lambda row: row.own_minus_average.shown("+z.1f"),
            "learned - Bayes, own": lambda row: row.learned_minus_bayes.shown("+z.1f"),
            "exact worth, whole trips": lambda row: f"{row.exact_worth:+z.1f}",
        }
        return [
            Table(
                "Attention return by HMI, attention hidden; exact over as many steps",
                ["driver", "revealing", *hmis],
                returns,
                EXACT_NOTE,
                sources=["/rows"],
            ),
            Table(
                "Attention return less the exact one over as many steps, paired by episode; exact "
                "over whole trips",
                ["driver", *hmis, "exact own, whole trips", "exact AvgHMI, whole trips"],
                from_exact,
                sources=["/rows"],
            ),
            Table.of(
                "Paired differences per episode, and the exact worth of knowing the driver over "
                "as many steps",
                results,
                differences,
                sources=["/rows"],
            ),
        ]

    def agents(self, place: Place) -> list[Agent]:
        """HMIs that do not see attention."""
        return [
            Agent(
                f"hidden-{model}",
                find_policy(place.folder / HIDDEN_RUN.format(model), VEHICLE_AI),
                f"alerts {model}, attention hidden",
            )
            for model in MODELS
        ]
