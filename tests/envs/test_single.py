"""Actions of one team, through each interface that takes them one by one."""

import math
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import spaces
from numpy.typing import NDArray

from hmi_marl import Scene, merge_v0
from hmi_marl.envs.single import SingleTeam, action_index, as_scalar

SMALL = {"scene": Scene(vehicles=2), "duration": 3.0}
INTEGERS = (int, np.int8, np.int32, np.int64, np.intp, np.uint8, np.uint32)
HUGE = 2**70
TAKEN = [
    True,
    *(kind(1) for kind in INTEGERS),
    *(np.array(1, kind) for kind in INTEGERS),
    *(torch.tensor(1, dtype=kind) for kind in (torch.bool, torch.uint8, torch.int64)),
]
REFUSED = [
    *(5, -1, HUGE, np.int64(5), np.array(-1), torch.tensor(5)),
    *(1.0, 1.5, math.nan, "left", "1", None, 1j, {}),
    *([1], [1, 2], (1,), np.array([1]), np.array([[1]]), torch.tensor([1]), torch.ones(1, 1)),
    *(np.True_, np.array(True), np.float64(1.0), np.array(1.0), torch.tensor(1.0)),
    *(np.datetime64("2020"), np.array("1"), np.array(None)),
]


def name(action: object) -> str:
    return f"{type(action).__name__}-{action!r}"


class Interface(NamedTuple):
    """One agent's actions through one interface."""

    name: str
    agent: str
    begin: Callable[[], Any]
    act: Callable[[Any], Any]
    team: SingleTeam


def interfaces() -> Iterator[Interface]:
    for agent in ("driver", "vehicle_ai"):
        for make in (merge_v0.env, merge_v0.raw_env):
            aec = make(**SMALL)

            def begin(aec: Any = aec, agent: str = agent) -> None:
                aec.reset(seed=0)
                if agent == "vehicle_ai":
                    aec.step(1)

            yield Interface(make.__name__, agent, begin, aec.step, aec.unwrapped.team)
        at_once = merge_v0.parallel_env(**SMALL)
        yield Interface(
            "parallel_env",
            agent,
            lambda env=at_once: env.reset(seed=0),
            lambda action, env=at_once, agent=agent: env.step(
                {"driver": 1, "vehicle_ai": 1} | {agent: action}
            ),
            at_once.team,
        )
        seat = {"driver": "MergeDriver", "vehicle_ai": "MergeHMI"}[agent]
        one = gymnasium.make(f"hmi_marl/{seat}-v0", **SMALL)
        yield Interface(
            seat, agent, lambda env=one: env.reset(seed=0), one.step, one.unwrapped.team
        )


INTERFACES = list(interfaces())


def state(interface: Interface) -> NDArray[np.float32]:
    teaming = interface.team.teaming
    return np.concatenate([teaming.state()[0], teaming.intent_given, teaming.steps])


@pytest.mark.parametrize("interface", INTERFACES, ids=lambda each: f"{each.name}-{each.agent}")
@pytest.mark.parametrize("action", TAKEN, ids=name)
def test_what_the_space_contains_is_taken(interface: Interface, action: Any) -> None:
    after = []
    for one in (1, action, 0):
        interface.begin()
        interface.act(one)
        after.append(state(interface))
    np.testing.assert_array_equal(after[0], after[1])
    assert (after[1] != after[2]).any(), "it is action 1"


@pytest.mark.parametrize("interface", INTERFACES, ids=lambda each: f"{each.name}-{each.agent}")
@pytest.mark.parametrize("action", REFUSED, ids=name)
def test_what_the_space_does_not_contain_is_refused_and_nothing_has_moved(
    interface: Interface, action: Any
) -> None:
    interface.begin()
    before = state(interface)
    refused = rf"action (.* )?of {interface.agent} is (an integer, 0 to|out of range)"
    for _ in range(2):
        with pytest.raises(ValueError, match=refused):
            interface.act(action)
        np.testing.assert_array_equal(state(interface), before)
    interface.act(1)


@pytest.mark.parametrize("action", TAKEN + REFUSED, ids=name)
def test_what_is_taken_is_what_the_space_contains_and_tensors(action: Any) -> None:
    space = spaces.Discrete(5)
    taken = any(action is one for one in TAKEN)
    if not isinstance(action, torch.Tensor) and action is not HUGE:  # too much for some Gymnasiums
        assert space.contains(action) == taken
    if taken:
        index = action_index(action, space, "driver")
        assert index == 1
        assert type(index) is int


def test_only_what_has_no_dimension_becomes_a_number() -> None:
    assert type(as_scalar(True)) is int
    assert as_scalar(np.array(3)) == 3
    assert as_scalar(torch.tensor(3)) == 3
    assert as_scalar(torch.tensor(0.5)) == 0.5, "which no space of integers contains"
    for same in (1, 0.5, "1", None, [1], np.array([1]), torch.tensor([1]), np.True_):
        assert as_scalar(same) is same
