"""How large an evaluation of adaptive HMIs is; importable without torch."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from hmi_marl.agents.adaptive.hmis import CAUTION
from hmi_marl.envs.streams import check_seed
from hmi_marl.training.evidence.conditioned import conditioned_hmi
from hmi_marl.training.evidence.settings import EvidenceSettings
from hmi_marl.training.protocols.settings import check_count
from hmi_marl.training.protocols.two_stage import TwoStage

TRIPS = 4
"""Of each driver: the first, as a stranger, and those after one, two and three."""


@dataclass(frozen=True)
class AdaptSettings:
    """How large it is.

    Raises:
        ValueError: too few drivers for an interval, or a number out of its range.
    """

    drivers: int = 400
    """Drivers of each of the four types."""
    strangers: int = 128
    """Drivers of the continuous population, all different."""
    repeats: int = 4
    """Times that each of them takes their trips."""
    candidates: int = 128
    """Others of that population, among whom an estimator looks for the one at the wheel."""
    changes: int = 400
    """Changes of driver in mid-trip, to each of the four types."""
    revealing: float = 0.35
    """Share of steps in which a^H differs from the last applied action, as every HMI assumes it."""
    caution: float = CAUTION
    """Of the HMI that goes by expected value: standard deviations of doubt that make it do as
    AvgHMI."""
    seed: int = 10**7
    """Of the trips."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "seed", check_seed(self.seed))
        for name in ("repeats", "candidates"):
            check_count(name, getattr(self, name))
        for name in ("drivers", "strangers", "changes"):
            if getattr(self, name) < 2:
                raise ValueError(
                    f"an interval needs at least 2, but got {name} = {getattr(self, name)}"
                )
        if not 0.0 <= self.revealing <= 1.0:
            raise ValueError(f"revealing is a share in [0, 1], but got {self.revealing}")
        if not self.caution >= 0.0:
            raise ValueError(f"caution is at least 0, but got {self.caution}")


QUICK = AdaptSettings(drivers=40, strangers=24, repeats=2, candidates=48, changes=40)
"""A coarse one, in a minute or two."""


@dataclass(frozen=True)
class AdaptReproduction:
    """How large the learning for unknown drivers is, and its evaluation.

    Raises:
        ValueError: no drives, updates or steps.
    """

    drives: int = EvidenceSettings.drives
    """Drives that the encoder learns from."""
    updates: int = EvidenceSettings.updates
    """Gradient steps of the encoder."""
    hmi_steps: int = 8_000_000
    """Environment steps in which the HMI conditioned on z learns."""
    rnn_hidden_dim: int = 32
    """Units of its recurrent layer."""
    num_teams: int = 512
    """Teams that train side by side."""
    seed: int = 0
    """Of all training."""
    judge: AdaptSettings = field(default_factory=AdaptSettings)
    """How large the evaluation is."""

    def __post_init__(self) -> None:
        for name in ("drives", "updates", "hmi_steps", "rnn_hidden_dim"):
            check_count(name, getattr(self, name))

    def evidence(self, driver_run: Path) -> EvidenceSettings:
        """How the encoder is learned."""
        return EvidenceSettings(
            str(driver_run), drives=self.drives, updates=self.updates, seed=self.seed
        )

    def conditioned(self, driver_run: Path) -> TwoStage:
        """How the HMI conditioned on z is learned."""
        return conditioned_hmi(
            str(driver_run), self.hmi_steps, self.rnn_hidden_dim, self.num_teams, self.seed
        )
