import numpy as np
import pytest

from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import Traits
from hmi_marl.envs.series import Series
from hmi_marl.envs.streams import episode_seed

FIRST = np.array([3, 2**64 - 1, 77], np.uint64)


def test_episodes_are_those_of_the_series_however_far_it_goes():
    population = TeamConfig(driver=["lisa", "homer", "bart"]).population
    series = Series(FIRST, population)
    episodes = np.zeros(3, np.uint64)
    rng = np.random.default_rng(0)
    np.testing.assert_array_equal(series.present, FIRST)
    for _ in range(5 * Series.AHEAD):
        which = np.flatnonzero(rng.random(3) < (0.9, 0.5, 0.1))
        episodes[which] += np.uint64(1)
        seeds, traits = series.go_on(which)
        expected = episode_seed(FIRST, episodes)
        np.testing.assert_array_equal(seeds, expected[which])
        np.testing.assert_array_equal(traits, population.draw(expected[which]).as_array())
        np.testing.assert_array_equal(series.present, expected)


def test_a_population_that_draws_the_impossible_is_refused_at_once():
    class Wild:
        def draw(self, seeds):
            return Traits.from_array(np.full((len(seeds), 4), 7.0))

    with pytest.raises(ValueError, match=r"beta lies in \[0, 1\]"):
        Series(FIRST, Wild())
