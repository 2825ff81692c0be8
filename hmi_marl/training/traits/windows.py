"""Windows of driving, their labels, and pools of windows of one driver, for the trait model.

Labels are the only input of a supervised setting besides the observed driving: the driver, or the
driver's preference for help. The preference of a simulated driver is η, the influence of alerts:
the answer to a question that people could be asked. No other trait is read, and η only for labelled
windows.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from hmi_marl.demonstrations.dataset import MISSING
from hmi_marl.reading import read_json
from hmi_marl.training.traits.episodes import Episodes
from hmi_marl.training.traits.settings import LABELLED, Supervision
from hmi_marl.typed_json import read_value


class Batch(NamedTuple):
    """P pools of n windows of at most T steps."""

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
    """Pool of each transition, shape (B,)."""


def transitions(batch: Batch) -> Transitions:
    """Return all transitions of a batch: the steps that another step follows."""
    pools, windows, steps, _ = batch.situations.shape
    later = torch.arange(1, steps, device=batch.length.device) < batch.length[..., None]
    pool = torch.arange(pools, device=batch.length.device)[:, None, None]
    pool = pool.expand(pools, windows, steps - 1)[later]
    x, actions = batch.situations, batch.actions
    return Transitions(x[:, :, :-1][later], actions[:, :, :-1][later], x[:, :, 1:][later], pool)


class Windows:
    """Demonstrations from which pools are drawn. Every episode is a window.

    Args:
        episodes: the demonstrations. Windows of an unknown driver are never drawn, since they
            cannot be pooled.
        labels: labels of the windows, shape (E,), NaN where there is none.

    Raises:
        ValueError: no driver is known, or the labels' shape is wrong, or a driver has several
            labels.
    """

    def __init__(self, episodes: Episodes, labels: NDArray[np.float64]) -> None:
        if labels.shape != (len(episodes),):
            raise ValueError(f"labels have shape ({len(episodes)},), not {labels.shape}")
        self._known = episodes.driver != MISSING
        if not self._known.any():
            raise ValueError("no window's driver is known, so none can be pooled with another")
        if episodes.length.max() < 2:
            raise ValueError(
                "all windows have a single step, so there are no transitions; record longer ones"
            )
        self._episodes, self._labels = episodes, labels
        self._pooled = by_driver(episodes.driver, self._known)
        self._labelled = by_driver(episodes.driver, self._known & ~np.isnan(labels))
        for number, own in self._labelled.items():
            if len(np.unique(labels[own])) > 1:
                raise ValueError(f"windows of {episodes.names[number]} have different labels")

    def draw(self, rng: np.random.Generator, count: int, size: int) -> NDArray[np.int64]:
        """Draw ``count`` pools of ``size`` windows, each of one driver: indices (count, size)."""
        return draw_pools(rng, self._pooled, count, size)

    def draw_pairs(self, rng: np.random.Generator, count: int, size: int) -> NDArray[np.int64]:
        """Draw an even ``count`` of pools, where pools 2k and 2k + 1 are of the same driver.

        The two share no window, unless their driver has fewer than ``2 size`` of them.

        Raises:
            ValueError: ``count`` is odd.
        """
        if count % 2:
            raise ValueError(f"count is an even number of pools, but got {count}")
        return self.draw(rng, count // 2, 2 * size).reshape(count, size)

    def draw_drivers(self, rng: np.random.Generator, count: int, size: int) -> NDArray[np.int64]:
        """Draw ``count`` different drivers, or all if there are no more, and windows of each.

        Returns:
            Indices of windows, none twice: an even number for each driver, ``2 size`` if every
            driver has so many. Shape (count, windows).

        Raises:
            ValueError: there is one driver alone, or one with a single window.
        """
        fewest = min(len(own) for own in self._pooled.values())
        if len(self._pooled) < 2 or fewest < 2:
            raise ValueError(
                "finding windows of one driver among others takes two drivers or more with two "
                "windows or more each; collect many, as with hmi-marl collect --population 2000"
            )
        each = 2 * min(size, fewest // 2)
        chosen = rng.choice(list(self._pooled), min(count, len(self._pooled)), replace=False)
        return np.stack([rng.choice(self._pooled[who], each, replace=False) for who in chosen])

    def draw_labelled(
        self, rng: np.random.Generator, count: int, size: int
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Draw pools of labelled windows, (count, size), with their labels, (count,).

        Raises:
            ValueError: no window has a label.
        """
        if not self._labelled:
            raise ValueError("no window of a known driver has a label, so none can be drawn")
        which = draw_pools(rng, self._labelled, count, size)
        return which, self._labels[which[:, 0]]

    def batch(self, which: NDArray[np.int64], device: str = "cpu") -> Batch:
        """Return the windows of these indices, (P, n)."""
        own = self._episodes
        return Batch(
            torch.from_numpy(own.units.standardise(own.situations[which])).to(device),
            torch.from_numpy(own.actions[which].astype(np.int64)).to(device),
            torch.from_numpy(own.length[which]).to(device),
        )


