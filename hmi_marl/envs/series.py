"""Series of episodes: which seed and driver each team's next episode has."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hmi_marl.envs.copies import OwnArrays
from hmi_marl.envs.drivers import TRAIT_NAMES, Population, check_traits
from hmi_marl.envs.streams import episode_seed


class Series(OwnArrays):
    """N series of episodes: the e-th of series k has the seed ``episode_seed(seeds[k], e)``.

    Seeds and drivers are computed some episodes ahead, for many at a time.

    Args:
        seeds: of the series, uint64 of shape (N,).
        population: draws the driver of each episode.

    Raises:
        ValueError, TypeError: a population that draws impossible traits.
    """

    AHEAD = 16
    """Most episodes of a series that are computed at a time."""

    AT_FIRST = 4
    """Episodes that are computed at first, since many trainers soon begin other series."""

    def __init__(self, seeds: NDArray[np.uint64], population: Population) -> None:
        self._first, self._population = seeds, population
        count = len(seeds)
        self.episodes = np.zeros(count, np.int64)
        """Number of the present episode of each series, shape (N,)."""
        self.moved = False
        """Whether some series have gone on since :meth:`look_ahead`; to be set by code that counts
        up :attr:`episodes` itself."""
        self.seeds = np.zeros((count, self.AHEAD), np.uint64)
        """Seeds of episodes, in the column of the episode's number modulo AHEAD."""
        self.traits = np.zeros((count, self.AHEAD, len(TRAIT_NAMES)))
        """Traits of their drivers."""
        self._until = np.zeros(count, np.int64)
        """Last episode of each series that is computed."""
        self._compute(np.arange(count), 0, self.AT_FIRST)

    @property
    def present(self) -> NDArray[np.uint64]:
        """Seeds of the present episodes, shape (N,)."""
        return episode_seed(self._first, self.episodes.astype(np.uint64))

    def go_on(self, series: NDArray[np.int64]) -> tuple[NDArray[np.uint64], NDArray[np.float64]]:
        """Go on to the next episode in M series; return the seeds, (M,), and traits, (M, 4)."""
        self.look_ahead()
        self.episodes[series] += 1
        self.moved = True
        place = series, self.episodes[series] % self.AHEAD
        return self.seeds[place], self.traits[place]

    def look_ahead(self) -> None:
        """Compute more of those series whose last computed episode has begun.

        Raises:
            ValueError, TypeError: a population that draws impossible traits. Nothing has changed.
        """
        if not self.moved:
            return
        at_end = np.flatnonzero(self.episodes >= self._until)
        if len(at_end):
            self._compute(at_end, 1, self.AHEAD)
        self.moved = False

    def _compute(self, series: NDArray[np.int64], first: int, count: int) -> None:
        """Compute ``count`` episodes, from the ``first`` after the present one on."""
        numbers = self.episodes[series, None] + first + np.arange(count)
        seeds = episode_seed(self._first[series, None], numbers.astype(np.uint64))
        drawn = check_traits(self._population.draw(seeds.ravel()), seeds.size)
        places = series[:, None], numbers % self.AHEAD
        self.seeds[places] = seeds
        self.traits[places] = drawn.as_array().reshape(*seeds.shape, -1)
        self._until[series] = numbers[:, -1]
