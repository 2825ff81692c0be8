import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hmi_marl.envs.streams import Stream, check_seed, episode_seed, mix, uniform

seeds = st.integers(0, 2**64 - 1)


def splitmix64(word: int) -> int:
    """The finaliser as published, in plain integers."""
    mask = 2**64 - 1
    word = ((word ^ (word >> 30)) * 0xBF58476D1CE4E5B9) & mask
    word = ((word ^ (word >> 27)) * 0x94D049BB133111EB) & mask
    return word ^ (word >> 31)


@given(seeds, st.integers(0, 1000), seeds)
def test_mix_is_the_chained_finaliser_in_plain_integers(seed, stream, counter):
    golden, mask = 0x9E3779B97F4A7C15, 2**64 - 1
    word = splitmix64((seed + golden) & mask)
    word = splitmix64((word + stream * golden) & mask)
    word = splitmix64((word + (counter + 1) * golden) & mask)
    assert int(mix(seed, stream, counter)) == word


def test_splitmix_matches_the_published_first_outputs():
    # The reference generator's first three outputs from seed 1234567.
    golden, mask = 0x9E3779B97F4A7C15, 2**64 - 1
    outputs = [splitmix64((1234567 + k * golden) & mask) for k in (1, 2, 3)]
    assert outputs == [6457827717110365317, 3203168211198807973, 9817491932198370423]


@given(st.lists(seeds, min_size=1, max_size=20))
def test_a_draw_does_not_depend_on_its_neighbours(several):
    together = uniform(np.array(several, np.uint64), Stream.SCENE, 7)
    alone = [float(uniform(np.uint64(seed), Stream.SCENE, 7)) for seed in several]
    assert together.tolist() == alone


def test_draws_are_uniform_and_streams_independent():
    count = 200_000
    first = uniform(np.arange(count, dtype=np.uint64), Stream.SCENE)
    second = uniform(np.arange(count, dtype=np.uint64), Stream.ATTENTION)
    third = uniform(5, Stream.SCENE, np.arange(count))
    for draws in (first, second, third):
        assert draws.min() >= 0
        assert draws.max() < 1
        assert abs(draws.mean() - 0.5) < 4 * np.sqrt(1 / 12 / count)
        counts = np.histogram(draws, 100, (0, 1))[0]
        chi_squared = ((counts - count / 100) ** 2 / (count / 100)).sum()
        assert abs(chi_squared - 99) < 4 * np.sqrt(2 * 99)
    for a, b in ((first, second), (first, third), (first[1:], first[:-1]), (third[1:], third[:-1])):
        assert abs(np.corrcoef(a, b)[0, 1]) < 4 / np.sqrt(count)


def test_the_first_episode_has_the_teams_own_seed_and_later_ones_their_own():
    assert int(episode_seed(42, 0)) == 42
    later = episode_seed(42, np.arange(1000))
    assert len(np.unique(later)) == 1000


@pytest.mark.parametrize("seed", [-1, 2**64])
def test_a_seed_out_of_range_is_refused(seed):
    with pytest.raises(ValueError, match="2\\^64"):
        check_seed(seed)


@pytest.mark.parametrize("seed", ["1", 1.5, True, None])
def test_a_seed_that_is_no_integer_is_refused(seed):
    with pytest.raises(TypeError, match="integer"):
        check_seed(seed)
