"""The service: pages and the connection of a trip, over visits, live trips and the database."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import AsyncIterator, Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import HTTPConnection, Request
from starlette.responses import JSONResponse, RedirectResponse, Response
from starlette.routing import Route, WebSocketRoute

from hmi_marl.envs.config import TeamConfig
from hmi_marl.people.play import measured, pages
from hmi_marl.people.play.live import LiveTrips
from hmi_marl.people.play.settings import PlaySettings
from hmi_marl.people.play.sockets import TripSocket
from hmi_marl.people.play.visits import Visit, VisitError
from hmi_marl.people.record import TIME, ReplayError, TripRecord
from hmi_marl.people.store import Store, visitor_name
from hmi_marl.people.web.cookies import Cookies
from hmi_marl.people.web.limits import NEW_VISITORS, Guard, RateLimit, client_address
from hmi_marl.people.web.once import FIELD, Once
from hmi_marl.people.web.pages import Site
from hmi_marl.people.web.server import make_app
from hmi_marl.people.web.settings import Limits, ServerSettings
from hmi_marl.people.web.texts import Texts

KIND = "play"
"""Kind of the sessions."""
_LOCKS = 64

Form = Mapping[str, str]


@dataclass(frozen=True)
class Guest:
    """A visitor with their session."""

    session: str
    code: str
    visit: Visit


class Refusal(Exception):  # noqa: N818  # it is an answer
    """An answer other than the page asked for."""

    def __init__(self, status: int, reason: str) -> None:
        super().__init__(reason)
        self.status = status


class Play:
    """The service of ``hmi-marl play``.

    Args:
        store: the database.
        key: signs cookies, see :func:`hmi_marl.people.web.cookies.signing_key`.
        settings: what visitors can choose.
        server: where it listens.
        limits: of visitors and requests.
    """

    def __init__(
        self,
        store: Store,
        key: bytes,
        settings: PlaySettings | None = None,
        server: ServerSettings | None = None,
        limits: Limits | None = None,
    ) -> None:
        self.settings = settings or PlaySettings()
        self._store = store
        self._server, self._limits = server or ServerSettings(), limits or Limits()
        self._site = Site(self._server, Texts("play"))
        self._pages = pages.PlayPages(self._site, self.settings)
        self._cookies = Cookies("hmi-marl-play", key, self._server)
        self.live = LiveTrips(store, self._limits.max_visitors)
        self._beginnings = RateLimit(*NEW_VISITORS)
        self._once: Once[tuple[str, str]] = Once()
        self._locks = [threading.Lock() for _ in range(_LOCKS)]

    def app(self) -> Guard:
        """Return the ASGI application."""
        socket = TripSocket(self.live, self._limits, self._current_trip)
        routes = [
            self._route("/", self._welcome),
            self._route("/begin", self._begin, "POST"),
            self._route("/trips", self._begin_trip, "POST"),
            self._route("/stop", self._stop, "POST"),
            self._route("/trip", self._trip),
            self._route("/next", self._next),
            self._route("/trips/{number:int}", self._replay),
            self._route("/trips/{number:int}/film", self._film),
            self._route("/trips/{number:int}/record", self._download),
            self._route("/data", self._data),
            self._route("/delete", self._delete, "POST"),
            WebSocketRoute("/trip/socket", socket.serve),
        ]
        static = {"play": Path(__file__).with_name("static")}
        return make_app(self._site, routes, static, self._limits, self._lifespan)

    @contextlib.asynccontextmanager
    async def _lifespan(self, app: Starlette) -> AsyncIterator[None]:
        self.live.start()
        try:
            yield
        finally:
            await self.live.close()

    def _route(
        self, path: str, handler: Callable[[Request, Form], Response], method: str = "GET"
    ) -> Route:
        """Run a handler in a thread, and answer with a page where it refuses."""

        async def endpoint(request: Request) -> Response:
            body = await request.body()
            try:
                form = _form(body) if method == "POST" else {}
                return await run_in_threadpool(handler, request, form)
            except Refusal as refusal:
                return self._site.problem(refusal.status, str(refusal))
            except VisitError as error:
                return self._site.problem(400, str(error))
            except ReplayError:
                return self._site.problem(409, self._site.texts("problem.version"))

        return Route(path, endpoint, methods=[method])

    def _guest(self, connection: HTTPConnection) -> Guest | None:
        """Return the visitor of a request, with what has ended meanwhile; None for a new one."""
        cookie = self._cookies.read(connection)
        if not isinstance(cookie, dict):
            return None
        session = self._store.session(str(cookie.get("session")))
        if session is None or session.kind != KIND:
            return None
        visit = Visit.from_json(session.state)
        if visit.current is not None and self._store.trip(visit.current).record.finished:
            visit = self._keep(session.id, visit.finish())
        return Guest(session.id, str(cookie.get("code")), visit)

    def _known(self, request: Request) -> Guest:
        guest = self._guest(request)
        if guest is None:
            raise Refusal(403, self._site.texts("problem.visit"))
        return guest

    def _keep(self, session: str, visit: Visit) -> Visit:
        self._store.save_session(session, visit.to_json())
        return visit

    @contextlib.contextmanager
    def _alone(self, connection: HTTPConnection) -> Any:
        """Let one request of a visitor at a time change their visit."""
        cookie = self._cookies.read(connection)
        session = str(cookie.get("session")) if isinstance(cookie, dict) else ""
        if not session:
            yield
            return
        with self._locks[hash(session) % _LOCKS]:
            yield

    def _current_trip(self, connection: HTTPConnection) -> int | None:
        """Return the trip under way of a visitor; None without one."""
        with self._alone(connection):
            guest = self._guest(connection)
        if guest is None:
            return None
        return guest.visit.current or guest.visit.last

    def _to(self, path: str) -> Response:
        return RedirectResponse(self._site.url(path), 303)

    def _welcome(self, request: Request, form: Form) -> Response:
        with self._alone(request):
            guest = self._guest(request)
        return self._pages.welcome(guest.visit if guest else None)

    def _begin(self, request: Request, form: Form) -> Response:
        """Choose a way; a new visitor gets a session and a code."""
        with self._alone(request):
            guest = self._guest(request)
            if guest is not None:
                return self._chosen(guest.session, guest.visit, form)
        self._choice(Visit(0), form)  # a choice that is none makes no visitor
        if self.live.full:
            raise Refusal(503, self._site.texts("problem.full"))
        address = client_address(request, self._server.trust_proxy)
        if not self._beginnings.allow(address):
            raise Refusal(429, self._site.texts("problem.wait"))
        session, code = self._once.make(form.get(FIELD, ""), self._new_guest)
        with self._locks[hash(session) % _LOCKS]:
            known = self._store.session(session)
            if known is None:  # deleted since the form was sent before
                self._once.forget((session, code))
                raise Refusal(403, self._site.texts("problem.visit"))
            answer = self._chosen(session, Visit.from_json(known.state), form)
        self._cookies.write(request, answer, {"session": session, "code": code})
        return answer

    def _new_guest(self) -> tuple[str, str]:
        visitor = self._store.new_visitor()
        state = Visit(visitor.number).to_json()
        return self._store.new_session(visitor.number, KIND, state), visitor.code

    def _choice(self, visit: Visit, form: Form) -> Visit:
        if form.get("way") == "measured":
            return visit.choose_measured(self.settings)
        seat, partner, driver = (form.get(name, "") for name in ("seat", "partner", "driver"))
        return visit.choose_free(self.settings, seat, partner, driver)

    def _chosen(self, session: str, visit: Visit, form: Form) -> Response:
        """Begin a free trip at once; a calibration is explained first."""
        if visit.current is not None:
            return self._to("/trip")
        if self.live.full:
            raise Refusal(503, self._site.texts("problem.full"))
        visit = self._keep(session, self._choice(visit, form))
        if visit.way != "free":
            return self._to("/next")
        self._new_trip(session, visit)
        return self._to("/trip")

    def _new_trip(self, session: str, visit: Visit) -> None:
        plan = visit.plan(self.settings, self._calibrated(visit))
        record = TripRecord(
            plan.config, plan.seed, plan.seat, plan.kind, plan.partner, (), (), None, False,
            visitor=visitor_name(visit.visitor), begun=datetime.now(UTC).strftime(TIME),
        )  # fmt: skip
        self._keep(session, visit.begin(self._store.begin_trip(session, record)))

    def _calibrated(self, visit: Visit) -> TeamConfig | None:
        """Return the team of a calibration; a server that is started anew may have another."""
        return next((record.config for record in self._records(visit.calibration[:1])), None)

    def _begin_trip(self, request: Request, form: Form) -> Response:
        with self._alone(request):
            guest = self._known(request)
            if guest.visit.current is None:
                if self.live.full:
                    raise Refusal(503, self._site.texts("problem.full"))
                self._new_trip(guest.session, guest.visit)
        return self._to("/trip")

    def _stop(self, request: Request, form: Form) -> Response:
        with self._alone(request):
            guest = self._known(request)
            self._keep(guest.session, guest.visit.stop())
        return self._to("/")

    def _trip(self, request: Request, form: Form) -> Response:
        with self._alone(request):
            guest = self._guest(request)
        if guest is None:
            return self._to("/")
        if guest.visit.current is None:
            return self._to("/next")
        record = self._store.trip(guest.visit.current).record
        return self._pages.trip(guest.visit, record)

    def _next(self, request: Request, form: Form) -> Response:
        with self._alone(request):
            guest = self._guest(request)
            if guest is None:
                return self._to("/")
            visit, stage = guest.visit, guest.visit.stage(self.settings)
            if stage == "measuring":
                records = self._records(visit.calibration)
                person = measured.measured(visitor_name(visit.visitor), records)
                visit = self._keep(guest.session, visit.measured(person, self.settings))
            if visit.stage(self.settings) == "result" and visit.result is None:
                visit = self._keep(guest.session, visit.judged(self._judged(visit)))
        stage = visit.stage(self.settings)
        if stage == "welcome":
            return self._to("/")
        if stage == "trip":
            return self._to("/trip")
        ended = None
        if visit.last is not None:
            with contextlib.suppress(ReplayError):  # its visit goes on all the same
                ended = measured.summary(self._store.trip(visit.last).record)
        return self._pages.next(visit, stage, ended, guest.code)

    def _judged(self, visit: Visit) -> dict[str, Any]:
        hmis = {
            hmi: [measured.summary(record) for record in self._records(visit.of_hmi(hmi))]
            for hmi in visit.hmis
        }
        believed = measured.belief(self._records(visit.calibration + visit.trial))
        return {"hmis": hmis, "belief": believed}

    def _records(self, numbers: tuple[int, ...]) -> list[TripRecord]:
        return [self._store.trip(number).record for number in numbers]

    def _own_record(self, request: Request) -> TripRecord:
        """Return a trip of this visitor that has ended.

        Raises:
            Refusal: there is none with this number.
        """
        guest, number = self._known(request), request.path_params["number"]
        if number not in guest.visit.own_trips:
            raise Refusal(404, self._site.texts("problem.trip"))
        if number in guest.visit.blinded_trips:
            raise Refusal(403, self._site.texts("problem.blinded"))
        return self._store.trip(number).record

    def _replay(self, request: Request, form: Form) -> Response:
        record = self._own_record(request)
        number = request.path_params["number"]
        return self._pages.replay(number, record, measured.summary(record))

    def _film(self, request: Request, form: Form) -> Response:
        return JSONResponse(measured.pictures(self._own_record(request)))

    def _download(self, request: Request, form: Form) -> Response:
        name = f"trip-{request.path_params['number']}.json"
        content = self._own_record(request).to_json()
        headers = {"Content-Disposition": f'attachment; filename="{name}"'}
        return JSONResponse(content, headers=headers)

    def _data(self, request: Request, form: Form) -> Response:
        guest = self._guest(request)
        if guest is None:
            return self._pages.data(None, "")
        return self._pages.data(guest.visit, guest.code)

    def _delete(self, request: Request, form: Form) -> Response:
        """Delete the data of the visitor with a code, who need not be the one that asks."""
        code = form.get("code", "")
        number = self._store.find_visitor(code)
        if number is None:
            raise Refusal(404, self._site.texts("problem.code"))
        counts = self._store.delete_visitor(code)
        answer = self._pages.deleted(counts)
        if self._guest(request) is None:
            self._cookies.clear(answer)
        return answer


def _form(body: bytes) -> dict[str, str]:
    """Return the last value of each name of a form.

    Raises:
        Refusal: too many values.
    """
    try:
        values = parse_qs(body.decode("utf-8", "replace"), True, max_num_fields=20)
    except ValueError:
        raise Refusal(400, "a form has at most 20 fields") from None
    return {name: each[-1].strip() for name, each in values.items()}
