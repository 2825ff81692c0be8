"""What is known exactly about alerting one driver, for people and as JSON."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hmi_marl.agents import oracle
from hmi_marl.agents.oracle import AlertReturns, Reachable
from hmi_marl.envs.drivers import Driver, get_driver
from hmi_marl.evaluation import audit
from hmi_marl.evaluation.audit import AuditedCell


@dataclass(frozen=True)
class AlertReport:
    """Exact returns of some alert rules for one driver, and the audit of the paper's table."""

    driver: Driver
    window: int
    horizon: int
    returns: dict[str, AlertReturns]
    """By HMI."""
    reachable: Reachable
    audited: list[AuditedCell]

    def as_text(self) -> str:
        """For people."""
        driver = self.driver
        lines = [
            f"{driver.name}: β = {driver.beta:g}, α = {driver.alpha:g}, η = {driver.eta:g}; "
            f"N = {self.window}, {self.horizon} steps. Exact expectations over one episode:",
            "",
            f"{'HMI':<17}{'attention return':>17}{'distraction return':>20}{'alerts':>9}",
        ]
        lines += [
            f"{name:<17}{row.total_return:>17.2f}{row.distraction_return:>20.2f}{row.alerts:>9.2f}"
            for name, row in self.returns.items()
        ]
        lines += [
            "",
            f"Distraction returns that any alert policy can reach: {self.reachable.least:.2f} to "
            f"{self.reachable.most:.2f}",
            "",
            audit.audit_text(self.audited, self.window),
        ]
        return "\n".join(lines)

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
                }
                for name, row in self.returns.items()
            },
            "reachable_distraction_return": self.reachable._asdict(),
            "audit": audit.audit_json(self.audited),
        }


def alert_report(driver: str | Driver, window: int, horizon: int) -> AlertReport:
    """Solve the alert problem and hold some plain rules beside the optimum.

    Raises:
        ValueError: unknown driver, window < 1 or horizon < 1.
    """
    driver = get_driver(driver)
    rules: dict[str, ArrayLike] = {
        "optimal": oracle.solve_alerts(driver, window, horizon).policy,
        "when-distracted": np.arange(2.0).reshape(1, 2, 1, 1),
        "never": 0.0,
        "always": 1.0,
    }
    returns = {name: oracle.evaluate(rule, driver, window, horizon) for name, rule in rules.items()}
    reachable = oracle.reachable(driver, window, horizon)
    return AlertReport(driver, window, horizon, returns, reachable, audit.audit(window))
