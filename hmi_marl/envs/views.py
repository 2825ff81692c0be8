"""Gymnasium environments for one seat, the other seat's partner given.

``gymnasium.make("hmi_marl/MergeDriver-v0", partner="never")`` is the driver's seat, with an HMI
as part of the world; ``gymnasium.make("hmi_marl/MergeHMI-v0", partner="rule")`` is the vehicle
AI's seat, with a driver inside. Moves are sequential, so that the HMI sees what the driver is about
to do. Both take every keyword of :mod:`hmi_marl.envs.merge_v0`.

The classes here take the partner as a :class:`hmi_marl.envs.seats.Policy`;
:mod:`hmi_marl.agents.partners`, which ``gymnasium.make`` goes through, also takes a known
policy's name or a plain function from one observation to an action. A policy may remember
what it saw: give each environment its own object.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from hmi_marl.envs.config import DRIVER, VEHICLE_AI, TeamConfig
from hmi_marl.envs.observations import Layout
from hmi_marl.envs.seats import PartnerTurns, Policy, check_policy
from hmi_marl.envs.single import RENDER_MODES, SingleTeam, team_info
from hmi_marl.envs.worlds import World


class _OneSeat(gymnasium.Env[NDArray[np.float32], np.int64]):
    """The common part of both seats."""

    metadata = {"render_modes": list(RENDER_MODES), "render_fps": 5}  # noqa: RUF012 (Gymnasium's)
    seat: str
    other_seat: str

    def __init__(
        self,
        partner: Policy,
        config: TeamConfig,
        world: str | World = "highway",
        render_mode: str | None = None,
    ) -> None:
        self.partner = check_policy(partner)
        self.config = config
        self.team = SingleTeam(config, world, render_mode)
        self._turns = PartnerTurns(self.team.teaming, self.seat, self.partner, self._checked)
        self.render_mode = render_mode
        self.metadata = self.metadata | {"render_fps": config.scene.policy_frequency}
        self.observation_space: spaces.Box = self.layout.space()  # type: ignore[assignment]
        self.action_space = self.team.action_spaces[self.seat]

    @property
    def layout(self) -> Layout:
        """Named columns of the observation."""
        return self.team.teaming.layouts[self.seat]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin the episode of this seed, or the next one; ``options`` are not used."""
        super().reset(seed=seed)
        self._begin(seed)
        self.partner.reset(self.team.teaming.seeds)
        self._turns.prepare()
        return self._observation(), self._info()

    def step(self, action: Any) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Take one step of the team from this seat's action; the reward is this seat's."""
        if self.team.teaming.over.all():
            raise RuntimeError("the episode is over: call reset() before stepping again")
        action = self.team.check(self.seat, action)  # before the partner is asked
        self.team.result = result = self._turns.step([action])
        self.team.show()
        terminated, truncated = bool(result.terminated[0]), bool(result.truncated[0])
        if not (terminated or truncated):
            self._turns.prepare()
        reward = float(result.rewards[self.seat][0])
        return self._observation(), reward, terminated, truncated, self._info()

    def _begin(self, seed: int | None) -> None:
        self.team.reset(seed)

    def _checked(self, actions: Any) -> NDArray[np.int64]:
        """The partner's actions, shape (1,), or an error that says what is wrong."""
        answer = np.asarray(actions)
        count = int(self.team.action_spaces[self.other_seat].n)
        if (
            answer.shape != (1,)
            or not np.issubdtype(answer.dtype, np.integer)
            or not 0 <= answer[0] < count
        ):
            raise ValueError(
                f"the partner in the seat of {self.other_seat} answers with an integer, 0 to "
                f"{count - 1}, for each team, but this one gave {answer!r}"
            )
        return answer

    def _observation(self) -> NDArray[np.float32]:
        return self.team.teaming.observe(self.seat)[0]

    def _info(self) -> dict[str, Any]:
        return team_info(self.team.teaming, self.team.result)

    def render(self) -> NDArray[np.uint8] | None:
        """A picture of shape (height, width, 3), or None after drawing in the window."""
        return self.team.render()

    def close(self) -> None:
        """Close the window, if there is one."""
        self.team.close()


class MergeDriver(_OneSeat):
    """The driver's seat; the HMI is part of the environment."""

    seat, other_seat = DRIVER, VEHICLE_AI


class MergeHMI(_OneSeat):
    """The vehicle AI's seat; the driver is part of the environment and acts before the AI sees."""

    seat, other_seat = VEHICLE_AI, DRIVER
