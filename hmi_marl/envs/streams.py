"""Counter-based random numbers: what happens to a team depends on its own seed alone.

A draw is a pure function of (seed, stream, counter), so it does not matter how many teams
share a batch, in which order or on which thread they run, or which world carries them. The
mixing function is SplitMix64's finaliser (Steele, Lea & Flood 2014), chained over the three
words. It needs only 64-bit integer arithmetic, works element by element on NumPy arrays of any
shape, and can be compiled.
"""

from __future__ import annotations

import numbers
from collections.abc import Callable
from enum import IntEnum
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.checks import Check, shown

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
TO_UNIT = 2.0**-53


class Stream(IntEnum):
    """Independent purposes that draw from the same seed."""

    EPISODE = 1
    TRAITS = 2
    SCENE = 3
    ATTENTION = 4
    DRIVER_POLICY = 5
    HMI_POLICY = 6
    TRAINING = 7
    """Series of training episodes, one for each iteration."""
    LEARNING = 8
    """Draws of a learner: initial weights, explored actions, mini-batches."""
    TEAM = 9
    """Series of episodes of the teams of a batch."""
    PART = 10
    """Parts of an experiment that are to be independent, such as repeated runs."""
    MIXTURE = 11
    """Policy that plays in an episode, out of a mixture; the counter is the seat's number."""
    CANDIDATES = 12
    """Candidates of a posterior over traits; the counter is the round."""


def mix_bits(seed: Any, stream: Any, counter: Any) -> Any:
    """The hash itself, for uint64 arrays or, compiled, for uint64 scalars."""
    word = seed
    for salt in (_GOLDEN, stream * _GOLDEN, (counter + np.uint64(1)) * _GOLDEN):
        word = word + salt
        word = (word ^ (word >> np.uint64(30))) * _MIX_1
        word = (word ^ (word >> np.uint64(27))) * _MIX_2
        word = word ^ (word >> np.uint64(31))
    return word


def unit_draw(seed: Any, stream: Any, counter: Any) -> Any:
    """Uniform in [0, 1) with 53 random bits, for uint64 arrays or, compiled, for uint64 scalars."""
    return (mix_bits(seed, stream, counter) >> np.uint64(11)) * TO_UNIT


def mix(seed: ArrayLike, stream: int, counter: ArrayLike = 0) -> NDArray[np.uint64]:
    """Hash (seed, stream, counter) to 64 random bits.

    Args:
        seed: uint64, any shape.
        stream: which purpose the bits serve, a :class:`Stream`.
        counter: uint64, broadcast against ``seed``.

    Returns:
        uint64 array of the broadcast shape.
    """
    return _on_arrays(mix_bits, seed, stream, counter)


def _on_arrays(draw: Callable[..., Any], seed: Any, stream: int, counter: Any) -> NDArray[Any]:
    words = np.asarray(seed, np.uint64), np.uint64(stream), np.asarray(counter, np.uint64)
    with np.errstate(over="ignore"):  # arithmetic modulo 2^64 is the point
        return np.asarray(draw(*words))


def uniform(seed: ArrayLike, stream: int, counter: ArrayLike = 0) -> NDArray[np.float64]:
    """Uniform draws in [0, 1) with 53 random bits; see :func:`mix` for the arguments."""
    return _on_arrays(unit_draw, seed, stream, counter)


def episode_seed(seed: ArrayLike, episode: ArrayLike) -> NDArray[np.uint64]:
    """Seed of the ``episode``-th episode of a series: the series' own seed for the first (0)."""
    return _numbered(seed, Stream.EPISODE, episode)


def team_seed(seed: ArrayLike, team: ArrayLike) -> NDArray[np.uint64]:
    """Seed of the series of team number ``team`` in a batch of teams with one seed.

    The team's e-th episode has the seed ``episode_seed(team_seed(seed, team), e)``. Batches of
    different seeds have no episode in common.
    """
    return mix(seed, Stream.TEAM, team)


def part_seed(seed: ArrayLike, part: ArrayLike) -> NDArray[np.uint64]:
    """Seed of the ``part``-th part of an experiment, such as a run: its own seed for the first."""
    return _numbered(seed, Stream.PART, part)


def _numbered(seed: ArrayLike, stream: Stream, number: ArrayLike) -> NDArray[np.uint64]:
    seed, number = np.asarray(seed, np.uint64), np.asarray(number, np.uint64)
    return np.where(number == 0, seed, mix(seed, stream, number))


def check_seed(seed: Any) -> int:
    """Return ``seed`` as an int in [0, 2^64), or raise ``ValueError``/``TypeError`` saying why."""
    if isinstance(seed, bool) or not isinstance(seed, numbers.Integral):
        raise TypeError(f"a seed is an integer, not {shown(seed)}")
    if not 0 <= int(seed) < 2**64:
        raise ValueError(f"a seed lies in [0, 2^64), but got {shown(seed)}")
    return int(seed)


Seed = Annotated[int, Check(lambda name, seed: check_seed(seed), "0 to 2^64 - 1")]
"""Seed as a checked setting; see :class:`hmi_marl.checks.Checked`."""
