"""Trips under way: the clock, the newest input, and the newest state.

The clock is the server's: no decision is taken earlier than 1/5 s after the one before, and the
newest input for a step counts. A trip waits for a decision that does not come, so that nothing is
decided for a person whose connection is lost. A state is sent only when the decisions before it are
on the disk.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from functools import lru_cache

from hmi_marl.envs.config import DRIVER
from hmi_marl.envs.scene import Scene
from hmi_marl.people.play.commits import Commits
from hmi_marl.people.play.messages import Decide, Found, hello, puzzle_content, state, written
from hmi_marl.people.play.puzzles import POINTS, puzzle
from hmi_marl.people.record import Progress
from hmi_marl.people.store import Store, StoredTrip
from hmi_marl.people.trip import Road, Trip

SLACK = 0.1
"""Time by which a decision may come early, after one that was late [s]: as much as the page's own
clock makes up for."""
IDLE = 60.0
"""Time after which a trip without a visitor leaves the memory [s]; it goes on from the database."""
TAKEN_OVER, FAILED, FULL = 4001, 1011, 1013
"""Codes with which connections are closed."""
_LOG = logging.getLogger(__name__)


@lru_cache(maxsize=16)
def road_of(scene: Scene) -> Road:
    """Return the road of a scene."""
    return Road.of(scene)


class Outbox:
    """Messages to one connection: of states the newest alone, of others all.

    Its task sends them; a slow connection has nothing pile up.
    """

    _MOST = 50

    def __init__(self) -> None:
        self._state: str | None = None
        self._others: list[str] = []
        self._more = asyncio.Event()
        self.closing: tuple[int, str] | None = None
        """Code and reason, once the connection is to be closed."""

    def put_state(self, text: str) -> None:
        """Send a state, in place of one that still waits."""
        self._state = text
        self._more.set()

    def put(self, text: str) -> None:
        """Send another message."""
        if len(self._others) < self._MOST:
            self._others.append(text)
        self._more.set()

    def close(self, code: int, reason: str) -> None:
        """Close the connection after what is waiting."""
        self.closing = self.closing or (code, reason)
        self._more.set()

    async def next(self) -> list[str]:
        """Wait for messages, and return them; none once the connection is to be closed."""
        while not (self._others or self._state is not None or self.closing):
            self._more.clear()
            await self._more.wait()
        found, self._others = self._others, []
        if self._state is not None:
            found.append(self._state)
            self._state = None
        return found


class LiveTrip:
    """One trip under way.

    Args:
        stored: the trip as it is in the database.
        trip: brought to the same place.
        solved: number searches that were answered, and how many of them rightly.
        commits: keeps the decisions.
        leave: called when the trip is not to stay in memory.
    """

    def __init__(
        self,
        stored: StoredTrip,
        trip: Trip,
        solved: tuple[int, int],
        commits: Commits,
        leave: Callable[[LiveTrip], None],
    ) -> None:
        self.number, self.session, self._seed = stored.number, stored.session, stored.record.seed
        self._trip, self._commits, self._leave = trip, commits, leave
        self._loop = asyncio.get_running_loop()
        self.pace = 1.0 / trip.config.scene.policy_frequency
        self._due = self._loop.time()
        self._waiting: Decide | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._kept = trip.decisions
        self._puzzle, self._right = solved
        self._away = 0
        self._outbox: Outbox | None = None
        self.idle_since = self._loop.time()

    @property
    def watched(self) -> bool:
        """Whether there is a connection."""
        return self._outbox is not None

    def join(self, outbox: Outbox) -> None:
        """Send what happens to this connection; one before it is closed."""
        if self._outbox is not None:
            self._outbox.close(TAKEN_OVER, "the trip goes on in another window")
        self._outbox = outbox
        trip, driving = self._trip, self._trip.seat == DRIVER
        content = hello(
            road_of(trip.config.scene),
            trip.seat,
            5 if driving else trip.config.alerts.choices,
            self.pace,
            puzzle(self._seed, self._puzzle) if driving else None,
            POINTS * self._right,
        )
        outbox.put(written(content))
        if self._kept == trip.decisions:  # else it follows when they are on the disk
            self._send_state()

    def part(self, outbox: Outbox) -> None:
        """Forget a connection that was closed."""
        if self._outbox is outbox:
            self._outbox = None
            self.idle_since = self._loop.time()

    def decide(self, decision: Decide) -> None:
        """Take a decision when its time has come.

        One that was taken already is acknowledged again, and changes nothing.

        Raises:
            ValueError: it is for a later step, or not of this seat.
        """
        trip = self._trip
        if decision.step < trip.decisions:
            if self._kept == trip.decisions:
                self._send_state()
            return
        if decision.step > trip.decisions:
            raise ValueError(f"the next decision is for step {trip.decisions}, not {decision.step}")
        if trip.over:
            raise ValueError("the trip is over")
        self._check(decision)
        self._waiting = decision
        if self._timer is None:
            self._timer = self._loop.call_at(max(self._due, self._loop.time()), self._take)

    def check_found(self, found: Found) -> bool:
        """Return whether an answer to the number search is right, and go to the next.

        Raises:
            ValueError: it is for another search, or the second task is closed.
        """
        trip = self._trip
        if trip.seat != DRIVER:
            raise ValueError("number searches are of a person who drives")
        if found.puzzle != self._puzzle:
            raise ValueError(f"the number search is {self._puzzle}, not {found.puzzle}")
        if not (self._away or (self._waiting is not None and self._waiting.away)):
            raise ValueError("the second task is closed")
        if trip.over:
            raise ValueError("the trip is over")
        now = puzzle(self._seed, self._puzzle)
        if found.number not in now.numbers:
            raise ValueError(f"{found.number} is not among the numbers")
        self._puzzle += 1
        return found.number == now.target

    def answered(self, right: bool) -> None:
        """Send the next number search, once the answer is on the disk."""
        self._right += right
        content = puzzle_content(puzzle(self._seed, self._puzzle))
        whole = {"type": "puzzle", "right": right, "points": POINTS * self._right, **content}
        if self._outbox is not None:
            self._outbox.put(written(whole))

    @property
    def decisions(self) -> int:
        """Decisions taken."""
        return self._trip.decisions

    def progress(self) -> Progress:
        """See :class:`~hmi_marl.people.play.commits.Saved`."""
        return self._trip.progress(self._kept)

    def saved(self, new: Progress) -> None:
        """See :class:`~hmi_marl.people.play.commits.Saved`."""
        self._kept = new.first + len(new.steps)
        if self._kept < self._trip.decisions:
            return  # the next transaction has the newer state
        self._send_state()
        if self._trip.over:
            self._leave(self)

    def failed(self, reason: str) -> None:
        """See :class:`~hmi_marl.people.play.commits.Saved`."""
        _LOG.warning("trip %d: nothing more can be stored: %s", self.number, reason)
        if self._timer is not None:
            self._timer.cancel()
        if self._outbox is not None:
            self._outbox.close(FAILED, "the decision could not be stored")
        self._leave(self)

    def _check(self, decision: Decide) -> None:
        driving = self._trip.seat == DRIVER
        choices = 5 if driving else self._trip.config.alerts.choices
        if decision.action >= choices:
            raise ValueError(f"action lies in 0 to {choices - 1}, but got {decision.action}")
        if driving and decision.away is None:
            raise ValueError("away is 0 or 1 in the driver's seat")
        if not driving and decision.away is not None:
            raise ValueError("away is null in the vehicle AI's seat")

    def _take(self) -> None:
        self._timer = None
        decision, self._waiting = self._waiting, None
        if decision is None or decision.step != self._trip.decisions or self._trip.over:
            return
        now = self._loop.time()
        self._due = max(self._due + self.pace, now + self.pace - SLACK)
        self._trip.advance(decision.action, decision.away)
        self._away = decision.away or 0
        self._commits.add(self)

    def _send_state(self) -> None:
        if self._outbox is not None:
            self._outbox.put_state(written(state(self._trip.picture())))


class LiveTrips:
    """All trips under way.

    Args:
        store: the database.
        most: connections at once.
    """

    def __init__(self, store: Store, most: int) -> None:
        self._store, self._most = store, most
        self._commits = Commits(store.add_decisions)
        self._trips: dict[int, LiveTrip] = {}
        self._opening: dict[int, asyncio.Task[LiveTrip]] = {}

    def start(self) -> None:
        """Begin, in the running event loop."""
        self._commits.start()

    async def close(self) -> None:
        """Keep everything, and end."""
        await self._commits.close()

    @property
    def connections(self) -> int:
        """Visitors on a trip now."""
        return sum(trip.watched for trip in list(self._trips.values()))

    @property
    def full(self) -> bool:
        """Whether there is no room for another visitor."""
        return self.connections >= self._most

    async def open(self, number: int) -> LiveTrip:
        """Return a trip by its number, from the memory or brought back from the database.

        Raises:
            ValueError: there is none, or it does not go as recorded.
        """
        self._forget_idle()
        if number not in self._trips:
            if number not in self._opening:
                opening = asyncio.get_running_loop().create_task(self._load(number))
                self._opening[number] = opening
                opening.add_done_callback(lambda _: self._opening.pop(number, None))
            return await asyncio.shield(self._opening[number])
        return self._trips[number]

    async def found(self, live: LiveTrip, found: Found) -> None:
        """Keep the answer to a number search, and send the next.

        Raises:
            ValueError: see :meth:`LiveTrip.check_found`.
        """
        right = live.check_found(found)
        answer = {"number": found.number, "right": right, "step": live.decisions}
        question = f"{_prefix(live.number)}{found.puzzle}"
        try:
            await asyncio.to_thread(self._store.answer, live.session, question, answer)
        except (OSError, ValueError) as error:
            live.failed(str(error))
            return
        live.answered(right)

    async def _load(self, number: int) -> LiveTrip:
        stored, trip, solved = await asyncio.to_thread(self._read, number)
        live = LiveTrip(stored, trip, solved, self._commits, self._leave)
        if not trip.over:
            self._trips[number] = live
        return live

    def _read(self, number: int) -> tuple[StoredTrip, Trip, tuple[int, int]]:
        stored = self._store.trip(number)
        road_of(stored.record.config.scene)  # slow for the first time
        return stored, Trip.resume(stored.record), solved(self._store, stored)

    def _leave(self, live: LiveTrip) -> None:
        self._trips.pop(live.number, None)

    def _forget_idle(self) -> None:
        now = asyncio.get_running_loop().time()
        for live in list(self._trips.values()):
            if not live.watched and now - live.idle_since > IDLE:
                self._leave(live)


def solved(store: Store, trip: StoredTrip) -> tuple[int, int]:
    """Return how many number searches of a trip were answered, and how many rightly."""
    prefix = _prefix(trip.number)
    answers = [
        each.value for each in store.answers(trip.session) if each.question.startswith(prefix)
    ]
    return len(answers), sum(bool(value["right"]) for value in answers)


def _prefix(number: int) -> str:
    """Beginning of the questions of a trip's number searches."""
    return f"second task {number}."
