"""Teams that take their steps in one of three ways, and everything that they show."""

import numpy as np

from hmi_marl.envs.alerts import Fatigue
from hmi_marl.envs.drivers import TraitDistributions
from hmi_marl.envs.execution import InNumPy
from hmi_marl.envs.loops import InLoops, InOneLoop
from hmi_marl.envs.rewards import RewardWeights
from hmi_marl.envs.step_result import Then
from hmi_marl.envs.team_arrays import Rules
from hmi_marl.envs.team_step import SUMS
from hmi_marl.envs.teaming import Teaming
from hmi_marl.envs.worlds.batched import BatchedWorld

WAYS = (InNumPy, InLoops, InOneLoop)
CONFIGS = {
    "paper": {"driver": ["lisa", "homer"]},
    "graded": {
        "driver": TraitDistributions(),
        "alert_strengths": (0.25, 0.5, 1.0),
        "fatigue": Fatigue(),
        "reward": "individual",
    },
    "hidden": {
        "driver": "bart",
        "ai_sees_attention": False,
        "observe_traits": False,
        "end_at_crash": False,
        "alert_window": 1,
        "weights": RewardWeights(speed_reward=-0.3, merging=0.7, collision=-1.5, alert=-2.0),
    },
}
VIEWS = ("driver", "vehicle_ai", "state", "traits")


def room_of(teams, names=VIEWS):
    """Room for observations, all rewards and the ends of a step."""
    room = teams.room(names, tuple(range(SUMS)))
    for array in (*(group.rows for group in room.groups.values()), *room.scores[1:]):
        array.fill(1 if array.dtype == bool else -9)
    return room


class Plain:
    """A batched world that shows the methods of World alone, as a world of one's own has them."""

    def __init__(self, world):
        self.scene, self.num_worlds = world.scene, world.num_worlds
        for name in ("reset", "step", "halt", "perceive", "ego", "lidar", "snapshot"):
            setattr(self, name, getattr(world, name))


def teams_of(kind, config, count):
    world = BatchedWorld(config.scene, count, 1)
    teams = Teaming(config, count, world if kind is InOneLoop else Plain(world))
    teams._execution = kind(teams.world, Rules.of(config))
    return teams


def play(teams, steps, seed, series=None):
    """Everything that teams show in some steps of random actions, as a list of arrays."""
    rng = np.random.default_rng(seed)
    shown = []
    then = None if series is None else Then(series, VIEWS)
    for step in range(steps):
        shown += teams.views(VIEWS).values()
        some = rng.random(teams.num_teams) < 0.5
        actions = rng.integers(0, 5, teams.num_teams)
        alerts = rng.integers(0, teams.alerts.choices, teams.num_teams)
        if step % 3 == 2:  # both seats at once
            room = room_of(teams)
            result = teams.turn(actions, alerts, views=room, then=then)
            shown += room.scores
        else:
            for which in (some, ~some):
                teams.intend(actions, which)
                shown += teams.views(VIEWS).values()
            result = teams.step(alerts, VIEWS, then)
        shown += [result.table, result.ends, *result.views.values()]
        if result.ended_teams is not None:
            ended = result.ended_teams
            shown += [ended.teams, ended.totals, *ended.views.values()]
        shown += [teams.seeds, teams.over, teams.steps, teams.traits.as_array(), teams.ego.x]
        if series is None and step % 7 == 3:
            teams.reset(teams.seeds + np.uint64(50), teams.over)
        if step == 9:
            teams.hand_over(teams.traits, teams.steps > 4)
    return shown
