"""HMIs that do not see attention: learned ones beside Bayes filters, for each driver.

Here knowing the driver can be worth something. Every HMI plays the same episodes with the same
driver, so that differences between them are paired.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.catalogue import make_driver_policy, make_hmi
from hmi_marl.agents.rollout import Observer, begin, play
from hmi_marl.checks import check_count
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import DRIVERS, PAPER_DRIVERS
from hmi_marl.envs.teaming import StepResult, Teaming
from hmi_marl.exact.hidden_attention import solve_belief
from hmi_marl.experiments.episodes import play_episodes
from hmi_marl.experiments.metrics_table.reproduction import EVALUATION_SEED, driver_job
from hmi_marl.reporting import statistics
from hmi_marl.reporting.page import text_table
from hmi_marl.reporting.statistics import Estimate
from hmi_marl.training.evidence.conditioned import HIDDEN_PPO, HMI_READS
from hmi_marl.training.protocols.two_stage import TwoStage
from hmi_marl.training.runs.jobs import Job

MARGIN = 0.01
"""A learned HMI is as good as the Bayes filter if it is within this share of its return."""
MODELS = (*PAPER_DRIVERS, "average")
LEARNED_OWN, LEARNED_AVERAGE, BAYES_OWN, BAYES_AVERAGE, NONE = (
    "learned, own",
    "learned, AvgHMI",
    "Bayes, own",
    "Bayes, AvgHMI",
    "NoHMI",
)


@dataclass(frozen=True)
class HiddenSettings:
    """How large the comparison is.

    Raises:
        ValueError: no steps or no episodes.
    """

    driver_steps: int = 12_000_000
    """Environment steps in which the driver learns, unless one is given."""
    hmi_steps: int = 4_000_000
    """Environment steps in which each HMI learns."""
    rnn_hidden_dim: int = 32
    """Units of the HMIs' recurrent layer."""
    episodes: int = 2000
    """Episodes of each driver with each HMI."""
    num_teams: int = 512
    """Teams that train side by side."""
    seed: int = 0
    """Of all training."""

    def __post_init__(self) -> None:
        for name in ("driver_steps", "hmi_steps", "rnn_hidden_dim", "episodes"):
            check_count(name, getattr(self, name))

    def driver_job(self, folder: Path) -> Job:
        """One driver policy over the four drivers and the average one."""
        return driver_job(MODELS, self.driver_steps, self.num_teams, self.seed, folder)

    def hmi_jobs(self, folder: Path, driver_run: Path) -> list[Job]:
        """An HMI with a memory for each driver model."""
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
                folder / f"hmi-{model}",
            )
            for model in MODELS
        ]


@dataclass(frozen=True)
class HiddenRow:
    """One driver with every HMI: attention returns over the same episodes."""

    driver: str
    revealing: float
    """Share of steps, after the first, in which a^H differs from the last applied action."""
    attention_return: dict[str, Estimate]
    """By HMI."""
    learned_minus_bayes: Estimate
    """Own HMIs, paired by episode."""
    own_minus_average: Estimate
    """Learned HMIs, paired by episode: what knowing the driver is worth."""
    exact_own: float
    """Expectation of the rule that is optimal on the belief, if steps reveal d independently with
    that probability and the episode runs its whole time."""

    def as_json(self) -> dict[str, Any]:
        """JSON content."""
        return vars(self) | {
            "attention_return": {k: e.as_json() for k, e in self.attention_return.items()},
            "learned_minus_bayes": self.learned_minus_bayes.as_json(),
            "own_minus_average": self.own_minus_average.as_json(),
            "as_good_as_bayes": as_good(self),
        }


def revealing_share(team: TeamConfig, driver_run: Path, seeds: NDArray[np.uint64]) -> float:
    """How often what a learned driver does shows whether they are distracted."""
    driver, hmi = make_driver_policy(str(driver_run), team), make_hmi("belief", team)
    reveals = _Reveals()
    play(begin(team, driver, hmi, seeds, "batched"), driver, hmi, [reveals])
    return reveals.shown / reveals.steps


