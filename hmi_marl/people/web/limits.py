"""Limits of requests: how many, how large, from where, and the headers of every answer.

:class:`Guard` stands before all routes.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Mapping
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import ClientDisconnect, HTTPConnection
from starlette.responses import PlainTextResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from hmi_marl.people.web.settings import Limits, ServerSettings

SECURITY_HEADERS: Mapping[str, str] = {
    "Content-Security-Policy": (
        "default-src 'self'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'; "
        "object-src 'none'"
    ),
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), geolocation=(), microphone=()",
    "Referrer-Policy": "same-origin",  # under no-referrer browsers send forms with Origin: null
    "X-Content-Type-Options": "nosniff",
}
"""Headers of every answer: nothing inline, nothing from elsewhere, no frame around it."""
_KNOWN = 10_000
"""Most addresses that are remembered."""
BODY_TIME = 10.0
"""Longest time that the body of a request may take [s]."""
NEW_VISITORS = 0.5, 60.0
"""New visitors from one address per second, and at once."""
_ADDRESS = 2048
"""Longest address of a request, its query included [bytes]."""


class RateLimit:
    """Token buckets, one for each key.

    Args:
        rate: tokens per second.
        burst: most tokens of a key.
        clock: returns the time [s].
    """

    def __init__(
        self, rate: float, burst: float, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._rate, self._burst, self._clock = rate, burst, clock
        self._buckets: OrderedDict[str, tuple[float, float]] = OrderedDict()
        self._lock = threading.Lock()

    def allow(self, key: str = "") -> bool:
        """Take a token of a key; False if it has none."""
        with self._lock:
            now = self._clock()
            tokens, since = self._buckets.pop(key, (self._burst, now))
            tokens = min(self._burst, tokens + (now - since) * self._rate)
            allowed = tokens >= 1.0
            self._buckets[key] = (tokens - allowed, now)
            if len(self._buckets) > _KNOWN:
                self._buckets.popitem(last=False)
            return allowed


def client_address(connection: HTTPConnection, trust_proxy: bool) -> str:
    """Return the address of a visitor: behind a trusted proxy, the one that it saw last."""
    forwarded = connection.headers.get("x-forwarded-for", "") if trust_proxy else ""
    last = forwarded.rpartition(",")[2].strip()
    return last or (connection.client.host if connection.client else "")


def is_secure(connection: HTTPConnection, trust_proxy: bool) -> bool:
    """Whether the visitor's connection is encrypted, as far as a trusted proxy says so."""
    forwarded = connection.headers.get("x-forwarded-proto", "") if trust_proxy else ""
    scheme = forwarded.rpartition(",")[2].strip() or connection.url.scheme
    return scheme in ("https", "wss")


def from_own_page(connection: HTTPConnection, trust_proxy: bool) -> bool:
    """Whether a request comes from a page of this service, as far as the browser says.

    Without either header it is no browser's, and brings no cookie of one.
    """
    headers = connection.headers
    if site := headers.get("sec-fetch-site"):
        return site in ("same-origin", "none")
    origin = headers.get("origin")
    if origin is None:
        return True
    forwarded = headers.get("x-forwarded-host", "") if trust_proxy else ""
    hosts = {headers.get("host", ""), forwarded.rpartition(",")[2].strip()} - {""}
    try:
        return urlsplit(origin).netloc in hosts
    except ValueError:  # no address
        return False


class Guard:
    """Middleware that limits requests, takes the base path off, and adds the headers.

    Args:
        app: what answers.
        settings: of the server.
        limits: of requests and their size.
    """

    def __init__(
        self,
        app: ASGIApp,
        settings: ServerSettings | None = None,
        limits: Limits | None = None,
    ) -> None:
        self._app = app
        self._settings = settings or ServerSettings()
        self._limits = limits or Limits()
        self._rate = RateLimit(self._limits.requests, 10 * self._limits.requests)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or pass it on."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        scope = self._without_base(scope)
        refusal = self._refusal(scope)
        if scope["type"] == "websocket":
            if refusal is not None:
                await send({"type": "websocket.close", "code": 1008})  # an HTTP 403
                return
            await self._app(scope, receive, send)
            return
        sender = _with_headers(scope, send)
        if refusal is not None:
            await refusal(scope, receive, sender)
            return
        try:
            body = await asyncio.wait_for(self._whole_body(receive), BODY_TIME)
        except ClientDisconnect:  # a part of a form is none
            return
        except TimeoutError:
            answer = PlainTextResponse(f"a form takes at most {BODY_TIME:g} s", 408)
            await answer(scope, receive, sender)
            return
        if body is None:
            most = self._limits.message_size
            answer = PlainTextResponse(f"a form has at most {most} bytes", 413)
            await answer(scope, receive, sender)
            return
        await self._app(scope, _replayed(body, receive), sender)

    def _without_base(self, scope: Scope) -> Scope:
        """Proxies pass the base path on, or take it off; both work."""
        base, path = self._settings.base_path, scope["path"]
        if base and (path == base or path.startswith(f"{base}/")):
            path = path[len(base) :] or "/"
            return {**scope, "path": path, "raw_path": path.encode(), "root_path": ""}
        return scope

    def _refusal(self, scope: Scope) -> Response | None:
        connection = HTTPConnection(scope)
        trust = self._settings.trust_proxy
        if not self._rate.allow(client_address(connection, trust)):
            return PlainTextResponse(
                "too many requests; wait a second", 429, headers={"Retry-After": "1"}
            )
        if len(scope["path"]) + len(scope["query_string"]) > _ADDRESS:
            return PlainTextResponse(f"an address has at most {_ADDRESS} bytes", 414)
        length = Headers(scope=scope).get("content-length", "0")
        if not length.isascii() or not length.isdigit():
            return PlainTextResponse("Content-Length is a number", 400)
        if int(length) > self._limits.message_size:
            most = self._limits.message_size
            return PlainTextResponse(f"a form has at most {most} bytes, not {length}", 413)
        changes = scope["type"] == "websocket" or scope["method"] not in ("GET", "HEAD")
        if changes and not from_own_page(connection, trust):
            return PlainTextResponse("this was sent by a page of another site", 403)
        return None

    async def _whole_body(self, receive: Receive) -> bytes | None:
        """Return the body; None if it is too large.

        Raises:
            ClientDisconnect: the connection ended before.
        """
        body = b""
        while True:
            message = await receive()
            if message["type"] != "http.request":
                raise ClientDisconnect
            body += message.get("body", b"")
            if len(body) > self._limits.message_size:
                return None
            if not message.get("more_body"):
                return body


def _replayed(body: bytes, receive: Receive) -> Receive:
    given = False

    async def again() -> Message:
        nonlocal given
        if given:
            return await receive()  # the end of the connection
        given = True
        return {"type": "http.request", "body": body, "more_body": False}

    return again


def _with_headers(scope: Scope, send: Send) -> Send:
    static = scope["path"].startswith("/static/")

    async def sender(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            for name, value in SECURITY_HEADERS.items():
                headers[name] = value
            headers.setdefault("Cache-Control", "no-cache" if static else "no-store")
        await send(message)

    return sender
