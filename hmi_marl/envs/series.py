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
    """Most episodes of a series that are known at a time."""

    AT_FIRST = 6
    """Episodes that are computed at first, since many trainers soon begin other series."""

    FEW = 3
    """Fewer episodes ahead than these are not enough for many steps."""

    def __init__(self, seeds: NDArray[np.uint64], population: Population) -> None:
        self._first, self._population = seeds, population
        count = len(seeds)
        self.episodes = np.zeros(count, np.int64)
        """Number of the present episode of each series, shape (N,)."""
        self.moved = False
        """Whether some series have gone on since :meth:`look_ahead`, each by one episode; to be set
        by code that counts up :attr:`episodes` itself."""
        self.seeds = np.zeros((count, self.AHEAD), np.uint64)
        """Seeds of episodes, in the column of the episode's number modulo AHEAD."""
        self.traits = np.zeros((count, self.AHEAD, len(TRAIT_NAMES)))
        """Traits of their drivers."""
        self._until = np.full(count, -1)
        """Last episode of each series that is computed."""
        self._compute(np.arange(count), self.AT_FIRST)
        self._sure = self.AT_FIRST - 1
        """Episodes that are known after the present one in every series, or fewer."""

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
        """Compute more episodes, if few of those of a series are left.

        Raises:
            ValueError, TypeError: a population that draws impossible traits. Nothing has changed.
        """
        if not self.moved:
            return
        sure = self._sure - 1  # a bound, so that not all are counted in every step
        if sure < 1:
            left = self._until - self.episodes
            if left.min() < self.FEW:  # others go along, since many take hardly longer than one
                half = self.AHEAD // 2
                self._compute(np.flatnonzero(left < half), half)
                left = self._until - self.episodes
            sure = int(left.min())
        self._sure, self.moved = sure, False

    def _compute(self, series: NDArray[np.int64], count: int) -> None:
        """Compute the next ``count`` episodes after those that are known."""
        numbers = self._until[series, None] + 1 + np.arange(count)
        seeds = episode_seed(self._first[series, None], numbers.astype(np.uint64))
        drawn = check_traits(self._population.draw(seeds.ravel()), seeds.size)
        places = series[:, None], numbers % self.AHEAD
        self.seeds[places] = seeds
        self.traits[places] = drawn.as_array().reshape(*seeds.shape, -1)
        self._until[series] = numbers[:, -1]
