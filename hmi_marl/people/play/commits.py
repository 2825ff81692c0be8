"""Decisions of many trips into the database, as many in one transaction as have come meanwhile."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import Protocol

from hmi_marl.people.record import Progress

Save = Callable[[Mapping[int, Progress]], None]


class Saved(Protocol):
    """A trip whose decisions are to be kept."""

    number: int

    def progress(self) -> Progress:
        """Return the decisions that are not on the disk yet."""
        ...

    def saved(self, new: Progress) -> None:
        """Called when they are on the disk."""

    def failed(self, reason: str) -> None:
        """Called when they could not be kept."""


class Commits:
    """Keep decisions in the order in which they come, and say when they are on the disk.

    While one transaction is being written, all that come wait for the next.

    Args:
        save: keeps decisions in one transaction, and returns when they are on the disk.
    """

    def __init__(self, save: Save) -> None:
        self._save = save
        self._waiting: dict[int, Saved] = {}
        self._more = asyncio.Event()
        self._closed = False
        self._task: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Begin, in the running event loop."""
        self._task = asyncio.get_running_loop().create_task(self._run())

    async def close(self) -> None:
        """Keep what is waiting, and end."""
        self._closed = True
        self._more.set()
        if self._task is not None:
            await self._task

    def add(self, trip: Saved) -> None:
        """Keep the decisions of a trip soon."""
        self._waiting[trip.number] = trip
        self._more.set()

    async def _run(self) -> None:
        while self._waiting or not self._closed:
            await self._more.wait()
            self._more.clear()
            batch, self._waiting = list(self._waiting.values()), {}
            if batch:
                await self._keep(batch)

    async def _keep(self, batch: list[Saved]) -> None:
        new = {trip.number: trip.progress() for trip in batch}
        try:
            await asyncio.to_thread(self._save, new)
        except (OSError, ValueError) as error:
            if len(batch) == 1 or isinstance(error, OSError):  # of the file, so of all alike
                for trip in batch:
                    trip.failed(str(error))
                return
            for trip in batch:  # one that was deleted meanwhile does not harm the others
                await self._keep([trip])
            return
        for trip in batch:
            trip.saved(new[trip.number])
