"""Driving by the policy that was learned from a driver, beside the driver's own.

Recorded episodes are played again, to know of speeds and gaps what was not recorded
(:func:`replay`); the policy drives fresh ones, given the driver's z (:func:`imitate`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.agents.learned.situations import EXTRA, LONG_AGO, situations
from hmi_marl.agents.learned.trait_model import TraitModel
from hmi_marl.agents.memory import Draws
from hmi_marl.demonstrations.dataset import Observed, alert_rate
from hmi_marl.demonstrations.env import team_of
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.streams import Stream, mix
from hmi_marl.envs.worlds import VEHICLE_ACTIONS
from hmi_marl.reporting import statistics
from hmi_marl.reporting.statistics import Estimate
from hmi_marl.training.traits.rollouts import Drives, drive

KEEP_SPEED = VEHICLE_ACTIONS.index("keep_speed")
LANE_CHANGES = [VEHICLE_ACTIONS.index(name) for name in ("move_left", "move_right")]


@dataclass(frozen=True)
class Driving:
    """How a driver, or the policy with their z, drives: means over drives, up to a crash."""

    drives: int
    speed: Estimate
    """[m/s]"""
    headway: Estimate
    """Median time headway while somebody is ahead [s]."""
    lane_changes: Estimate
    """Applied actions move_left or move_right, per minute."""
    repeated: Estimate
    """Share of steps with v_t = v_{t-1}."""
    alert_effect: Estimate
    """The same in steps with an alert, less that in steps without one for ``LONG_AGO`` steps."""
    crash_rate: Estimate

    def as_json(self) -> dict[str, Any]:
        """JSON content."""
        return {
            name: value.as_json() if isinstance(value, Estimate) else value
            for name, value in vars(self).items()
        }


@dataclass(frozen=True)
class DrivingRow:
    """A driver beside the policy that imitates them."""

    driver: str
    demonstrated: Driving
    imitated: Driving

    def as_json(self) -> dict[str, Any]:
        """JSON content."""
        both = {"demonstrated": self.demonstrated, "imitated": self.imitated}
        return {"driver": self.driver} | {name: each.as_json() for name, each in both.items()}


def recorded_actions(observed: Observed, horizon: int) -> NDArray[np.int64]:
    """v_t as recorded, then keep_speed to the end of ``horizon`` steps, shape (E, horizon)."""
    actions = np.full((len(observed), horizon), KEEP_SPEED)
    taken = observed.steps_taken
    actions[:, : taken.shape[1]][taken] = observed.actions[taken]
    return actions


def seeds_of(observed: Observed) -> NDArray[np.uint64]:
    """The episodes' seeds, or ``ValueError`` where there are none."""
    if observed.seeds is None:
        raise ValueError("recorded drives have no seeds, so they cannot be played again")
    return observed.seeds


def following(actions: NDArray[np.int64]) -> Callable[[NDArray[np.float32]], NDArray[np.int64]]:
    """Takes these actions (N, T) step by step, whatever the situation."""
    steps = iter(actions.T)
    return lambda situations: next(steps)


def replay(observed: Observed) -> Drives:
    """Recorded episodes played again, with the actions and alerts that were recorded.

    The reward takes what was applied for what was intended: a lane change that a distracted driver
    repeats costs again.

    Raises:
        ValueError: there are no seeds, or the drives now end otherwise, so that the demonstrations
            are of another version of the environment.
    """
    config, seeds = team_of(observed), seeds_of(observed)
    drives = drive(config, following(recorded_actions(observed, config.horizon)), 0.0, seeds)
    if (drives.crashed != observed.crashed).any():
        raise ValueError("played again, the demonstrations do not crash where they did")
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
    """Drives with actions drawn from π(a | s, z), for z of shape (Z,) or (N, Z) and N seeds.

    What is drawn in a drive depends on its own seed alone.
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
    """The policy drives fresh episodes, the same ones with each driver's z.

    Args:
        model: whose policy drives.
        observed: demonstrations, for how their teams were set up and how often alerts sounded.
        z: of each driver, shape (Z,).
        episodes: for each.
        seed: of all of them.

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
    """Raise ``ValueError`` unless the model reads states such as the demonstrations'."""
    shown = tuple((part.name, part.size) for part in observed.layout.parts)
    if model.card.reads != shown:
        raise ValueError(
            f"this trait model reads states of {model.card.reads}, but the demonstrations have "
            f"{shown}; use the scene that it was trained on"
        )


def checked_z(model: TraitModel, name: str, z: ArrayLike) -> NDArray[np.float64]:
    """A driver's z as an array of shape (Z,), or ``ValueError``."""
    value = np.asarray(z, np.float64)
    if value.shape != (model.card.latent,) or not np.isfinite(value).all():
        raise ValueError(f"z of {name} is {model.card.latent} finite numbers, not {z!r}")
    return value


def of_drivers(drives: Drives, labels: Sequence[str | None]) -> dict[str, Drives]:
    """Drives apart by whose they are; those of None are left out."""
    names = np.array([label or "" for label in labels])
    return {
        name: Drives(**{key: value[names == name] for key, value in vars(drives).items()})
        for name in dict.fromkeys(label for label in labels if label is not None)
    }


def compare_driving(
    demonstrated: Mapping[str, Drives], imitated: Mapping[str, Drives], policy_frequency: int
) -> list[DrivingRow]:
    """Each driver's driving beside that of the policy with their z.

    Args:
        demonstrated, imitated: drives of each driver, the same drivers.
        policy_frequency: steps per second.

    Raises:
        ValueError: other drivers in one than in the other.
    """
    if set(demonstrated) != set(imitated):
        odd = ", ".join(sorted(set(demonstrated) ^ set(imitated)))
        raise ValueError(f"drives of the same drivers can be compared, but only one has {odd}")
    return [
        DrivingRow(
            name,
            driving(drives, policy_frequency),
            driving(imitated[name], policy_frequency),
        )
        for name, drives in demonstrated.items()
    ]


def driving(drives: Drives, policy_frequency: int) -> Driving:
    """How these N drives went."""
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
    """Mean of each row's values where marked, shape (N,); NaN if nowhere."""
    count = where.sum(axis=1)
    total = np.where(where, values, 0).sum(axis=1).astype(np.float64)
    return np.divide(total, count, out=np.full(len(count), np.nan), where=count > 0)
