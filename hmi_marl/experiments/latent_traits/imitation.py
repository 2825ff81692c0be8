r"""Compare the policy :math:`π(a | s, z)` that was learned from drivers with the drivers.

**Likelihood.** How likely the policy finds their actions, with z from *other* windows of the same
driver, so that z holds the driver and not the actions. The likelihood has an exact bound. Actions
are drawn from :math:`p_k(v_t | v_{<t}, \text{seed}, a^A)`, which the Bayes filter of the true
driver k computes, so by Gibbs' inequality

.. math::
    \mathbb{E}[\log p_k(v_t | ...)] \ge \mathbb{E}[\log π(v_t | s_t, z)]

for any policy whose situation follows from the same, as ours does.

**Driving.** Recorded episodes are replayed for speeds and gaps that were not recorded
(:func:`replay`); the policy drives fresh ones, given the driver's z (:func:`imitate`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.agents.learned.situations import EXTRA, LONG_AGO, situations
from hmi_marl.agents.learned.trait_encoder import Latent
from hmi_marl.agents.learned.trait_model import TraitModel
from hmi_marl.agents.memory import Draws
from hmi_marl.demonstrations.dataset import MISSING, Observed, alert_rate
from hmi_marl.demonstrations.env import team_of
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.streams import Stream, mix
from hmi_marl.envs.worlds import VEHICLE_ACTIONS
from hmi_marl.exact.identify import Identification
from hmi_marl.reporting import statistics
from hmi_marl.reporting.statistics import Estimate
from hmi_marl.training.traits.rollouts import Drives, drive

KEEP_SPEED = VEHICLE_ACTIONS.index("keep_speed")
LANE_CHANGES = [VEHICLE_ACTIONS.index(name) for name in ("move_left", "move_right")]


@dataclass(frozen=True)
class ActionLikelihood:
    """Mean log-likelihood per step of one driver's actions [nats], over pools of windows.

    Windows count as they are, a crashed car that stands until the end included.
    """

    driver: str
    pools: int
    own: Estimate
    """Log π(v_t | s_t, z), z from another pool of this driver."""
    other: Estimate
    """The same with z from a pool of another driver."""
    own_minus_other: Estimate
    """Paired by pool: the policy's gain from this driver's z."""
    exact: Estimate | None = None
    """Log evidence of the true driver, which no policy exceeds except by chance."""
    exact_minus_own: Estimate | None = None
    """Paired by pool: distance from the bound."""


def pool_latents(model: TraitModel, observed: Observed, pools: ArrayLike) -> Latent:
    """Infer q(z | τ) of P pools of n windows each, indices of shape (P, n).

    Raises:
        ValueError: see :meth:`Encoder.encode`; or a pool that is not of one known driver.
    """
    places, _ = checked_pools(observed, pools)
    used, where = np.unique(places, return_inverse=True)
    return model.latents(model.encode(observed.take(used)), where.reshape(places.shape))


def driver_latents(model: TraitModel, observed: Observed) -> dict[str, NDArray[np.float64]]:
    """Return the posterior mean of z, shape (Z,), given all windows of each known driver."""
    windows = {
        observed.names[who]: np.flatnonzero(observed.driver == who)
        for who in np.unique(observed.driver[observed.driver != MISSING])
    }
    return {name: pool_latents(model, observed, own[None]).mean[0] for name, own in windows.items()}


def checked_pools(
    observed: Observed, pools: ArrayLike
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return pools as indices of windows, (P, n), and their drivers, indices of names, (P,).

    Raises:
        ValueError: no such indices, or windows of different or unknown drivers in a pool.
    """
    places = np.asarray(pools)
    if places.ndim != 2 or places.size == 0 or not np.issubdtype(places.dtype, np.integer):
        raise ValueError(
            f"pools are indices of windows, integers of shape (P, n), but got {places.dtype} of "
            f"shape {places.shape}"
        )
    if places.min() < 0 or places.max() >= len(observed):
        raise ValueError(f"indices of windows lie in 0 to {len(observed) - 1}")
    drivers = observed.driver[places]
    if (drivers != drivers[:, :1]).any() or (drivers == MISSING).any():
        raise ValueError("all windows of a pool are of one driver who is known")
    return places.astype(np.int64), drivers[:, 0]


