"""N teams as an rsl_rl ``VecEnv``, for either seat or for the whole team.

======================  =============================  =========================================
seat                    actions                        turns
======================  =============================  =========================================
``"driver"``            (N, 1): a^H, 0 to 4            the partner alerts inside ``step``, seeing
                                                       this a^H
``"vehicle_ai"``        (N, 1): a^A, 0 or 1 (or to k)  the partner has always driven before the
                                                       observation, which therefore holds a^H_t
                                                       (with ``sequential=False`` it drives at the
                                                       same time: the AI sees a^H_{t-1})
``"team"``              (N, 2): a^H and a^A            simultaneous: the AI sees a^H_{t-1}
======================  =============================  =========================================

Observations are a TensorDict of float32 groups, the same for every seat: ``driver`` and
``vehicle_ai`` (what these seats see), ``traits`` (N, 4) (β, α, η and inflation as they are) and
``critic`` (the team's whole state). :attr:`TeamVecEnv.layouts` names their columns. A trainer that
reads some of them only says so by :attr:`TeamVecEnv.groups`, and the others, with their lidars, are
not computed; :meth:`TeamVecEnv.read` computes one of them when it is needed after all.

A team begins its next episode inside the ``step`` that ends one. ``extras`` of such a step hold
``final_observation``, ``final_teams`` and ``log`` (see :meth:`TeamVecEnv.step`).

Team k plays the series of seed ``team_seed(seed, k)`` (:mod:`hmi_marl.envs.streams`): its e-th
episode has seed ``episode_seed(team_seed(seed, k), e)``, so nothing of it depends on the number of
teams, and environments of different seeds share no episode.

Needs torch, tensordict and rsl_rl (the ``train`` extra).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray
from rsl_rl.env import VecEnv  # type: ignore[import-untyped]
from tensordict import TensorDict

from hmi_marl.checks import Whole, check_choice, check_flag, shown
from hmi_marl.envs.config import DRIVER, VEHICLE_AI
from hmi_marl.envs.execution import WrongActionError
from hmi_marl.envs.groups import (
    CRITIC,
    GROUPS,
    TEAM,
    VIEW,
    Seat,
    check_seat,
    checked_groups,
    whole_steps,
)
from hmi_marl.envs.observations import TRAITS_LAYOUT, Layout
from hmi_marl.envs.rewards import TERMS
from hmi_marl.envs.seats import PartnerTurns, Policy
from hmi_marl.envs.series import Series
from hmi_marl.envs.step_result import EndedTeams, Then
from hmi_marl.envs.streams import check_seed, team_seed
from hmi_marl.envs.team_arrays import Room
from hmi_marl.envs.team_step import ALERTS, CRASHES, LENGTH, OF_BOTH, OF_DRIVER, OF_VEHICLE_AI
from hmi_marl.envs.teaming import TRAITS, Teaming
from hmi_marl.envs.vector_outcome import EpisodeLog, Outcome, groups_of, on_device
from hmi_marl.envs.worlds import VEHICLE_ACTIONS
from hmi_marl.files import json_value

if TYPE_CHECKING:
    from hmi_marl.envs.render import Viewer

_READ_AS_THEY_ARE = {torch.float32, torch.float64, torch.int64}
"""Types of actions that need no conversion."""
_LOGGED = tuple(f"Episode/{name}" for name in ("return", *TERMS, "length", "alerts", "crash_rate"))


class TeamVecEnv(VecEnv):  # type: ignore[misc]  # rsl_rl has no types
    """N teams with one seat or both to be learned.

    Args:
        teaming: the N teams, in any world. Belongs to this environment from now on.
        seat: "driver", "vehicle_ai" or "team" (both).
        partner: the policy in the other seat; None exactly for seat "team".
        seed: team k plays the series of episodes of ``team_seed(seed, k)``.
        device: of the returned tensors. The teams themselves run on the CPU.
        groups: observations to compute in each step; see :attr:`groups`.
        sequential: of seat "vehicle_ai": whether the partner drives before it observes.

    Raises:
        ValueError, TypeError: a seat, partner, seed, group or ``sequential`` that does not fit,
            saying what does.
    """

    def __init__(
        self,
        teaming: Teaming,
        seat: Seat = "team",
        partner: Policy | None = None,
        seed: int = 0,
        device: str | torch.device = "cpu",
        groups: Collection[str] = GROUPS,
        sequential: bool = True,
    ) -> None:
        check_seat(seat, partner)
        if not check_flag("sequential", sequential) and seat != VEHICLE_AI:
            raise ValueError(
                f"sequential=False is for seat='vehicle_ai'; of seat={seat!r} the policies decide"
            )
        self.teaming = teaming
        self.seat = seat
        self.partner = partner
        self.device = torch.device(device)
        self._on_cpu = self.device.type == "cpu"
        self.num_envs = teaming.num_teams
        """N, the number of teams."""
        self.agents = (DRIVER, VEHICLE_AI) if seat == TEAM else (seat,)
        """Agents of the columns of ``step``'s argument."""
        sizes = {DRIVER: len(VEHICLE_ACTIONS), VEHICLE_AI: teaming.alerts.choices}
        self.action_sizes = tuple(sizes[agent] for agent in self.agents)
        """Number of values of each column of actions: (5,), (2,) or (5, 2); with k strengths of
        alert k + 1 in place of 2."""
        self.num_actions = len(self.agents)
        """Columns of actions, 1 or 2."""
        self.max_episode_length = teaming.config.horizon
        """Steps in an episode that nothing cuts short."""
        self.layouts: Mapping[str, Layout] = {
            **teaming.layouts,
            TRAITS: TRAITS_LAYOUT,
            CRITIC: teaming.state_layout,
        }
        """Named columns of each group of observations."""
        self.cfg: dict[str, Any] = {
            "environment": "hmi_marl.TeamVecEnv",
            "seat": seat,
            "partner": None if partner is None else type(partner).__name__,
            "world": type(teaming.world).__name__,
            "num_teams": self.num_envs,
            "seed": check_seed(seed),
            "team": json_value(teaming.config),
        }
        """Description of the environment, fit for JSON; rsl_rl keeps it with the run."""
        self._turns: PartnerTurns | None = None
        if partner is not None:
            self._turns = PartnerTurns(teaming, seat, partner, sequential=sequential)
        self.groups = groups  # checks them
        individual = teaming.config.reward == "individual"
        of_team = OF_BOTH if individual else OF_DRIVER
        column_of = {DRIVER: OF_DRIVER, VEHICLE_AI: OF_VEHICLE_AI, TEAM: of_team}
        self._rewarded = tuple(dict.fromkeys((*self.agents, seat)))
        """Agents and the seat, each with a reward."""
        self._reward_columns = tuple(column_of[each] for each in self._rewarded)
        """Column of the step's table of each reward."""
        columns = (column_of[seat], *range(len(TERMS)), LENGTH, ALERTS, CRASHES)
        self._logged = dict(zip(_LOGGED, columns, strict=True))
        """Columns of totals that are logged, by name."""
        self._viewer: Viewer | None = None
        self._start_series(seed)
        self._untouched = True

    @property
    def unwrapped(self) -> TeamVecEnv:
        """The environment itself."""
        return self

    @property
    def groups(self) -> tuple[str, ...]:
        """Groups of observations that each step computes, in their order; all by default.

        May be assigned at any time. Raises ValueError for none, or a name that is no group's.
        """
        return tuple(self._groups)

    @groups.setter
    def groups(self, groups: Collection[str]) -> None:
        self._groups = {group: VIEW[group] for group in checked_groups(groups)}
        """Name among the teams' views of each."""

    def read(self, group: str) -> torch.Tensor:
        """Return one group of the present observations, also one that is not in :attr:`groups`.

        Shape (N, its layout's size).

        Raises:
            ValueError: there is no such group.
        """
        check_choice("group=", group, GROUPS)
        return self._observed({group: VIEW[group]})[group]

    @property
    def episode_length_buf(self) -> torch.Tensor:
        """Steps that are over in each team's episode, int64 of shape (N,): a copy.

        Assigning moves each team's clock within its present episode: ``time`` in the observations
        and the end of the episode count from the new value. rsl_rl's ``init_at_random_ep_len``
        does so once to spread the ends of episodes. Seeds stay as they are, but since the draws
        of attention belong to the clock's steps, an episode that was moved is not the one that
        its seed gives otherwise. Statistics count the steps really taken.

        Raises:
            ValueError, TypeError: on assigning anything but a tensor of this shape that holds
                whole numbers from 0 to horizon - 1.
        """
        return torch.from_numpy(self.teaming.steps).to(self.device)

    @episode_length_buf.setter
    def episode_length_buf(self, steps: torch.Tensor) -> None:
        if not isinstance(steps, torch.Tensor):
            raise TypeError(f"episode lengths are a torch tensor, not {shown(steps)}")
        values = steps.detach().cpu().numpy()
        self.teaming.steps = whole_steps(values, self.num_envs, self.max_episode_length - 1)
        self._untouched = False

    def reset(
        self, seed: int | None = None, first_team: int = 0
    ) -> tuple[TensorDict, dict[str, Any]]:
        """Begin an episode in every team at once.

        Args:
            seed: starts every team's series anew, team k's from ``team_seed(seed, k)``. Without it
                each team goes on to its next episode; the first call after making the environment
                stays at the first.
            first_team: number of the first team in the batch of that seed, of which these teams are
                a part.

        Returns:
            The observations, and ``extras``, which are empty.
        """
        if seed is not None:
            self._start_series(seed, first_team)
        elif not self._untouched:
            self._series.go_on(np.arange(self.num_envs))
            self._begin()
        self._untouched = False
        return self.get_observations(), {}

    def get_observations(self) -> TensorDict:
        """Return the present observations, groups of shape (N, their layout's size): a copy."""
        return self._observed(self._groups)

    def step(
        self, actions: torch.Tensor
    ) -> tuple[TensorDict, torch.Tensor, torch.Tensor, dict[str, Any]]:
        """Take one step of every team; teams at the end of their episode begin the next.

        Args:
            actions: indices of shape (N, num_actions), any integer type, or floats that hold
                whole numbers, as rsl_rl stores them.

        Returns:
            observations: of the new episode where the old one ended.
            rewards: float32 of shape (N,), of the seat. Seat "team" gets what both seats get, or
                the sum of the two if rewards are "individual".
            dones: int64 of shape (N,), 1 where an episode ended.
            extras: ``time_outs``, bool of shape (N,): the episode ended by its time alone. With
                seat "team" also ``rewards``, what each agent gets by name, float32 of shape (N,)
                (policies that learn at the same time need them apart). And if
                E > 0 episodes ended: ``final_teams``, int64 of shape (E,), their teams;
                ``final_observation``, what these saw last, batch size (E,), row by row as in
                ``final_teams``; ``log``, for rsl_rl's logger, float32 tensors of shape (E,) on
                the CPU, a value for each episode that ended, so that means over several steps
                weigh every episode alike: ``Episode/return`` (of the seat), ``Episode/<term>``
                (sums of the reward terms), ``Episode/length`` (steps), ``Episode/crash_rate``
                (0 or 1) and ``Episode/alerts``.

        Raises:
            ValueError: actions of another shape or type, out of range, NaN or not whole. Nothing
                has moved then.
        """
        columns = self._checked(actions)
        self._untouched = False
        room = self._room(self._groups, self._reward_columns)
        outcome = Outcome(room, self._groups, self._rewarded)
        then = Then(self._series, tuple(room.groups))
        if self._turns is None:
            result = self.teaming.turn(columns[0], columns[1], False, room, then)
        else:  # a partner who drives acts before anything is observed
            wanted = room.without_views() if self.seat == VEHICLE_AI else room
            result = self._turns.step(columns[0], wanted, then)
        extras: dict[str, Any] = {"time_outs": outcome.time_outs}
        if self.seat == TEAM:
            extras["rewards"] = {agent: outcome.rewards[agent] for agent in self.agents}
        if result.ended_teams is not None:
            extras |= self._extras_of(result.ended_teams)
            if self._turns is not None:
                self._turns.begin(self.teaming.seeds, result.ended.copy())
        if self.seat == VEHICLE_AI:
            self._prepare()
            self.teaming.views(room)
        returned = outcome.observations, outcome.rewards[self.seat], outcome.dones, extras
        return returned if self._on_cpu else on_device(returned, self.device)

    def picture(self, team: int = 0) -> NDArray[np.uint8]:
        """Picture of one of the teams, shape (height, width, 3)."""
        team = Whole(0, self.num_envs - 1)("team", team)
        from hmi_marl.envs.render import Viewer, team_status  # pulls in pygame

        if self._viewer is None:
            self._viewer = Viewer(self.teaming.config)
        return self._viewer.draw(self.teaming.world.snapshot(team), team_status(self.teaming, team))

    def __getstate__(self) -> dict[str, Any]:
        """Return all but the viewer, whose pictures cannot be copied."""
        return self.__dict__ | {"_viewer": None}

    def close(self) -> None:
        """Close the viewer that pictures were drawn with."""
        if self._viewer is not None:
            self._viewer.close()
            self._viewer = None

    def _start_series(self, seed: int, first_team: int = 0) -> None:
        series = team_seed(check_seed(seed), check_seed(first_team) + np.arange(self.num_envs))
        self._series = Series(series, self.teaming.config.population)
        self._begin()

    def _begin(self) -> None:
        """Begin the present episodes of the series."""
        self.teaming.reset(self._series.present)
        if self._turns is not None:
            self._turns.begin(self.teaming.seeds)
        self._prepare()

    def _prepare(self) -> None:
        """Let a partner who drives first act."""
        if self._turns is not None:
            self._turns.prepare()

    def _observed(self, groups: Mapping[str, str]) -> TensorDict:
        """The present observations, of groups with these names among the teams' views."""
        self._prepare()
        room = self._room(groups)
        outcome = Outcome(room, groups, ())
        self.teaming.views(room)
        return on_device(outcome.observations, self.device)

    def _room(self, groups: Mapping[str, str], columns: tuple[int, ...] = ()) -> Room:
        return self.teaming.room(tuple(groups.values()), columns)

    def _extras_of(self, ended: EndedTeams) -> dict[str, Any]:
        """``extras`` about the episodes that ended."""
        last = {group: ended.views[name] for group, name in self._groups.items()}
        return {
            "final_teams": torch.from_numpy(ended.teams),
            "final_observation": groups_of(last, len(ended.teams)),
            "log": EpisodeLog(ended.totals, self._logged),
        }

    def _checked(self, actions: torch.Tensor) -> NDArray[np.int64]:
        """The columns of actions as int64, or an error that says what is wrong."""
        if not isinstance(actions, torch.Tensor):
            raise TypeError(f"actions are a torch tensor, not {type(actions).__name__}")
        wanted = (self.num_envs, self.num_actions)
        if actions.shape != wanted:
            raise ValueError(
                f"actions of seat {self.seat!r} have shape {wanted}, a column each for "
                f"{' and '.join(self.agents)}, but got {tuple(actions.shape)}"
            )
        if actions.dtype not in _READ_AS_THEY_ARE:
            if actions.dtype == torch.bool or actions.is_complex():
                raise ValueError(f"actions are whole numbers, but got {actions.dtype}")
            actions = actions.to(torch.float64 if actions.is_floating_point() else torch.int64)
        try:
            return self.teaming.whole_actions(_as_array(actions), self.action_sizes)
        except WrongActionError as wrong:
            raise ValueError(
                f"action {wrong.value} of {self.agents[wrong.column]} in team {wrong.team} is not "
                f"a whole number from 0 to {self.action_sizes[wrong.column] - 1}"
            ) from None


def _as_array(actions: torch.Tensor) -> NDArray[Any]:
    """Actions on the CPU, without a copy where they are there already."""
    elsewhere = actions.device.type != "cpu"
    return actions.numpy(force=elsewhere or actions.requires_grad or actions.is_neg())
