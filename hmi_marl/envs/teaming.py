"""Steps of N teams over any world: the order of moves, the human model, the rewards.

:meth:`Teaming.turn` is a whole step. With sequential moves the driver acts first
(:meth:`Teaming.intend`), so that the vehicle AI's observation holds a^H_t when it acts
(:meth:`Teaming.step`). With simultaneous moves the vehicle AI is asked first, and its observation
still holds a^H_{t-1}.

Each team has its own turn: resetting some teams in mid-turn leaves the others in theirs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.envs import attention as attention_model
from hmi_marl.envs import observations as obs
from hmi_marl.envs.attention import Attention
from hmi_marl.envs.config import DRIVER, VEHICLE_AI, TeamConfig
from hmi_marl.envs.drivers import TRAIT_NAMES, Traits, check_traits
from hmi_marl.envs.rewards import attention_terms, driving_terms, share
from hmi_marl.envs.streams import Stream, uniform
from hmi_marl.envs.worlds import VEHICLE_ACTIONS, Ego, World, make_world

Actor = NDArray[np.int64] | list[int] | Callable[[NDArray[np.float32]], NDArray[np.int64]]
"""Actions of one seat, shape (N,), or a function that gives them for its observations, (N, D)."""

NO_ACTION = -1
_LANE_CHANGES = (VEHICLE_ACTIONS.index("move_left"), VEHICLE_ACTIONS.index("move_right"))


@dataclass(frozen=True)
class StepResult:
    """Rewards and ends of one step of N teams. Every array has shape (N,)."""

    rewards: dict[str, NDArray[np.float64]]
    """Reward of each agent."""
    terms: dict[str, NDArray[np.float64]]
    """Value of each reward term."""
    terminated: NDArray[np.bool_]
    """The episode ended by a crash."""
    truncated: NDArray[np.bool_]
    """The episode's time is over."""


