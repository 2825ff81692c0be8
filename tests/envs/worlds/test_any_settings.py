"""Random teams with settings from the whole range of every field: finite, and equal in both worlds.

``make soak`` runs the whole size.
"""

import numpy as np
import pytest
from configurations import any_config, any_scene, number
from parity import assert_parity

from hmi_marl.envs.drivers import INFLATION
from hmi_marl.envs.teaming import Teaming


def cost(config) -> float:
    """About how long a team's step takes, by the work of the world and of its lidars."""
    scene, vehicles = config.scene, 3 + max(config.scene.vehicle_range)
    simulated = scene.simulation_frequency // scene.policy_frequency
    return vehicles * (simulated + scene.lidar_cells / 10)


def soak(team_steps: int, configurations: int, seed: int) -> int:
    """Drive random teams by random actions; the invariants hold in every step."""
    rng = np.random.default_rng(seed)
    configs = [any_config(rng) for _ in range(configurations)]
    shares = np.array([1 / cost(config) for config in configs])
    shares = np.maximum(shares / shares.sum(), 0.02 / configurations)  # less of what takes long
    done = 0
    for config, share in zip(configs, shares, strict=True):
        own = int(np.ceil(team_steps * share))
        done += drive(config, own, int(np.clip(own // 20, 1, 2000)), rng)
    return done


def drive(config, team_steps: int, count: int, rng) -> int:
    """Drive ``count`` teams until all of them together have taken so many steps."""
    teams, episode, done, window = Teaming(config, count, "batched"), 0, 0, config.alert_window
    teams.reset(np.arange(count))
    strongest, levels = config.alerts.strongest, config.alerts.levels
    while done < team_steps:
        before = teams.applied
        teams.intend(rng.integers(0, 5, count))
        result = teams.step(rng.integers(0, strongest + 1, count))
        done += count
        attention, where = teams.attention, f"{config}, step {done // count}"
        seen = [teams.state(), *(teams.observe(agent) for agent in teams.layouts)]
        seen += [*result.rewards.values(), *result.terms.values()]
        assert all(np.isfinite(values.astype(np.float32)).all() for values in seen), where
        assert (np.abs(teams.ego.speed) <= 41).all(), where
        assert np.isin(attention.distracted, (0, 1)).all()
        assert ((attention.accepted >= 0) & (attention.accepted <= strongest)).all()
        assert ((attention.counter >= 0) & (attention.counter < window)).all()
        assert ((attention.fatigue >= 0) & (attention.fatigue <= levels)).all()
        repeats = (attention.distracted == 1) & (before >= 0)
        assert (teams.applied == before)[repeats].all()
        if teams.over.any():
            episode += 1
            teams.reset(np.arange(count) + 10_000 * episode, teams.over)
    return done


def compare_worlds(number_of_scene: int) -> int:
    """Compare two short episodes of one random scene in both worlds; returns their steps."""
    rng = np.random.default_rng(number_of_scene)
    scene, _ = any_scene(rng, 1)
    simulated = scene.simulation_frequency // scene.policy_frequency
    duration = max(1, min(10, 60 // simulated)) / scene.policy_frequency
    seeds, driver = rng.integers(0, 2**63, 2), str(rng.choice(["random", "rule"]))
    return assert_parity(scene, seeds, duration, number(rng, INFLATION), driver)[0]


def test_any_settings_give_finite_numbers():
    assert soak(4_000, 4, seed=1) >= 4_000


@pytest.mark.usefixtures("unmeasured")
@pytest.mark.parametrize("number_of_scene", [3, 8, 21, 26, 29])  # quick ones, ends included
def test_both_worlds_are_equal_in_any_scene(number_of_scene):
    assert compare_worlds(number_of_scene) > 0


@pytest.mark.long
def test_ten_million_team_steps():
    assert soak(10_000_000, 100, seed=2) >= 10_000_000


@pytest.mark.long
@pytest.mark.parametrize("block", range(10))
def test_both_worlds_are_equal_beside_the_ten_million(block):
    assert sum(compare_worlds(1000 + 10 * block + k) for k in range(10)) > 0
