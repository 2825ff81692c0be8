"""Seeds that are apart have nothing in common: neither episodes nor runs nor drivers."""

from pathlib import Path

import numpy as np
import pytest
import torch

import hmi_marl
from hmi_marl.demonstrations.recording import CollectSettings
from hmi_marl.envs.streams import episode_seed, part_seed, team_seed
from hmi_marl.experiments.adaptation.evaluation import AdaptSettings, groups
from hmi_marl.experiments.latent_traits.experiment import LatentTraits
from hmi_marl.experiments.metrics_table.table import TableConfig
from hmi_marl.experiments.protocols.plan import ComparisonSettings


def seeds_of_batch(seed, first_team=0):
    env = hmi_marl.make_vec(50, "team", world="batched", threads=1, duration=0.2)
    env.reset(seed, first_team)
    found = []
    for _ in range(5):
        found += env.teaming.seeds.tolist()
        env.step(torch.ones(50, 2))
    return found


def seeds_of_table(seed):
    return TableConfig(seed=seed, episodes=200).seeds(range(200)).tolist()


def seeds_of_demonstrations(seed):
    return CollectSettings(seed=seed, population=3, steps=2000).episodes()[1].tolist()


def seeds_of_comparison(seed):
    (plan,) = ComparisonSettings(seed=seed, seeds=5, tasks=("hidden",)).plans()
    return [job.settings.seed for job in plan.jobs(Path(), plan.runs_of("joint"))]


def seeds_of_traits(seed):
    settings = LatentTraits(seed=seed, seeds=4)
    learned = {each.seed for each in settings.trainings(Path()).values()}
    return [*learned, settings.datasets(Path())["population"].seed]


def unknown_drivers(seed):
    by_name = {group.name: group for group in groups(AdaptSettings(seed=seed))}
    population = by_name["population"]
    return [*population.drivers, *population.candidates]


@pytest.mark.parametrize(
    "drawn",
    [
        seeds_of_batch,
        seeds_of_table,
        seeds_of_demonstrations,
        seeds_of_comparison,
        seeds_of_traits,
        unknown_drivers,
    ],
)
def test_neighbouring_seeds_share_nothing(drawn):
    several = [drawn(seed) for seed in (0, 1, 2, 3)]
    assert all(len(set(each)) == len(each) for each in several)
    assert len({one for each in several for one in each}) == sum(map(len, several))
    assert drawn(1) == several[1]


def test_the_seeds_of_a_batch_are_those_that_are_documented():
    first, *later = np.array(seeds_of_batch(8), np.uint64).reshape(5, 50)
    np.testing.assert_array_equal(first, team_seed(8, np.arange(50)))
    for number, seeds in enumerate(later, 1):
        expected = episode_seed(team_seed(8, np.arange(50)), number)
        np.testing.assert_array_equal(seeds, expected)


def test_a_part_of_a_batch_has_the_series_of_its_place():
    whole, part = (np.array(seeds_of_batch(8, first)).reshape(5, 50) for first in (0, 20))
    np.testing.assert_array_equal(whole[:, 20:], part[:, :30])


def test_a_teams_first_episode_is_that_of_one_environment_with_its_seed():
    env = hmi_marl.make_vec(3, "driver", "never", seed=5, threads=1)
    alone = hmi_marl.merge_v0.env(world="batched")
    for team in range(3):
        alone.reset(seed=int(team_seed(5, team)))
        seen = env.get_observations()["driver"][team].numpy()
        np.testing.assert_array_equal(alone.observe("driver"), seen)


def test_parts_have_seeds_of_their_own_and_the_first_that_of_the_whole():
    seeds = part_seed(3, np.arange(100))
    assert seeds[0] == 3
    assert len(np.unique(seeds)) == 100
    (plan,) = ComparisonSettings(seed=3, tasks=("seen",)).plans()
    assert plan.training(plan.runs[0], Path()).seed == 3
