"""One team as the single-episode interfaces need it: seeds in series, checked actions, pictures."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hmi_marl.envs.config import DRIVER, VEHICLE_AI, TeamConfig
from hmi_marl.envs.streams import check_seed, episode_seed
from hmi_marl.envs.teaming import StepResult, Teaming
from hmi_marl.envs.worlds import VEHICLE_ACTIONS

if TYPE_CHECKING:
    from hmi_marl.envs.render import Viewer

RENDER_MODES = ("human", "rgb_array")


class SingleTeam:
    """A :class:`Teaming` of one, under PettingZoo's and Gymnasium's habits."""

    def __init__(self, config: TeamConfig, world: str, render_mode: str | None) -> None:
        if render_mode is not None and render_mode not in RENDER_MODES:
            raise ValueError(f"render_mode is None or one of {RENDER_MODES}, not {render_mode!r}")
        self.teaming = Teaming(config, 1, world)
        self.result: StepResult | None = None
        """Of the last step, None before the first."""
        self._render_mode = render_mode
        self._viewer: Viewer | None = None
        self._seed: int | None = None
        self._episode = 0

    def __getstate__(self) -> dict[str, Any]:
        """For copies and pickles: all but the viewer, since a window cannot be copied."""
        return self.__dict__ | {"_viewer": None}

    @property
    def seed(self) -> int:
        """The seed of the present episode."""
        return int(self.teaming.seeds[0])

    def reset(self, seed: int | None) -> None:
        """Begin the episode of ``seed``, or without one the next episode of the series."""
        if seed is not None:
            self._seed, self._episode = check_seed(seed), 0
        elif self._seed is None:
            self._seed, self._episode = int(np.random.SeedSequence().generate_state(1)[0]), 0
        else:
            self._episode += 1
        self.teaming.reset(episode_seed([self._seed], self._episode))
        self.result = None
        self.show()

    def intend(self, action: Any) -> None:
        """a^H, checked."""
        self.teaming.intend([_index(action, len(VEHICLE_ACTIONS), DRIVER)])

    def check_alert(self, action: Any) -> int:
        """Return a^A as an int, or raise."""
        return _index(action, self.teaming.alerts.choices, VEHICLE_AI)

    def alert(self, action: Any) -> StepResult:
        """a^A, checked; takes the step."""
        self.result = self.teaming.step([self.check_alert(action)])
        return self.result

    def render(self) -> NDArray[np.uint8] | None:
        """A picture (height, width, 3) in mode "rgb_array"; None after drawing in the window."""
        if self._render_mode is None:
            raise RuntimeError(
                f"nothing to draw on: make the environment with render_mode= one of {RENDER_MODES}"
            )
        from hmi_marl.envs.render import Viewer, has_display, team_status  # pulls in pygame

        if self._viewer is None:
            window = self._render_mode == "human"
            if window and not has_display():
                warnings.warn(
                    'render_mode="human" on a machine without a display: nothing will be seen; '
                    'render_mode="rgb_array" gives pictures',
                    stacklevel=3,
                )
                window = False
            self._viewer = Viewer(self.teaming.config, window)
        if self._viewer.closed:
            return None  # somebody closed the window
        picture = self._viewer.draw(self.teaming.world.snapshot(0), team_status(self.teaming, 0))
        return picture if self._render_mode == "rgb_array" else None

    def show(self) -> None:
        """Draw in the window if there is one; called after every step."""
        if self._render_mode == "human":
            self.render()

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._viewer is not None:
            self._viewer.close()
            self._viewer = None


def _index(action: Any, count: int, agent: str) -> int:
    """``action`` as an int in 0 .. count - 1, or an error that names the agent."""
    given = np.asarray(action)
    if given.size != 1 or not np.issubdtype(given.dtype, np.integer):
        raise ValueError(f"the action of {agent} is an integer, 0 to {count - 1}, not {action!r}")
    index = int(given.reshape(()))
    if not 0 <= index < count:
        raise ValueError(f"action {index} of {agent} is out of range: it is 0 to {count - 1}")
    return index
