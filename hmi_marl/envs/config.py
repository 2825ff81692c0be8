"""Settings of a team, with the documented defaults."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Annotated, ParamSpec, TypeVar

from hmi_marl.checks import Check, Checked, Real, Share
from hmi_marl.envs.alerts import FULL, Alerts, Fatigue, FatigueLevels, Strengths
from hmi_marl.envs.attention import WINDOW
from hmi_marl.envs.drivers import Driver, DriverList, Population, as_population
from hmi_marl.envs.rewards import RewardWeights, Sharing
from hmi_marl.envs.scene import VEHICLES, Scene, check_vehicles
from hmi_marl.registry import suggest

AGENTS = ("driver", "vehicle_ai")
DRIVER, VEHICLE_AI = AGENTS


Window = Annotated[int, WINDOW]
Duration = Annotated[float, Real(0.0, 3600.0, "s", above=True)]
VehicleRange = Annotated[tuple[int, int], Check(check_vehicles, VEHICLES)]


@dataclass(frozen=True)
class TeamConfig(Checked):
    """Settings of one team of driver and vehicle AI.

    Raises:
        ValueError, TypeError: a value out of its range, saying what to use instead.
    """

    driver: str | Driver | Sequence[str | Driver] | Population = "homer"
    """A known driver's name, a Driver, a list of them or a Population drawn from at each reset."""
    observe_traits: bool = True
    """Whether both observations carry the driver's four traits."""
    ai_sees_attention: bool = True
    """Whether the vehicle AI sees d, i and c of the last step (a driver-monitoring camera)."""
    reward: Sharing = "team"
    """Reward of each agent: "team", "individual", "driving" or "attention" (see
    :data:`rewards.SHARES`)."""
    alert_window: Window = 7
    """N, the intervention window in steps, 1 to 10,000."""
    alert_strengths: Strengths = FULL
    """Strengths of the vehicle AI's alerts, up to 100 that rise within (0, 1]; (1.0,) is the
    paper's bit, alert or not. See :mod:`hmi_marl.envs.alerts`."""
    fatigue: Fatigue | None = None
    """Loss of effect of alerts that pile up; none by default."""
    duration: Duration = 20.0
    """Length of an episode, up to 3600 s."""
    end_at_crash: bool = True
    """Whether a crash ends the episode. If not, the crashed car stands, and the world with it,
    until the time is over, while attention and rewards go on."""
    scene: Scene = field(default_factory=Scene)
    """Road, traffic, frequencies and lidar."""
    weights: RewardWeights = field(default_factory=RewardWeights)
    """Coefficients of the eight reward terms."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "driver", as_population(self.driver))
        super().__post_init__()
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
    def alerts(self) -> Alerts:
        """The alerts and their effects."""
        return Alerts(self.alert_strengths, self.fatigue)

    @property
    def population(self) -> Population:
        """The population that each episode's driver is drawn from."""
        assert isinstance(self.driver, Population)
        return self.driver

    @property
    def only_driver(self) -> Driver | None:
        """The driver, if there is only one to draw."""
        population = self.population
        if isinstance(population, DriverList) and len(set(population.drivers)) == 1:
            return population.drivers[0]
        return None


@dataclass(frozen=True)
class TeamSettings:
    """A command's options about teams, as typed: nothing is checked yet."""

    alert_window: Window = 7
    """N, the intervention window in steps."""
    alert_strengths: Strengths = FULL
    """Strengths of alert that the HMI can choose from, rising within (0, 1]."""
    fatigue: tuple[FatigueLevels, FatigueLevels, Share] | None = None
    """LEVELS PER_ALERT EFFECT, loss of effect of alerts that pile up: an alert of strength 1 raises
    fatigue by PER_ALERT of LEVELS, a step without one lowers it by 1, and at the highest level the
    share EFFECT of η is lost. For example 10 2 0.5; none by default."""
    duration: Duration = 20.0
    """Length of an episode [s]."""
    end_at_crash: bool = True
    """Whether a crash ends the episode."""
    ai_sees_attention: bool = True
    """Whether the HMI sees d, i and c; if not, exact HMIs use the Bayes belief."""
    vehicles: VehicleRange = (1, 20)
    """Least and most other vehicles."""

    def team(
        self, driver: str | Driver | Sequence[str | Driver] | Population, reward: Sharing = "team"
    ) -> TeamConfig:
        """Return the checked settings of teams with this driver."""
        return TeamConfig(
            driver=driver,
            ai_sees_attention=self.ai_sees_attention,
            reward=reward,
            alert_window=self.alert_window,
            alert_strengths=self.alert_strengths,
            fatigue=as_fatigue(self.fatigue),
            duration=self.duration,
            end_at_crash=self.end_at_crash,
            scene=Scene(vehicles=self.vehicles),
        )


def as_fatigue(numbers: tuple[int, int, float] | None) -> Fatigue | None:
    """Return the :class:`Fatigue` of (levels, per_alert, effect), as a command takes them."""
    return None if numbers is None else Fatigue(*numbers)


_P = ParamSpec("_P")
_R = TypeVar("_R")


def takes_team_settings(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Show the fields of :class:`TeamConfig` in place of ``**settings``, and refuse other names.

    ``help()`` and editors that look at the running program then list every keyword, and the error
    for a typo names the nearest.
    """
    signature = inspect.signature(function)
    own = [p for p in signature.parameters.values() if p.kind is not p.VAR_KEYWORD]
    settings = [
        p.replace(kind=p.KEYWORD_ONLY) for p in inspect.signature(TeamConfig).parameters.values()
    ]
    signature = signature.replace(parameters=own + settings)
    known = [name for name in signature.parameters if name != "self"]

    @functools.wraps(function)
    def checked(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        for name in kwargs:
            if name not in known:
                own = function.__qualname__
                raise TypeError(
                    # Python's own wording: TorchRL and others try keywords and look for it.
                    f"{own}() got an unexpected keyword argument {name!r}; "
                    f"{suggest(name, known, f'help({own})')}"
                )
        return function(*args, **kwargs)

    checked.__signature__ = signature  # type: ignore[attr-defined]
    return checked
