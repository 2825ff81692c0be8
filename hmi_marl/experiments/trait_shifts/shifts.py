"""Shifts: in what strangers differ from those that a trait model and its probes were made for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

from hmi_marl.demonstrations.population import PopulationTraits
from hmi_marl.demonstrations.recording import RANDOM, CollectSettings
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import PAPER_DRIVERS, TraitDistributions


@dataclass(frozen=True)
class Shift:
    """One difference between recordings of the same strangers."""

    name: str
    """Name in files."""
    what: str
    """Description for a reader."""
    changes: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))
    """Fields of :class:`CollectSettings` that differ."""

    def recording(self, base: CollectSettings) -> CollectSettings:
        """Settings of the shifted recording."""
        return replace(base, **self.changes)


def _traits(**changes: Any) -> dict[str, Any]:
    return {"traits": PopulationTraits(**changes)}


NONE = Shift("none", "none")
SHIFTS: tuple[Shift, ...] = (
    NONE,
    Shift(
        "control-driver",
        "driver policy: the control",
        {"driver_policy": "trained:driver-inflation"},
    ),
    Shift(
        "other-driver",
        "driver policy: another training",
        {"driver_policy": "trained:hidden-two-stage-driver"},
    ),
    Shift(
        "joint-driver",
        "driver policy: learned jointly",
        {"driver_policy": "trained:hidden-joint-driver"},
    ),
    Shift("rule-driver", "driver policy: rule", {"driver_policy": "rule"}),
    Shift("no-alerts", "HMI: no alerts", {"alert_rate": 0.0}),
    Shift("average-hmi", "HMI: when distracted, the optimum for the average", {"hmi": "average"}),
    Shift(
        "adaptive-hmi",
        "HMI: adaptive, expected value",
        {"hmi": "adapt:expected", "ai_sees_attention": False},
    ),
    Shift("drift-small", "β rises, α falls by 0.3", _traits(drift=0.3)),
    Shift("drift-large", "β rises, α falls by 0.6", _traits(drift=0.6)),
    Shift("window-5", "alert window N = 5", {"alert_window": 5}),
    Shift("window-9", "alert window N = 9", {"alert_window": 9}),
    Shift("traffic", "25 to 30 other vehicles", {"vehicles": (25, 30)}),
    Shift("high-inflation", "inflation 9 to 13", _traits(inflation=(9.0, 13.0))),
    Shift("high-beta", "β 0.8 to 1", _traits(beta=(0.8, 1.0))),
    Shift("low-alpha", "α 0 to 0.2", _traits(alpha=(0.0, 0.2))),
    Shift("low-eta", "η 0 to 0.2", _traits(eta=(0.0, 0.2))),
)
"""Shifts by row of the tables. The first is none."""


@dataclass(frozen=True)
class Belief:
    """Assumptions of an exact posterior about how windows came about.

    Their world (road, traffic) is read from the recording: windows are replayed in it.
    """

    driver_policy: str | None
    """Driver policy; None: nothing is assumed about which actions a driver chooses."""
    config: TeamConfig
    """Settings of the teams."""
    prior: TraitDistributions
    """Distributions of the traits."""


def unshifted_belief(base: CollectSettings, recording: CollectSettings) -> Belief:
    """Return the belief that nothing has shifted, for windows of a recording."""
    config = replace(recording.team(PAPER_DRIVERS), alert_window=base.alert_window)
    return Belief(base.driver_policy, config, base.traits.distributions)


def knowing_belief(recording: CollectSettings, has_probabilities: bool) -> Belief | None:
    """Return the belief that knows how a recording was made; None where none can be computed.

    The posterior assumes alerts that say nothing of the driver, and traits that stay as they are.

    Args:
        recording: settings.
        has_probabilities: whether the driver policy gives the probabilities of its actions; if not,
            nothing is assumed about it.
    """
    if recording.hmi != RANDOM or recording.traits.drift:
        return None
    policy = recording.driver_policy if has_probabilities else None
    return Belief(policy, recording.team(PAPER_DRIVERS), recording.traits.distributions)
