"""A trip that is under way: one team with a person in one seat and a policy in the other.

::

    trip = Trip(TeamConfig(), "driver", partner="optimal", seed=1)
    while not trip.over:
        show(trip.picture())
        trip.advance(action, looking_away=0)
    record = trip.record()

It is an episode of the environment: the same policies in both seats play the same one with
:func:`hmi_marl.agents.rollout.play`, to the last bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import lru_cache

import numpy as np

from hmi_marl.agents.catalogue import make_driver_policy, make_hmi
from hmi_marl.checks import Whole, check_choice
from hmi_marl.envs.config import DRIVER, VEHICLE_AI, TeamConfig
from hmi_marl.envs.scene import LANE_WIDTH, Scene
from hmi_marl.envs.seats import PartnerTurns, Policy, check_policy
from hmi_marl.envs.streams import check_seed
from hmi_marl.envs.team_step import NO_ACTION
from hmi_marl.envs.teaming import Teaming
from hmi_marl.envs.worlds import VEHICLE_ACTIONS, Snapshot, World, make_world
from hmi_marl.people.record import (
    SEATS,
    TIME,
    Kind,
    Progress,
    Seat,
    StateDigest,
    TripRecord,
    WorldName,
)

CAR_LENGTH, CAR_WIDTH = 5.0, 2.0
"""Every vehicle's size [m], as highway-env has it."""
_KEEP_SPEED = VEHICLE_ACTIONS.index("keep_speed")
_POINT_EVERY = 5.0
"""Distance between points of the ramp [m]."""


@dataclass(frozen=True)
class Road:
    """The road of a scene, for drawing [m]."""

    lanes: int
    """Main lanes; the middle of lane k, from the left, is at y = k * lane_width."""
    lane_width: float
    length: float
    ramp: tuple[tuple[float, float], ...]
    """Middle of the ramp and of the lane that merges, as points (x, y) from its start to its end.
    """
    car_length: float = CAR_LENGTH
    car_width: float = CAR_WIDTH

    @classmethod
    def of(cls, scene: Scene) -> Road:
        """Road of a scene that is fitted to its episode, such as ``config.scene``."""
        from hmi_marl.envs.worlds.highway import MergeScene  # highway-env is slow to import

        network = MergeScene(scene).road.network
        points: list[tuple[float, float]] = []
        for index in (("j", "k", 0), ("k", "b", 0), ("b", "c", scene.lanes)):
            lane = network.get_lane(index)
            for along in np.linspace(0.0, lane.length, 1 + round(lane.length / _POINT_EVERY)):
                x, y = lane.position(along, 0.0)
                points.append((float(x), float(y)))
        return cls(scene.lanes, LANE_WIDTH, scene.length, tuple(points))


@dataclass(frozen=True)
class Moment:
    """All vehicles after one simulator step. The driven car is the first of V."""

    time: float
    """Since the start of the episode [s]."""
    x: tuple[float, ...]
    """Along the road [m], V numbers."""
    y: tuple[float, ...]
    """Across the road, growing to the right [m]."""
    heading: tuple[float, ...]
    """0 along the road [rad]."""
    speed: tuple[float, ...]
    """[m/s]."""
    crashed: tuple[bool, ...]

    @classmethod
    def of(cls, snapshot: Snapshot) -> Moment:
        """The same as lists of plain numbers."""
        x, y = snapshot.position.T.tolist()
        return cls(
            snapshot.time,
            tuple(x),
            tuple(y),
            tuple(snapshot.heading.tolist()),
            tuple(snapshot.speed.tolist()),
            tuple(snapshot.crashed.tolist()),
        )


@dataclass(frozen=True)
class Picture:
    """A trip after its latest step, as the person's seat sees it."""

    step: int
    """Decisions taken."""
    steps: int
    """Decisions in a trip that nothing cuts short."""
    moments: tuple[Moment, ...]
    """Every simulator step of the latest decision, the present last; the start alone before it."""
    lane: int
    """0 (left) to lanes - 1 (right), ``lanes`` on the ramp."""
    speed: float
    """[m/s]."""
    target_speed: float
    """[m/s]."""
    score: float
    """Sum of the rewards of the person's seat."""
    alert: int
    """a^A of the latest step: 0, or the number of the alert's strength."""
    strength: float
    """Strength of this alert, 0 without one."""
    distracted: int | None
    """d of the latest step; None where the seat does not see it."""
    alert_left: int | None
    """Steps for which an accepted alert is in effect still; None where the seat does not see it."""
    intended: int | None
    """The driver's latest a^H, in the vehicle AI's seat that of the step to come; None if none."""
    applied: int | None
    """The latest v; None before the first."""
    crashed: bool
    over: bool


