"""A belief about the driver: a probability for each of K candidates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hmi_marl.envs.drivers import Driver, Traits
from hmi_marl.exact.identify import marginal


@dataclass(frozen=True, eq=False)
class TraitBelief:
    """Probabilities of K candidates in each of N teams."""

    drivers: tuple[Driver, ...]
    """The K candidates: the known types, or a sample of a population."""
    probabilities: NDArray[np.float64]
    """Probability of each candidate, shape (N, K); the rows sum to 1."""

    @property
    def mean(self) -> NDArray[np.float64]:
        """Expected traits, shape (N, 4), columns as in ``TRAIT_NAMES``."""
        return self.probabilities @ _table(self.drivers)

    @property
    def spread(self) -> NDArray[np.float64]:
        """Standard deviation of each trait, shape (N, 4)."""
        table = _table(self.drivers)
        apart = table - self.mean[:, None]  # (N, K, 4)
        return np.sqrt(np.einsum("nk,nkt->nt", self.probabilities, apart**2))

    @property
    def most_likely(self) -> NDArray[np.int64]:
        """Place of the likeliest candidate, shape (N,); the first of equals."""
        return self.probabilities.argmax(axis=1)

    def named(self) -> dict[str, NDArray[np.float64]]:
        """Probability of each name among the candidates, shape (N,)."""
        return marginal(self.probabilities, [driver.name for driver in self.drivers])

    def expected(self, values: NDArray[np.floating]) -> NDArray[np.float64]:
        """Expectation of a quantity of each candidate: shape (K, ...) to (N, ...)."""
        return np.tensordot(self.probabilities, values, axes=1)


def _table(drivers: Sequence[Driver]) -> NDArray[np.float64]:
    return Traits.of(drivers).as_array()