def action_likelihood(
    model: TraitModel,
    observed: Observed,
    pools: ArrayLike,
    identification: Identification | None = None,
) -> list[ActionLikelihood]:
    """Measure how likely each driver's actions are to the policy, given z of other windows.

    Pool j of a driver is judged with z of their pool j - 1 (the last, for the first), and with z of
    a pool of each other driver in turn.

    Args:
        model: encoder and policy.
        observed: E demonstrations.
        pools: indices of windows, shape (P, n): two or more for each of two or more drivers, and
            no window twice, so that z never comes from windows that are judged.
        identification: evidence of these E windows for candidates, for the exact bound; its
            drivers have the names that the demonstrations give them.

    Raises:
        ValueError: other pools, or an identification of other windows or drivers.
    """
    places, whose = checked_pools(observed, pools)
    drivers, counts = np.unique(whose, return_counts=True)
    if len(np.unique(places)) < places.size:
        raise ValueError("a window is in the pools twice, so z may come from windows it is for")
    if len(drivers) < 2 or counts.min() < 2:
        raise ValueError("there are two pools or more of each driver, and two drivers or more")
    z = pool_latents(model, observed, places).mean
    exact = None if identification is None else _exact(observed, places, whose, identification)
    by_who = [np.flatnonzero(whose == who) for who in drivers]
    rows = []
    for place, (who, own) in enumerate(zip(drivers, by_who, strict=True)):
        turns = (place + 1 + np.arange(len(own)) % (len(drivers) - 1)) % len(drivers)
        others = [by_who[k][j % len(by_who[k])] for j, k in enumerate(turns)]
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
    """Average log π(v_t | s_t, z) over the steps of these windows."""
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
    """Return the log evidence per step of each pool's true driver, shape (P,)."""
    known = [driver.name for driver in identification.drivers]
    missing = [observed.names[who] for who in np.unique(whose) if observed.names[who] not in known]
    if missing:
        raise ValueError(f"{missing[0]} drove, but is not among the candidates {', '.join(known)}")
    if len(identification.log_evidence) != len(observed):
        raise ValueError(
            f"the evidence is of {len(identification.log_evidence)} windows, but there are "
            f"{len(observed)}"
        )
    columns = np.array([known.index(observed.names[who]) for who in whose])
    total = identification.log_evidence[places, columns[:, None]].sum(axis=1)
    if (total == -np.inf).any():
        who = observed.names[whose[np.argmin(total)]]
        raise ValueError(f"by the evidence {who} cannot have driven the windows labelled {who}")
    return np.asarray(total / observed.length[places].sum(axis=1), np.float64)


# Driving.


@dataclass(frozen=True)
class Driving:
    """Driving of a driver, or of the policy with their z: means over drives, up to a crash."""

    drives: int
    speed: Estimate
    """[m/s]"""
    headway: Estimate
    """Median time headway while a vehicle is ahead [s]."""
    lane_changes: Estimate
    """Applied actions move_left or move_right, per minute."""
    repeated: Estimate
    """Share of steps with v_t = v_{t-1}."""
    alert_effect: Estimate
    """The same in steps with an alert, less that in steps without one for ``LONG_AGO`` steps."""
    crash_rate: Estimate


@dataclass(frozen=True)
class DrivingRow:
    """A driver, and the policy that imitates them."""

    driver: str
    demonstrated: Driving
    imitated: Driving


def recorded_actions(observed: Observed, horizon: int) -> NDArray[np.int64]:
    """Return v_t as recorded, then keep_speed up to ``horizon`` steps, shape (E, horizon)."""
    actions = np.full((len(observed), horizon), KEEP_SPEED)
    taken = observed.steps_taken
    actions[:, : taken.shape[1]][taken] = observed.actions[taken]
    return actions


def seeds_of(observed: Observed) -> NDArray[np.uint64]:
    """Return the episodes' seeds, or raise ``ValueError`` if there are none."""
    if observed.seeds is None:
        raise ValueError("recorded drives have no seeds, so they cannot be replayed")
    return observed.seeds


def following(actions: NDArray[np.int64]) -> Callable[[NDArray[np.float32]], NDArray[np.int64]]:
    """Return a function that takes these actions (N, T) step by step in any situation."""
    steps = iter(actions.T)
    return lambda situations: next(steps)


def replay(observed: Observed) -> Drives:
    """Replay recorded episodes with the actions and alerts that were recorded.

    The reward takes the applied action for the intended one: a lane change that a distracted
    driver repeats costs again.

    Raises:
        ValueError: there are no seeds, or the drives now end differently, so the demonstrations
            are of another version of the environment.
    """
    config, seeds = team_of(observed), seeds_of(observed)
    drives = drive(config, following(recorded_actions(observed, config.horizon)), 0.0, seeds)
    if (drives.crashed != observed.crashed).any():
        raise ValueError(
            "replayed demonstrations do not crash where they did; they are of another version"
        )
    alerts = np.zeros_like(drives.alerts)
    alerts[:, : observed.alerts.shape[1]] = observed.alerts
    x = situations(drives.situations[..., :-EXTRA], drives.actions, alerts)
    return replace(drives, situations=x, alerts=alerts)