class Trip:
    """One trip.

    Args:
        config: settings of the team.
        seat: of the person, "driver" or "vehicle_ai".
        partner: name of the policy in the other seat, see :mod:`hmi_marl.agents.catalogue`.
        seed: of the episode, as :meth:`Teaming.reset` takes it.
        kind: "free", "calibration" or "trial".
        policy: of the other seat, where ``partner`` is a name that the catalogue does not know. It
            belongs to this trip alone.
        visitor: code of the person.
        begun: time in UTC such as 2026-01-31T12:00:00Z; now by default.
        world: "batched" or "highway".

    Raises:
        ValueError, TypeError: what does not fit, saying what to use instead.
    """

    def __init__(
        self,
        config: TeamConfig,
        seat: Seat,
        partner: str,
        seed: int,
        kind: Kind = "free",
        *,
        policy: Policy | None = None,
        visitor: str = "",
        begun: str | None = None,
        world: WorldName = "batched",
    ) -> None:
        check_choice("seat", seat, SEATS)
        seed = check_seed(seed)
        begun = datetime.now(UTC).strftime(TIME) if begun is None else begun
        if policy is None:
            make = make_hmi if seat == DRIVER else make_driver_policy
            policy = make(partner, config)
        self._intents: list[int] = []
        self._alerts: list[int] = []
        self._looking_away: list[int] | None = None
        # A world of one team needs no threads, which would only wait for each other.
        self._teaming = Teaming(config, 1, _world(world, config.scene))
        self._turns = PartnerTurns(self._teaming, seat, check_policy(policy))
        seeds = np.array([seed], np.uint64)
        self._teaming.reset(seeds)
        self._turns.begin(seeds)
        self._camera = _Camera(config.scene, world, seed)
        self._score, self._digest = 0.0, StateDigest()
        self._empty = TripRecord(
            config, seed, seat, kind, partner, (), (), None, False,
            world=world, visitor=visitor, begun=begun,
        )  # fmt: skip
        self._turns.prepare()

    @classmethod
    def resume(cls, record: TripRecord, policy: Policy | None = None) -> Trip:
        """Bring a trip to where its record ends, to go on.

        Args:
            record: of the trip until now.
            policy: of the other seat, new, if :class:`Trip` was given one.

        Raises:
            ValueError: the policy acts otherwise than in the record, or a state differs.
        """
        trip = cls(
            record.config, record.seat, record.partner, record.seed, record.kind,
            policy=policy, visitor=record.visitor, begun=record.begun, world=record.world,
        )  # fmt: skip
        own = record.intents if record.seat == DRIVER else record.alerts
        for step, action in enumerate(own):
            away = None if record.looking_away is None else record.looking_away[step]
            trip.advance(action, away)
        now = trip.record()
        same = (now.intents, now.alerts, now.crashed) == (
            record.intents, record.alerts, record.crashed,
        )  # fmt: skip
        if not same or (record.digest and now.digest != record.digest):
            raise ValueError(
                f"the trip with {record.partner!r} does not go as recorded by version "
                f"{record.version}; begin a new one"
            )
        return trip

    @property
    def config(self) -> TeamConfig:
        """Settings of the team."""
        return self._empty.config

    @property
    def seat(self) -> Seat:
        """Seat of the person."""
        return self._empty.seat

    @property
    def decisions(self) -> int:
        """Decisions taken."""
        return len(self._intents)

    @property
    def over(self) -> bool:
        """Whether the episode has ended."""
        return bool(self._teaming.over[0])

    @property
    def teaming(self) -> Teaming:
        """The team, to be looked at."""
        return self._teaming

    def advance(self, action: int, looking_away: int | None = None) -> None:
        """Take one decision.

        Args:
            action: of the person's seat: a^H, 0 to 4, or a^A.
            looking_away: d_t of a person who drives, 1 while they look away from the road and 0
                while at it; None where the chain draws it. One or the other for the whole trip.

        Raises:
            ValueError, TypeError: the trip is over, or an action out of range. Nothing has changed.
        """
        if self.over:
            raise ValueError("the trip is over; begin another")
        choices = len(VEHICLE_ACTIONS) if self.seat == DRIVER else self.config.alerts.choices
        action = Whole(0, choices - 1)("action", action)
        away = None
        if looking_away is not None:
            away = [Whole(0, 1)("looking_away", looking_away)]
        self._check_attention(away)
        result = self._turns.step([action], looking_away=away)
        if away is not None:
            self._looking_away = self._looking_away or []
            self._looking_away += away
        self._intents.append(int(self._teaming.intended[0]))
        self._alerts.append(int(self._teaming.alerted[0]))
        self._score += float(result.rewards[self.seat][0])
        self._digest.after(self._teaming, result)
        self._camera.follow(int(self._teaming.applied[0]))
        if not self.over:
            self._turns.prepare()

    def _check_attention(self, away: list[int] | None) -> None:
        if away is not None and self.seat == VEHICLE_AI:
            raise ValueError("looking_away is of a person who drives; leave it out in this seat")
        if self.decisions and (away is None) != (self._looking_away is None):
            raise ValueError("looking_away is given in every step of a trip, or in none")

    def picture(self) -> Picture:
        """Return what the person's seat sees now."""
        teaming, alerts = self._teaming, self.config.alerts
        ego, attention = teaming.ego, teaming.attention
        seen = self.seat == DRIVER or self.config.ai_sees_attention
        alert, applied = int(teaming.alerted[0]), int(teaming.applied[0])
        left = int((attention.accepted[0] > 0) * (self.config.alert_window - attention.counter[0]))
        intended = int(teaming.intended[0])
        return Picture(
            step=self.decisions,
            steps=self.config.horizon,
            moments=self._camera.moments,
            lane=int(ego.lane[0]),
            speed=float(ego.speed[0]),
            target_speed=float(ego.target_speed[0]),
            score=self._score,
            alert=alert,
            strength=float(alerts.strength(alert)) if alert else 0.0,
            distracted=int(attention.distracted[0]) if seen else None,
            alert_left=left if seen else None,
            intended=None if intended == NO_ACTION else intended,
            applied=None if applied == NO_ACTION else applied,
            crashed=bool(teaming.crashed[0]),
            over=self.over,
        )

    def record(self) -> TripRecord:
        """Return the trip until now, which may be in the middle."""
        return replace(
            self._empty,
            intents=tuple(self._intents),
            alerts=tuple(self._alerts),
            looking_away=None if self._looking_away is None else tuple(self._looking_away),
            crashed=bool(self._teaming.crashed[0]),
            digest=self._digest.hexdigest(),
        )

    def progress(self, first: int) -> Progress:
        """Return the decisions from a step on, without checking again those before."""
        away: Sequence[int | None] = self._looking_away or [None] * self.decisions
        steps = zip(self._intents[first:], self._alerts[first:], away[first:], strict=True)
        crashed, digest = bool(self._teaming.crashed[0]), self._digest.hexdigest()
        return Progress(first, tuple(steps), crashed, digest, self.over)


