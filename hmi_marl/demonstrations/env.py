"""The environment that demonstrations come from, made from the data's own description.

It is the driver's seat with the HMI that collected the data as the partner. Observations are the
demonstrations' states, and actions are the driver's, a^H. A recorded window is replayed, state by
state, from its seed, its driver and its actions::

    env = dataset.recover_environment()
    env.reset(seed=episode.seed, options={"driver": "homer"})

because the car applies v_t when a^H_t = v_t. A crash ends the episode.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from gymnasium.envs.registration import EnvSpec
from numpy.typing import NDArray

from hmi_marl.agents.catalogue import make_hmi
from hmi_marl.demonstrations.dataset import Observed, observed_layout
from hmi_marl.envs.alerts import Fatigue
from hmi_marl.envs.config import VEHICLE_AI, TeamConfig
from hmi_marl.envs.drivers import (
    DRIVERS,
    DriverList,
    Population,
    TraitDistributions,
    Traits,
    get_driver,
)
from hmi_marl.envs.observations import Layout
from hmi_marl.envs.rewards import RewardWeights
from hmi_marl.envs.scene import Scene
from hmi_marl.envs.single import MergeDriver
from hmi_marl.typed_json import read_as


def team_config(team: Mapping[str, Any], **defaults: Any) -> TeamConfig:
    """Make a configuration from JSON, as :func:`hmi_marl.files.json_value` writes it.

    Args:
        team: fields of :class:`TeamConfig`; ``driver`` may be left out.
        defaults: values of fields that ``team`` lacks.

    Raises:
        ValueError, TypeError: an unknown field, or a value out of its range.
    """
    fields: dict[str, Any] = defaults | dict(team)
    given, weights = fields.pop("scene", {}), fields.pop("weights", {})
    if not (isinstance(given, Mapping) and isinstance(weights, Mapping)):
        raise ValueError("scene and weights of a team are mappings")
    scene: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value for name, value in given.items()
    }
    if isinstance(driver := fields.get("driver"), Mapping):
        listed = "drivers" in driver
        fields["driver"] = (
            read_as(DriverList, driver) if listed else read_as(TraitDistributions, driver)
        )
    if isinstance(fatigue := fields.get("fatigue"), Mapping):
        fields["fatigue"] = read_as(Fatigue, fatigue)
    return TeamConfig(scene=Scene(**scene), weights=RewardWeights(**weights), **fields)


class Described(Protocol):
    """Episodes of one dataset that say how they were made."""

    @property
    def layout(self) -> Layout:
        """Layout of the observed states."""

    @property
    def actions(self) -> NDArray[Any]:
        """v_t, shape (E, T)."""

    @property
    def about(self) -> Mapping[str, Any]:
        """How the data were made."""


def team_of(observed: Described) -> TeamConfig:
    """Return the configuration of the teams that these demonstrations come from, without a driver.

    Recordings that hold none are taken to be of the default scene, at its policy frequency.

    Raises:
        ValueError: the states do not have the layout of such a team.
    """
    team = observed.about.get("team", {})
    try:
        frequency = team.get("scene", {}).get("policy_frequency", Scene().policy_frequency)
        duration = observed.actions.shape[1] / frequency
        config = team_config(team, duration=duration, end_at_crash=False)
    except (ArithmeticError, AttributeError, TypeError, ValueError) as error:
        raise ValueError(f"the demonstrations describe no team that can be: {error}") from None
    if observed_layout(config) != observed.layout:
        raise ValueError("the demonstrations' states are not laid out as their scene would be seen")
    if config.horizon < observed.actions.shape[1]:
        raise ValueError(
            f"a window has {observed.actions.shape[1]} steps, but an episode of this team "
            f"{config.horizon}"
        )
    return config


class DemonstratedDriver(MergeDriver):
    """The driver's seat with the observations of demonstrations; ``hmi`` names the partner.

    Args:
        team: see :func:`team_config`.
        drivers: names of known drivers to draw from evenly; without any, traits are drawn evenly.
        render_mode: None, "rgb_array" or "human".
    """

    def __init__(
        self,
        team: Mapping[str, Any],
        hmi: str,
        drivers: Sequence[str] = (),
        world: str = "batched",
        render_mode: str | None = None,
    ) -> None:
        known = tuple(get_driver(name) for name in drivers)
        self._population = _Chosen(DriverList(known) if known else TraitDistributions())
        config = team_config(team, driver=self._population)
        self._layout = observed_layout(config)
        super().__init__(make_hmi(hmi, config), config, world, render_mode)
        self._columns = self.team.teaming.layouts[VEHICLE_AI].columns_of(self._layout)

    @property
    def layout(self) -> Layout:
        """Layout of the observation: the demonstrations' states."""
        return self._layout

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin an episode.

        Args:
            seed: the seed of a recorded window, to replay it, or any other; without one the next
                episode of the series begins.
            options: ``driver``: name of a known driver, for this episode alone.
        """
        name = (options or {}).get("driver")
        if name is not None and name not in DRIVERS:
            raise ValueError(f"unknown driver {name!r}; known drivers: {', '.join(DRIVERS)}")
        self._population.name = name
        return super().reset(seed=seed, options=options)

    def _begin(self, seed: int | None) -> None:
        self.team.reset(seed, of_episode=True)

    def _observation(self) -> NDArray[np.float32]:
        return self.team.teaming.observe(VEHICLE_AI)[0, self._columns]


class _Chosen:
    """A population, or one driver for as long as its name is set."""

    def __init__(self, population: Population) -> None:
        self.population = population
        self.name: str | None = None

    def draw(self, seeds: NDArray[np.uint64]) -> Traits:
        """See :meth:`Population.draw`."""
        if self.name is None:
            return self.population.draw(seeds)
        return Traits.of([DRIVERS[self.name]] * len(seeds))


def env_spec(observed: Observed) -> EnvSpec | None:
    """Return the specification of these demonstrations' environment; None if they hold none.

    A crash ends its episodes, also where the recorded car stood until the end of the window.
    """
    about = observed.about
    if "team" not in about or "hmi" not in about:
        return None
    return EnvSpec(
        id="hmi_marl/DemonstratedDriver-v0",
        entry_point=f"{__name__}:{DemonstratedDriver.__name__}",
        kwargs={
            "team": dict(about["team"]) | {"end_at_crash": True},
            "hmi": about["hmi"],
            "drivers": [name for name in observed.names if name in DRIVERS],
        },
    )
