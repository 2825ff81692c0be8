"""What the paper prints for distraction returns, held against what any alert policy can reach.

The paper does not say how long its window N or its episodes are. The audit therefore takes a
given N and every horizon from 94 to 100 steps, around the 95 or so that its NoHMI row implies.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

from hmi_marl.envs.drivers import DRIVERS, PAPER_DRIVERS, Driver
from hmi_marl.exact import oracle
from hmi_marl.paper.printed import DISTRACTION_RETURNS

HORIZONS = range(94, 101)


@dataclass(frozen=True)
class AuditedCell:
    """One cell of the paper's table beside the exact numbers. Ranges are over the horizons."""

    hmi: str
    driver: str
    paper: float
    least: float
    """The worst that any alert policy can do in the longest of these episodes."""
    most: float
    """The best that any alert policy can do in the shortest."""
    reachable: bool
    optimum: tuple[float, float]
    """Distraction return of the alert optimum (which maximises the whole attention return)."""
    optimum_if_eta_1: tuple[float, float]
    """The same, if the driver's η were 1."""


def audit(window: int = oracle.DEFAULT_WINDOW) -> list[AuditedCell]:
    """Every distraction return that the paper prints, row by row."""
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


def _exact_ranges(driver: Driver, window: int) -> list[tuple[float, float]]:
    """What is reachable, the optimum, and the optimum if η were 1, over the horizons."""
    reachable = [oracle.reachable(driver, window, horizon) for horizon in HORIZONS]
    ranges = [(min(r.least for r in reachable), max(r.most for r in reachable))]
    for who in (driver, replace(driver, eta=1.0)):
        optima = [oracle.solve_alerts(who, window, steps).distraction_return for steps in HORIZONS]
        ranges.append((min(optima), max(optima)))
    return ranges


def audit_json(cells: list[AuditedCell]) -> list[dict[str, Any]]:
    """The audit as JSON content."""
    return [asdict(cell) for cell in cells]
