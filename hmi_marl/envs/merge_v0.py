"""# merge_v0: a distractible driver and the HMI that may alert them

| Agents | `driver`, `vehicle_ai` |
| --- | --- |
| Actions | `Discrete(5)`, `Discrete(2)` (k + 1 with k strengths of alert) |
| Observations | flat `Box`, float32, one for each seat |
| State | flat `Box`, float32, for centralised critics |
| Import | `from hmi_marl import merge_v0` |

HMIway-env of "Learning Latent Traits for Simulated Cooperative Driving Tasks": a human driver
steers a car past a highway merge among other vehicles, and may be distracted; the vehicle's AI
may alert them. `env()` is the PettingZoo AEC environment, in which the two move sequentially and
the AI sees what the driver is about to do, π(a^A | a^H, s, z). `parallel_env()` lets both move at
the same time; the AI then sees the driver's *last* action. It is written natively, since
PettingZoo's conversion would hide a^H from the AI (and `is_parallelizable` is therefore False).

## Actions

`driver`, a^H: 0 move_left, 1 keep_speed, 2 move_right, 3 speed_up, 4 slow_down (highway-env's
LANE_LEFT, IDLE, LANE_RIGHT, FASTER, SLOWER). `vehicle_ai`, a^A: 0 no_alert, 1 alert; with
`alert_strengths` s_1 < ... < s_k, j is an alert of strength s_j.

## One step

1. `driver` acts, then `vehicle_ai`.
2. The counter c, the acceptance i and the distraction d are updated, in this order. An alert is
   in effect for `alert_window` steps, in which becoming distracted is less likely by η and
   becoming attentive more likely by η. An alert of strength s helps by η s, and a weaker one
   does not undo a stronger one. With `fatigue`, alerts that pile up help less, and the level of
   fatigue f is updated last (`hmi_marl.envs.alerts`).
3. The applied action is v_t = v_{t-1} if d_t = 1, else a^H_t; v_0 = a^H_0.
4. The world moves by one policy step (1/5 s in three simulator steps).
5. Both agents get their rewards.

An episode is truncated after `duration` (20 s, 100 steps) and terminated by a crash, for both
agents at once; each gets the rewards of the last step.

## Observations

Ask for a part by name: `env.unwrapped.layout("vehicle_ai")["distracted"]` is its slice, and
`print(env.unwrapped.layout("driver").table())` shows them all. With the defaults:

`driver` (52): `lidar` 16 x (distance, relative radial speed) as perceived with inflated
obstacles, `speed`, `target_speed`, `heading`, `lateral`, `lane` (one-hot), `position`,
`applied_action` (one-hot v_{t-1}), `alerted` (a^A_{t-1}), `time`, `traits` (β, α, η, inflation),
whose columns are also named `beta`, `alpha`, `eta` and `inflation`.

`vehicle_ai` (65): the same with true sizes in `lidar`, and `intended_action` (one-hot; with
sequential moves a^H_t, with simultaneous moves a^H_{t-1}), `previous_intended_action` (a^H_{t-1}),
and, with `ai_sees_attention`, `distracted`, `accepted`, `counter` (d, i, c of the last step). With
graded alerts `alerted` and `accepted` are strengths, 0 for none; with `fatigue`, `fatigue` (f over
its levels) follows `counter`.

`state()`: both lidars and everything that either seat could see, attention and traits included.

## Rewards

| Term | Value |
| --- | --- |
| `collision` | -5 if crashed |
| `speed_reward` | 5 speed / 30 m/s |
| `right_lane` | 0.1 in the rightmost main lane |
| `merging` | -0.1 Σ (target - current) / target speed over vehicles in the merging lane |
| `lane_change` | -0.1 if a^H is a lane change |
| `distraction` | -10 if d_t = 1 |
| `alert` | 10 if no alert and d_{t-1} = 0; 10 (1 - s) if an alert of strength s |
| `accept_alert` | 30 if alert, d_{t-1} = 1 and d_t = 0 |

`info` of both agents carries each term, `distracted`, `accepted`, `counter`, `applied_action`,
`crashed`, `speed`, `time_headway` and the driver's traits: the truth, for evaluation. Of alerts of
other strengths than 1 also `strength` (in effect), with `fatigue` also `fatigue` (the level).

## Arguments

```python
merge_v0.env(
    driver="homer",          # a name, a Driver, a list of them or a Population drawn at each reset
    world="highway",         # highway-env itself; "batched": the same, compiled; or a World
    observe_traits=True,     # both seats see β, α, η, inflation
    ai_sees_attention=True,  # the AI sees d, i, c of the last step
    reward="team",           # or "individual" (driving and distraction to the driver, alert terms
                             # to the AI), "driving" (the five driving terms to both) or
                             # "attention" (the three others to both)
    alert_window=7,          # N, in steps
    alert_strengths=(1.0,),  # of the alerts there are, rising within (0, 1]
    fatigue=None,            # or Fatigue(levels=10, per_alert=2, effect=0.5)
    duration=20.0,           # s
    end_at_crash=True,       # False: the crashed car stands until the time is over
    scene=Scene(),           # lanes, vehicles=(1, 20), lengths, frequencies, lidar
    weights=RewardWeights(),
    render_mode=None,        # or "rgb_array", "human"
)
```

`reset(seed=...)` starts an episode that is a pure function of the seed (and of the actions);
`reset()` without one goes on to the next episode of the same series.

## Version history

* v0: first version.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from numpy.typing import NDArray
from pettingzoo import AECEnv, ParallelEnv
from pettingzoo.utils import wrappers

from hmi_marl.envs.config import AGENTS, DRIVER, VEHICLE_AI, TeamConfig, takes_team_settings
from hmi_marl.envs.observations import Layout
from hmi_marl.envs.single import RENDER_MODES, Pictured, SingleTeam, team_info
from hmi_marl.envs.worlds import World

_OVER = "the episode is over: call reset() before stepping again"


class _InOrder(wrappers.OrderEnforcingWrapper):  # type: ignore[misc]
    """PettingZoo's checks on the order of calls, with an error where it would only log one."""

    def step(self, action: int | None) -> None:
        """The selected agent's action; None when its episode is over."""
        if self._has_reset and not self.agents:
            raise RuntimeError(_OVER)
        super().step(action)


