"""``hmi-marl oracle``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from hmi_marl.agents import oracle
from hmi_marl.envs.attention import check_window
from hmi_marl.envs.drivers import get_driver
from hmi_marl.evaluation.alert_report import alert_report
from hmi_marl.files import make_folder, write_json


@dataclass(frozen=True)
class Oracle:
    """The exact optimum of the alert problem for one driver, and the audit of the paper's table.

    Example: hmi-marl oracle --driver bart --window 7 --horizon 100
    """

    driver: str = "homer"
    """lisa, marge, bart, homer, average, or name:beta,alpha,eta,inflation."""
    window: int = oracle.DEFAULT_WINDOW
    """N, for how many steps an alert stays in effect."""
    horizon: int = oracle.DEFAULT_HORIZON
    """Steps in an episode (5 per second)."""
    out: Path = Path("runs/oracle")
    """Folder for the JSON."""

    def run(self, typed: str) -> None:
        """Solve, write and print."""
        driver, window = get_driver(self.driver), check_window(self.window)
        horizon = oracle.check_horizon(self.horizon)
        make_folder(self.out)
        found = alert_report(driver, window, horizon)
        path = self.out / f"{driver.name}-window{window}-horizon{horizon}.json"
        write_json(path, found.as_json())
        print(found.as_text())
        print(f"\nwritten: {path}")
