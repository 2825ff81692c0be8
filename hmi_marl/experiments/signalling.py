"""Measure signalling: how often drivers reveal d by a^H, where, and how much the HMI learns by it.

See :mod:`hmi_marl.exact.signalling` for the definitions. All counts are of the steps after the
first, which reveals nothing, since v_0 = a^H_0.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.catalogue import make_driver_policy, make_hmi
from hmi_marl.agents.rollout import begin, play
from hmi_marl.agents.signals import SignalWatch
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.step_result import StepResult
from hmi_marl.envs.teaming import Teaming
from hmi_marl.envs.worlds import VEHICLE_ACTIONS
from hmi_marl.experiments.episodes import driven_by
from hmi_marl.files import json_value
from hmi_marl.reporting import statistics
from hmi_marl.reporting.blocks import Table
from hmi_marl.reporting.statistics import Estimate

NEAR = 2.0
"""Time headway below which a vehicle ahead counts as near [s]."""
SITUATIONS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "last applied action": VEHICLE_ACTIONS,
        "vehicle ahead": (f"within {NEAR:g} s", "none so near"),
        "ramp": ("a vehicle merges", "none merges"),
        "last alert": ("alert", "no alert"),
    }
)
"""Situations before a step, as the driver sees them, in groups; one of each group holds."""


@dataclass(frozen=True)
class Signals:
    """Sums over some steps of E episodes. Arrays have shape (E,)."""

    steps: NDArray[np.int64]
    revealing: NDArray[np.int64]
    """Steps in which a^H_t reveals d_t."""
    entropy: NDArray[np.float64]
    """Sum of h(b'_t), the uncertainty about d_t before a^H_t and v_t [bits]."""
    information: NDArray[np.float64]
    """Information about d_t in a^H_t and v_t [bits]."""
    log_loss: NDArray[np.float64]
    """Log loss of the belief about d_t after them [bits]; in expectation it is ``entropy`` less
    ``information``."""

    def of(self, which: NDArray[np.bool_]) -> Signals:
        """Return those of the marked episodes, bool, shape (E,)."""
        return Signals(**{each.name: getattr(self, each.name)[which] for each in fields(self)})

    @property
    def share(self) -> float:
        """Share of steps that reveal d; 0 without steps."""
        return float(self.revealing.sum() / max(1, self.steps.sum()))

    def per_step(self, name: str) -> Estimate:
        """Return a sum per step, with its interval over episodes; NaN without steps."""
        highest = math.inf if name == "log_loss" else 1.0
        return statistics.ratio(getattr(self, name), self.steps, 0.0, highest)

    def numbers(self) -> dict[str, int | Estimate]:
        """Return the number of steps, and every sum per step."""
        return {"steps": int(self.steps.sum())} | {
            each.name: self.per_step(each.name) for each in fields(self) if each.name != "steps"
        }


@dataclass(frozen=True)
class Signalling:
    """Signals of one driver's episodes."""

    driver: str
    total: Signals
    """In all steps."""
    by_situation: Mapping[str, Mapping[str, Signals]]
    """The same steps by situation, as in ``SITUATIONS``."""

    @property
    def share(self) -> Estimate:
        """Share of steps in which a^H reveals d."""
        return self.total.per_step("revealing")

    @property
    def bits(self) -> Estimate:
        """Information about d in each step [bits]."""
        return self.total.per_step("information")

    def numbers(self) -> dict[str, Any]:
        """Return what is shown, for JSON."""
        situations = {
            group: {label: signals.numbers() for label, signals in each.items()}
            for group, each in self.by_situation.items()
        }
        numbers = {"driver": self.driver, **self.total.numbers(), "by_situation": situations}
        return json_value(numbers)


class SignalCounter(SignalWatch):
    """Count the signals of N teams, an episode each."""

    def __init__(self) -> None:
        self._sums: NDArray[np.float64] | None = None
        """Shape (1 + number of situations, number of sums, N): all steps first."""

    def before(self, teaming: Teaming) -> None:
        """Note what is known before the turn, and the situation."""
        super().before(teaming)
        self._counts = self.active & (teaming.steps > 0)
        self._situation = _situation(teaming)

    def after(self, teaming: Teaming, result: StepResult) -> None:
        """Count the step."""
        super().after(teaming, result)
        assert self.signal is not None
        now = self.signal
        loss = now.log_loss(teaming.attention.distracted)
        one = np.ones(teaming.num_teams)
        step = np.where(
            self._counts, np.stack([one, now.reveals, now.entropy, now.information, loss]), 0.0
        )
        sums = np.where(self._situation[:, None], step, 0.0)
        self._sums = sums if self._sums is None else self._sums + sums

    def signals(self) -> tuple[Signals, dict[str, dict[str, Signals]]]:
        """Return the sums of all steps, and by situation.

        Raises:
            RuntimeError: no step has been taken.
        """
        if self._sums is None:
            raise RuntimeError("no step has been counted; play episodes with this observer first")
        total, *rest = (
            Signals(*sums[:2].astype(np.int64), *sums[2:].copy()) for sums in self._sums
        )
        each = iter(rest)
        return total, {
            group: {label: next(each) for label in labels} for group, labels in SITUATIONS.items()
        }

    def by_driver(self, team: TeamConfig, seeds: NDArray[np.uint64]) -> dict[str, Signalling]:
        """Return the signals of each driver, by name.

        Args:
            team: whose drivers are listed.
            seeds: of the N episodes.

        Raises:
            ValueError: the team's population is no list of drivers.
            RuntimeError: no step has been taken.
        """
        total, parts = self.signals()
        return {
            name: Signalling(
                name,
                total.of(which),
                {
                    group: {label: signals.of(which) for label, signals in each.items()}
                    for group, each in parts.items()
                },
            )
            for name, which in driven_by(team, seeds).items()
        }


def _situation(teaming: Teaming) -> NDArray[np.bool_]:
    """Mark for all steps and each situation the teams in it, shape (1 + situations, N)."""
    near = teaming.time_headway() <= NEAR
    merges = teaming.ego.merging_slowness != 0.0
    alerted = teaming.alerted > 0
    applied = teaming.applied
    groups = [
        [applied == action for action in range(len(VEHICLE_ACTIONS))],
        *([holds, ~holds] for holds in (near, merges, alerted)),
    ]
    every = np.ones(teaming.num_teams, np.bool_)
    return np.stack([every, *(marks for group in groups for marks in group)])


def measure_signalling(
    team: TeamConfig, driver_policy: str, hmi: str, seeds: NDArray[np.uint64]
) -> dict[str, Signalling]:
    """Play episodes of policies by name in the batched world, and measure each driver's signals.

    Raises:
        FileNotFoundError, ValueError: an unknown name, or a population that is no list of drivers.
    """
    return _count(team, driver_policy, hmi, seeds).by_driver(team, seeds)


def revealing_share(
    team: TeamConfig, driver_policy: str, seeds: NDArray[np.uint64], hmi: str = "belief"
) -> float:
    """Measure the share of steps, after the first, in which a^H reveals d, all drivers together.

    Raises:
        FileNotFoundError, ValueError: an unknown name.
    """
    total, _ = _count(team, driver_policy, hmi, seeds).signals()
    return total.share


def _count(
    team: TeamConfig, driver_policy: str, hmi: str, seeds: NDArray[np.uint64]
) -> SignalCounter:
    driver, ai = make_driver_policy(driver_policy, team), make_hmi(hmi, team)
    counter = SignalCounter()
    play(begin(team, driver, ai, seeds, "batched"), driver, ai, [counter])
    return counter


def signalling_tables(measured: Sequence[Signalling]) -> list[Table]:
    """Show signals by driver, and by driver and situation."""
    overall = [
        [
            each.driver,
            each.share.percent(),
            *(
                each.total.per_step(name).shown(".3f")
                for name in ("entropy", "information", "log_loss")
            ),
        ]
        for each in measured
    ]
    situations = [
        [group, label]
        + [
            f"{each.by_situation[group][label].per_step('revealing').percent()} % / "
            f"{each.by_situation[group][label].per_step('information').shown('.3f')}"
            for each in measured
        ]
        for group, labels in SITUATIONS.items()
        for label in labels
    ]
    return [
        Table(
            "Signals by driver: share of steps in which a^H reveals d, and bits per step about d: "
            "unknown before, learned from a^H and v, log loss of the exact belief after",
            ["driver", "revealing [%]", "unknown", "learned", "log loss"],
            overall,
        ),
        Table(
            "Signals by situation: share of its steps that reveal d, and bits learned per step",
            ["situation", "", *(each.driver for each in measured)],
            situations,
        ),
    ]