@takes_team_settings
def env(
    *, world: str | World = "highway", render_mode: str | None = None, **settings: Any
) -> AECEnv[str, NDArray[np.float32], int]:
    """The AEC environment, with PettingZoo's checks on the order of calls.

    For keywords see the module's documentation.
    """
    return _InOrder(raw_env(world=world, render_mode=render_mode, **settings))


class _TwoSeats(Pictured):
    """Spaces, layouts and state of both PettingZoo interfaces."""

    metadata: dict[str, Any] = {  # noqa: RUF012 (PettingZoo's habit)
        "name": "merge_v0",
        "render_modes": list(RENDER_MODES),
        "render_fps": 5,
    }
    possible_agents: list[str]

    def __init__(
        self, world: str | World, render_mode: str | None, settings: dict[str, Any]
    ) -> None:
        self.config = TeamConfig(**settings)
        self.team = SingleTeam(self.config, world, render_mode)
        self.render_mode = render_mode
        self.metadata = self.metadata | {"render_fps": self.config.scene.policy_frequency}
        self.possible_agents = list(AGENTS)
        self.agents: list[str] = []
        self.observation_spaces = {
            agent: layout.space() for agent, layout in self.team.teaming.layouts.items()
        }
        self.action_spaces = self.team.action_spaces
        self.state_space = self.team.teaming.state_layout.space()
        self._begun = False
        self._np_random: np.random.Generator | None = None

    @property
    def np_random(self) -> np.random.Generator:
        """Random numbers for wrappers, such as SuperSuit's; seeded by ``reset(seed=...)``.

        The environment itself draws nothing from it.
        """
        if self._np_random is None:
            self._np_random, _ = seeding.np_random()
        return self._np_random

    @np_random.setter
    def np_random(self, generator: np.random.Generator) -> None:
        self._np_random = generator

    def observation_space(self, agent: str) -> spaces.Box:
        """The same space object at each call."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Discrete:
        """The same space object at each call."""
        return self.action_spaces[agent]

    def layout(self, agent: str) -> Layout:
        """Named columns of this agent's observation."""
        return self.team.teaming.layouts[agent]

    @property
    def state_layout(self) -> Layout:
        """Named columns of :meth:`state`."""
        return self.team.teaming.state_layout

    def state(self) -> NDArray[np.float32]:
        """The whole team's state."""
        self._need_reset()
        return self.team.teaming.state()[0]

    def _begin(self, seed: int | None) -> None:
        self.team.reset(seed)
        if seed is not None:
            self._np_random, _ = seeding.np_random(int(seed))
        self._begun = True

    def _need_reset(self) -> None:
        if not self._begun:
            raise RuntimeError("no episode has begun: call reset() first")

    def _infos(self) -> dict[str, dict[str, Any]]:
        return {agent: team_info(self.team.teaming, self.team.result) for agent in AGENTS}


