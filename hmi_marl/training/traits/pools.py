"""Windows of driving, and pools of them that are one driver's: what the trait model learns from."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from hmi_marl.agents.learned.situations import situations
from hmi_marl.agents.learned.trait_model import standardise
from hmi_marl.demonstrations.dataset import MISSING, Observed

SMALLEST_SPREAD = 1e-6


class Batch(NamedTuple):
    """P pools of n windows, T steps long at most."""

    situations: torch.Tensor
    """Shape (P, n, T, D)."""
    actions: torch.Tensor
    """v_t, shape (P, n, T); -1 after the end."""
    length: torch.Tensor
    """Steps of each window, shape (P, n)."""


class Transitions(NamedTuple):
    """B steps from a situation to the next."""

    before: torch.Tensor
    """Shape (B, D)."""
    actions: torch.Tensor
    """Shape (B,)."""
    after: torch.Tensor
    """Shape (B, D)."""
    pool: torch.Tensor
    """Which pool each is from, shape (B,)."""


def transitions(batch: Batch) -> Transitions:
    """All steps of a batch that another step follows."""
    pools, windows, steps, _ = batch.situations.shape
    later = torch.arange(1, steps, device=batch.length.device) < batch.length[..., None]
    pool = torch.arange(pools, device=batch.length.device)[:, None, None]
    pool = pool.expand(pools, windows, steps - 1)
    return Transitions(
        batch.situations[:, :, :-1][later],
        batch.actions[:, :, :-1][later],
        batch.situations[:, :, 1:][later],
        pool[later],
    )


class Units(NamedTuple):
    """What observed states are measured in, by the model: both of shape (D,)."""

    centre: NDArray[np.float32]
    scale: NDArray[np.float32]

    @classmethod
    def of(cls, observed: Observed) -> Units:
        """Mean and standard deviation over all steps; columns that never change keep their unit."""
        states = observed.states[observed.steps_taken].astype(np.float64)
        spread = states.std(axis=0)
        scale = np.where(spread > SMALLEST_SPREAD, spread, 1.0)
        return cls(states.mean(axis=0).astype(np.float32), scale.astype(np.float32))

    def standardise(self, x: NDArray[np.float32]) -> NDArray[np.float32]:
        """Situations in these units."""
        return standardise(x, self.centre, self.scale)


class Windows:
    """Demonstrations, ready to draw pools of. Every episode is a window.

    Args:
        observed: the demonstrations. Windows whose driver is not known are never drawn, since they
            cannot be pooled.
        labels: of the windows, shape (E,), NaN where there is none.
        units: of the states.

    Raises:
        ValueError: nobody is known by name, or labels of another shape, or a driver with several.
    """

    def __init__(self, observed: Observed, labels: NDArray[np.float64], units: Units) -> None:
        if labels.shape != (len(observed),):
            raise ValueError(f"labels have shape ({len(observed)},), not {labels.shape}")
        self._known = observed.driver != MISSING
        if not self._known.any():
            raise ValueError("no window's driver is known, so none can be pooled with another")
        if observed.length.max() < 2:
            raise ValueError("windows of a single step lead nowhere; record longer ones")
        for who in np.unique(observed.driver[self._known]):
            theirs = labels[observed.driver == who]
            if len(np.unique(theirs[~np.isnan(theirs)])) > 1:
                raise ValueError(f"windows of {observed.names[who]} have different labels")
        self._observed, self._labels = observed, labels
        x = situations(observed.states, observed.actions, observed.alerts)
        self._situations = units.standardise(x)

    def draw(self, rng: np.random.Generator, count: int, size: int) -> NDArray[np.int64]:
        """``count`` pools of ``size`` windows, each of one driver: indices (count, size)."""
        return draw_pools(rng, self._observed.driver, self._known, count, size)

    def draw_pairs(self, rng: np.random.Generator, count: int, size: int) -> NDArray[np.int64]:
        """The same for an even ``count``, where pools 2k and 2k + 1 are of the same driver.

        The two share no window, unless their driver has fewer than ``2 size`` of them.

        Raises:
            ValueError: an odd ``count``.
        """
        if count % 2:
            raise ValueError(f"pairs make an even number of pools, not {count}")
        return self.draw(rng, count // 2, 2 * size).reshape(count, size)

    def draw_labelled(
        self, rng: np.random.Generator, count: int, size: int
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Pools of labelled windows, (count, size), and their labels, (count,).

        Raises:
            ValueError: there is no label to draw by.
        """
        labelled = self._known & ~np.isnan(self._labels)
        if not labelled.any():
            raise ValueError("no window of a known driver has a label, so none can be drawn")
        which = draw_pools(rng, self._observed.driver, labelled, count, size)
        return which, self._labels[which[:, 0]]

    def batch(self, which: NDArray[np.int64], device: str = "cpu") -> Batch:
        """The windows of these indices, (P, n)."""
        return Batch(
            torch.from_numpy(self._situations[which]).to(device),
            torch.from_numpy(self._observed.actions[which]).to(device),
            torch.from_numpy(self._observed.length[which]).to(device),
        )


def draw_pools(
    rng: np.random.Generator,
    driver: NDArray[np.int64],
    among: NDArray[np.bool_],
    count: int,
    size: int,
) -> NDArray[np.int64]:
    """Pools of windows of one driver each, drivers being equally likely.

    No window stands twice in a pool, unless its driver has fewer than ``size`` of them.

    Args:
        rng: to draw by.
        driver: of each window, shape (E,).
        among: windows to draw from, shape (E,).
        count, size: of the pools.

    Returns:
        Indices of windows, shape (count, size).
    """
    windows = np.flatnonzero(among)
    drivers = np.unique(driver[windows])
    theirs = {who: windows[driver[windows] == who] for who in drivers}
    chosen = rng.choice(drivers, count)
    return np.stack(
        [rng.choice(theirs[who], size, replace=len(theirs[who]) < size) for who in chosen]
    )
