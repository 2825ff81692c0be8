"""Arguments of the loops: always of the same types, so that a call need not look at them."""

import pickle
from copy import deepcopy

import numba
import numpy as np
import pytest
import torch
from step_ways import CONFIGS, InOneLoop, play, teams_of

import hmi_marl
from hmi_marl.envs import loops
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.scene import Scene
from hmi_marl.envs.series import Series

seen: dict[str, tuple[object, ...]] = {}
"""Types of each loop's arguments, in all tests."""


def types_of(arguments):
    """Types as numba has them, and whether arrays lie where their type says."""

    def aligned(value):
        if isinstance(value, tuple):
            return all(map(aligned, value))
        return not isinstance(value, np.ndarray) or value.flags.aligned

    assert aligned(arguments)
    return tuple(map(numba.typeof, arguments))


@pytest.fixture(autouse=True)
def same_types(monkeypatch):
    ready = loops.ready
    names = set()

    def checked(loop, *arguments):
        names.add(loop.__name__)
        types = types_of(arguments)
        assert seen.setdefault(loop.__name__, types) == types
        return ready(loop, *arguments)

    monkeypatch.setattr(loops, "ready", checked)
    return names


def usual():
    """Take steps whose arguments are as they are everywhere."""
    config = TeamConfig(driver=["lisa", "homer"], duration=1.0, scene=Scene(vehicles=2))
    teams = teams_of(InOneLoop, config, 3)
    seeds = np.arange(3, dtype=np.uint64)
    teams.reset(seeds)
    series = Series(seeds, config.population)
    play(teams, 6, 0, series)
    return teams, series


def test_these_are_the_loops_that_are_called_so(same_types):
    usual()
    assert same_types == {"enter_actions", "step_teams", "look_and_write_teams"}


def test_after_copies():
    teams, series = usual()
    for copy in (pickle.loads(pickle.dumps((teams, series))), deepcopy((teams, series))):
        play(copy[0], 6, 0, copy[1])


@pytest.mark.parametrize("with_series", [False, True])
@pytest.mark.parametrize("count", [1, 2, 21])
@pytest.mark.parametrize("name", CONFIGS)
def test_of_any_settings_and_number_of_teams(name, count, with_series):
    config = TeamConfig(duration=1.0, scene=Scene(vehicles=(2, 5)), **CONFIGS[name])
    teams = teams_of(InOneLoop, config, count)
    seeds = np.arange(count, dtype=np.uint64)
    teams.reset(seeds)
    play(teams, 12, 5, Series(seeds, config.population) if with_series else None)


@pytest.mark.parametrize("count", [1, 3])
@pytest.mark.parametrize(
    ("seat", "partner"),
    [("team", None), ("driver", "random:0.3"), ("vehicle_ai", "rule"), ("driver", "optimal:homer")],
)
def test_of_any_seat(seat, partner, count):
    more = {} if partner is None else {"partner": partner}
    env = hmi_marl.make_vec(count, seat=seat, duration=1.0, **more)
    rng = np.random.default_rng(0)
    for _ in range(12):
        columns = [rng.integers(0, 5 if a == "driver" else 2, count) for a in env.agents]
        env.step(torch.from_numpy(np.stack(columns, axis=1)))


def test_of_actions_as_they_come():
    config = TeamConfig(duration=1.0, scene=Scene(vehicles=2))
    teams = teams_of(InOneLoop, config, 3)
    teams.reset([1, 2, 3])
    strided = np.zeros((3, 2), np.int64)[:, 0]
    odd = np.frombuffer(bytearray(25), np.uint8)[1:].view(np.int64)
    fixed = np.ones(3, np.int64)
    fixed.flags.writeable = False
    for actions in ([1, 1, 1], strided, odd, fixed, np.ones(3, np.uint8), np.ones(3, ">i8")):
        teams.intend(actions, np.ones(6, np.bool_)[::2])
        teams.step(actions)
