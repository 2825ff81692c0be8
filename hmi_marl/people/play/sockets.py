"""The connection of a trip's page: what comes in is checked, and each mistake is answered."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress

from starlette.concurrency import run_in_threadpool
from starlette.requests import HTTPConnection
from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

from hmi_marl.people.play.live import FULL, LiveTrip, LiveTrips, Outbox
from hmi_marl.people.play.messages import Found, error, read_message, written
from hmi_marl.people.web.limits import RateLimit
from hmi_marl.people.web.settings import Limits

NO_VISIT, NO_TRIP, RUBBISH = 4003, 4004, 1008
"""Codes with which connections are closed."""
_NO_ANSWER = "the database does not answer; try again"
_MISTAKES = 200
"""Mistakes after which a connection is closed."""


class TripSocket:
    """Connections of trips.

    Args:
        live: the trips under way.
        limits: of visitors and messages.
        current: returns the trip of the visitor of a connection, or None.
    """

    def __init__(
        self, live: LiveTrips, limits: Limits, current: Callable[[HTTPConnection], int | None]
    ) -> None:
        self._live, self._limits, self._current = live, limits, current

    async def serve(self, websocket: WebSocket) -> None:
        """Serve one connection until it ends."""
        await websocket.accept()
        asked = websocket.query_params.get("trip", "")
        try:
            number = await run_in_threadpool(self._current, websocket)
        except (OSError, ValueError):
            await _refuse(websocket, FULL, _NO_ANSWER)
            return
        if number is None:
            await _refuse(websocket, NO_VISIT, "there is no visit; begin on the first page")
            return
        if asked != str(number):
            await _refuse(websocket, NO_TRIP, f"trip {asked[:20]!r} is not under way")
            return
        try:
            live = await self._live.open(number)
        except ValueError as problem:
            await _refuse(websocket, NO_TRIP, str(problem))
            return
        except OSError:
            await _refuse(websocket, FULL, _NO_ANSWER)
            return
        if self._live.full and not live.watched:
            await _refuse(websocket, FULL, "there are too many visitors now; try again later")
            return
        outbox = Outbox()
        live.join(outbox)
        sender = asyncio.create_task(self._send(websocket, outbox))
        try:
            with suppress(WebSocketDisconnect):
                await self._receive(websocket, live, outbox)
        finally:
            live.part(outbox)
            if outbox.closing is None:
                sender.cancel()
            with suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
                await sender

    async def _send(self, websocket: WebSocket, outbox: Outbox) -> None:
        while texts := await outbox.next():
            for text in texts:
                await websocket.send_text(text)
        if outbox.closing is not None:
            await websocket.close(*outbox.closing)

    async def _receive(self, websocket: WebSocket, live: LiveTrip, outbox: Outbox) -> None:
        rate = RateLimit(self._limits.messages, 3 * self._limits.messages)
        mistakes = 0
        while websocket.client_state is WebSocketState.CONNECTED:
            message = await websocket.receive()
            if message["type"] != "websocket.receive" or outbox.closing is not None:
                return
            try:
                if not rate.allow():
                    raise ValueError(f"at most {self._limits.messages:g} messages a second")
                await self._handle(live, message.get("text"))
            except ValueError as problem:
                mistakes += 1
                outbox.put(written(error(str(problem))))
                if mistakes == _MISTAKES:
                    outbox.close(RUBBISH, "too many messages that are none")
                    return

    async def _handle(self, live: LiveTrip, text: str | None) -> None:
        if text is None:
            raise ValueError("messages are texts")
        most = self._limits.message_size
        if len(text) > most:
            raise ValueError(f"a message has at most {most} characters, not {len(text)}")
        message = read_message(text)
        if isinstance(message, Found):
            await self._live.found(live, message)
        else:
            live.decide(message)


async def _refuse(websocket: WebSocket, code: int, reason: str) -> None:
    with suppress(WebSocketDisconnect, RuntimeError):
        await websocket.send_text(written(error(reason)))
        await websocket.close(code, reason[:100])
