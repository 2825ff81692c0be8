from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from trait_models import untrained

from hmi_marl.agents.learned.situations import EXTRA, situations
from hmi_marl.demonstrations.dataset import Observed
from hmi_marl.demonstrations.recording import CollectSettings, collect
from hmi_marl.envs.observations import FASTEST, Layout
from hmi_marl.experiments.latent_traits.imitation import (
    by_driver,
    checked_z,
    compare_driving,
    driving,
    imitate,
    replay,
)
from hmi_marl.files import json_value
from hmi_marl.reporting.statistics import mean, share
from hmi_marl.training.traits.rollouts import Drives


def observe(**settings: Any) -> Observed:
    """Random drivers, some of whom crash."""
    small: dict[str, Any] = {"drivers": ("bart", "marge"), "steps": 300, "duration": 6.0}
    (data,) = collect(
        CollectSettings(
            **{"vehicles": (20, 20), **small, **settings}, driver_policy="random", num_teams=10_000
        )
    )
    return data.observed


# Recorded episodes, played again.


@pytest.mark.parametrize("end_at_crash", [False, True])
def test_a_replay_is_what_was_recorded(end_at_crash: bool) -> None:
    observed = observe(end_at_crash=end_at_crash)
    assert 0 < observed.crashed.sum() < len(observed)
    drives, taken = replay(observed), observed.steps_taken
    np.testing.assert_array_equal(drives.crashed, observed.crashed)
    np.testing.assert_array_equal(drives.situations[..., :-EXTRA][taken], observed.states[taken])
    np.testing.assert_array_equal(drives.actions[taken], observed.actions[taken])
    np.testing.assert_array_equal(drives.alerts[taken], observed.alerts[taken])
    x = situations(observed.states, observed.actions, observed.alerts)
    np.testing.assert_array_equal(drives.situations[taken], x[taken])
    speed = observed.layout.scalar(observed.states, "speed") * FASTEST
    later = taken[:, 1:]
    np.testing.assert_allclose(drives.speed[:, :-1][later], speed[:, 1:][later], atol=1e-4)
    standing = np.arange(drives.speed.shape[1]) >= observed.driven[:, None]
    assert (drives.speed[observed.crashed[:, None] & standing] == 0).all()
    assert (drives.speed[~standing] > 0).all()


def test_what_cannot_be_played_again_is_refused() -> None:
    observed = observe()
    with pytest.raises(ValueError, match="no seeds, so they cannot be replayed"):
        replay(replace(observed, seeds=None))
    with pytest.raises(ValueError, match="do not crash where they did"):
        replay(replace(observed, crash_step=np.full(len(observed), -1)))


# The policy, driving.


def test_a_drive_depends_on_its_seed_alone() -> None:
    observed = observe()
    model, z = untrained(observed.layout), {"bart": [0.5, -1.0], "marge": [2.0, 1.0]}
    few, many = (imitate(model, observed, z, episodes, 7) for episodes in (3, 5))
    alone = imitate(model, observed, {"marge": z["marge"]}, 5, 7)
    for name in vars(many["marge"]):
        whole = getattr(many["marge"], name)
        np.testing.assert_array_equal(getattr(few["marge"], name), whole[:3], err_msg=name)
        np.testing.assert_array_equal(getattr(alone["marge"], name), whole, err_msg=name)
    assert (many["marge"].actions != many["bart"].actions).any()
    np.testing.assert_array_equal(many["marge"].alerts, many["bart"].alerts)
    other = imitate(model, observed, z, 5, 8)
    assert (other["bart"].situations != many["bart"].situations).any()


def test_actions_are_drawn_as_often_as_the_policy_says() -> None:
    observed = observe()
    odds = np.array([0.1, 0.4, 0.05, 0.15, 0.3])

    def fixed(name: str, values: Any) -> Any:
        if name == "policy.layer1.bias":
            return np.log(odds)
        return values * (not name.startswith("policy"))

    drives = imitate(untrained(observed.layout, change=fixed), observed, {"lisa": [0, 0]}, 200, 0)[
        "lisa"
    ]
    count = drives.actions.size
    shares = np.bincount(drives.actions.ravel(), minlength=5) / count
    assert (np.abs(shares - odds) < 5 * np.sqrt(odds * (1 - odds) / count)).all()
    alerts = observed.alerts.mean()
    assert drives.alerts.mean() == pytest.approx(alerts, abs=5 * 0.4 / np.sqrt(count))


