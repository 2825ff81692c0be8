import dataclasses
from typing import Any

import numpy as np
import pytest
from demonstrations import LAYOUT, changed, made_up

from hmi_marl.demonstrations.dataset import (
    STATE_PARTS,
    Demonstrations,
    Observed,
    alert_rate,
    held_out,
    observed_layout,
)
from hmi_marl.demonstrations.step_file import column_names
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.observations import Layout, state_layout, vehicle_ai_layout

HIDDEN = ("distracted", "accepted", "counter", "intended", "traits", "perceived", "beta", "inflat")


def test_an_observed_state_is_what_can_be_seen_from_outside() -> None:
    config = TeamConfig()
    layout, seen = observed_layout(config), vehicle_ai_layout(config)
    assert tuple(layout.slices) == STATE_PARTS
    assert layout.size == 2 * 16 + 5 + 4
    assert set(layout.parts) < set(seen.parts), "with the units of the vehicle AI's observation"
    names = column_names(layout)
    assert names[:2] == ["lidar_0", "lidar_1"]
    assert names[31:] == [
        "lidar_31",
        "speed",
        "target_speed",
        "heading",
        "lateral",
        "lane_0",
        "lane_1",
        "lane_2",
        "lane_3",
        "position",
    ]


def test_observed_data_have_no_field_for_anything_hidden() -> None:
    names = [field.name for field in dataclasses.fields(Observed)]
    assert not [name for name in names if any(hidden in name for hidden in HIDDEN)]
    observed = made_up([2]).observed
    assert not [value for value in vars(observed).values() if "Truth" in type(value).__name__]


def test_lengths_crashes_and_places_are_counted_by_hand() -> None:
    data = made_up(
        [3, 5, 2, 5, 1],
        crash_step=[2, 1, -1, -1, 0],
        driver=[0, 1, 0, -1, 0],
        names=("lisa", "bart"),
    )
    observed = data.observed
    assert len(data) == 5
    assert observed.steps_taken.sum(axis=1).tolist() == [3, 5, 2, 5, 1]
    assert observed.crashed.tolist() == [True, True, False, False, True]
    assert observed.driven.tolist() == [3, 2, 2, 5, 1]
    assert observed.number.tolist() == [0, 0, 1, 0, 2]
    assert observed.labels() == ["lisa", "bart", "lisa", None, "lisa"]


@pytest.mark.parametrize("which", [[4, 1], np.array([False, True, False, False, True])])
def test_episodes_are_taken_with_their_truth(which: Any) -> None:
    data = made_up([3, 5, 2, 5, 1], driver=[0, 1, 0, -1, 0], names=("lisa", "bart"))
    taken = data.take(which)
    places = np.arange(5)[which]
    assert taken.observed.length.tolist() == [[3, 5, 2, 5, 1][k] for k in places]
    np.testing.assert_array_equal(taken.observed.states, data.observed.states[places])
    assert taken.observed.seeds is not None
    assert data.observed.seeds is not None
    np.testing.assert_array_equal(taken.observed.seeds, data.observed.seeds[places])
    assert taken.truth is not None
    assert data.truth is not None
    np.testing.assert_array_equal(taken.truth.traits, data.truth.traits[places])


def refuse(message: str, part: str = "observed", **arrays: Any) -> None:
    data = getattr(made_up([3, 2]), part)
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(data, **arrays)


