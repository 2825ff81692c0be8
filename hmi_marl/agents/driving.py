"""Driver policies that need no training: a rule and random actions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.memory import Draws, Memoryless
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.observations import FASTEST, driver_layout
from hmi_marl.envs.streams import Stream
from hmi_marl.envs.worlds import VEHICLE_ACTIONS

KEEP_SPEED, SPEED_UP, SLOW_DOWN = (
    VEHICLE_ACTIONS.index(name) for name in ("keep_speed", "speed_up", "slow_down")
)


class RuleBasedDriver(Memoryless):
    """Keep the lane and the gap that the lidar perceives ahead.

    It slows down when the perceived gap is shorter than ``slow_gap`` seconds of driving, or
    would close within ``slow_closing`` seconds; it speeds up when the gap is longer than
    ``fast_gap`` seconds and not closing; otherwise it keeps its speed. Since it uses *perceived*
    gaps, a higher inflation makes it more careful.
    """

    reads: tuple[str, ...] = ("lidar", "speed", "target_speed")
    """Parts of the observation that it reads."""

    def __init__(
        self,
        config: TeamConfig,
        slow_gap: float = 0.6,
        slow_closing: float = 3.0,
        fast_gap: float = 1.0,
    ) -> None:
        self._layout = driver_layout(config)
        self._range = config.scene.lidar_range
        self._top = np.float32(max(config.scene.target_speeds) / FASTEST)
        self.slow_gap, self.slow_closing, self.fast_gap = slow_gap, slow_closing, fast_gap

    def act(self, observations: NDArray[np.float32]) -> NDArray[np.int64]:
        """See :meth:`Policy.act`."""
        lidar = self._layout.get(observations, "lidar").reshape(len(observations), -1, 2)
        gap, opening = lidar[:, 0, 0] * self._range, lidar[:, 0, 1] * self._range
        speed = np.maximum(self._layout.scalar(observations, "speed") * FASTEST, 1.0)
        seen = gap < self._range
        time_gap = gap / speed
        closes_in = np.where(opening < 0, gap / np.maximum(-opening, 1e-6), np.inf)
        too_close = seen & ((time_gap < self.slow_gap) | (closes_in < self.slow_closing))
        free = ~seen | ((time_gap > self.fast_gap) & (opening >= 0))
        at_top = self._layout.scalar(observations, "target_speed") >= self._top
        return np.select([too_close, free & ~at_top], [SLOW_DOWN, SPEED_UP], KEEP_SPEED)


class RandomDriver:
    """Choose any of the five actions with equal probability."""

    reads: tuple[str, ...] = ()
    """Parts of the observation that it reads."""

    def __init__(self) -> None:
        self._draws = Draws(Stream.DRIVER_POLICY)

    def reset(self, seeds: NDArray[np.uint64], which: NDArray[np.bool_] | None = None) -> None:
        """See :meth:`Policy.reset`."""
        self._draws.reset(seeds, which)

    def act(self, observations: NDArray[np.float32]) -> NDArray[np.int64]:
        """See :meth:`Policy.act`."""
        return (self._draws.next() * len(VEHICLE_ACTIONS)).astype(np.int64)
