"""HMIs that are compared on unknown drivers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.adaptive.hmis import ExpectedValueHMI, Trained, make_adaptive
from hmi_marl.agents.adaptive.trait_estimator import TraitEstimator
from hmi_marl.agents.catalogue import make_hmi
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import PAPER_DRIVERS, Driver, Traits
from hmi_marl.envs.seats import Policy

KNOWING, AVERAGE, NONE = "knows the driver", "AvgHMI", "NoHMI"
LEARNED_KNOWING, LEARNED_AVERAGE = "learned, knows the driver", "learned AvgHMI"
CHOOSING, CONDITIONED, EXPECTED = "chooses by type", "conditioned on z", "expected value"
BAYES = ", Bayes"
ADAPTIVE = {
    CHOOSING: ("choosing", False),
    CONDITIONED: ("conditioned", False),
    EXPECTED: ("expected", False),
    CHOOSING + BAYES: ("choosing", True),
    CONDITIONED + BAYES: ("conditioned", True),
    EXPECTED + BAYES: ("expected", True),
}
"""Adaptive HMIs: their kind, and whether they use the exact posterior instead of the encoder."""
_LEARNED_EVIDENCE = ("evidence", "traits")
_READS = {
    LEARNED_KNOWING: ("hidden",),
    LEARNED_AVERAGE: ("hidden",),
    CHOOSING: ("hidden", *_LEARNED_EVIDENCE),
    CONDITIONED: ("conditioned", *_LEARNED_EVIDENCE),
    EXPECTED: _LEARNED_EVIDENCE,
    CHOOSING + BAYES: ("hidden",),
    CONDITIONED + BAYES: ("conditioned", "evidence"),
}
"""Fields of :class:`Trained` that the HMIs read; others read none."""


class KnownDriver:
    """Evidence that is certain of the driver, one of ``drivers``, for an HMI that knows them."""

    def __init__(self, drivers: Sequence[Driver]) -> None:
        self.drivers = tuple(drivers)
        self._table = Traits.of(drivers).as_array()
        self.reset(1)

    def set_drivers(self, traits: Traits) -> None:
        """Set the N drivers from now on; raises ``ValueError`` for one who is not a candidate."""
        same = (traits.as_array()[:, None] == self._table).all(axis=2)
        if not same.any(axis=1).all():
            raise ValueError("a driver is not among the candidates")
        self._driver = same.argmax(axis=1)

    def reset(self, count: int, which: NDArray[np.bool_] | None = None) -> None:
        """See :meth:`Evidence.reset`; in each of these teams the first candidate drives."""
        first = np.zeros(count, np.int64)
        self._driver = first if which is None else np.where(which, first, self._driver)

    def begin(self, which: NDArray[np.bool_]) -> None:
        """See :meth:`Evidence.begin`."""

    def observe(
        self, observations: NDArray[np.float32], new: NDArray[np.bool_]
    ) -> NDArray[np.float64]:
        """See :meth:`Evidence.observe`."""
        drives = self._driver[:, None] == np.arange(len(self.drivers))
        return np.where(new[:, None] & ~drives, -np.inf, 0.0)


def hmi_names(drivers: Sequence[Driver]) -> tuple[str, ...]:
    """List all HMIs that can be made for a group of these drivers."""
    only = drivers[0].name if len(drivers) == 1 else ""
    learned = (LEARNED_KNOWING,) if only in PAPER_DRIVERS else ()
    return (KNOWING, AVERAGE, NONE, *learned, LEARNED_AVERAGE, *ADAPTIVE)


def read_by(hmi: str, trained: Trained) -> Trained:
    """Return what an HMI reads of the trained models; the others' places are empty."""
    read = _READS.get(hmi, ())
    return replace(trained, **{each.name: "" for each in fields(trained) if each.name not in read})


@dataclass
class Hmis:
    """Factory of the HMIs for one group of drivers."""

    config: TeamConfig
    """Settings of the teams."""
    trained: Trained
    """Trained models and policies."""
    drivers: Sequence[Driver]
    """All drivers of the group."""
    candidates: Sequence[Driver]
    """Drivers that adaptive HMIs consider."""
    revealing: float
    """Assumed share of steps in which a^H differs from the last applied action."""
    caution: float
    """Caution of the HMI of expected value."""
    known: KnownDriver = field(init=False)
    """Evidence of the HMI that knows the driver."""

    def __post_init__(self) -> None:
        self.known = KnownDriver(self.drivers)

    def make(self, name: str) -> Policy:
        """Make one of :func:`hmi_names`."""
        config = self.config
        if name in ADAPTIVE:
            kind, exact = ADAPTIVE[name]
            return make_adaptive(
                kind, config, exact, self.candidates, self.trained, self.revealing, self.caution
            )
        if name == KNOWING:
            estimator = TraitEstimator(self.known, config, change_rate=1.0)
            return ExpectedValueHMI(estimator, config, self.revealing, caution=0.0)
        if name == AVERAGE:
            return make_hmi(f"belief:average:{self.revealing}", config)
        if name == NONE:
            return make_hmi("never", config)
        model = "average" if name == LEARNED_AVERAGE else self.drivers[0].name
        return self.trained.hidden_hmi(model, config)