def test_impossible_imitations_are_refused() -> None:
    observed = observe()
    model = untrained(observed.layout)
    with pytest.raises(ValueError, match="at least one episode, but got 0"):
        imitate(model, observed, {"bart": [0, 0]}, 0, 0)
    other = untrained(Layout(observed.layout.parts[::-1]))
    with pytest.raises(ValueError, match="use the scene that it was trained on"):
        imitate(other, observed, {"bart": [0, 0]}, 1, 0)
    for z in ([0.0], [[0.0, 0.0]], [0.0, np.nan]):
        with pytest.raises(ValueError, match="z of bart is 2 finite numbers, not"):
            checked_z(model, "bart", z)


# What driving comes to.


def drives_of(
    actions: list[list[int]],
    alerts: list[list[int]],
    speed: list[list[float]],
    headway: list[list[float]],
    crashed: list[bool],
) -> Drives:
    done, alerted = np.array(actions), np.array(alerts)
    x = situations(np.zeros((*done.shape, 1), np.float32), done, alerted)
    return Drives(
        x,
        done,
        alerted,
        np.array(speed),
        np.array(headway),
        np.array(crashed),
        np.zeros(len(done)),
    )


INF = np.inf


def test_driving_by_hand() -> None:
    # At 5 Hz. The second crashes in its second step, and stands.
    drives = drives_of(
        actions=[[0, 0, 1, 2], [3, 4, 4, 0]],
        alerts=[[0, 0, 1, 1], [0, 0, 0, 0]],
        speed=[[20.0, 22.0, 24.0, 26.0], [30.0, 10.0, 0.0, 0.0]],
        headway=[[INF, 1.0, 2.0, 4.0], [INF, INF, 9.0, 9.0]],
        crashed=[False, True],
    )
    found = driving(drives, 5)
    assert found.drives == 2
    assert found.speed == mean([23.0, 20.0], lowest=0.0)
    assert found.headway == mean([2.0])  # the other had nobody ahead before the crash
    assert found.lane_changes == mean([3 * 300 / 4, 0.0], lowest=0.0)
    assert found.repeated == mean([1 / 3, 0.0], lowest=0.0)
    assert found.alert_effect == mean([0.0 - 1.0])  # the other had no alert
    assert found.crash_rate == share(1, 2)
    assert json_value(found)["crash_rate"] == share(1, 2).as_json()


def test_a_drive_that_nothing_is_known_of_is_left_out() -> None:
    only = drives_of([[1]], [[1]], [[0.0]], [[INF]], [False])
    found = driving(only, 5)
    for name in ("headway", "repeated", "alert_effect"):
        assert np.isnan(getattr(found, name).mean), name
    assert found.speed.mean == 0.0


def test_drivers_are_compared_one_by_one() -> None:
    observed = observe()
    model = untrained(observed.layout)
    drives = replay(observed)
    apart = by_driver(drives, [*observed.labels()[:-1], None])
    assert {name: len(one.actions) for name, one in apart.items()} == {"bart": 10, "marge": 9}
    np.testing.assert_array_equal(apart["marge"].actions, observed.actions[10:19])
    played = imitate(model, observed, {"marge": [1, 0], "bart": [0, 0]}, 4, 0)
    rows = compare_driving(apart, played, 5)
    assert [row.driver for row in rows] == ["bart", "marge"]
    assert rows[1].demonstrated == driving(apart["marge"], 5)
    assert rows[1].imitated == driving(played["marge"], 5)
    assert json_value(rows[1])["imitated"]["drives"] == 4
    with pytest.raises(ValueError, match="only one has marge"):
        compare_driving(apart, {"bart": played["bart"]}, 5)


def test_who_repeats_what_they_did_is_seen_from_their_driving() -> None:
    # Of random intents an attentive driver repeats a fifth, and bart most of the rest.
    observed = observe(steps=15_000)
    rows = by_driver(replay(observed), observed.labels())
    bart, marge = (driving(rows[name], 5) for name in ("bart", "marge"))
    assert bart.repeated.low > 0.75
    assert marge.repeated.high < 0.4
    assert marge.alert_effect.high < 0 < bart.alert_effect.high
