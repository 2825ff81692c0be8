import dataclasses

import numpy as np
import pytest

from hmi_marl import Driver, merge_v0
from hmi_marl.agents import make_driver_policy, make_hmi
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.rewards import TERMS
from hmi_marl.envs.scene import Scene
from hmi_marl.experiments.episodes import Episodes, play_episodes

QUIET = TeamConfig(driver="homer", duration=2.0, scene=Scene(vehicles=2))
CROWDED = TeamConfig(driver=["lisa", "homer"], duration=2.0, scene=Scene(vehicles=20))
CRASHING, WHOLE = 5, 1  # seeds in CROWDED under random driving


def played(config: TeamConfig, driver: str, hmi: str, seeds: list[int]) -> Episodes:
    return play_episodes(config, make_driver_policy(driver, config), make_hmi(hmi, config), seeds)


def assert_same(one: Episodes, other: Episodes) -> None:
    for field in dataclasses.fields(Episodes):
        if field.name != "returns":
            np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name))
    assert one.returns.keys() == other.returns.keys() == set(TERMS)
    for name in TERMS:
        np.testing.assert_array_equal(one.returns[name], other.returns[name], err_msg=name)


def median_of_finite(headways: list[float]) -> float:
    finite = [headway for headway in headways if np.isfinite(headway)]
    return float(np.median(finite)) if finite else np.inf


def by_hand(config: TeamConfig, driver_name: str, hmi_name: str, seed: int) -> Episodes:
    settings = {field.name: getattr(config, field.name) for field in dataclasses.fields(TeamConfig)}
    env = merge_v0.raw_env(**settings)
    driver, hmi = make_driver_policy(driver_name, config), make_hmi(hmi_name, config)
    env.reset(seed=seed)
    for seat in (driver, hmi):
        seat.reset(np.array([seed], np.uint64))
    returns = dict.fromkeys(TERMS, 0.0)
    length = alerts = distracted = 0
    headways = []
    while not (env.terminations["driver"] or env.truncations["driver"]):
        env.step(int(driver.act(env.observe("driver")[None])[0]))
        alert = int(hmi.act(env.observe("vehicle_ai")[None])[0])
        env.step(alert)
        info = env.infos["driver"]
        for name in TERMS:
            returns[name] += info[name]
        length += 1
        alerts += alert
        distracted += info["distracted"]
        headways.append(info["time_headway"])
    return Episodes(
        seeds=np.array([seed], np.uint64),
        length=np.array([length]),
        crashed=np.array([info["crashed"]]),
        alerts=np.array([alerts]),
        distracted=np.array([distracted]),
        min_time_headway=np.array([min(headways)]),
        median_time_headway=np.array([median_of_finite(headways)]),
        returns={name: np.array([value]) for name, value in returns.items()},
    )


@pytest.mark.parametrize(
    ("config", "driver", "hmi", "seed"),
    [
        (QUIET, "rule", "own", 3),
        (QUIET, "random", "belief", 4),
        (CROWDED, "random", "random:0.3", CRASHING),
        (CROWDED, "random", "random:0.3", WHOLE),
        (dataclasses.replace(CROWDED, end_at_crash=False), "random", "always", CRASHING),
    ],
)
def test_an_episode_is_worth_what_stepping_by_hand_sums_up_to(
    config: TeamConfig, driver: str, hmi: str, seed: int
) -> None:
    assert_same(played(config, driver, hmi, [seed]), by_hand(config, driver, hmi, seed))


def test_episodes_side_by_side_are_those_played_alone() -> None:
    seeds = [CRASHING, WHOLE, 10]
    together = played(CROWDED, "random", "random:0.3", seeds)
    assert len(set(together.length)) > 1, "ended episodes should wait for the last"
    alone = [played(CROWDED, "random", "random:0.3", [seed]) for seed in seeds]
    assert_same(together, Episodes.join(alone))


def test_a_crash_ends_an_episode_and_nothing_is_counted_after() -> None:
    episodes = played(CROWDED, "random", "always", [CRASHING, WHOLE])
    assert episodes.crashed.tolist() == [True, False]
    assert episodes.length[0] < episodes.length[1] == CROWDED.horizon
    assert episodes.alerts.tolist() == episodes.length.tolist()
    assert episodes.returns["collision"].tolist() == [-5.0, 0.0]


def test_a_driver_who_crashed_distracted_is_not_counted_on() -> None:
    asleep = Driver("asleep", beta=1.0, alpha=0.0, eta=0.0, inflation=1.0)
    config = dataclasses.replace(CROWDED, driver=asleep)
    episodes = played(config, "random", "never", [26, WHOLE])
    assert episodes.crashed.tolist() == [True, False]
    assert episodes.distracted.tolist() == episodes.length.tolist()


def test_the_same_policies_can_play_again() -> None:
    driver, hmi = make_driver_policy("random", QUIET), make_hmi("belief", QUIET)
    first = play_episodes(QUIET, driver, hmi, [8, 9])
    play_episodes(QUIET, driver, hmi, [1, 2, 3])
    assert_same(play_episodes(QUIET, driver, hmi, [8, 9]), first)


def test_nobody_ahead_is_an_infinite_headway() -> None:
    # one other vehicle, in another lane or behind, and the one on the ramp
    config = dataclasses.replace(QUIET, duration=1.0, scene=Scene(lanes=5, vehicles=1))
    headways = played(config, "rule", "never", list(range(6))).min_time_headway
    assert np.isinf(headways).any()
    assert (headways > 0).all()


def test_distraction_costs_ten_a_step() -> None:
    episodes = played(QUIET, "rule", "never", [0, 1, 2])
    assert episodes.distracted.any()
    np.testing.assert_array_equal(episodes.returns["distraction"], -10.0 * episodes.distracted)


def made(seeds: list[int]) -> Episodes:
    values = np.array(seeds)
    return Episodes(
        seeds=values.astype(np.uint64),
        length=values + 1,
        crashed=values % 2 == 0,
        alerts=values + 2,
        distracted=values + 3,
        min_time_headway=values / 2,
        median_time_headway=values / 4,
        returns={name: values * 10.0 + k for k, name in enumerate(TERMS)},
    )


def test_joined_episodes_keep_their_order() -> None:
    assert_same(Episodes.join([made([4, 2]), made([7]), made([])]), made([4, 2, 7]))


def test_the_attention_return_is_the_sum_of_its_three_terms() -> None:
    episodes = made([1, 2])
    # 10 seed + place in TERMS, for distraction (5), alert (6) and accept_alert (7)
    assert episodes.attention_return().tolist() == [3 * 10 + 18, 3 * 20 + 18]
