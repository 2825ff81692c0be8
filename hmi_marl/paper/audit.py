"""Audit of the paper's distraction returns: the range that alert policies can reach, exactly.

The paper does not give its window N or the length of its episodes. The audit therefore takes one N
and every horizon from 94 to 100 steps, around the 95 or so that the NoHMI row implies.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

from hmi_marl.envs.drivers import DRIVERS, PAPER_DRIVERS, Driver
from hmi_marl.exact import oracle
from hmi_marl.paper.printed import DISTRACTION_RETURNS

HORIZONS = range(94, 101)


@dataclass(frozen=True)
class AuditedCell:
    """One cell of the paper's table and the exact numbers. Ranges are over the horizons."""

    hmi: str
    driver: str
    paper: float
    least: float
    """Lowest return of any alert policy, in the longest of these episodes."""
    most: float
    """Highest return of any alert policy, in the shortest."""
    reachable: bool
    optimum: tuple[float, float]
    """Distraction return of the alert optimum (which maximises the whole attention return)."""
    optimum_if_eta_1: tuple[float, float]
    """The same with η = 1."""


def audit(window: int = oracle.DEFAULT_WINDOW) -> list[AuditedCell]:
    """Audit every distraction return that the paper prints, row by row."""
    exact = {name: _exact_ranges(DRIVERS[name], window) for name in PAPER_DRIVERS}
    return [
        AuditedCell(
            hmi=hmi,
            driver=name,
            paper=row[name],
            least=least,
            most=most,
            reachable=least <= row[name] <= most,
            optimum=optimum,
            optimum_if_eta_1=optimum_if_eta_1,
        )
        for hmi, row in DISTRACTION_RETURNS.items()
        for name, ((least, most), optimum, optimum_if_eta_1) in exact.items()
    ]


@lru_cache(maxsize=64)
def reachable_in_the_paper(
    driver: Driver, window: int = oracle.DEFAULT_WINDOW
) -> tuple[float, float]:
    """Least and most distraction return of any alert policy, over all of the horizons."""
    by_steps = oracle.reachable_by_steps(driver, window, HORIZONS[-1])[HORIZONS[0] :]
    return float(by_steps[:, 0].min()), float(by_steps[:, 1].max())


@lru_cache(maxsize=64)
def _exact_ranges(driver: Driver, window: int) -> tuple[tuple[float, float], ...]:
    """Ranges over the horizons: reachable returns, the optimum, the optimum with η = 1."""
    ranges = [reachable_in_the_paper(driver, window)]
    for each in (driver, replace(driver, eta=1.0)):
        optima = [oracle.solve_alerts(each, window, steps).distraction_return for steps in HORIZONS]
        ranges.append((min(optima), max(optima)))
    return tuple(ranges)
