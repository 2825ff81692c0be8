r"""Compare how the recovered reward and the true one rank driving.

Windows of one driver are ranked by three undiscounted returns: the true driving return and, given
the driver's z, the recovered

.. math::
    F = \sum_{t=0}^{T-2} f(s_t, a_t, s_{t+1}, z), \quad G = \sum_{t=0}^{T-2} g(s_t, a_t, z)

All windows have T steps, including those in which a crashed car stands. A reward is recovered up
to scale, so ranks are compared: Spearman's correlation. Within demonstrations all drive about
equally well, which makes it hard; in a mixture with worse driving, good must be ranked above bad.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.agents.learned.trait_model import TraitModel
from hmi_marl.agents.memory import Draws
from hmi_marl.demonstrations.dataset import Observed, alert_rate
from hmi_marl.demonstrations.env import team_of
from hmi_marl.envs.streams import Stream, mix
from hmi_marl.envs.worlds import VEHICLE_ACTIONS
from hmi_marl.experiments.latent_traits.imitation import (
    check_fits,
    checked_z,
    drive_policy,
    following,
    recorded_actions,
    replay,
    seeds_of,
)
from hmi_marl.reporting import statistics
from hmi_marl.reporting.statistics import CONFIDENCE, Estimate
from hmi_marl.training.traits.rollouts import Drives, drive

NOISE = (0.1, 0.3, 1.0)
"""Probabilities that a random action replaces a recorded one; at 1 all are random."""
DEMONSTRATED, LEARNED = "demonstrated", "learned"
_BOOTSTRAPS = 1000
_AT_ONCE = 512
"""Windows rewarded at once; bounds memory."""
_NUMBERS = 2**20
"""Ranked at once; bounds memory."""


class Returns(NamedTuple):
    """Returns of N windows. Arrays have shape (N,)."""

    true: NDArray[np.float64]
    """True driving return."""
    f: NDArray[np.float64]
    """F, with shaping."""
    g: NDArray[np.float64]
    """G, without shaping."""


@dataclass(frozen=True)
class Ranks:
    """Spearman correlations with the true driving return; NaN where one of the two is constant."""

    f: Estimate
    """Correlation of F."""
    g: Estimate
    """Correlation of G."""


@dataclass(frozen=True)
class RewardRanking:
    """Rank correlations of one driver's recovered reward."""

    driver: str
    episodes: int
    """Demonstrated windows. Each is driven again in every other way."""
    demonstrated: Ranks
    """Within the demonstrations."""
    mixture: Ranks
    """Over all ways to drive together."""
    returns: Mapping[str, Mapping[str, Estimate]]
    """Mean true, f and g return of each way to drive."""


def reward_ranking(
    model: TraitModel, observed: Observed, z: Mapping[str, ArrayLike], seed: int = 0
) -> list[RewardRanking]:
    """Rank each driver's demonstrations, and worse driving, by the recovered reward given z (Z,).

    ``seed`` is that of random actions and resampling.

    Raises:
        ValueError: a driver without two demonstrations or more, a z of another size, a model for
            other states, or demonstrations without seeds.
    """
    check_fits(model, observed)
    labels, rows = np.array([label or "" for label in observed.labels()]), []
    for name, one in z.items():
        value, own = checked_z(model, name, one), np.flatnonzero(labels == name)
        if len(own) < 2:
            raise ValueError(f"ranks take two demonstrations or more, but {name} has {len(own)}")
        windows = observed.take(own)
        ways = {
            way: returns_of(model, drives, value)
            for way, drives in ways_to_drive(model, windows, value, seed).items()
        }
        rows.append(
            RewardRanking(
                name,
                len(windows),
                _ranks([ways[DEMONSTRATED]], seed),
                _ranks(list(ways.values()), seed),
                {
                    way: {key: statistics.mean(each) for key, each in returns._asdict().items()}
                    for way, returns in ways.items()
                },
            )
        )
    return rows