class raw_env(_TwoSeats, AECEnv[str, NDArray[np.float32], int]):  # type: ignore[misc]  # noqa: N801 (PettingZoo's name)
    """Sequential moves, without PettingZoo's wrapper. Keywords as for :func:`env`."""

    metadata = _TwoSeats.metadata | {"is_parallelizable": False}

    @takes_team_settings
    def __init__(
        self, *, world: str | World = "highway", render_mode: str | None = None, **settings: Any
    ) -> None:
        AECEnv.__init__(self)
        _TwoSeats.__init__(self, world, render_mode, settings)

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> None:
        """Begin the episode of this seed, or the next one; ``options`` are not used."""
        self._begin(seed)
        self.agents = list(AGENTS)
        self.agent_selection = DRIVER
        self._skip_agent_selection = None
        self.rewards: dict[str, float] = dict.fromkeys(AGENTS, 0.0)
        self._cumulative_rewards = dict.fromkeys(AGENTS, 0.0)
        self.terminations = dict.fromkeys(AGENTS, False)
        self.truncations = dict.fromkeys(AGENTS, False)
        self.infos = self._infos()

    def observe(self, agent: str) -> NDArray[np.float32]:
        """Return this agent's observation."""
        self._need_reset()
        return self.team.teaming.observe(agent)[0]

    def step(self, action: int | None) -> None:
        """The selected agent's action; None when its episode is over."""
        self._need_reset()
        if not self.agents:
            raise RuntimeError(_OVER)
        agent = self.agent_selection
        if self.terminations[agent] or self.truncations[agent]:
            self._was_dead_step(action)
            return
        action = self.team.check(agent, action)  # before anything changes
        self._cumulative_rewards[agent] = 0.0
        if agent == DRIVER:
            self.team.teaming.intend([action])
            self._clear_rewards()
            self.agent_selection = VEHICLE_AI
            return
        self.team.result = result = self.team.teaming.step([action])
        for name in AGENTS:
            self.rewards[name] = float(result.rewards[name][0])
            self.terminations[name] = bool(result.terminated[0])
            self.truncations[name] = bool(result.truncated[0])
        self.infos = self._infos()
        self.agent_selection = DRIVER
        self._accumulate_rewards()
        self.team.show()


class parallel_env(_TwoSeats, ParallelEnv[str, NDArray[np.float32], int]):  # type: ignore[misc]  # noqa: N801 (PettingZoo's name)
    """Simultaneous moves: the AI sees a^H of the last step. Keywords as for :func:`env`."""

    @takes_team_settings
    def __init__(
        self, *, world: str | World = "highway", render_mode: str | None = None, **settings: Any
    ) -> None:
        _TwoSeats.__init__(self, world, render_mode, settings)

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, NDArray[np.float32]], dict[str, dict[str, Any]]]:
        """Begin the episode of this seed, or the next one; ``options`` are not used."""
        self._begin(seed)
        self.agents = list(AGENTS)
        return self._observations(), self._infos()

    def step(
        self, actions: dict[str, int]
    ) -> tuple[
        dict[str, NDArray[np.float32]],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """One step of the team, from both agents' actions.

        After the end no agent is left to act, and no actions give five empty dicts.
        """
        self._need_reset()
        if not self.agents:
            if actions:
                raise RuntimeError(_OVER)
            return {}, {}, {}, {}, {}
        if set(actions) != set(AGENTS):
            raise ValueError(f"actions are needed for {AGENTS}, but got {tuple(actions)}")
        alert = self.team.check(VEHICLE_AI, actions[VEHICLE_AI])
        intent = self.team.check(DRIVER, actions[DRIVER])
        self.team.result = result = self.team.teaming.turn([intent], [alert])
        self.team.show()
        rewards = {agent: float(result.rewards[agent][0]) for agent in AGENTS}
        terminations = dict.fromkeys(AGENTS, bool(result.terminated[0]))
        truncations = dict.fromkeys(AGENTS, bool(result.truncated[0]))
        if result.terminated[0] or result.truncated[0]:
            self.agents = []
        return self._observations(), rewards, terminations, truncations, self._infos()

    def _observations(self) -> dict[str, NDArray[np.float32]]:
        return {agent: self.team.teaming.observe(agent)[0] for agent in AGENTS}
