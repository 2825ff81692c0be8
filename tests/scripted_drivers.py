"""Driver policies that reveal d with a known probability."""

import numpy as np

from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.observations import driver_layout
from hmi_marl.envs.streams import uniform


class RevealingDriver:
    """Keep a^H = v_{t-1}, or another action with probability ``share``, by seed and step."""

    def __init__(self, config: TeamConfig, share: float) -> None:
        self._layout, self._share = driver_layout(config), share

    def reset(self, seeds, which=None):
        self._seeds, self._steps = seeds, np.uint64(0)

    def act(self, observations):
        last = np.maximum(self._layout.chosen(observations, "applied_action"), 0)
        differs = uniform(self._seeds, 98, np.full(len(last), self._steps)) < self._share
        self._steps += np.uint64(1)
        return np.where(differs, (last + 1) % 5, last)