class _Reveals(Observer):
    """Count the steps, after the first, in which a^H differs from the last applied action."""

    shown = steps = 0

    def before(self, teaming: Teaming) -> None:
        """Note the last applied actions."""
        self._last, self._counts = teaming.applied, ~teaming.over & (teaming.steps > 0)

    def after(self, teaming: Teaming, result: StepResult) -> None:
        """Compare the intents with them."""
        self.shown += int((self._counts & (teaming.intended != self._last)).sum())
        self.steps += int(self._counts.sum())


def compare_hidden(
    settings: HiddenSettings,
    folder: Path,
    driver_run: Path,
    progress: Callable[[str], object],
) -> list[HiddenRow]:
    """Play every driver with every HMI; ``progress`` is told each driver's name when done."""
    seeds = np.arange(EVALUATION_SEED, EVALUATION_SEED + settings.episodes, dtype=np.uint64)
    rows = []
    for name in MODELS:
        team = TeamConfig(driver=name, ai_sees_attention=False)
        share = revealing_share(team, driver_run, seeds[:500] + np.uint64(10**6))
        hmis = {
            LEARNED_OWN: str(folder / f"hmi-{name}"),
            LEARNED_AVERAGE: str(folder / "hmi-average"),
            BAYES_OWN: f"belief:{name}:{share}",
            BAYES_AVERAGE: f"belief:average:{share}",
            NONE: "never",
        }
        returns = {}
        for label, hmi in hmis.items():
            seats = make_driver_policy(str(driver_run), team), make_hmi(hmi, team)
            returns[label] = play_episodes(team, *seats, seeds, world="batched").attention_return()
        exact = solve_belief(DRIVERS[name], team.alert_window, team.horizon, team.weights, share)
        rows.append(
            HiddenRow(
                driver=name,
                revealing=share,
                attention_return={k: statistics.mean(values) for k, values in returns.items()},
                learned_minus_bayes=statistics.mean(returns[LEARNED_OWN] - returns[BAYES_OWN]),
                own_minus_average=statistics.mean(returns[LEARNED_OWN] - returns[LEARNED_AVERAGE]),
                exact_own=exact.total_return,
            )
        )
        progress(name)
    return rows


def table_head(rows: list[HiddenRow]) -> list[str]:
    """Of the returns."""
    return ["driver", "revealing", "exact, own", *rows[0].attention_return]


def table_rows(rows: list[HiddenRow]) -> list[list[str]]:
    """Attention returns by driver and HMI."""
    return [
        [row.driver, f"{100 * row.revealing:.1f} %", f"{row.exact_own:.1f}"]
        + [f"{e.mean:.1f} [{e.low:.1f}, {e.high:.1f}]" for e in row.attention_return.values()]
        for row in rows
    ]


DIFFERENCES_HEAD = ["driver", "learned - Bayes, own", "own - AvgHMI, learned", "verdict"]


def difference_rows(rows: list[HiddenRow]) -> list[list[str]]:
    """Paired differences by driver."""
    return [
        [
            row.driver,
            *(
                f"{e.mean:+.1f} [{e.low:+.1f}, {e.high:+.1f}]"
                for e in (row.learned_minus_bayes, row.own_minus_average)
            ),
            "as good as Bayes" if as_good(row) else "MISSED",
        ]
        for row in rows
    ]


CAPTION = (
    "Attention return by HMI, attention hidden (exact: own rule, whole episodes, if steps reveal d "
    "independently with the share that was measured)"
)
PAIRED = "Paired differences per episode"


def as_text(rows: list[HiddenRow]) -> str:
    """For a terminal."""
    return "\n".join(
        [
            CAPTION,
            text_table(table_head(rows), table_rows(rows)),
            "",
            PAIRED,
            text_table(DIFFERENCES_HEAD, difference_rows(rows)),
        ]
    )


def as_good(row: HiddenRow) -> bool:
    """Whether the learned HMI does as well as the Bayes filter.

    The filter's rule is the optimum if steps reveal d independently, so a learned one can at most
    come to about as much. A difference counts as none within ``MARGIN`` of the filter's return,
    whatever the interval.
    """
    return row.learned_minus_bayes.mean >= -MARGIN * abs(row.attention_return[BAYES_OWN].mean)