def drive_policy(
    model: TraitModel,
    config: TeamConfig,
    alert_rate: float,
    z: NDArray[np.float64],
    seeds: NDArray[np.uint64],
) -> Drives:
    """Drive with actions drawn from π(a | s, z), for z of shape (Z,) or (N, Z) and N seeds.

    Draws of a drive depend on its own seed alone.
    """
    draws = Draws(Stream.DRIVER_POLICY)
    draws.reset(seeds)

    def act(x: NDArray[np.float32]) -> NDArray[np.int64]:
        below = np.cumsum(np.exp(model.policy(x, z)), axis=1)[:, :-1]
        return (draws.next()[:, None] >= below).sum(axis=1)

    return drive(config, act, alert_rate, seeds)


def imitate(
    model: TraitModel, observed: Observed, z: Mapping[str, ArrayLike], episodes: int, seed: int
) -> dict[str, Drives]:
    """Let the policy drive fresh episodes, the same ones with each driver's z, shape (Z,).

    Teams' settings and their rate of alerts are those of the demonstrations.

    Raises:
        ValueError: no episodes, a z of another size, or a model for other states.
    """
    if episodes < 1:
        raise ValueError(f"there is at least one episode, but got {episodes}")
    check_fits(model, observed)
    config, rate = team_of(observed), alert_rate(observed)
    seeds = mix(seed, Stream.EPISODE, np.arange(episodes))
    return {
        name: drive_policy(model, config, rate, checked_z(model, name, one), seeds)
        for name, one in z.items()
    }


def check_fits(model: TraitModel, observed: Observed) -> None:
    """Raise ``ValueError`` unless the model reads states like those of the demonstrations."""
    shown = tuple((part.name, part.size) for part in observed.layout.parts)
    if model.card.reads != shown:
        raise ValueError(
            f"this trait model reads states of {model.card.reads}, but the demonstrations have "
            f"{shown}; use the scene that it was trained on"
        )


def checked_z(model: TraitModel, name: str, z: ArrayLike) -> NDArray[np.float64]:
    """Return a driver's z as an array of shape (Z,), or raise ``ValueError``."""
    value = np.asarray(z, np.float64)
    if value.shape != (model.card.latent,) or not np.isfinite(value).all():
        raise ValueError(f"z of {name} is {model.card.latent} finite numbers, not {z!r}")
    return value


def by_driver(drives: Drives, labels: Sequence[str | None]) -> dict[str, Drives]:
    """Group drives by driver; those labelled None are left out."""
    names = np.array([label or "" for label in labels])
    return {
        name: Drives(**{key: value[names == name] for key, value in vars(drives).items()})
        for name in dict.fromkeys(label for label in labels if label is not None)
    }


def compare_driving(
    demonstrated: Mapping[str, Drives], imitated: Mapping[str, Drives], policy_frequency: int
) -> list[DrivingRow]:
    """Compare each driver's driving with the policy's, given their z; ``policy_frequency`` in Hz.

    Raises:
        ValueError: the drivers differ.
    """
    if set(demonstrated) != set(imitated):
        odd = ", ".join(sorted(set(demonstrated) ^ set(imitated)))
        raise ValueError(f"driving is compared over the same drivers, but only one has {odd}")
    return [
        DrivingRow(name, *(driving(each, policy_frequency) for each in (drives, imitated[name])))
        for name, drives in demonstrated.items()
    ]


def driving(drives: Drives, policy_frequency: int) -> Driving:
    """Summarise N drives."""
    steps = drives.speed.shape[1]
    moving = steps - (drives.speed > 0)[:, ::-1].argmax(axis=1)  # a crashed car stands at 0 m/s
    driven = np.where(drives.crashed, moving, steps)
    on = np.arange(steps) < driven[:, None]
    changes = (np.isin(drives.actions, LANE_CHANGES) & on).sum(axis=1)
    same = drives.actions[:, 1:] == drives.actions[:, :-1]
    since = drives.situations[:, 1:, -LONG_AGO - 1 :]
    alerted, quiet = (_share(same, on[:, 1:] & (since[..., k] == 1)) for k in (0, LONG_AGO))
    headway = np.where(on, drives.headway, np.inf)
    return Driving(
        drives=len(driven),
        speed=statistics.mean(_share(drives.speed, on), lowest=0.0),
        headway=statistics.mean(
            [np.median(one[np.isfinite(one)]) for one in headway if np.isfinite(one).any()],
            lowest=0.0,
        ),
        lane_changes=statistics.mean(changes * 60.0 * policy_frequency / driven, lowest=0.0),
        repeated=statistics.mean(_share(same, on[:, 1:]), lowest=0.0),
        alert_effect=statistics.mean(alerted - quiet),
        crash_rate=statistics.share(int(drives.crashed.sum()), len(driven)),
    )


def _share(values: NDArray[Any], where: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Average each row's values where marked, shape (N,); NaN if nowhere."""
    count = where.sum(axis=1)
    total = np.where(where, values, 0).sum(axis=1).astype(np.float64)
    return np.divide(total, count, out=np.full(len(count), np.nan), where=count > 0)