class _Camera:
    """A world of its own that decides in every simulator step, to see what lies between decisions.

    Given the action, and keep_speed in the simulator steps after it, its car does the same.
    """

    def __init__(self, scene: Scene, world: str, seed: int) -> None:
        self._per_decision = scene.simulation_frequency // scene.policy_frequency
        self._all = np.ones(1, np.bool_)
        self._world = _world(world, replace(scene, policy_frequency=scene.simulation_frequency))
        self._world.reset(np.array([seed], np.uint64), np.ones(1), self._all)
        self._tick = 1 / scene.simulation_frequency
        self._time = 0
        self.moments: tuple[Moment, ...] = (self._moment(),)
        """Every simulator step of the latest decision, or the start."""

    def follow(self, action: int) -> None:
        """Move by one decision, as a team does: a crashed car is halted and its world stands."""
        moments = []
        standing = bool(self._world.ego().crashed[0])
        if standing:
            self._world.halt(self._all)
        for place in range(self._per_decision):
            if not standing:
                command = action if place == 0 else _KEEP_SPEED
                self._world.step(np.array([command]), self._all)
            self._time += 1
            moments.append(self._moment())
        self.moments = tuple(moments)

    def _moment(self) -> Moment:
        return replace(Moment.of(self._world.snapshot(0)), time=self._time * self._tick)


def _world(name: str, scene: Scene) -> World:
    """Return a new world of one car; a copy, since reading the road takes most of making one."""
    return make_world(name, scene, 1, threads=1) if name == "highway" else deepcopy(_fresh(scene))


@lru_cache(maxsize=32)
def _fresh(scene: Scene) -> World:
    return make_world("batched", scene, 1, threads=1)
