"""Trips of people: an episode of the environment, kept as its seed and actions.

A trip replays to the same states to the last bit (:func:`replay`), and observers of the replay see
what observers of the trip saw::

    record = TripRecord.from_json(read_json(path))
    teaming = replay(record, observers=[recorder])

As JSON the configuration is written as in the stamps of demonstrations.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from datetime import datetime
from functools import cache
from typing import Annotated, Any, Literal, get_type_hints

import numpy as np
from numpy.typing import NDArray

import hmi_marl
from hmi_marl.agents.rollout import Observer, turn
from hmi_marl.checks import Check, Checked, Whole, shown
from hmi_marl.demonstrations.env import team_config
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import DriverList, TraitDistributions
from hmi_marl.envs.step_result import StepResult
from hmi_marl.envs.streams import Seed
from hmi_marl.envs.team_step import OF_BOTH
from hmi_marl.envs.teaming import Teaming
from hmi_marl.envs.worlds import VEHICLE_ACTIONS, World
from hmi_marl.files import json_value
from hmi_marl.typed_json import read_value

FORMAT = "hmi-marl trip 1"
Seat = Literal["driver", "vehicle_ai"]
Kind = Literal["free", "calibration", "trial"]
WorldName = Literal["batched", "highway"]
SEATS: tuple[Seat, ...] = ("driver", "vehicle_ai")
KINDS: tuple[Kind, ...] = ("free", "calibration", "trial")
TIME = "%Y-%m-%dT%H:%M:%SZ"
_TEXT = 200


def check_code(name: str, value: str) -> str:
    """Return a visitor's code: up to 64 letters, digits, - and _, or nothing.

    Raises:
        TypeError, ValueError: it is something else.
    """
    return _matching(name, value, r"[A-Za-z0-9_-]{0,64}", "up to 64 letters, digits, - and _")


def _matching(name: str, value: str, pattern: str, what: str) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{name} is a text, not {shown(value)}")
    if not re.fullmatch(pattern, value):
        raise ValueError(f"{name} is {what}, not {shown(value)}")
    return value


def _check_text(name: str, value: str) -> str:
    return _matching(name, value, f"[^\x00-\x1f\x7f\ud800-\udfff]{{0,{_TEXT}}}", "one short line")


def _check_digest(name: str, value: str) -> str:
    return _matching(name, value, r"[0-9a-f]{64}|", "a SHA-256 of 64 hexadecimal digits, or empty")


def _check_time(name: str, value: str) -> str:
    """Return a time in UTC to the second, such as 2026-01-31T12:00:00Z, or nothing."""
    what = "a time in UTC such as 2026-01-31T12:00:00Z, or empty"
    _matching(name, value, r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ|", what)
    try:
        if value:
            datetime.strptime(value, TIME)
    except ValueError:
        raise ValueError(f"{name} is {what}, not {shown(value)}") from None
    return value


Code = Annotated[str, Check(check_code)]
"""A random code that stands for a visitor."""
Line = Annotated[str, Check(_check_text)]
Time = Annotated[str, Check(_check_time)]
_Bit = Annotated[int, Whole(0, 1)]


@cache
def environment_stamp() -> str:
    """Fingerprint of the sources of the environment's step and of the batched world."""
    from hmi_marl.envs.worlds.batched.compiler import source_stamp  # numba is slow to import

    return source_stamp()[:16]


