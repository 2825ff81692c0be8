"""One team for the single-episode interfaces, and the Gymnasium environments of one seat.

:class:`SingleTeam` has the series of seeds, checked actions, pictures and info.
``gymnasium.make("hmi_marl/MergeDriver-v0", partner="never")`` is the driver's seat, with an HMI
as part of the world; ``gymnasium.make("hmi_marl/MergeHMI-v0", partner="rule")`` is the vehicle
AI's seat, with a driver inside. Moves are sequential, so that the HMI sees what the driver is about
to do. Both take every keyword of :mod:`hmi_marl.envs.merge_v0`.

The classes here take the partner as a :class:`hmi_marl.envs.seats.Policy`;
:mod:`hmi_marl.agents.partners`, which ``gymnasium.make`` goes through, also takes a known
policy's name or a plain function from one observation to an action.
"""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from hmi_marl.envs.alerts import FULL
from hmi_marl.envs.config import DRIVER, VEHICLE_AI, TeamConfig
from hmi_marl.envs.observations import Layout
from hmi_marl.envs.rewards import TERMS
from hmi_marl.envs.seats import PartnerTurns, Policy, check_policy
from hmi_marl.envs.step_result import StepResult
from hmi_marl.envs.streams import check_seed, episode_seed
from hmi_marl.envs.teaming import Teaming
from hmi_marl.envs.worlds import VEHICLE_ACTIONS, World

if TYPE_CHECKING:
    from hmi_marl.envs.render import Viewer


RENDER_MODES = ("human", "rgb_array")


class SingleTeam:
    """A :class:`Teaming` of one team, with the conventions of PettingZoo and Gymnasium."""

    def __init__(self, config: TeamConfig, world: str | World, render_mode: str | None) -> None:
        if render_mode is not None and render_mode not in RENDER_MODES:
            raise ValueError(f"render_mode is None or one of {RENDER_MODES}, not {render_mode!r}")
        self.teaming = Teaming(config, 1, world)
        self.action_spaces = {
            DRIVER: spaces.Discrete(len(VEHICLE_ACTIONS)),
            VEHICLE_AI: spaces.Discrete(config.alerts.choices),
        }
        """Action space of each agent; always the same objects."""
        self.result: StepResult | None = None
        """Result of the last step, None before the first."""
        self._render_mode = render_mode
        self._viewer: Viewer | None = None
        self._seed: int | None = None
        self._episode = 0

    def __getstate__(self) -> dict[str, Any]:
        """Return all but the viewer, since a window cannot be copied."""
        return self.__dict__ | {"_viewer": None}

    @property
    def seed(self) -> int:
        """The seed of the present episode."""
        return int(self.teaming.seeds[0])

    def reset(self, seed: int | None, of_episode: bool = False) -> None:
        """Begin the episode of ``seed``, or without one the next episode of the series.

        Args:
            seed: of a new series; its first episode begins.
            of_episode: the seed is an episode's own, as :attr:`seed` gives it.
        """
        if seed is not None:
            self._seed, self._episode = check_seed(seed), 0
        elif self._seed is None:
            self._seed, self._episode = int(np.random.SeedSequence().generate_state(1)[0]), 0
        else:
            self._episode += 1
        this = episode_seed([self._seed], self._episode)
        if of_episode and seed is not None:
            this = np.array([self._seed], np.uint64)
        self.teaming.reset(this)
        self.result = None
        self.show()

    def check(self, agent: str, action: Any) -> int:
        """Return the agent's action as an int, or raise; see :func:`action_index`."""
        return action_index(action, self.action_spaces[agent], agent)

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
            return None  # the window was closed
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


class Pictured:
    """An environment of one team, with its pictures."""

    team: SingleTeam

    def render(self) -> NDArray[np.uint8] | None:
        """A picture of shape (height, width, 3), or None after drawing in the window."""
        return self.team.render()

    def close(self) -> None:
        """Close the window, if there is one."""
        self.team.close()


def team_info(teaming: Teaming, result: StepResult | None, team: int = 0) -> dict[str, Any]:
    """Numbers about one team after a step, for ``info``: the truth, for evaluation and pictures.

    ``distracted`` (d), ``accepted`` (i), ``counter`` (c), ``applied_action`` (v, -1 before the
    first step), ``crashed``, ``speed`` [m/s], ``time_headway`` [s] to the next object ahead in the
    lane (inf if nothing is), ``beta``, ``alpha``, ``eta``, ``inflation``, and one entry per
    reward term, 0 before the first step. With alerts of other strengths than 1 also ``strength``,
    that of the alert in effect, 0 if none is; with fatigue also ``fatigue``, its level.
    """
    attention, ego, traits = teaming.attention, teaming.ego, teaming.traits
    alerts = teaming.alerts
    more: dict[str, float] = {}
    if alerts.strengths != FULL:
        more["strength"] = float(alerts.strength(attention.accepted[team]))
    if alerts.fatigue is not None:
        more["fatigue"] = int(attention.fatigue[team])
    return {
        "distracted": bool(attention.distracted[team]),
        "accepted": bool(attention.accepted[team]),
        "counter": int(attention.counter[team]),
        "applied_action": int(teaming.applied[team]),
        "crashed": bool(ego.crashed[team]),
        "speed": float(ego.speed[team]),
        "time_headway": float(teaming.time_headway()[team]),
        "beta": float(traits.beta[team]),
        "alpha": float(traits.alpha[team]),
        "eta": float(traits.eta[team]),
        "inflation": float(traits.inflation[team]),
        **more,
        **{name: float(result.terms[name][team]) if result else 0.0 for name in TERMS},
    }


def action_index(action: Any, space: spaces.Discrete, agent: str) -> int:
    """Return an action as an int, or raise.

    Args:
        action: what ``space`` contains (an int, ``True``, a NumPy integer, a zero-dimensional
            array of one), or a zero-dimensional tensor with such an ``item()``.
        space: of the agent's actions.
        agent: for the message.

    Raises:
        ValueError: the space does not contain it.
    """
    given = as_scalar(action)
    try:
        contained = space.contains(given)
    except OverflowError:  # some Gymnasiums, for an int of more than 64 bits
        contained = False
    if contained:
        return int(given)
    last = int(space.n) - 1
    if isinstance(given, (int, np.integer)) and not 0 <= given <= last:
        raise ValueError(f"action {given} of {agent} is out of range: it is 0 to {last}")
    raise ValueError(f"the action of {agent} is an integer, 0 to {last}, not {action!r}")


def as_scalar(action: Any) -> Any:
    """Return a bool, a zero-dimensional array or tensor as a number, anything else unchanged."""
    if isinstance(action, np.ndarray) and action.shape == ():
        return action[()]
    if not isinstance(action, np.generic) and getattr(action, "shape", None) == ():
        action = action.item()  # a tensor of torch or jax, on any device
    return int(action) if isinstance(action, bool) else action


class _OneSeat(Pictured, gymnasium.Env[NDArray[np.float32], np.int64]):
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
        self._turns.begin(self.team.teaming.seeds)
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


class MergeDriver(_OneSeat):
    """The driver's seat; the HMI is part of the environment."""

    seat, other_seat = DRIVER, VEHICLE_AI


class MergeHMI(_OneSeat):
    """The vehicle AI's seat; the driver is part of the environment and acts before the AI sees."""

    seat, other_seat = VEHICLE_AI, DRIVER
