"""What is handed out is the caller's own, or cannot be written to: editing it changes nothing."""

import copy
import hashlib
from dataclasses import fields, is_dataclass

import gymnasium
import numpy as np
import pytest
import torch

import hmi_marl
from hmi_marl import TeamConfig, make_driver_policy, make_hmi
from hmi_marl.agents.adaptive.hmis import make_adaptive
from hmi_marl.envs.alerts import Fatigue
from hmi_marl.envs.teaming import Teaming
from hmi_marl.exact import oracle
from hmi_marl.exact.hidden_attention import solve_belief

STEPS, TEAMS = 12, 4
SETTINGS = {"driver": ["bart", "homer"], "duration": 1.6}


def arrays_in(value):
    """All arrays and tensors in what was handed out."""
    if isinstance(value, (np.ndarray, torch.Tensor)):
        yield value
    elif isinstance(value, (list, tuple)):
        for each in value:
            yield from arrays_in(each)
    elif hasattr(value, "items"):
        for _, each in value.items():
            yield from arrays_in(each)
    elif is_dataclass(value):
        for field in fields(value):
            yield from arrays_in(getattr(value, field.name))


def look(*values):
    """A digest of what was handed out."""
    digest = hashlib.sha256()
    for array in arrays_in(values):
        digest.update(np.ascontiguousarray(np.asarray(array)).tobytes())
    return digest.hexdigest()


def scribble(*values):
    """The same digest; then overwrite everything that can be written to."""
    digest = look(*values)
    for array in arrays_in(values):
        plain = np.asarray(array)  # a tensor's own memory
        if plain.flags.writeable:
            plain[...] = 1 if plain.dtype == np.bool_ else 77
    return digest


def all_of_teams(teams):
    names = ("seeds", "over", "intent_given", "steps", "intended", "previous_intended", "applied")
    names += ("alerted", "attention", "traits", "crashed", "ego")
    shown = [getattr(teams, name) for name in names]
    shown += [teams.time_headway(), teams.alerts.effects, teams.state()]
    shown += [teams.observe(agent) for agent in ("driver", "vehicle_ai")]
    shown += [teams.views(("driver", "state")), teams.observe("driver", ("lidar",))]
    world = teams.world
    return [*shown, world.ego(), world.lidar(True), world.lidar(False), world.snapshot(1)]


def drive_teams(world, seen):
    config = TeamConfig(**SETTINGS, alert_strengths=(0.5, 1.0), fatigue=Fatigue())
    teams, rng = Teaming(config, TEAMS, world), np.random.default_rng(0)
    teams.reset(np.arange(TEAMS))
    digests = [seen(all_of_teams(teams))]
    for _ in range(8):
        teams.intend(rng.integers(0, 5, TEAMS))
        digests.append(seen(all_of_teams(teams)))
        result = teams.step(rng.integers(0, 3, TEAMS), views=("state",))
        digests.append(seen(result, result.rewards, result.terms, result.terminated))
        digests.append(seen(all_of_teams(teams)))
    return digests


def drive_vector(seat, seen):
    partner = {"team": None, "driver": "random", "vehicle_ai": "random"}[seat]
    env = hmi_marl.make_vec(TEAMS, seat, partner, seed=3, threads=1, **SETTINGS)
    rng = np.random.default_rng(0)
    digests = [seen(env.reset(seed=5)), seen(env.get_observations())]
    for _ in range(2 * STEPS):
        actions = torch.from_numpy(rng.integers(0, 2, (TEAMS, env.num_actions)))
        digests.append(seen(env.step(actions)))
        digests.append(seen(env.get_observations(), env.read("critic"), env.episode_length_buf))
    return digests


def drive_pettingzoo(parallel, seen):
    make = hmi_marl.merge_v0.parallel_env if parallel else hmi_marl.merge_v0.env
    env, digests = make(world="batched", **SETTINGS), []
    for seed in (1, None):
        digests.append(seen(env.reset(seed=seed)))
        while env.agents:
            digests.append(seen(env.state()))
            if parallel:
                digests.append(seen(env.step({"driver": 3, "vehicle_ai": 1})))
            else:
                digests.append(seen(env.last()))
                done = env.terminations[env.agent_selection] or env.truncations[env.agent_selection]
                env.step(None if done else 1)
    return digests


def drive_gymnasium(name, seen):
    env, digests = gymnasium.make(name, partner="random", world="batched", **SETTINGS), []
    for seed in (1, None):
        digests.append(seen(env.reset(seed=seed)))
        over = False
        while not over:
            *step, info = env.step(1)
            over = step[2] or step[3]
            digests.append(seen(step, info))
    return digests


