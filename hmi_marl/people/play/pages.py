"""Pages of play."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from starlette.responses import HTMLResponse

from hmi_marl.envs.config import DRIVER, VEHICLE_AI
from hmi_marl.envs.drivers import get_driver
from hmi_marl.people.play.result_parts import belief_table, order_table, traits_table
from hmi_marl.people.play.settings import PlaySettings
from hmi_marl.people.play.trip_parts import alert_pad, driver_pad, facts, stage
from hmi_marl.people.play.visits import Stage, Visit
from hmi_marl.people.record import TripRecord
from hmi_marl.people.web.once import FIELD, Once
from hmi_marl.people.web.pages import Content, Markup, Site, tag

_STYLES = ("/static/play/play.css",)


class PlayPages:
    """All pages of the service.

    Args:
        site: what they have in common.
        settings: what visitors can choose.
    """

    def __init__(self, site: Site, settings: PlaySettings) -> None:
        self._site, self._settings, self._texts = site, settings, site.texts

    def welcome(self, visit: Visit | None) -> HTMLResponse:
        """Return the first page, with the way back into a visit."""
        texts, settings = self._texts, self._settings
        once = Once.token()
        cards: list[Content] = []
        if settings.measures:
            cards.append(self._measured_card(visit, once))
        if DRIVER in settings.seats:
            cards.append(self._free_card(DRIVER, once, settings.hmis))
        if VEHICLE_AI in settings.seats:
            policies = settings.driver_policies
            cards.append(self._free_card(VEHICLE_AI, once, policies, settings.drivers))
        return self._page(
            texts("welcome.title"),
            tag("h1", texts("welcome.title")),
            tag("p", texts("welcome.lead"), class_="lead"),
            self._go_on(visit),
            tag("div", *cards, class_="cards"),
            tag("h2", texts("welcome.stored.title")),
            tag("p", texts("welcome.stored")),
            self._data_link(),
            wide=True,
        )

    def _go_on(self, visit: Visit | None) -> Content:
        if visit is None or (not visit.way and visit.current is None):
            return None
        path = "/trip" if visit.current is not None else "/next"
        texts = self._texts
        link = tag("a", texts("welcome.on"), href=self._site.url(path), class_="button primary")
        stop: Content = None
        if visit.current is not None:
            stop = self._site.button("/stop", texts("welcome.stop"), None)
        return tag("div", link, stop, class_="row")

    def _measured_card(self, visit: Visit | None, once: str) -> Markup:
        texts, settings = self._texts, self._settings
        again = visit is not None and bool(visit.calibration)
        label = texts("welcome.measured.on") if again else texts("welcome.measured.begin")
        return tag(
            "section",
            tag("h2", texts("welcome.measured.title")),
            tag(
                "p",
                texts(
                    "welcome.measured",
                    calibration=settings.calibration_trips,
                    trial=3 * settings.trial_trips,
                    seconds=f"{settings.team.duration:g}",
                ),
            ),
            self._site.button("/begin", label, way="measured", **{FIELD: once}),
            class_="card",
        )

    def _free_card(
        self, seat: str, once: str, partners: Sequence[str], drivers: Sequence[str] = ()
    ) -> Markup:
        texts = self._texts
        fields = [
            self._choice(f"{seat}-partner", "partner", texts(f"seat.{seat}.partner"), partners)
        ]
        if drivers:
            names = [get_driver(name).name for name in drivers]
            fields.append(
                self._choice(f"{seat}-driver", "driver", texts("seat.driver.name"), drivers, names)
            )
        form = tag(
            "form",
            tag("input", type="hidden", name="way", value="free"),
            tag("input", type="hidden", name="seat", value=seat),
            tag("input", type="hidden", name=FIELD, value=once),
            *fields,
            tag("button", texts(f"seat.{seat}.begin"), class_="primary"),
            method="post",
            action=self._site.url("/begin"),
        )
        return tag(
            "section",
            tag("h2", texts(f"seat.{seat}.title")),
            tag("p", texts(f"seat.{seat}.about")),
            form,
            class_="card",
        )

    def _choice(
        self,
        identity: str,
        name: str,
        label: str,
        values: Sequence[str],
        shown: Sequence[str] | None = None,
    ) -> Markup:
        options = [
            tag("option", self._policy(word) if shown is None else word.capitalize(), value=value)
            for value, word in zip(values, shown or values, strict=True)
        ]
        return tag(
            "p",
            tag("label", label, for_=identity, class_="field"),
            tag("select", *options, name=name, id=identity),
        )

    def _policy(self, name: str) -> str:
        """Return a policy's name in words, where there are any."""
        kind, _, argument = name.partition(":")
        key = name.replace(":", ".") if f"policy.{name.replace(':', '.')}" in self._texts else kind
        if f"policy.{key}" not in self._texts:
            return name
        words = self._texts(f"policy.{key}")
        return words if key != kind or not argument else f"{words} ({argument})"

    def trip(self, visit: Visit, record: TripRecord) -> HTMLResponse:
        """Return the page of a trip under way, which its scripts fill."""
        texts, driving = self._texts, record.seat == DRIVER
        title = texts(f"seat.{record.seat}.title")
        data = {
            "trip": str(visit.current),
            "seat": record.seat,
            "texts": json.dumps(texts.all("trip.")),
        }
        return self._page(
            title,
            tag("h1", title, class_="compact"),
            self._progress(visit),
            tag(
                "div",
                stage(self._site),
                tag(
                    "div",
                    facts(texts, driving),
                    driver_pad(texts) if driving else alert_pad(texts, record),
                    tag(
                        "div",
                        tag(
                            "button", texts("trip.sound.on"), id="sound", type="button",
                            aria_pressed="true",
                        ),
                        self._site.button("/stop", texts("trip.stop"), None),
                        class_="row",
                    ),
                    class_="side",
                ),
                class_="play",
            ),
            scripts=["/static/play/trip.js"],
            data=data,
            wide=True,
        )  # fmt: skip

    def _progress(self, visit: Visit) -> Content:
        """Say which of several trips it is."""
        texts, settings = self._texts, self._settings
        if visit.way != "measured":
            return None
        if visit.person is None:
            number, of = len(visit.calibration) + 1, settings.calibration_trips
            return tag("p", texts("trip.calibration", number=number, of=of), class_="note")
        number, of = len(visit.trial) + 1, len(visit.order)
        return tag("p", texts("trip.trial", number=number, of=of), class_="note")

    def next(
        self, visit: Visit, at: Stage, ended: Mapping[str, Any] | None, code: str
    ) -> HTMLResponse:
        """Return the page between trips, or that of the result."""
        texts, settings = self._texts, self._settings
        parts: list[Content] = []
        if at == "over":
            title = texts("over.title")
            parts += [self._site.button("/trips", texts("over.again"))]
        elif at == "calibration":
            done, of = len(visit.calibration), settings.calibration_trips
            title = texts("calibration.title")
            parts += [
                tag("p", texts("calibration.lead")),
                tag("ul", *(tag("li", texts(f"calibration.{each}")) for each in ("1", "2", "3"))),
                self._bar(done, of),
                self._site.button("/trips", texts("calibration.begin", number=done + 1, of=of)),
            ]
        elif at == "trial":
            assert visit.person is not None
            done, of = len(visit.trial), len(visit.order)
            title = texts("trial.title")
            parts += [
                traits_table(visit.person, texts),
                tag("p", texts("trial.lead")),
                self._bar(done, of),
                self._site.button("/trips", texts("trial.begin", number=done + 1, of=of)),
            ]
        else:
            title = texts("result.title")
            parts += self._result(visit, code)
        return self._page(
            title,
            tag("h1", title),
            self._ended(visit, ended),
            *parts,
            tag("p", tag("a", texts("over.first"), href=self._site.url("/"))),
            self._data_link(),
        )

    def _result(self, visit: Visit, code: str) -> list[Content]:
        assert visit.person is not None
        assert visit.result is not None
        texts = self._texts
        return [
            tag("p", texts("result.lead"), class_="lead"),
            order_table(visit.result["hmis"], visit.hmis, texts),
            traits_table(visit.person, texts),
            belief_table(visit.result["belief"], texts),
            tag(
                "section",
                tag("h2", texts("data.code.title")),
                tag("p", texts("data.code")),
                tag("p", tag("code", _grouped(code), class_="code")),
                class_="card",
            ),
        ]

    def _bar(self, done: int, of: int) -> Markup:
        label = self._texts("over.done", done=done, of=of)
        return tag(
            "p",
            tag("label", label, for_="done"),
            tag("progress", value=done, max=of, id="done"),
        )

    def _ended(self, visit: Visit, ended: Mapping[str, Any] | None) -> Content:
        """Show the trip that ended last."""
        if ended is None:
            return None
        texts = self._texts
        number = visit.last
        blinded = number in visit.blinded_trips
        outcome = texts("over.crashed") if ended["crashed"] else texts("over.whole")
        return tag(
            "section",
            tag("h2", texts("over.last")),
            tag("p", outcome, role="status"),
            self._summary(ended, blinded),
            None if blinded else tag(
                "div",
                tag("a", texts("over.replay"), href=self._site.url(f"/trips/{number}"),
                    class_="button"),
                tag("a", texts("over.download"), href=self._site.url(f"/trips/{number}/record"),
                    class_="button", download=True),
                class_="row",
            ),
            class_="card",
        )  # fmt: skip

    def _summary(self, ended: Mapping[str, Any], blinded: bool = False) -> Markup:
        """Show a trip in numbers, those left out that would tell its HMI."""
        texts = self._texts
        values = {
            "score": f"{ended['score']:.0f}",
            "seconds": f"{ended['seconds']:.1f} s",
            "speed": f"{3.6 * ended['speed']:.0f} km/h",
            "away": f"{100 * ended['away']:.0f} %",
            "alerts": str(ended["alerts"]),
        }
        if blinded:
            del values["alerts"]
        shown = [
            tag("div", tag("dt", texts(f"over.fact.{name}")), tag("dd", value))
            for name, value in values.items()
        ]
        return tag("dl", *shown, class_="facts")

    def replay(self, number: int, record: TripRecord, sums: Mapping[str, Any]) -> HTMLResponse:
        """Return the page that shows a trip again."""
        texts = self._texts
        title = texts("replay.title", number=number)
        controls = tag(
            "div",
            tag("button", texts("trip.replay.play"), id="play", class_="primary", disabled=True),
            tag("label", texts("replay.place"), for_="place", class_="hidden-label"),
            tag("input", type="range", id="place", min=0, max=1, value=0, step=1),
            class_="row",
        )
        return self._page(
            title,
            tag("h1", title),
            tag(
                "div",
                tag("canvas", id="road", role="img", aria_label=texts("trip.canvas")),
                tag("div", id="banner", aria_hidden="true", hidden=True),
                class_="stage",
            ),
            controls,
            tag("p", id="status", role="status", class_="note"),
            self._summary(sums),
            tag("p", texts("replay.about", seed=record.seed, steps=len(record)), class_="note"),
            tag(
                "div",
                tag("a", texts("over.download"), class_="button", download=True,
                    href=self._site.url(f"/trips/{number}/record")),
                tag("a", texts("replay.back"), class_="button", href=self._site.url("/next")),
                class_="row",
            ),
            scripts=["/static/play/replay.js"],
            data={
                "film": self._site.url(f"/trips/{number}/film"),
                "texts": json.dumps(texts.all("trip.")),
            },
        )  # fmt: skip

    def data(self, visit: Visit | None, code: str) -> HTMLResponse:
        """Return the page on which a visitor sees, downloads and deletes their data."""
        texts = self._texts
        own: list[Content] = []
        if visit is not None:
            shown = set(visit.own_trips) - set(visit.blinded_trips)
            own = [
                tag("p", texts("data.code")),
                tag("p", tag("code", _grouped(code), class_="code")),
                tag("p", texts("data.trips", count=len(visit.own_trips))),
                tag("ul", *(self._own_trip(number) for number in sorted(shown))),
            ]
        return self._page(
            texts("data.title"),
            tag("h1", texts("data.title")),
            *own,
            tag("h2", texts("data.delete.title")),
            tag("p", texts("data.delete")),
            tag(
                "form",
                tag("label", texts("data.delete.label"), for_="code", class_="field"),
                tag("p", tag("input", type="text", name="code", id="code", value=_grouped(code),
                             required=True, autocomplete="off", maxlength="40")),
                tag("button", texts("data.delete.button"), class_="danger"),
                method="post",
                action=self._site.url("/delete"),
            ),
            tag("p", tag("a", texts("over.first"), href=self._site.url("/"))),
        )  # fmt: skip

    def _own_trip(self, number: int) -> Markup:
        texts = self._texts
        show = tag("a", texts("data.trip", number=number), href=self._site.url(f"/trips/{number}"))
        return tag("li", show)

    def deleted(self, counts: Mapping[str, int]) -> HTMLResponse:
        """Return the page after a deletion."""
        texts = self._texts
        words = texts("data.deleted", trips=counts["trips"], decisions=counts["decisions"])
        return self._page(
            texts("data.deleted.title"),
            tag("h1", texts("data.deleted.title")),
            tag("p", words, role="status"),
            tag("p", tag("a", texts("over.first"), href=self._site.url("/"))),
        )

    def _data_link(self) -> Markup:
        link = tag("a", self._texts("data.title"), href=self._site.url("/data"))
        return tag("p", link, class_="note")

    def _page(self, title: str, *content: Content, **more: Any) -> HTMLResponse:
        return self._site.page(title, *content, styles=_STYLES, **more)


def _grouped(code: str) -> str:
    """Write a code in groups of four."""
    return " ".join(code[start : start + 4] for start in range(0, len(code), 4))
