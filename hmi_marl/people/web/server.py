"""Run a service: routes, static files, errors as pages, and the server itself."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractAsyncContextManager
from pathlib import Path
from types import FrameType

import uvicorn
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import BaseRoute, Mount, Route
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp

from hmi_marl.people.web.limits import Guard
from hmi_marl.people.web.pages import STATIC, Site
from hmi_marl.people.web.settings import Limits, ServerSettings

LARGEST_FRAME = 65_536
"""Bytes of a WebSocket message above which the connection is closed without another word."""
_SWITCH = 0.001
"""Longest that a thread which computes a page keeps connections waiting [s]."""
_GRACE = 3
"""Longest wait for open connections at the end [s]."""

Lifespan = Callable[[Starlette], AbstractAsyncContextManager[None]]


def make_app(
    site: Site,
    routes: Sequence[BaseRoute],
    static: Mapping[str, Path],
    limits: Limits | None = None,
    lifespan: Lifespan | None = None,
) -> Guard:
    """Make the application of a service.

    Args:
        site: its pages.
        routes: its own routes, without the base path.
        static: folders of files by their names, served under /static/NAME.
        limits: of requests.
        lifespan: runs around the server, as Starlette takes it.
    """

    async def http_problem(request: Request, error: Exception) -> Response:
        assert isinstance(error, HTTPException)
        reason = site.texts("problem.missing") if error.status_code == 404 else error.detail
        answer = site.problem(error.status_code, reason)
        for name, value in (error.headers or {}).items():
            answer.headers[name] = value
        return answer

    async def bug(request: Request, error: Exception) -> Response:
        return site.problem(500, site.texts("problem.bug"))

    async def disk(request: Request, error: Exception) -> Response:
        logging.getLogger(__name__).error("%s", error)
        return site.problem(503, site.texts("problem.disk"))

    async def health(request: Request) -> Response:
        return PlainTextResponse("ok")

    folders = {"web": STATIC, **static}
    app = Starlette(
        routes=[
            *routes,
            Route("/health", health),
            *(
                Mount(f"/static/{name}", StaticFiles(directory=folder))
                for name, folder in folders.items()
            ),
        ],
        exception_handlers={HTTPException: http_problem, OSError: disk, Exception: bug},
        lifespan=lifespan,
    )
    app.router.redirect_slashes = False  # it knows neither the base path nor whom to believe
    return Guard(app, site.settings, limits)  # around everything, so that errors have headers too


def serve(
    app: ASGIApp, settings: ServerSettings, ready: Callable[[str], object], *, quiet: bool = True
) -> None:
    """Run a server until Ctrl-C or SIGTERM, after which open connections are closed.

    Args:
        app: of :func:`make_app`.
        settings: of the server.
        ready: called with the address of the first page, once requests are answered.
        quiet: without a line for each request.

    Raises:
        OSError: the address is in use, or not of this machine; the message says what to do.
    """
    sockets = [listening(settings)]
    interval = sys.getswitchinterval()
    try:
        port = sockets[0].getsockname()[1]
        config = uvicorn.Config(
            app,
            ws="websockets-sansio",
            ws_max_size=LARGEST_FRAME,
            ws_per_message_deflate=False,
            ws_ping_interval=20.0,
            proxy_headers=False,  # X-Forwarded-* are read in limits.py, where they are trusted
            server_header=False,
            access_log=not quiet,
            log_config=None,
            timeout_graceful_shutdown=_GRACE,
        )
        logging.getLogger("uvicorn").setLevel(logging.WARNING if quiet else logging.INFO)
        server = _Server(config, lambda: ready(settings.address(port)))
        sys.setswitchinterval(_SWITCH)
        asyncio.run(server.serve(sockets))
    finally:
        sys.setswitchinterval(interval)
        for each in sockets:
            each.close()


def listening(settings: ServerSettings) -> socket.socket:
    """Return a socket that listens at the address of the settings.

    Raises:
        OSError: the address is in use, or not of this machine.
    """
    host, port = settings.host, settings.port
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        family, kind, protocol, _, address = found[0]
        listener = socket.socket(family, kind, protocol)
    except OSError as error:
        raise OSError(f"--host {host} is no address of this machine: {error.strerror}") from None
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
        listener.listen(2048)
    except OSError as error:
        listener.close()
        raise OSError(
            f"cannot listen at {host}, port {port}: {error.strerror}; choose another with --port, "
            "or 0 for a free one"
        ) from None
    return listener


class _Server(uvicorn.Server):
    """A server that ends well by a signal, instead of raising it again, and says when it began."""

    def __init__(self, config: uvicorn.Config, ready: Callable[[], object]) -> None:
        super().__init__(config)
        self._ready = ready

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        if self.started:
            self._ready()

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        before = {
            number: signal.signal(number, self._stop) for number in (signal.SIGINT, signal.SIGTERM)
        }
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    def _stop(self, number: int, frame: FrameType | None) -> None:
        self.force_exit = self.should_exit and number == signal.SIGINT
        self.should_exit = True


class ServerThread:
    """A server in a thread of this process, for tests and benchmarks."""

    def __init__(self, app: ASGIApp, settings: ServerSettings) -> None:
        self._app, self._settings = app, settings

    def start(self) -> str:
        """Begin, and return the address when requests are answered."""
        listener = listening(self._settings)
        self._begun = threading.Event()
        config = uvicorn.Config(
            self._app,
            ws="websockets-sansio",
            ws_max_size=LARGEST_FRAME,
            ws_per_message_deflate=False,
            proxy_headers=False,
            server_header=False,
            log_config=None,
            timeout_graceful_shutdown=_GRACE,
        )
        self._server = _Server(config, self._begun.set)
        self._thread = threading.Thread(
            target=lambda: asyncio.run(self._server.serve([listener])), daemon=True
        )
        self._thread.start()
        if not self._begun.wait(60):
            raise TimeoutError("the server did not begin within 60 s")
        return self._settings.address(listener.getsockname()[1])

    def stop(self) -> None:
        """End it, and wait until it has ended."""
        self._server.should_exit = True
        self._thread.join(60)
