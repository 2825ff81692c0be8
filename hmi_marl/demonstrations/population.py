"""Populations of recorded drivers: ranges of their traits, and drift from window to window.

With drift δ, a driver's β rises and α falls evenly from the first window to the last, around the
drawn values b and a, which stay the means over the driver's windows:

    β_w = b + s_w min(δ / 2, b, 1 - b),    α_w = a - s_w min(δ / 2, a, 1 - a),

where s_w runs from -1 to 1. So both change by δ, or by as much as [0, 1] leaves on both sides.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from hmi_marl.checks import Checked, Share
from hmi_marl.envs.drivers import INFLATION, TRAIT_NAMES, TraitDistributions, Uniform

_SIGNS = {"beta": 1.0, "alpha": -1.0}
"""Traits that drift, and in which direction."""


@dataclass(frozen=True)
class PopulationTraits(Checked):
    """Ranges that a population's traits are drawn from evenly, and their drift.

    Raises:
        ValueError, TypeError: a number out of its range, or a range that runs backwards.
    """

    beta: tuple[Share, Share] = (0.0, 1.0)
    """Least and most β of the population."""
    alpha: tuple[Share, Share] = (0.0, 1.0)
    """Least and most α of the population."""
    eta: tuple[Share, Share] = (0.0, 1.0)
    """Least and most η of the population."""
    inflation: tuple[Annotated[float, INFLATION], Annotated[float, INFLATION]] = (1.0, 9.0)
    """Least and most inflation of the population."""
    drift: Share = 0.0
    """Rise of β and fall of α over the windows of each driver of the population, around the drawn
    values and as far as [0, 1] allows; the truth has the traits of each window."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in TRAIT_NAMES:
            low, high = getattr(self, name)
            if low > high:
                raise ValueError(f"{name} of the population: the range {low:g} {high:g} runs back")

    @property
    def distributions(self) -> TraitDistributions:
        """Distributions that the traits are drawn from."""
        return TraitDistributions(*(Uniform(*getattr(self, name)) for name in TRAIT_NAMES))

    def drifted(
        self, traits: NDArray[np.float64], number: NDArray[np.int64], windows: int
    ) -> NDArray[np.float64]:
        """Return the traits in single windows, shape (E, 4).

        Args:
            traits: of each window's driver as drawn, shape (E, 4).
            number: of each window among its driver's, 0 to ``windows`` - 1, shape (E,).
            windows: of each driver; a single one has the drawn traits.
        """
        moved = traits.copy()
        if self.drift and windows > 1:
            along = 2 * number / (windows - 1) - 1
            for name, sign in _SIGNS.items():
                column = moved[:, TRAIT_NAMES.index(name)]
                column += sign * along * np.minimum(self.drift / 2, np.minimum(column, 1 - column))
        return moved