class Teaming:
    """N teams of driver and vehicle AI.

    Team k's episode depends on seed k and team k's actions alone.

    Args:
        config: settings of every team.
        num_teams: N.
        world: a world's name, or a World with N copies of ``config.scene``.

    Raises:
        ValueError, TypeError: fewer than one team, or a world that does not fit.
    """

    def __init__(self, config: TeamConfig, num_teams: int = 1, world: str | World = "highway"):
        if num_teams < 1:
            raise ValueError(f"there is at least one team, but got num_teams = {num_teams}")
        self.config = config
        self.alerts = config.alerts
        """Meaning of a^A."""
        self.num_teams = num_teams
        self.world = _fitting(world, config, num_teams)
        self.layouts = {
            DRIVER: obs.driver_layout(config),
            VEHICLE_AI: obs.vehicle_ai_layout(config),
        }
        self.state_layout = obs.state_layout(config)
        zeros = np.zeros(num_teams, np.int64)
        self.seeds = np.zeros(num_teams, np.uint64)
        self.traits = Traits.from_array(np.zeros((num_teams, len(TRAIT_NAMES))))
        self.attention = Attention.initial(num_teams)
        self.steps = zeros.copy()
        """Steps taken in each team's episode."""
        self.intended = zeros + NO_ACTION
        """The latest a^H of each team, -1 before the first."""
        self.previous_intended = zeros + NO_ACTION
        self.applied = zeros + NO_ACTION
        """The latest v."""
        self.alerted = zeros.copy()
        """The latest a^A, 0 to k."""
        self.over = np.ones(num_teams, np.bool_)
        """Teams without a running episode: ended, or not begun."""
        self.ego: Ego = self.world.ego()
        self.intent_given = np.zeros(num_teams, np.bool_)
        """Teams in mid-turn: the driver has acted, the vehicle AI has not."""

    def reset(self, seeds: ArrayLike, which: NDArray[np.bool_] | None = None) -> None:
        """Begin new episodes in the teams marked in ``which`` (shape (N,), all by default).

        Args:
            seeds: of the episodes, integers of shape (N,) in [0, 2^64); those of unmarked teams
                are not read.
            which: shape (N,), bool.

        Raises:
            ValueError, TypeError: seeds or a mask that do not fit, or a population that draws
                impossible traits. Nothing has changed then.
        """
        fresh = check_mask(which, self.num_teams)
        seeds = np.where(fresh, self._checked_seeds(seeds, fresh), self.seeds)
        drawn = check_traits(self.config.population.draw(seeds), self.num_teams).as_array()
        self.seeds = seeds
        self.traits = Traits.from_array(np.where(fresh[:, None], drawn, self.traits.as_array()))
        self.attention = Attention.initial(self.num_teams).where(fresh, self.attention)
        for name in ("intended", "previous_intended", "applied"):
            setattr(self, name, np.where(fresh, NO_ACTION, getattr(self, name)))
        for name in ("steps", "alerted"):
            setattr(self, name, np.where(fresh, 0, getattr(self, name)))
        self.over = self.over & ~fresh
        self.intent_given = self.intent_given & ~fresh
        self.world.reset(self.seeds, self.traits.inflation, fresh)
        self.ego = self.world.ego()

    def hand_over(self, traits: Traits, which: NDArray[np.bool_] | None = None) -> None:
        """Change drivers in mid-episode. The new ones are attentive; car, time and v stay.

        Args:
            traits: of N drivers; those of unmarked teams are not used.
            which: the teams that change drivers, shape (N,), bool; all by default.

        Raises:
            ValueError, TypeError: impossible traits, a mask that does not fit, or a turn that has
                begun: another driver would carry out its intent. Nothing has changed then.
        """
        fresh = check_mask(which, self.num_teams)
        if (fresh & self.intent_given).any():
            raise ValueError("the wheel is handed over between turns; alert with step() first")
        new = check_traits(traits, self.num_teams).as_array()
        self.traits = Traits.from_array(np.where(fresh[:, None], new, self.traits.as_array()))
        self.attention = Attention.initial(self.num_teams).where(fresh, self.attention)
        self.world.perceive(self.traits.inflation, fresh)

    def turn(self, driver: Actor, hmi: Actor, sequential: bool = True) -> StepResult:
        """Take one step of every team, each seat in its turn.

        Args:
            driver: a^H_t, or a function from the driver's observations to them.
            hmi: a^A_t, or a function from the vehicle AI's observations to them.
            sequential: whether the vehicle AI is asked after the driver and so sees a^H_t. If
                not, it is asked first and sees a^H_{t-1}.

        Raises:
            ValueError, TypeError: as :meth:`intend` and :meth:`step`. Whatever the vehicle AI's
                function raises leaves every team as it was before the turn.
        """
        if not sequential:
            alerts = self._ask(VEHICLE_AI, hmi)
            self.intend(self._ask(DRIVER, driver))
            return self.step(alerts)
        self.intend(self._ask(DRIVER, driver))
        try:
            alerts = self._ask(VEHICLE_AI, hmi)
        except Exception:
            self.withdraw()
            raise
        return self.step(alerts)

    def _ask(self, agent: str, actor: Actor) -> ArrayLike:
        return actor(self.observe(agent)) if callable(actor) else actor

    def intend(self, driver_actions: ArrayLike, which: NDArray[np.bool_] | None = None) -> None:
        """Set the drivers' a^H_t, shape (N,), integers 0 to 4.

        Args:
            driver_actions: a^H_t; those of ended and of unmarked teams are not read.
            which: the teams in which the driver acts now, shape (N,), bool; all by default.

        Raises:
            ValueError: an action out of range, or a second intent in the same step.
        """
        acts = check_mask(which, self.num_teams) & ~self.over
        if (acts & self.intent_given).any():
            raise ValueError("the drivers have already acted in this step; now alert with step()")
        actions = self._checked(driver_actions, len(VEHICLE_ACTIONS), "driver", acts)
        self.previous_intended = np.where(acts, self.intended, self.previous_intended)
        self.intended = np.where(acts, actions, self.intended)
        self.intent_given = self.intent_given | acts

    def withdraw(self) -> None:
        """Take back every a^H_t of the present turns, as if :meth:`intend` had not been called."""
        self.intended = np.where(self.intent_given, self.previous_intended, self.intended)
        self.intent_given = np.zeros(self.num_teams, np.bool_)

    def step(self, alerts: ArrayLike) -> StepResult:
        """Take the step with the HMIs' a^A_t: attention, then the world, then rewards.

        Ended teams stay as they are and get zeros.

        Args:
            alerts: a^A_t, shape (N,), integers: 0 or 1 with the paper's alerts, 0 to k with k
                strengths.

        Raises:
            ValueError: an action out of range, or no :meth:`intend` before.
        """
        config, active, before = self.config, ~self.over, self.attention
        if not self.intent_given[active].all():
            raise ValueError("the driver acts first: call intend() with the driver's action")
        alerts = self._checked(alerts, self.alerts.choices, "vehicle_ai", active)
        self.intent_given = np.zeros(self.num_teams, np.bool_)
        draws = uniform(self.seeds, Stream.ATTENTION, self.steps.astype(np.uint64))
        window = config.alert_window
        after = attention_model.step(before, alerts, self.traits, window, draws, self.alerts)
        self.attention = after.where(active, before)
        keeps = (self.attention.distracted == 1) & (self.applied != NO_ACTION)
        applied = np.where(keeps, self.applied, self.intended)
        self.applied = np.where(active, applied, self.applied)
        self.alerted = np.where(active, alerts, self.alerted)
        self._move_world(active)
        terms = {
            name: np.where(active, values, 0.0)
            for name, values in self._terms(before, alerts).items()
        }
        self.steps = self.steps + active
        terminated = active & self.ego.crashed & config.end_at_crash
        truncated = active & ~terminated & (self.steps >= config.horizon)
        self.over = self.over | terminated | truncated
        rewards = dict(zip((DRIVER, VEHICLE_AI), share(terms, config.reward), strict=True))
        return StepResult(rewards, terms, terminated, truncated)

    def _move_world(self, active: NDArray[np.bool_]) -> None:
        standing = self.ego.crashed
        newly_standing = active & standing & (self.ego.speed != 0.0)
        if newly_standing.any():
            self.world.halt(newly_standing)
        self.world.step(self.applied, active & ~standing)
        self.ego = self.world.ego()

    def _terms(
        self, before: Attention, alerts: NDArray[np.int64]
    ) -> dict[str, NDArray[np.float64]]:
        weights, ego = self.config.weights, self.ego
        driving = driving_terms(
            weights,
            crashed=ego.crashed,
            speed=ego.speed,
            in_right_lane=ego.lane == self.config.scene.lanes - 1,
            merging_slowness=ego.merging_slowness,
            changes_lane=np.isin(self.intended, _LANE_CHANGES),
        )
        return driving | attention_terms(
            weights,
            alert=self.alerts.strength(alerts),
            distracted_before=before.distracted,
            distracted=self.attention.distracted,
        )

    def observe(self, agent: str) -> NDArray[np.float32]:
        """Return the agent's observations, shape (N, layout's size); see :mod:`observations`."""
        parts = self._common_parts()
        parts["lidar"] = self._lidar(inflated=agent == DRIVER)
        return self.layouts[agent].join(parts)

    def state(self) -> NDArray[np.float32]:
        """Return the whole team's state, shape (N, state_layout.size), for centralised critics."""
        parts = self._common_parts()
        parts["lidar"] = self._lidar(inflated=False)
        parts["perceived_lidar"] = self._lidar(inflated=True)
        return self.state_layout.join(parts)

    def time_headway(self) -> NDArray[np.float64]:
        """Time to the next object ahead in the lane [s], shape (N,); inf if none, or at 0 m/s."""
        moving = self.ego.speed > 0
        speed = np.where(moving, self.ego.speed, 1.0)
        return np.where(moving, np.maximum(self.ego.gap, 0.0) / speed, np.inf)

    def _lidar(self, inflated: bool) -> NDArray[np.float32]:
        return obs.lidar_part(self.world.lidar(inflated), self.config.scene)

    def _common_parts(self) -> dict[str, NDArray[Any]]:
        actions, now = len(VEHICLE_ACTIONS), self.attention
        # Before intend() the latest a^H already is the last step's.
        previous = np.where(self.intent_given, self.previous_intended, self.intended)
        return obs.motion_parts(self.ego, self.config.scene) | {
            "intended_action": obs.one_hot(self.intended, actions),
            "previous_intended_action": obs.one_hot(previous, actions),
            "applied_action": obs.one_hot(self.applied, actions),
            "alerted": self.alerts.strength(self.alerted)[:, None],
            "time": self.steps[:, None] / self.config.horizon,
            "distracted": now.distracted[:, None],
            "accepted": self.alerts.strength(now.accepted)[:, None],
            "counter": now.counter[:, None] / self.config.alert_window,
            "fatigue": now.fatigue[:, None] / max(1, self.alerts.levels),
            "traits": obs.traits_part(self.traits),
        }

    def _checked_seeds(self, seeds: ArrayLike, fresh: NDArray[np.bool_]) -> NDArray[np.uint64]:
        given = np.asarray(seeds)
        if given.shape != (self.num_teams,):
            raise ValueError(f"seeds have shape ({self.num_teams},), not {given.shape}")
        if not np.issubdtype(given.dtype, np.integer):
            raise TypeError(f"seeds are integers, best an array of uint64, but got {given.dtype}")
        if (given[fresh] < 0).any():
            raise ValueError(f"a seed lies in [0, 2^64), but got {given[fresh].min()}")
        return given.astype(np.uint64)

    def _checked(
        self, actions: ArrayLike, count: int, agent: str, acts: NDArray[np.bool_]
    ) -> NDArray[np.int64]:
        given = np.asarray(actions)
        if given.shape != (self.num_teams,):
            raise ValueError(
                f"{agent} actions have shape ({self.num_teams},), but got {given.shape}"
            )
        if not np.issubdtype(given.dtype, np.integer):
            raise TypeError(f"{agent} actions are integers, but got {given.dtype}")
        wrong = acts & ((given < 0) | (given >= count))
        if wrong.any():
            raise ValueError(
                f"{agent} action {given[wrong][0]} is out of range: it is one of 0 to {count - 1}"
            )
        return np.where(acts, given, 0).astype(np.int64)


def check_mask(which: NDArray[np.bool_] | None, count: int) -> NDArray[np.bool_]:
    """Return the marks of teams, bool, shape (count,): all by default; or raise ValueError."""
    mask = np.ones(count, np.bool_) if which is None else np.asarray(which)
    if mask.shape != (count,) or mask.dtype != np.bool_:
        raise ValueError(
            f"which= marks teams by bools of shape ({count},), but got {mask.dtype} of shape "
            f"{mask.shape}"
        )
    return mask


def _fitting(world: str | World, config: TeamConfig, num_teams: int) -> World:
    if isinstance(world, str):
        return make_world(world, config.scene, num_teams)
    if not (hasattr(world, "scene") and hasattr(world, "num_worlds")):
        raise TypeError(f"world= takes a world's name or a World, not {world!r}")
    if world.num_worlds != num_teams:
        raise ValueError(f"num_teams = {num_teams}, but the world has {world.num_worlds} scenes")
    if world.scene != config.scene:
        raise ValueError(
            f"the world's scene is not the team's; make it with config.scene, {config.scene}"
        )
    return world
