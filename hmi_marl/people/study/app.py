"""Web service of a rating study; pages are plain forms, which work without scripts too."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl

from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import FileResponse, RedirectResponse, Response
from starlette.routing import Route

from hmi_marl.people.store import Visitor
from hmi_marl.people.study.pages import Pages
from hmi_marl.people.study.visits import INSTRUCTIONS, PANEL_IDS, Visit, Visits
from hmi_marl.people.web.cookies import Cookies
from hmi_marl.people.web.limits import NEW_VISITORS, Guard, RateLimit, client_address
from hmi_marl.people.web.once import FIELD, Once
from hmi_marl.people.web.pages import Site
from hmi_marl.people.web.server import make_app
from hmi_marl.people.web.settings import Limits

STATIC = Path(__file__).with_name("static")
COOKIE = "hmi-marl-study"
_ACTIVE = 900.0
"""Time after the last page for which a rater counts as present [s]."""
_CODES = 0.2, 10.0
"""Codes from one address that may be tried per second, and at once."""
_FIELDS = 20


class StudyService:
    """Routes of a study.

    Args:
        visits: of the study, in its database.
        site: settings and texts of the pages.
        key: signs the cookies.
        limits: of visitors and requests.
        most_raters: raters after whom no more are admitted.
        clock: returns the time [s].
    """

    def __init__(
        self,
        visits: Visits,
        site: Site,
        key: bytes,
        limits: Limits | None = None,
        most_raters: int = 100_000,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._visits, self._site, self._clock = visits, site, clock
        self._limits, self._most_raters = limits or Limits(), most_raters
        self._pages = Pages(visits.study, site)
        self._cookies = Cookies(COOKIE, key, site.settings)
        self._beginnings, self._codes = RateLimit(*NEW_VISITORS), RateLimit(*_CODES)
        self._once: Once[tuple[Visitor, str]] = Once()
        self._seen: dict[str, float] = {}

    def app(self) -> Guard:
        """Return the application."""
        routes = [
            Route("/", self._first),
            Route("/consent", self._consent, methods=["POST"]),
            Route("/answer", self._answer, methods=["POST"]),
            Route("/withdraw", self._ask_withdraw),
            Route("/withdraw", self._withdraw, methods=["POST"]),
            Route("/delete", self._ask_delete),
            Route("/delete", self._delete, methods=["POST"]),
            Route("/clips/{name}", self._clip),
        ]
        return make_app(self._site, routes, {"study": STATIC}, self._limits)

    async def _first(self, request: Request) -> Response:
        visit, code = await self._visit(request)
        if visit is None:
            query = request.query_params
            ids = {name: query[name][:64] for name in PANEL_IDS if name in query}
            return self._pages.consent(ids if self._visits.study.settings.keep_ids else {})
        return self._page(visit, code)

    def _page(self, visit: Visit, code: str) -> Response:
        if visit.due is None:
            return self._pages.end(code)
        if visit.due == INSTRUCTIONS:
            return self._pages.instructions(visit, code)
        return self._pages.rate(visit, visit.due)

    async def _consent(self, request: Request) -> Response:
        form = await _form(request)
        visit, _ = await self._visit(request)
        if visit is not None:  # sent twice
            return self._home()
        ids = {name: form[name] for name in PANEL_IDS if name in form}
        if form.get("agree") != "yes":
            return self._pages.consent(ids, missing=True)
        texts, address = self._site.texts, client_address(request, self._site.settings.trust_proxy)
        if not self._beginnings.allow(address):
            raise HTTPException(429, texts("consent.wait"), {"Retry-After": "10"})
        if self._present() >= self._limits.max_visitors:
            raise HTTPException(503, texts("consent.full"), {"Retry-After": "60"})
        if await run_in_threadpool(self._visits.raters) >= self._most_raters:
            raise HTTPException(403, texts("consent.over"))
        begun = await run_in_threadpool(
            self._once.make, form.get(FIELD, ""), lambda: self._visits.begin(ids)
        )
        visitor, session = begun
        if await run_in_threadpool(self._visits.find, session) is None:  # withdrawn since
            self._once.forget(begun)
            return self._home()
        self._seen[session] = self._clock()
        answer = self._home()
        self._cookies.write(request, answer, {"session": session, "code": visitor.code})
        return answer

    async def _answer(self, request: Request) -> Response:
        form = await _form(request)
        visit, _ = await self._visit(request)
        if visit is None:
            return self._home()
        page = form.get("page", "")
        try:
            wrong = await run_in_threadpool(self._visits.answer, visit, page, form)
        except ValueError as error:
            raise HTTPException(400, str(error)) from None
        if wrong:
            return self._pages.rate(visit, page, form, wrong)
        if request.headers.get("accept") == "application/json":  # the script's, which goes on
            return Response(status_code=204)
        return self._home()

    async def _ask_withdraw(self, request: Request) -> Response:
        visit, _ = await self._visit(request)
        return self._home() if visit is None else self._pages.ask_to_leave()

    async def _withdraw(self, request: Request) -> Response:
        visit, code = await self._visit(request)
        if visit is None:
            return self._home()
        await run_in_threadpool(self._visits.delete, code)
        return self._deleted()

    async def _ask_delete(self, request: Request) -> Response:
        return self._pages.delete()

    async def _delete(self, request: Request) -> Response:
        form = await _form(request)
        address = client_address(request, self._site.settings.trust_proxy)
        if not self._codes.allow(address):
            raise HTTPException(429, self._site.texts("consent.wait"), {"Retry-After": "10"})
        deleted = await run_in_threadpool(self._visits.delete, form.get("code", ""))
        return self._deleted() if deleted else self._pages.delete(unknown=True)

    async def _clip(self, request: Request) -> Response:
        path = self._visits.study.path(request.path_params["name"])
        if path is None or not path.is_file():
            raise HTTPException(404)
        return FileResponse(path, headers={"Cache-Control": "private, max-age=86400"})

    async def _visit(self, request: Request) -> tuple[Visit | None, str]:
        """The visit of a cookie, and the code in it."""
        content: Any = self._cookies.read(request)
        if not isinstance(content, dict):
            return None, ""
        visit = await run_in_threadpool(self._visits.find, content.get("session"))
        if visit is not None:
            self._seen[visit.session] = self._clock()
        return visit, str(content.get("code", ""))

    def _present(self) -> int:
        """Number of raters who were seen of late."""
        since = self._clock() - _ACTIVE
        self._seen = {session: last for session, last in self._seen.items() if last >= since}
        return len(self._seen)

    def _home(self) -> Response:
        return RedirectResponse(self._site.url("/"), 303)

    def _deleted(self) -> Response:
        answer = self._pages.deleted()
        self._cookies.clear(answer)
        return answer


async def _form(request: Request) -> Mapping[str, str]:
    """Fields of a form, the last of each name."""
    body = await request.body()
    try:
        return dict(parse_qsl(body.decode(), max_num_fields=_FIELDS))
    except ValueError:
        raise HTTPException(400, "this is not a form of the study's pages") from None
