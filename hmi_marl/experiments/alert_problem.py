"""Exact values of the alert problem of one driver, and the audit of the paper's table."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from hmi_marl.agents.hmis import strongest_alert
from hmi_marl.envs.alerts import PLAIN, Alerts
from hmi_marl.envs.drivers import Driver, get_driver
from hmi_marl.exact import oracle
from hmi_marl.exact.oracle import AlertReturns, Reachable
from hmi_marl.files import json_value
from hmi_marl.paper.audit import HORIZONS, AuditedCell, audit
from hmi_marl.reporting.blocks import Block, Table, Text

AUDIT = "/audit"
"""Place of the audit in a JSON file."""


@dataclass(frozen=True)
class AlertProblem:
    """Exact returns of some alert rules for one driver, and the audit of the paper's table."""

    driver: Driver
    window: int
    horizon: int
    returns: dict[str, AlertReturns]
    """Returns by HMI."""
    reachable: Reachable
    audited: list[AuditedCell]
    alerts: Alerts = PLAIN
    """Alerts of the problem; the audit is of the paper's alone."""

    def blocks(self) -> list[Block]:
        """Blocks of the report."""
        driver = self.driver
        about = (
            f"{driver.name}: β = {driver.beta:g}, α = {driver.alpha:g}, η = {driver.eta:g}; "
            f"N = {self.window}, {self.horizon} steps. Exact expectations over one episode:"
        )
        if not self.alerts.plain:
            strengths = ", ".join(f"{strength:g}" for strength in self.alerts.strengths)
            fatigue = "none" if self.alerts.fatigue is None else f"{self.alerts.fatigue}"
            about += (
                f"\nAlerts of strength {strengths}, of which plain rules give the strongest; "
                f"fatigue: {fatigue}."
            )
        rows = [
            [name, f"{r.total_return:.2f}", f"{r.distraction_return:.2f}", f"{r.alerts:.2f}"]
            for name, r in self.returns.items()
        ]
        return [
            Text(about),
            Table(
                "",
                ["HMI", "attention return", "distraction return", "alerts"],
                rows,
                sources=["/returns"],
            ),
            Text(
                f"Distraction returns that any alert policy can reach: {self.reachable.least:.2f} "
                f"to {self.reachable.most:.2f}"
            ),
            audit_table(self.audited, self.window),
        ]

    def as_json(self) -> dict[str, Any]:
        """JSON content."""
        return {
            "driver": vars(self.driver),
            "window": self.window,
            "horizon": self.horizon,
            "returns": {
                name: {
                    "total_return": row.total_return,
                    "distraction_return": row.distraction_return,
                    "alerts": row.alerts,
                    "alerts_by_strength": row.rate_by_strength.sum(axis=1).tolist(),
                }
                for name, row in self.returns.items()
            },
            "alerts": json_value(self.alerts),
            "reachable_distraction_return": self.reachable._asdict(),
            "audit": json_value(self.audited),
        }


def alert_problem(
    driver: str | Driver, window: int, horizon: int, alerts: Alerts = PLAIN
) -> AlertProblem:
    """Solve the alert problem of a driver, and evaluate some plain rules.

    Raises:
        ValueError: unknown driver, window < 1 or horizon < 1.
    """
    driver = get_driver(driver)
    given: dict[str, Any] = {"strengths": alerts.strengths, "fatigue": alerts.fatigue}
    problem = driver, window, horizon
    rules = {
        "when-distracted": strongest_alert(alerts, 0.0, 1.0),
        "never": strongest_alert(alerts, 0.0),
        "always": strongest_alert(alerts, 1.0),
    }
    returns: dict[str, AlertReturns] = {"optimal": oracle.solve_alerts(*problem, **given)}
    returns |= {name: oracle.evaluate(rule, *problem, **given) for name, rule in rules.items()}
    reachable = oracle.reachable(*problem, **given)
    return AlertProblem(*problem, returns, reachable, audit(window), alerts)


def audit_table(cells: Sequence[AuditedCell], window: int) -> Table:
    """Table of the paper's distraction returns, and what any alert policy can reach."""

    def ends(low: float, high: float) -> str:
        return f"{low:.0f} to {high:.0f}"

    columns: dict[str, Callable[[AuditedCell], str]] = {
        "HMI, driver": lambda cell: f"{cell.hmi}, {cell.driver}",
        "paper": lambda cell: f"{cell.paper:.0f}",
        "reachable": lambda cell: ends(cell.least, cell.most),
        "optimum": lambda cell: ends(*cell.optimum),
        "optimum, η = 1": lambda cell: ends(*cell.optimum_if_eta_1),
        "verdict": lambda cell: (
            "reachable" if cell.reachable else "OUT OF REACH of every alert policy"
        ),
    }
    title = (
        f"The paper's distraction returns, and what any alert policy can reach at N = {window} "
        f"over {HORIZONS[0]} to {HORIZONS[-1]} steps"
    )
    return Table.of(title, cells, columns, sources=[AUDIT])
