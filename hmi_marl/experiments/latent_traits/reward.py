r"""Whether the reward that was recovered ranks driving as the true one does.

Windows of one driver are ranked by three undiscounted returns: the true driving return, and with
the driver's z the recovered

.. math::
    F = \sum_{t=0}^{T-2} f(s_t, a_t, s_{t+1}, z), \quad G = \sum_{t=0}^{T-2} g(s_t, a_t, z)

All windows have T steps, those included in which a crashed car stands. A reward is recovered up to
scale, so ranks are compared: Spearman's correlation. Within demonstrations all drive about equally
well, which makes it hard; over a mixture with worse driving, bad must be told from good.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from hmi_marl.agents.learned.trait_model import TraitModel
from hmi_marl.agents.memory import Draws
from hmi_marl.demonstrations.dataset import Observed, alert_rate
from hmi_marl.demonstrations.env import team_of
from hmi_marl.envs.streams import Stream, mix
from hmi_marl.envs.worlds import VEHICLE_ACTIONS
from hmi_marl.experiments.latent_traits.driving import (
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
"""How likely a random action takes the place of a recorded one; at 1 all are random."""
DEMONSTRATED, LEARNED = "demonstrated", "learned"
_BOOTSTRAPS = 1000
_AT_ONCE = 512
"""Windows rewarded at once; bounds memory."""
_NUMBERS = 2**20
"""Ranked at once; bounds memory."""


class Returns(NamedTuple):
    """What N windows are worth. Arrays have shape (N,)."""

    true: NDArray[np.float64]
    """True driving return."""
    f: NDArray[np.float64]
    """F, with the shaping."""
    g: NDArray[np.float64]
    """G, without."""


@dataclass(frozen=True)
class Ranks:
    """Spearman correlations with the true driving return; NaN where one of the two is constant."""

    f: Estimate
    """Of F."""
    g: Estimate
    """Of G."""

    def as_json(self) -> dict[str, Any]:
        """Both, each with its interval."""
        return {"f": self.f.as_json(), "g": self.g.as_json()}


@dataclass(frozen=True)
class RewardRanking:
    """How one driver's recovered reward ranks windows."""

    driver: str
    episodes: int
    """Demonstrated windows. Each was driven again in every other way."""
    demonstrated: Ranks
    """Within the demonstrations."""
    mixture: Ranks
    """Over all ways to drive together."""
    returns: Mapping[str, Mapping[str, Estimate]]
    """Mean true, f and g return of each way to drive."""

    def as_json(self) -> dict[str, Any]:
        """JSON content."""
        return {
            "driver": self.driver,
            "episodes": self.episodes,
            "demonstrated": self.demonstrated.as_json(),
            "mixture": self.mixture.as_json(),
            "returns": {
                way: {name: value.as_json() for name, value in values.items()}
                for way, values in self.returns.items()
            },
        }


def reward_ranking(
    model: TraitModel, observed: Observed, z: Mapping[str, ArrayLike], seed: int = 0
) -> list[RewardRanking]:
    """How the recovered reward ranks each driver's demonstrations, and worse driving beside them.

    Args:
        model: reward and policy.
        observed: demonstrations that can be played again.
        z: of each driver who is to be looked at, shape (Z,).
        seed: of random actions and resampling.

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
        theirs = observed.take(own)
        ways = {
            way: returns_of(model, drives, value)
            for way, drives in ways_to_drive(model, theirs, value, seed).items()
        }
        rows.append(
            RewardRanking(
                name,
                len(theirs),
                _ranks([ways[DEMONSTRATED]], seed),
                _ranks(list(ways.values()), seed),
                {
                    way: {key: statistics.mean(each) for key, each in told._asdict().items()}
                    for way, told in ways.items()
                },
            )
        )
    return rows


def ways_to_drive(
    model: TraitModel, observed: Observed, z: NDArray[np.float64], seed: int
) -> dict[str, Drives]:
    """The same E episodes as demonstrated, by the policy given z (Z,), and with random actions.

    Random actions take the place of recorded ones in each step with the probabilities ``NOISE``.
    What is recorded goes on as if nothing had happened, so that these drives do not depend on the
    model, and models can be compared.
    """
    config, rate, seeds = team_of(observed), alert_rate(observed), seeds_of(observed)
    recorded = recorded_actions(observed, config.horizon)
    drives = {
        DEMONSTRATED: replay(observed),
        LEARNED: drive_policy(model, config, rate, z, seeds),
    }
    for share in NOISE:
        noisy = with_noise(recorded, share, mix(seeds, Stream.LEARNING, seed))
        drives[way_of(share)] = drive(config, following(noisy), rate, seeds)
    return drives


def way_of(share: float) -> str:
    """The name of driving with this share of random actions."""
    return "random" if share == 1.0 else f"{share:.0%} random"


def with_noise(
    actions: NDArray[np.int64], share: float, seeds: NDArray[np.uint64]
) -> NDArray[np.int64]:
    """Actions (E, T) of which each is replaced by a random one with probability ``share`` > 0.

    What is drawn for an episode depends on its seed alone, and steps that are replaced at one share
    are replaced at every larger one.
    """
    draws = Draws(Stream.LEARNING)
    draws.reset(seeds)
    drawn = np.stack([draws.next() for _ in range(actions.shape[1])], axis=1)
    # Where drawn < share, drawn / share is even over [0, 1) again.
    anything = (drawn / share * len(VEHICLE_ACTIONS)).astype(np.int64)
    return np.where(drawn < share, anything, actions)


def returns_of(model: TraitModel, drives: Drives, z: NDArray[np.float64]) -> Returns:
    """True and recovered returns of N drives, given z of shape (Z,)."""
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
    """Spearman's correlation of two arrays of shape (W, E), all W x E pairs of numbers together.

    The interval is of percentiles over resampled columns, which are episodes: what W ways to drive
    come to in one traffic is not independent.

    Args:
        one, other: shape (W, E).
        seed: of resampling.

    Returns:
        NaN where one of the two is constant.
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
    low, high = np.nanquantile(np.concatenate(drawn), [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return Estimate(found, float(low), float(high))


def _spearman(one: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of each row of (B, M) with the same of the other, shape (B,); NaN where one is constant."""
    a, b = (stats.rankdata(values, axis=1) - (values.shape[1] + 1) / 2 for values in (one, other))
    spread = np.sqrt((a**2).sum(axis=1) * (b**2).sum(axis=1))
    return np.divide((a * b).sum(axis=1), spread, out=np.full(len(a), math.nan), where=spread > 0)
