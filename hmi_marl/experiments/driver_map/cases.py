"""Cases of the map: one alert problem each, and what it is worth there to know the driver."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from hmi_marl.checks import Checked, Share
from hmi_marl.envs.attention import WINDOW
from hmi_marl.envs.drivers import DRIVERS
from hmi_marl.envs.rewards import RewardWeights
from hmi_marl.exact.driver_worth import Problem, hidden_returns, seen_returns
from hmi_marl.exact.oracle import HORIZON
from hmi_marl.experiments.criteria import LEAST_WORTH, SAME_RULE

PAPER = "paper"
"""Name of the paper's weights in ``WEIGHTS``."""
WEIGHTS: Mapping[str, RewardWeights] = MappingProxyType(
    {
        PAPER: RewardWeights(),
        "no accept bonus": RewardWeights(accept_alert=0.0),
        "alerts cost 3 x": RewardWeights(alert=30.0),
        "distraction costs 3 x": RewardWeights(distraction=-30.0),
    }
)
"""Reward weights of the cases, by name."""
WHEN_DISTRACTED, AVERAGE, NO_PREVENTION, ALWAYS_WHEN_DISTRACTED = (
    "when distracted",
    "average",
    "no prevention",
    "always when distracted",
)
"""Rules that are compared with the best one for the driver: an alert exactly when distracted; the
best rule for the average driver; the best without alerts to an attentive driver; the best that
always alerts a distracted one."""
_CENTRE = 13
"""Place of the middle among the 27 points of a cube."""


@dataclass(frozen=True)
class Case(Checked):
    """One alert problem, for all drivers."""

    window: Annotated[int, WINDOW]
    """N, in steps."""
    weights: str
    """Name of the reward weights."""
    horizon: Annotated[int, HORIZON]
    """Steps in the episode."""
    revealing: Share | None = None
    """Share of revealing steps with attention hidden; None if attention is seen."""

    @property
    def name(self) -> str:
        """Name of its file."""
        share = "seen" if self.revealing is None else f"hidden-{100 * self.revealing:g}"
        return f"{share}-window-{self.window}-{self.weights.replace(' ', '-')}"

    def losses(self, traits: NDArray[np.float64], threads: int) -> dict[str, NDArray[np.float64]]:
        """Returns per episode that rules lose against the best one for the driver, shape (G,) each.

        Args:
            traits: β, α and η, shape (G, 3).
            threads: at most.
        """
        problem = Problem(self.window, self.horizon, WEIGHTS[self.weights])
        if self.revealing is not None:
            hidden = hidden_returns(traits, problem, self.revealing, threads=threads)
            return {AVERAGE: hidden.own - hidden.average}
        seen = seen_returns(traits, problem, threads=threads)
        return {
            WHEN_DISTRACTED: seen.optimum - seen.when_distracted,
            AVERAGE: seen.optimum - seen.average,
            NO_PREVENTION: seen.optimum - seen.no_prevention,
            ALWAYS_WHEN_DISTRACTED: seen.optimum - seen.always_when_distracted,
        }


@dataclass(frozen=True)
class Integral:
    """An integral over a uniform population, by the midpoint rule."""

    value: float
    error: float
    """Difference from the rule with a third as many points of each trait; what is left of it is
    about a ninth where the integrand is smooth."""


@dataclass(frozen=True)
class Loss:
    """What a rule loses against the best one for the driver, over the drivers."""

    mean: Integral
    """Mean over a population that is uniform in β, α and η."""
    other_rule: Integral
    """Share of it for whom the rule is not optimal."""
    worth_it: Integral
    """Share of it for whom the rule loses at least ``LEAST_WORTH``."""
    most: float
    """Largest loss that was found, by the grid and then along it."""
    most_at: tuple[float, ...]
    """β, α and η there."""
    named: dict[str, float]
    """Loss for each known driver, by name."""
    slices: tuple[tuple[tuple[float, ...], ...], ...]
    """Loss in [η, β, α] on an even grid from 0 to 1."""