@dataclass(frozen=True)
class TripRecord(Checked):
    """One trip, finished or not: an episode of the environment up to its last step taken.

    Raises:
        ValueError, TypeError: a value out of its range; the message names it.
    """

    config: TeamConfig
    """Settings of the team; its driver is a list of drivers or distributions of traits."""
    seed: Seed
    """Seed of the episode, as :meth:`Teaming.reset` takes it."""
    seat: Seat
    """Seat of the person."""
    kind: Kind
    """Part of the visit that it belongs to."""
    partner: Line
    """Name of the policy in the other seat."""
    intents: tuple[Annotated[int, Whole(0, len(VEHICLE_ACTIONS) - 1)], ...]
    """a^H_t of L steps."""
    alerts: tuple[Annotated[int, Whole(0, 100)], ...]
    """a^A_t of L steps."""
    looking_away: tuple[_Bit, ...] | None
    """d_t of L steps as the second task showed it; None where the chain drew it."""
    crashed: bool
    """Whether the driven car is crashed after the last step."""
    world: WorldName = "batched"
    """World in which it took place."""
    digest: Annotated[str, Check(_check_digest)] = ""
    """SHA-256 of the states after every step, see :class:`StateDigest`; empty if not known."""
    visitor: Code = ""
    """Code of the person, who has no name here."""
    begun: Time = ""
    """Time of its beginning in UTC, such as 2026-01-31T12:00:00Z."""
    version: Line = hmi_marl.__version__
    """Version of the package."""
    stamp: Line = field(default_factory=environment_stamp)
    """See :func:`environment_stamp`."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.config.population, (DriverList, TraitDistributions)):
            raise ValueError(
                "config.driver of a trip is drivers or TraitDistributions, not "
                f"{shown(self.config.population)}"
            )
        if len(self.alerts) != len(self.intents):
            raise ValueError(
                f"a trip has as many alerts as intents, not {len(self.alerts)} and "
                f"{len(self.intents)}"
            )
        if self.looking_away is not None and len(self.looking_away) != len(self.intents):
            raise ValueError(
                f"looking_away has {len(self.intents)} steps, as intents, not "
                f"{len(self.looking_away)}"
            )
        if len(self.intents) > self.config.horizon:
            raise ValueError(
                f"a trip has at most {self.config.horizon} steps, not {len(self.intents)}"
            )
        strongest = self.config.alerts.choices - 1
        if max(self.alerts, default=0) > strongest:
            raise ValueError(f"alerts lie in 0 to {strongest}, but got {max(self.alerts)}")

    def __len__(self) -> int:
        return len(self.intents)

    @property
    def finished(self) -> bool:
        """Whether the episode has ended, by time or by a crash."""
        return len(self) == self.config.horizon or (self.crashed and self.config.end_at_crash)

    def to_json(self) -> dict[str, Any]:
        """Return the trip as JSON content."""
        return {"format": FORMAT} | json_value(self)

    @classmethod
    def from_json(cls, content: Any) -> TripRecord:
        """Make a trip from JSON content of others.

        Raises:
            ValueError: another format, a field that is missing, unknown, of another type or out of
                its range; the message names it.
        """
        if not isinstance(content, Mapping) or content.get("format") != FORMAT:
            raise ValueError(f"a trip is a mapping with the format {FORMAT!r}")
        given = {name: value for name, value in content.items() if name != "format"}
        wanted = {each.name for each in fields(cls)}
        if odd := sorted(map(str, wanted ^ set(given))):
            raise ValueError(f"a trip has not exactly its fields: {shown(odd)}")
        hints = get_type_hints(cls)
        values = {
            name: read_value(hints[name], value, name)
            for name, value in given.items()
            if name != "config"
        }
        try:
            return cls(config=_config(given["config"]), **values)
        except (ArithmeticError, AttributeError, TypeError) as error:
            raise ValueError(str(error)) from None


@dataclass(frozen=True)
class Progress:
    """Decisions of a trip from a step on, and where it stands after them."""

    first: int
    """Step of the first of them."""
    steps: tuple[tuple[int, int, int | None], ...]
    """a^H_t, a^A_t and d_t, or None where the chain drew it."""
    crashed: bool
    digest: str
    """See :class:`StateDigest`."""
    finished: bool
    """Whether the episode has ended."""


def _config(content: Any) -> TeamConfig:
    if not isinstance(content, Mapping) or "driver" not in content:
        raise ValueError("config is a mapping with a driver")
    config = team_config(content)
    if odd := set(json_value(config)) ^ set(content):
        raise ValueError(f"config has not exactly its fields: {shown(sorted(map(str, odd)))}")
    return config


class StateDigest(Observer):
    """SHA-256 of what one team and all vehicles of its world are after every step.

    In the batched world it does not depend on the processor.
    """

    def __init__(self) -> None:
        self._digest = hashlib.sha256()

    def after(self, teaming: Teaming, result: StepResult) -> None:
        """Add the state of team 0."""
        snapshot, attention = teaming.world.snapshot(0), teaming.attention
        whole = [teaming.applied, attention.distracted, attention.accepted]
        whole += [attention.counter, attention.fatigue, snapshot.crashed.astype(np.int64)]
        rewards = result.table[0, :OF_BOTH]  # their sum says no more
        for numbers in (snapshot.position, snapshot.heading, snapshot.speed, rewards):
            self._digest.update(np.ascontiguousarray(numbers, "<f8").tobytes())
        for counts in whole:
            self._digest.update(np.ascontiguousarray(counts, "<i8").tobytes())

    def hexdigest(self) -> str:
        """Digest of the steps until now."""
        return self._digest.hexdigest()


class _Recorded:
    """The actions of one seat, one after the other."""

    reads: tuple[str, ...] = ()

    def __init__(self, actions: Sequence[int]) -> None:
        self._actions = iter(actions)

    def reset(self, seeds: NDArray[np.uint64], which: NDArray[np.bool_] | None = None) -> None:
        """Do nothing: they are actions of one episode."""

    def act(self, observations: NDArray[np.float32]) -> NDArray[np.int64]:
        """Return the next action."""
        return np.array([next(self._actions)])


class ReplayError(ValueError):
    """A trip that does not replay as it was, since another version recorded it."""


def replay(
    record: TripRecord, world: str | World | None = None, observers: Sequence[Observer] = ()
) -> Teaming:
    """Drive a trip again, step by step, and check that it goes and ends as recorded.

    Args:
        record: of the trip.
        world: name of the world, or a World with one copy of ``record.config.scene``; by default
            that of the trip.
        observers: watch each turn.

    Returns:
        The team after the last step.

    Raises:
        ReplayError: the episode ends earlier, its crash differs, or, in the world of the trip, a
            state; the message says which and by which version it was recorded.
    """
    world = record.world if world is None else world
    teaming, digest = Teaming(record.config, 1, world), StateDigest()
    teaming.reset([record.seed])
    driver, hmi = _Recorded(record.intents), _Recorded(record.alerts)
    for step in range(len(record)):
        if teaming.over[0]:
            raise _differs(record, f"it ends after {step} steps and not {len(record)}")
        away = None if record.looking_away is None else record.looking_away[step : step + 1]
        turn(teaming, driver, hmi, [digest, *observers], away)
    if bool(teaming.crashed[0]) != record.crashed:
        raise _differs(record, "it ends " + ("without the crash" if record.crashed else "crashed"))
    if record.digest and world == record.world and digest.hexdigest() != record.digest:
        raise _differs(record, "its states differ")
    return teaming


def _differs(record: TripRecord, how: str) -> ReplayError:
    return ReplayError(
        f"the trip does not replay as it was: {how}; it was recorded by version {record.version} "
        f"with the environment {record.stamp}, and this is {hmi_marl.__version__} with "
        f"{environment_stamp()}"
    )
