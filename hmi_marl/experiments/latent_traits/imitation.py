r"""How likely people's actions are to the policy :math:`π(a | s, z)` that was learned from them.

The z is from *other* windows of the same driver, so that it tells who drives and not what was done.
The likelihood has an exact bound. Actions are drawn from :math:`p_k(v_t | v_{<t}, \text{seed},
a^A)`, which the Bayes filter of the true driver k tells, so by Gibbs' inequality

.. math::
    \mathbb{E}[\log p_k(v_t | ...)] \ge \mathbb{E}[\log π(v_t | s_t, z)]

for any policy whose situation follows from the same, as ours does. Whether it drives as they do
when it drives by itself is for :mod:`hmi_marl.experiments.latent_traits.driving`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.agents.learned.situations import situations
from hmi_marl.agents.learned.trait_model import Latent, TraitModel
from hmi_marl.demonstrations.dataset import MISSING, Observed
from hmi_marl.exact.identify import Identification
from hmi_marl.reporting import statistics
from hmi_marl.reporting.statistics import Estimate


@dataclass(frozen=True)
class ActionLikelihood:
    """Mean log-likelihood per step of one driver's actions [nats], over pools of windows.

    Windows count as they are, a crashed car that stands until the end included.
    """

    driver: str
    pools: int
    own: Estimate
    """Of log π(v_t | s_t, z), z from another pool of this driver."""
    other: Estimate
    """z from a pool of another driver."""
    own_minus_other: Estimate
    """Paired by pool: what z tells the policy about the driver."""
    exact: Estimate | None = None
    """Log evidence of the true driver, which no policy can exceed but by luck."""
    exact_minus_own: Estimate | None = None
    """Paired by pool: what is missed."""

    def as_json(self) -> dict[str, Any]:
        """JSON content."""
        return {
            name: value.as_json() if isinstance(value, Estimate) else value
            for name, value in vars(self).items()
        }


def pool_latents(model: TraitModel, observed: Observed, pools: ArrayLike) -> Latent:
    """q(z | τ) of P pools of n windows each, places of shape (P, n).

    Raises:
        ValueError: see :meth:`TraitModel.encode`; or pools that are none of one known driver.
    """
    places, _ = checked_pools(observed, pools)
    used, where = np.unique(places, return_inverse=True)
    some = observed.take(used)
    hidden = model.encode(some.states, some.actions, some.alerts, some.length)
    return model.latent(hidden[where.reshape(places.shape)].mean(axis=1))


def driver_latents(model: TraitModel, observed: Observed) -> dict[str, NDArray[np.float64]]:
    """The posterior mean of z, shape (Z,), given all windows of each known driver."""
    windows = {
        observed.names[who]: np.flatnonzero(observed.driver == who)
        for who in np.unique(observed.driver[observed.driver != MISSING])
    }
    return {
        name: pool_latents(model, observed, theirs[None]).mean[0]
        for name, theirs in windows.items()
    }


def checked_pools(
    observed: Observed, pools: ArrayLike
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pools as places of windows, shape (P, n), and whose they are, indices of names, (P,).

    Raises:
        ValueError: no such places, or windows of different or unknown drivers in a pool.
    """
    places = np.asarray(pools)
    if places.ndim != 2 or places.size == 0 or not np.issubdtype(places.dtype, np.integer):
        raise ValueError(
            f"pools are places of windows, integers of shape (P, n), but got {places.dtype} of "
            f"shape {places.shape}"
        )
    if places.min() < 0 or places.max() >= len(observed):
        raise ValueError(f"places of windows lie in 0 to {len(observed) - 1}")
    whose = observed.driver[places]
    if (whose != whose[:, :1]).any() or (whose == MISSING).any():
        raise ValueError("all windows of a pool are of one driver who is known")
    return places.astype(np.int64), whose[:, 0]


def action_likelihood(
    model: TraitModel,
    observed: Observed,
    pools: ArrayLike,
    identification: Identification | None = None,
) -> list[ActionLikelihood]:
    """How likely each driver's actions are to the policy, given z of other windows.

    Pool j of a driver is judged with z of their pool j - 1 (the last, for the first), and with z of
    a pool of each other driver in turn.

    Args:
        model: encoder and policy.
        observed: E demonstrations.
        pools: places of windows, shape (P, n): two or more for each of two or more drivers, and no
            window twice, so that z never comes from windows that are judged.
        identification: what these E windows tell of candidates, for the exact bound; its drivers
            have the names that the demonstrations give them.

    Raises:
        ValueError: pools that are not so, or an identification of other windows or drivers.
    """
    places, whose = checked_pools(observed, pools)
    drivers, counts = np.unique(whose, return_counts=True)
    if len(np.unique(places)) < places.size:
        raise ValueError(
            "a window stands in the pools twice, so that z may come from what it is for"
        )
    if len(drivers) < 2 or counts.min() < 2:
        raise ValueError("there are two pools or more of each driver, and two drivers or more")
    z = pool_latents(model, observed, places).mean
    exact = None if identification is None else _exact(observed, places, whose, identification)
    theirs = [np.flatnonzero(whose == who) for who in drivers]
    rows = []
    for place, (who, own) in enumerate(zip(drivers, theirs, strict=True)):
        turns = (place + 1 + np.arange(len(own)) % (len(drivers) - 1)) % len(drivers)
        others = [theirs[k][j % len(theirs[k])] for j, k in enumerate(turns)]
        by_own, by_other = (
            np.array(
                [
                    _per_step(model, observed, places[j], z[k])
                    for j, k in zip(own, source, strict=True)
                ]
            )
            for source in (np.roll(own, 1), others)
        )
        rows.append(
            ActionLikelihood(
                observed.names[who],
                len(own),
                statistics.mean(by_own),
                statistics.mean(by_other),
                statistics.mean(by_own - by_other),
                None if exact is None else statistics.mean(exact[own]),
                None if exact is None else statistics.mean(exact[own] - by_own),
            )
        )
    return rows


def _per_step(
    model: TraitModel, observed: Observed, windows: NDArray[np.int64], z: NDArray[np.float64]
) -> float:
    """Mean log π(v_t | s_t, z) over the steps of these windows."""
    some = observed.take(windows)
    taken, x = some.steps_taken, situations(some.states, some.actions, some.alerts)
    done = some.actions[taken]
    return float(model.policy(x[taken], z)[np.arange(len(done)), done].mean())


def _exact(
    observed: Observed,
    places: NDArray[np.int64],
    whose: NDArray[np.int64],
    identification: Identification,
) -> NDArray[np.float64]:
    """Log evidence per step of each pool's true driver, shape (P,)."""
    known = [driver.name for driver in identification.drivers]
    missing = [observed.names[who] for who in np.unique(whose) if observed.names[who] not in known]
    if missing:
        raise ValueError(f"{missing[0]} drove, but is none of the candidates {', '.join(known)}")
    if len(identification.log_evidence) != len(observed):
        raise ValueError(
            f"the evidence is of {len(identification.log_evidence)} windows, but there are "
            f"{len(observed)}"
        )
    columns = np.array([known.index(observed.names[who]) for who in whose])
    told = identification.log_evidence[places, columns[:, None]].sum(axis=1)
    if (told == -np.inf).any():
        who = observed.names[whose[np.argmin(told)]]
        raise ValueError(f"by the evidence {who} cannot have driven what is told to be theirs")
    return np.asarray(told / observed.length[places].sum(axis=1), np.float64)
