"""HMIs that do not see attention: learned ones against Bayes filters, for each driver.

Here knowing the driver can be worth something. Every HMI plays the same episodes with the same
driver, so that differences between them are paired.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hmi_marl.agents.learned.policy import find_policy
from hmi_marl.checks import Count, Steps, Units
from hmi_marl.envs.config import VEHICLE_AI, TeamConfig
from hmi_marl.envs.drivers import DRIVERS
from hmi_marl.envs.streams import Seed, part_seed
from hmi_marl.exact.hidden_attention import rule_return, solve_belief
from hmi_marl.experiments.criteria import BAYES_MARGIN
from hmi_marl.experiments.episodes import evaluation_seeds, play_named
from hmi_marl.experiments.experiment import (
    HIDDEN_EXPERIMENT,
    HIDDEN_RUN,
    MODELS,
    Agent,
    Place,
    driver_job,
)
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


@dataclass(frozen=True)
class HiddenRow:
    """One driver with every HMI: attention returns over the same episodes."""

    driver: str
    revealing: float
    """Share of steps, after the first, in which a^H differs from the last applied action."""
    attention_return: dict[str, Estimate]
    """Returns by HMI."""
    learned_minus_bayes: Estimate
    """Own HMIs, paired by episode."""
    bayes_own_minus_average: Estimate
    """Bayes filters, paired by episode: the worth of knowing the driver, by exact rules."""
    own_minus_bayes_average: Estimate
    """Learned own HMI less the Bayes filter for the average driver, paired by episode."""
    own_minus_average: Estimate
    """Learned HMIs, paired by episode; large also where the learned AvgHMI is a poor one."""
    exact_own: float
    """Expectation of the rule that is optimal on the belief, if steps reveal d independently with
    that probability and the episode runs its whole time."""
    exact_average: float
    """The same of the rule that is optimal for the average driver, with this driver."""

    @property
    def exact_worth(self) -> float:
        """Exact gain from knowing the driver, per episode."""
        return self.exact_own - self.exact_average

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
        returns = {
            label: play_named(team, str(place.driver_run), hmi, self.episodes).attention_return()
            for label, hmi in hmis.items()
        }
        game = team.alert_window, team.horizon, team.weights
        own_rule, average_rule = (
            solve_belief(DRIVERS[k], *game, share) for k in (model, "average")
        )
        return HiddenRow(
            driver=model,
            revealing=share,
            attention_return={k: statistics.mean(values) for k, values in returns.items()},
            learned_minus_bayes=statistics.mean(returns[LEARNED_OWN] - returns[BAYES_OWN]),
            bayes_own_minus_average=statistics.mean(returns[BAYES_OWN] - returns[BAYES_AVERAGE]),
            own_minus_bayes_average=statistics.mean(returns[LEARNED_OWN] - returns[BAYES_AVERAGE]),
            own_minus_average=statistics.mean(returns[LEARNED_OWN] - returns[LEARNED_AVERAGE]),
            exact_own=own_rule.total_return,
            exact_average=rule_return(average_rule, model, team.weights),
        )

    def numbers_of(self, results: list[HiddenRow]) -> dict[str, Any]:
        """JSON content."""
        return {"rows": [json_value(row) | {"exact_worth": row.exact_worth} for row in results]}

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
        """Tables of returns and of paired differences."""
        returns = [
            [row.driver, f"{100 * row.revealing:.1f} %"]
            + [f"{value:.1f}" for value in (row.exact_own, row.exact_average)]
            + [estimate.shown() for estimate in row.attention_return.values()]
            for row in results
        ]
        differences: dict[str, Callable[[HiddenRow], str]] = {
            "driver": lambda row: row.driver,
            "exact worth of knowing": lambda row: f"{row.exact_worth:+.1f}",
            "own - AvgHMI, Bayes": lambda row: row.bayes_own_minus_average.shown("+.1f"),
            "learned own - Bayes AvgHMI": lambda row: row.own_minus_bayes_average.shown("+.1f"),
            "own - AvgHMI, learned": lambda row: row.own_minus_average.shown("+.1f"),
            "learned - Bayes, own": lambda row: row.learned_minus_bayes.shown("+.1f"),
        }
        return [
            Table(
                "Attention return by HMI, attention hidden (exact: whole episodes, if steps reveal "
                "d independently with the share that was measured)",
                [
                    *("driver", "revealing", "exact, own", "exact, AvgHMI"),
                    *results[0].attention_return,
                ],
                returns,
                sources=["/rows"],
            ),
            Table.of(
                "Paired differences per episode, and the exact worth of knowing the driver",
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