@dataclass(frozen=True)
class Grid:
    """Where the drivers of a case lie."""

    cells: int
    """Of β and of α in the coarser of both midpoint rules. η has one more: losses have a ridge at
    β = η, where points would lie if both had as many."""
    points: int
    """Of β and of α in a slice."""
    etas: tuple[float, ...]
    """η of the slices."""

    @property
    def shape(self) -> tuple[int, int, int]:
        """Points of β, α and η of the finer midpoint rule."""
        return 3 * self.cells, 3 * self.cells, 3 * (self.cells + 1)

    @property
    def middles(self) -> NDArray[np.float64]:
        """Middles of the cells of the finer rule, shape (G, 3); those of the coarser among them."""
        return _product([(np.arange(count) + 0.5) / count for count in self.shape])

    @property
    def slices(self) -> NDArray[np.float64]:
        """Points of the slices, in the order of η, β, α; shape (G, 3)."""
        even = np.linspace(0.0, 1.0, self.points)
        return _product([np.array(self.etas), even, even])[:, [1, 2, 0]]

    def integral(self, values: NDArray[np.float64] | NDArray[np.bool_]) -> Integral:
        """Integrate what is known at the middles, shape (G,)."""
        cube = values.reshape(self.shape)
        fine, coarse = float(cube.mean()), float(cube[1::3, 1::3, 1::3].mean())
        return Integral(fine, abs(fine - coarse))


@dataclass(frozen=True)
class CaseResult:
    """Losses in one case."""

    case: Case
    grid: Grid
    losses: dict[str, Loss]
    """By rule."""


def solve_case(case: Case, grid: Grid, threads: int) -> CaseResult:
    """Measure the losses of one case."""
    named = np.array([driver.traits[:3] for driver in DRIVERS.values()])
    middles, slices = grid.middles, grid.slices
    drivers = np.concatenate([middles, slices, named])
    found = {}
    for rule, values in case.losses(drivers, threads).items():
        inner, flat, own = np.split(values, [len(middles), len(middles) + len(slices)])

        def loss(traits: NDArray[np.float64], rule: str = rule) -> NDArray[np.float64]:
            return case.losses(traits, threads)[rule]

        most, where = climb(loss, drivers[np.argmax(values)], 0.5 / (3 * grid.cells))
        shape = len(grid.etas), grid.points, grid.points
        found[rule] = Loss(
            mean=grid.integral(inner),
            other_rule=grid.integral(inner > SAME_RULE),
            worth_it=grid.integral(inner >= LEAST_WORTH),
            most=most,
            most_at=tuple(where.tolist()),
            named=dict(zip(DRIVERS, own.tolist(), strict=True)),
            slices=_nested(flat.reshape(shape)),
        )
    return CaseResult(case, grid, found)


def climb(
    function: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    start: NDArray[np.float64],
    step: float,
    least_step: float = 1e-4,
) -> tuple[float, NDArray[np.float64]]:
    """Follow a function of points in the unit cube, shape (G, 3), uphill along a grid.

    Args:
        function: gives a value for each point, shape (G,).
        start: shape (3,).
        step: first distance of the grid's points; halved where no neighbour is higher.
        least_step: distance below which it ends.

    Returns:
        The highest value, and where, shape (3,).
    """
    cube = _product([np.array([-1.0, 0.0, 1.0])] * 3)
    place = start
    while True:
        around = np.clip(place + step * cube, 0.0, 1.0)
        values = function(around)
        best = int(np.argmax(values))
        if values[best] > values[_CENTRE]:
            place = around[best]
        elif step > least_step:
            step /= 2.0
        else:
            return float(values[_CENTRE]), place


def _product(axes: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    """All combinations, the last axis fastest: shape (G, len(axes))."""
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


def _nested(cube: NDArray[np.float64]) -> tuple[tuple[tuple[float, ...], ...], ...]:
    return tuple(tuple(tuple(row) for row in layer) for layer in cube.tolist())
