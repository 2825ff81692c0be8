"""Printed values of the paper's tables.

Metrics are by HMI (rows) and driver (columns). The paper leaves cells of a driver with another
driver's HMI as ``*``. The row "own" is the diagonal of its first four rows.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

Row = Mapping[str, float]

DISTRACTION_RETURNS: Mapping[str, Row] = MappingProxyType(
    {
        "own": {"lisa": -85.0, "marge": -80.0, "bart": -123.0, "homer": -117.0},
        "AvgHMI": {"lisa": -181.0, "marge": -45.0, "bart": -744.0, "homer": -162.0},
        "NoHMI": {"lisa": -192.0, "marge": -176.0, "bart": -745.0, "homer": -770.0},
    }
)
SPEED_RETURNS: Mapping[str, Row] = MappingProxyType(
    {
        "own": {"lisa": 445.0, "marge": 446.0, "bart": 444.0, "homer": 458.0},
        "AvgHMI": {"lisa": 447.0, "marge": 421.0, "bart": 432.0, "homer": 391.0},
        "NoHMI": {"lisa": 451.0, "marge": 423.0, "bart": 428.0, "homer": 404.0},
    }
)
AVERAGE_KL: Mapping[str, float] = MappingProxyType(
    {"none": 435.0, "id": 4940.0, "preference": 2872.0}
)
"""Average KL divergence between driver types [nats], by supervision; under the figure."""
DRIVER_TRAITS: Mapping[str, tuple[float, float, float, float]] = MappingProxyType(
    {
        "lisa": (0.2, 0.8, 0.01, 3.0),
        "marge": (0.2, 0.8, 1.0, 9.0),
        "bart": (0.8, 0.2, 0.01, 3.0),
        "homer": (0.8, 0.2, 1.0, 9.0),
    }
)
"""The paper's table of drivers: β, α, η and inflation."""
REWARDS: Mapping[str, float] = MappingProxyType(
    {
        "collision": -5.0,
        "speed_reward": 5.0,
        "right_lane": 0.1,
        "merging": -0.1,
        "lane_change": -0.1,
        "distraction": -10.0,
        "alert": 10.0,
        "accept_alert": 30.0,
    }
)
"""The paper's table of rewards, by :data:`hmi_marl.envs.rewards.TERMS`."""


def mean_over_drivers(row: Row) -> float:
    """Return the average over the drivers, which the paper's text gives."""
    return sum(row.values()) / len(row)
