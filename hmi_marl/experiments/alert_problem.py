"""What is known exactly about alerting one driver, for people and as JSON."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hmi_marl.agents.hmis import strongest_alert
from hmi_marl.envs.alerts import PLAIN, Alerts
from hmi_marl.envs.drivers import Driver, get_driver
from hmi_marl.exact import oracle
from hmi_marl.exact.oracle import AlertReturns, Reachable
from hmi_marl.files import json_value
from hmi_marl.paper import audit
from hmi_marl.paper.audit import AuditedCell


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
    alerts: Alerts = PLAIN
    """What alerts there are; the audit is of the paper's alone."""

    def as_text(self) -> str:
        """For people."""
        driver = self.driver
        lines = [
            f"{driver.name}: β = {driver.beta:g}, α = {driver.alpha:g}, η = {driver.eta:g}; "
            f"N = {self.window}, {self.horizon} steps. Exact expectations over one episode:",
            *([] if self.alerts.plain else [self._about_alerts()]),
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

    def _about_alerts(self) -> str:
        strengths = ", ".join(f"{strength:g}" for strength in self.alerts.strengths)
        fatigue = "none" if self.alerts.fatigue is None else f"{self.alerts.fatigue}"
        return (
            f"Alerts of strength {strengths}, of which plain rules give the strongest; "
            f"fatigue: {fatigue}."
        )

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
            "audit": audit.audit_json(self.audited),
        }


def alert_report(
    driver: str | Driver, window: int, horizon: int, alerts: Alerts = PLAIN
) -> AlertReport:
    """Solve the alert problem and hold some plain rules beside the optimum.

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
    return AlertReport(*problem, returns, reachable, audit.audit(window), alerts)
