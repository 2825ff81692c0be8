"""Everything about a team that is a choice, in one place, with the documented defaults."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

from hmi_marl.envs.attention import check_window
from hmi_marl.envs.drivers import Driver, DriverList, Population, as_population
from hmi_marl.envs.rewards import RewardWeights, Sharing, check_sharing
from hmi_marl.envs.scene import Scene

AGENTS = ("driver", "vehicle_ai")
DRIVER, VEHICLE_AI = AGENTS


@dataclass(frozen=True)
class TeamConfig:
    """How one team of driver and vehicle AI is set up.

    Raises:
        ValueError, TypeError: a value out of its range, saying what to use instead.
    """

    driver: str | Driver | Iterable[str | Driver] | Population = "homer"
    """A known driver's name, a Driver, a list of them or a Population drawn from at each reset."""
    observe_traits: bool = True
    """Whether both observations carry the driver's four traits."""
    ai_sees_attention: bool = True
    """Whether the vehicle AI sees d, i and c of the last step (a driver-monitoring camera)."""
    reward: Sharing = "team"
    """Whose reward: "team", "individual" or "driving" (see :func:`rewards.share`)."""
    alert_window: int = 7
    """N, the intervention window in steps."""
    duration: float = 20.0
    """Length of an episode [s]."""
    end_at_crash: bool = True
    """Whether a crash ends the episode. If not, the crashed car stands, and the world with it,
    until the time is over, while attention and rewards go on."""
    scene: Scene = field(default_factory=Scene)
    """Road, traffic, frequencies and lidar."""
    weights: RewardWeights = field(default_factory=RewardWeights)
    """Coefficients of the eight reward terms."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "driver", as_population(self.driver))
        check_sharing(self.reward)
        check_window(self.alert_window)
        if not isinstance(self.scene, Scene):
            raise TypeError(f"scene= takes a Scene, not {self.scene!r}")
        if not (math.isfinite(self.duration) and self.duration > 0):
            raise ValueError(f"duration is a positive number of seconds, but got {self.duration}")
        steps = self.duration * self.scene.policy_frequency
        if abs(steps - round(steps)) > 1e-9 or round(steps) < 1:
            raise ValueError(
                f"duration = {self.duration} s is not a whole number of steps "
                f"of 1/{self.scene.policy_frequency} s"
            )
        object.__setattr__(self, "scene", self.scene.fitted(self.duration))

    @property
    def horizon(self) -> int:
        """Steps in an episode that nothing cuts short."""
        return round(self.duration * self.scene.policy_frequency)

    @property
    def population(self) -> Population:
        """Where the driver of an episode is drawn from."""
        assert isinstance(self.driver, Population)
        return self.driver

    @property
    def only_driver(self) -> Driver | None:
        """The driver, if there is only one to draw."""
        population = self.population
        if isinstance(population, DriverList) and len(set(population.drivers)) == 1:
            return population.drivers[0]
        return None
