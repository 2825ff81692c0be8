"""``hmi-marl oracle``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from hmi_marl.envs.alerts import FULL, Alerts
from hmi_marl.envs.attention import check_window
from hmi_marl.envs.config import as_fatigue
from hmi_marl.envs.drivers import get_driver
from hmi_marl.exact import oracle
from hmi_marl.experiments.alert_problem import alert_problem
from hmi_marl.files import make_folder, write_json
from hmi_marl.reporting.blocks import as_text


@dataclass(frozen=True)
class Oracle:
    """Solve the alert problem of one driver exactly, and audit the paper's table.

    Example: hmi-marl oracle --driver bart --window 7 --horizon 100
    """

    driver: str = "homer"
    """lisa, marge, bart, homer, average, name:beta,alpha,eta,inflation, or a driver file."""
    window: int = oracle.DEFAULT_WINDOW
    """N, the steps for which an alert stays in effect."""
    horizon: int = oracle.DEFAULT_HORIZON
    """Steps in an episode (5 per second)."""
    alert_strengths: tuple[float, ...] = FULL
    """Strengths of alert that the HMI can choose from, rising within (0, 1]."""
    fatigue: tuple[int, int, float] | None = None
    """LEVELS PER_ALERT EFFECT: how repeated alerts lose their effect, for example 10 2 0.5; by
    default they do not."""
    out: Path = Path("runs/oracle")
    """Folder for the JSON."""

    def run(self, command_line: str) -> None:
        """Solve, write and print."""
        driver, window = get_driver(self.driver), check_window(self.window)
        horizon = oracle.check_horizon(self.horizon)
        alerts = Alerts(self.alert_strengths, as_fatigue(self.fatigue))
        make_folder(self.out)
        found = alert_problem(driver, window, horizon, alerts)
        name = f"{driver.name}-window{window}-horizon{horizon}"
        if alerts.strengths != FULL:
            name += "-strengths" + "-".join(f"{strength:g}" for strength in alerts.strengths)
        if self.fatigue is not None:
            name += "-fatigue" + "-".join(f"{number:g}" for number in self.fatigue)
        path = self.out / f"{name}.json"
        write_json(path, found.as_json())
        print(as_text(found.blocks()))
        print(f"\nwritten: {path}")