def by_driver(driver: NDArray[np.int64], among: NDArray[np.bool_]) -> dict[int, NDArray[np.int64]]:
    """Return the indices of the windows of every driver, of those that are ``among``, both (E,)."""
    windows = np.flatnonzero(among)
    order = windows[np.argsort(driver[windows], kind="stable")]
    if not len(order):
        return {}
    drivers, first = np.unique(driver[order], return_index=True)
    return dict(zip(drivers.tolist(), np.split(order, first[1:]), strict=True))


def draw_pools(
    rng: np.random.Generator,
    windows: Mapping[int, NDArray[np.int64]],
    count: int,
    size: int,
) -> NDArray[np.int64]:
    """Draw pools of windows of one driver each, with all drivers equally likely.

    No window is drawn twice for a pool, unless its driver has fewer than ``size`` of them.

    Args:
        windows: indices of the windows of each driver; see :func:`by_driver`.

    Returns:
        Indices of windows, shape (count, size).
    """
    drawn_from = [windows[number] for number in rng.choice(list(windows), count)]
    return np.stack([rng.choice(own, size, replace=len(own) < size) for own in drawn_from])


def choose_labelled(
    driver: NDArray[np.int64], share: float, rng: np.random.Generator
) -> NDArray[np.bool_]:
    """Mark a share in (0, 1] of every known driver's windows, at least one, drawn by ``rng``.

    ``driver`` is that of each window, shape (E,); -1 if not known.
    """
    marked = np.zeros(len(driver), np.bool_)
    for number in np.unique(driver[driver != MISSING]):
        windows = np.flatnonzero(driver == number)
        marked[rng.permutation(windows)[: max(1, round(share * len(windows)))]] = True
    return marked


def make_labels(
    episodes: Episodes,
    supervision: Supervision,
    share: float,
    rng: np.random.Generator,
    preferences: Mapping[str, float] | None = None,
    eta: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]:
    """Return labels of all windows, shape (E,), NaN where there is none.

    Args:
        share: share of each driver's windows that is labelled; ``rng`` chooses them.
        preferences: people's answers by name, in [0, 1]; not needed for simulated drivers.
        eta: η of each window's driver, shape (E,), which answers for simulated drivers.

    Raises:
        ValueError: a preference is missing or outside [0, 1], or all labels are the same.
    """
    marked = choose_labelled(episodes.driver, share, rng)
    labels = np.full(len(episodes), np.nan)
    if supervision == "id":
        labels[marked] = episodes.driver[marked]
    elif supervision == "preference":
        labels[marked] = _preferences(episodes, marked, preferences, eta)
    if supervision in LABELLED and len(np.unique(labels[~np.isnan(labels)])) < 2:
        raise ValueError("all labels are the same, so nothing can be learned from them")
    return labels


def _preferences(
    episodes: Episodes,
    marked: NDArray[np.bool_],
    answers: Mapping[str, float] | None,
    eta: NDArray[np.float64] | None,
) -> NDArray[np.float64]:
    if answers is None:
        if eta is None:
            raise ValueError(
                "the preferences of these drivers are unknown, since the demonstrations have no "
                "truth; give the drivers' answers with --preferences FILE"
            )
        return eta[marked]
    asked = [episodes.names[number] for number in episodes.driver[marked]]
    if missing := sorted(set(asked) - set(answers)):
        raise ValueError(f"the preferences lack {', '.join(missing)}; add them to the file")
    values = np.array([float(answers[name]) for name in asked])
    inside = (values >= 0) & (values <= 1)
    if not inside.all():
        raise ValueError(f"a preference lies in [0, 1], but got {values[~inside][0]:g}")
    return values


def read_preferences(path: Path) -> dict[str, float]:
    """Read people's answers from a JSON file {"name": number in [0, 1], ...}.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file contains something else.
    """
    content = read_json(path)
    try:
        return dict(read_value(dict[str, float], content, "preference"))
    except ValueError as error:
        raise ValueError(
            f'{path} does not contain {{"name": number in [0, 1], ...}}: {error}'
        ) from None