def drive_policies(seen):
    seated = {"vehicle_ai": [], "driver": [make_driver_policy("rule", TeamConfig(**SETTINGS))]}
    config = TeamConfig(**SETTINGS, ai_sees_attention=False)
    seated["vehicle_ai"] += [make_hmi("random:0.3", config), make_hmi("belief:bart", config)]
    seated["vehicle_ai"] += [make_adaptive("expected", config, exact=True)]
    digests = []
    for seat, policies in seated.items():
        for policy in policies:
            teams = Teaming(config, TEAMS, "batched")
            teams.reset(np.arange(TEAMS))
            policy.reset(teams.seeds)
            for _ in range(8):
                if seat == "vehicle_ai":
                    teams.intend([1, 3, 4, 0])
                actions = policy.act(teams.observe(seat))
                kept = actions.copy()
                digests.append(seen(actions, getattr(policy, "belief", None)))
                if seat == "driver":
                    teams.intend(kept)
                teams.step(kept if seat == "vehicle_ai" else np.zeros(TEAMS, np.int64))
    return digests


WAYS = [
    (drive_teams, "batched"),
    (drive_teams, "highway"),
    (drive_vector, "team"),
    (drive_vector, "driver"),
    (drive_vector, "vehicle_ai"),
    (drive_pettingzoo, True),
    (drive_pettingzoo, False),
    (drive_gymnasium, "hmi_marl/MergeDriver-v0"),
    (drive_gymnasium, "hmi_marl/MergeHMI-v0"),
    (drive_policies,),
]


@pytest.mark.parametrize("way", WAYS, ids=lambda way: f"{way[0].__name__}{way[1:]}")
def test_editing_what_was_handed_out_changes_nothing(way):
    drive, *arguments = way
    undisturbed = drive(*arguments, look)
    assert len(set(undisturbed)) > 5
    assert drive(*arguments, scribble) == undisturbed


def test_tables_of_the_oracle_are_the_callers():
    weights = TeamConfig().weights
    for solve in (
        lambda: oracle.solve_alerts("bart", 3, 10),
        lambda: oracle.alert_losses("bart", 3, 10),
        lambda: solve_belief("bart", 3, 10, weights),
        lambda: TeamConfig(driver="bart", duration=2.0).population.draw(np.arange(3)),
    ):
        first = look(solve())
        scribble(solve())
        assert look(solve()) == first


@pytest.mark.parametrize("wrong", [[0.5, 1, 2, 3], [0, 1, 2, float("nan")], [0, 1, 2, 1e30]])
def test_episode_lengths_that_are_no_whole_numbers_are_refused(wrong):
    env = hmi_marl.make_vec(TEAMS, "team", threads=1, **SETTINGS)
    with pytest.raises(ValueError, match="whole numbers from 0 to 7"):
        env.episode_length_buf = torch.tensor(wrong)
    with pytest.raises(TypeError, match=r"torch tensor, not 0\.5"):
        env.episode_length_buf = 0.5
    with pytest.raises(TypeError, match="steps are whole numbers"):
        env.teaming.steps = np.full(TEAMS, 0.5)
    assert env.episode_length_buf.tolist() == [0] * TEAMS
    env.episode_length_buf = torch.tensor([0.0, 1.0, 2.0, 3.0])
    assert env.episode_length_buf.tolist() == [0, 1, 2, 3]


def test_an_environment_can_be_copied_after_a_picture():
    env = hmi_marl.make_vec(2, "driver", "random", threads=1, **SETTINGS)
    env.step(torch.ones(2, 1))
    env.picture()
    other = copy.deepcopy(env)
    for _ in range(3):
        assert look(env.step(torch.ones(2, 1))) == look(other.step(torch.ones(2, 1)))
    assert other.picture().shape == env.picture().shape


def test_one_partner_with_memory_in_several_environments_is_refused():
    config = TeamConfig(**SETTINGS)

    def make(partner):
        return lambda: gymnasium.make(
            "hmi_marl/MergeDriver-v0", partner=partner, world="batched", **SETTINGS
        )

    cars = gymnasium.vector.SyncVectorEnv([make(make_hmi("random:0.5", config))] * 2)
    cars.reset(seed=0)
    with pytest.raises(RuntimeError, match="give each environment its own"):
        cars.step(np.array([1, 1]))
    for partner in (make_hmi("when-distracted", config), "random:0.5"):  # no memory; one for each
        cars = gymnasium.vector.SyncVectorEnv([make(partner)] * 2)
        cars.reset(seed=0)
        cars.step(np.array([1, 1]))


def test_a_partner_may_go_on_in_another_environment_or_in_a_copy():
    partner = make_hmi("random:0.5", TeamConfig(**SETTINGS))
    for _ in range(2):
        env = hmi_marl.make_vec(2, "driver", partner, threads=1, **SETTINGS)
        env.step(torch.ones(2, 1))
    other = copy.deepcopy(env)
    for each in (env, other, env):
        each.step(torch.ones(2, 1))