def ways_to_drive(
    model: TraitModel, observed: Observed, z: NDArray[np.float64], seed: int
) -> dict[str, Drives]:
    """Drive the same E episodes as demonstrated, by the policy given z (Z,), and at random.

    Random actions replace recorded ones in each step with the probabilities ``NOISE``. The other
    recorded actions stay as they are, so that these drives do not depend on the model, and models
    can be compared.
    """
    config, rate, seeds = team_of(observed), alert_rate(observed), seeds_of(observed)
    recorded = recorded_actions(observed, config.horizon)
    drives = {DEMONSTRATED: replay(observed), LEARNED: drive_policy(model, config, rate, z, seeds)}
    for share in NOISE:
        noisy = with_noise(recorded, share, mix(seeds, Stream.LEARNING, seed))
        drives[way_of(share)] = drive(config, following(noisy), rate, seeds)
    return drives


def way_of(share: float) -> str:
    """Name driving with this share of random actions."""
    return "random" if share == 1.0 else f"{share:.0%} random"


def with_noise(
    actions: NDArray[np.int64], share: float, seeds: NDArray[np.uint64]
) -> NDArray[np.int64]:
    """Replace each of the actions (E, T) by a random one with probability ``share`` > 0.

    Draws of an episode depend on its seed alone, and steps that are replaced at one share are
    replaced at every larger one.
    """
    draws = Draws(Stream.LEARNING)
    draws.reset(seeds)
    drawn = np.stack([draws.next() for _ in range(actions.shape[1])], axis=1)
    # Where drawn < share, drawn / share is even over [0, 1) again.
    anything = (drawn / share * len(VEHICLE_ACTIONS)).astype(np.int64)
    return np.where(drawn < share, anything, actions)


def returns_of(model: TraitModel, drives: Drives, z: NDArray[np.float64]) -> Returns:
    """Compute true and recovered returns of N drives, given z of shape (Z,)."""
    count, steps = drives.actions.shape
    f, g = np.zeros((2, count))
    for start in range(0, count, _AT_ONCE):
        part = slice(start, start + _AT_ONCE)
        x, actions = drives.situations[part], drives.actions[part, :-1].ravel()
        before, after = (s.reshape(-1, x.shape[2]) for s in (x[:, :-1], x[:, 1:]))
        shape = -1, steps - 1
        f[part] = model.reward(before, actions, after, z).reshape(shape).sum(axis=1)
        g[part] = model.base_reward(before, actions, z).reshape(shape).sum(axis=1)
    return Returns(drives.driving_return, f, g)


def _ranks(several: Sequence[Returns], seed: int) -> Ranks:
    true, f, g = (np.stack(values) for values in zip(*several, strict=True))
    return Ranks(rank_correlation(f, true, seed), rank_correlation(g, true, seed))


def rank_correlation(
    one: NDArray[np.float64], other: NDArray[np.float64], seed: int = 0
) -> Estimate:
    """Correlate two arrays of shape (W, E) by Spearman, all W x E pairs together; NaN if constant.

    The interval is of percentiles over resampled columns, which are episodes: W ways to drive in
    the same traffic are not independent.
    """
    found = float(_spearman(one.reshape(1, -1), other.reshape(1, -1))[0])
    if math.isnan(found):
        return Estimate(math.nan, math.nan, math.nan)
    rng, count = np.random.default_rng(seed), one.shape[1]
    at_once = max(1, _NUMBERS // one.size)
    drawn = []
    for start in range(0, _BOOTSTRAPS, at_once):
        which = rng.integers(0, count, (min(at_once, _BOOTSTRAPS - start), count))
        resampled = (np.moveaxis(values[:, which], 1, 0) for values in (one, other))
        drawn.append(_spearman(*(values.reshape(len(which), -1) for values in resampled)))
    values = np.concatenate(drawn)
    low, high = np.nanquantile(values, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return Estimate(found, float(low), float(high), float(np.nanstd(values)), count)


def _spearman(one: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    """Correlate the rows of two arrays (B, M), shape (B,); NaN where one is constant."""
    from scipy import stats  # takes half a second

    a, b = (stats.rankdata(values, axis=1) - (values.shape[1] + 1) / 2 for values in (one, other))
    spread = np.sqrt((a**2).sum(axis=1) * (b**2).sum(axis=1))
    return np.divide((a * b).sum(axis=1), spread, out=np.full(len(a), math.nan), where=spread > 0)