def test_observed_data_are_checked_at_the_door() -> None:
    observed = made_up([3, 2]).observed
    speed, lane, lidar = (LAYOUT[name].start for name in ("speed", "lane", "lidar"))
    refuse(r"actions have shape \(E, T\)", actions=np.zeros(3, np.int64))
    refuse(r"actions have shape \(E, T\)", actions=np.zeros((0, 3), np.int64))
    refuse(r"states has shape \(2, 3, 17\), not \(2, 3, 5\)", states=np.zeros((2, 3, 5)))
    refuse("alerts has shape", alerts=np.zeros((2, 4), np.int64))
    refuse("actions are whole numbers, not float64", actions=observed.actions * 1.0)
    refuse("actions lies in 0 to 4, but got 5", actions=changed(observed, "actions", (0, 0), 5))
    refuse("actions lies in 0 to 4, but got -1", actions=changed(observed, "actions", (0, 2), -1))
    refuse("alerts lies in 0 to 1, but got 2", alerts=changed(observed, "alerts", (1, 1), 2))
    refuse("after an episode's end", actions=changed(observed, "actions", (1, 2), 1))
    refuse("after an episode's end", alerts=changed(observed, "alerts", (1, 2), 1))
    refuse("after an episode's end", states=changed(observed, "states", (1, 2, speed), 0.5))
    for wrong in (np.nan, np.inf):
        states = changed(observed, "states", (0, 1, speed), wrong)
        refuse("speed is not finite everywhere", states=states)
    states = changed(observed, "states", (0, 1, speed), 30.0)  # in m/s
    refuse(r"speed lies in \[-2, 2\], but reaches from 0 to 30; see the units", states=states)
    refuse("lidar lies in", states=changed(observed, "states", (0, 1, lidar), -9))
    refuse("lane is one-hot", states=changed(observed, "states", (0, 1, lane), 0.5))
    refuse("lane is one-hot", states=changed(observed, "states", (0, 1, LAYOUT["lane"]), 0))
    refuse("length lies in 1 to 3, but got 0", length=np.array([3, 0]))
    refuse("length lies in 1 to 3, but got 4", length=np.array([4, 2]))
    refuse("crash_step is a step of its episode", crash_step=np.array([-1, 2]))
    refuse("crash_step is a step of its episode", crash_step=np.array([-2, 0]))
    refuse("driver lies in -1 to 0, but got 1", driver=np.array([0, 1]))
    refuse("names are different non-empty strings", names=("lisa", "lisa"))
    refuse("names are different non-empty strings", names=("",))
    refuse("seeds has shape", seeds=np.zeros(3, np.uint64))
    refuse("may hold no traits, but holds beta", about={"team": {"drivers": [{"beta": 0.2}]}})


def test_truth_is_checked_at_the_door() -> None:
    truth = made_up([3, 2]).truth
    assert truth is not None
    traits = truth.traits
    refuse(r"intended has shape \(E, T\)", "truth", intended=np.zeros(3, np.int64))
    refuse("counter has shape", "truth", counter=np.zeros((1, 3), np.int64))
    refuse("distracted lies in 0 to 1", "truth", distracted=changed(truth, "distracted", 0, 2))
    refuse("counter lies in 0", "truth", counter=changed(truth, "counter", (0, 0), -1))
    refuse("intended lies in -1 to 4", "truth", intended=changed(truth, "intended", 0, 5))
    refuse("traits has shape", "truth", traits=traits[:, :3])
    refuse("beta lies in", "truth", traits=changed(truth, "traits", (0, 0), 1.5))
    refuse("after an episode's end", "truth", accepted=changed(truth, "accepted", (1, 2), 1))


def test_truth_of_other_episodes_is_refused() -> None:
    with pytest.raises(ValueError, match="of other episodes"):
        Demonstrations(made_up([3, 2]).observed, made_up([2, 3]).truth)
    with pytest.raises(ValueError, match="of other episodes"):
        Demonstrations(made_up([3, 2]).observed, made_up([3]).truth)


@pytest.mark.parametrize("layout", [state_layout(TeamConfig()), Layout(LAYOUT.parts[:3])])
def test_states_with_hidden_or_missing_parts_are_refused(layout: Layout) -> None:
    observed = made_up([2]).observed
    with pytest.raises(ValueError, match=r"has the parts lidar, speed.* and no others, but got"):
        dataclasses.replace(observed, layout=layout, states=np.zeros((1, 2, layout.size)))


def test_alerts_count_by_steps_that_there_were():
    observed = made_up([4, 2]).observed
    alerts = np.array([[1, 0, 0, 1], [1, 0, 0, 0]])
    assert alert_rate(dataclasses.replace(observed, alerts=alerts)) == 0.5


def test_the_last_windows_of_every_driver_are_held_out():
    driver = [0, 0, 1, 0, 1, 0, 0, -1]
    observed = made_up([3] * 8, driver=driver, names=("ada", "bob")).observed
    marked = held_out(observed.driver, 0.4)
    # Of ada's windows 0, 1, 3, 5, 6 the last two, of bob's 2 and 4 the last one.
    assert np.flatnonzero(marked).tolist() == [4, 5, 6]
    assert not held_out(observed.driver, 0.0).any()
