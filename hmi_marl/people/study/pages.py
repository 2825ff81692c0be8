"""Pages of a rating study."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from starlette.responses import HTMLResponse

from hmi_marl.people.study.folder import Study
from hmi_marl.people.study.settings import POINTS, RATINGS
from hmi_marl.people.study.visits import INSTRUCTIONS, Visit
from hmi_marl.people.web.once import FIELD, Once
from hmi_marl.people.web.pages import Content, Markup, Site, tag

_STYLES = ("/static/study/study.css",)
_SCRIPTS = ("/static/study/study.js",)


class Pages:
    """All pages of a study, in the order in which raters see them."""

    def __init__(self, study: Study, site: Site) -> None:
        self._study, self._site = study, site

    def consent(self, ids: Mapping[str, str], missing: bool = False) -> HTMLResponse:
        """Return the study's own text, to agree to; ``ids`` go on to the next page."""
        texts = self._site.texts
        paragraphs = [part for part in self._study.consent.split("\n\n") if part.strip()]
        form = tag(
            "form",
            *(tag("input", type="hidden", name=name, value=value) for name, value in ids.items()),
            tag("input", type="hidden", name=FIELD, value=Once.token()),
            self._alert(texts("consent.missing")) if missing else None,
            tag(
                "label",
                tag("input", type="checkbox", name="agree", value="yes", required=True),
                texts("consent.agree"),
                class_="choice",
            ),
            tag("button", texts("consent.begin"), class_="primary"),
            method="post",
            action=self._site.url("/consent"),
        )
        return self._page(
            texts("consent.title"),
            tag("div", *(tag("p", each.strip()) for each in paragraphs), class_="card"),
            form,
            tag("p", self._link("/delete", texts("delete.link")), class_="note"),
            status=400 if missing else 200,
        )

    def instructions(self, visit: Visit, code: str) -> HTMLResponse:
        """Return what to do, and the rater's code."""
        texts = self._site.texts
        minutes = max(1, round(visit.clips * (self._study.settings.duration + 20.0) / 60.0))
        items = [
            texts("instructions.watch"),
            texts("instructions.rate", points=POINTS),
            texts("instructions.texts"),
            texts("instructions.leave"),
        ]
        return self._page(
            texts("instructions.title"),
            tag("p", texts("instructions.lead", clips=visit.clips, minutes=minutes), class_="lead"),
            tag("ul", *(tag("li", item) for item in items)),
            self._code(code),
            self._site.button("/answer", texts("instructions.begin"), page=INSTRUCTIONS),
            self._leave(),
        )

    def rate(
        self,
        visit: Visit,
        page: str,
        given: Mapping[str, str] | None = None,
        wrong: Sequence[str] = (),
    ) -> HTMLResponse:
        """Return a clip and its four questions, with what was given already."""
        texts, number = self._site.texts, visit.done + 1
        title = texts("rate.title", number=number, clips=visit.clips)
        form = tag(
            "form",
            tag("input", type="hidden", name="page", value=page),
            self._alert(texts("rate.missing")) if wrong else None,
            *(self._question(name, (given or {}).get(name), name in wrong) for name in RATINGS),
            tag("p", "", role="status", class_="status", data_text=texts("rate.lost")),
            tag("button", texts("rate.next"), class_="primary"),
            method="post",
            action=self._site.url("/answer"),
            id="answer",
            data_next=self._site.url("/"),
        )
        return self._page(
            title,
            tag("progress", max=visit.clips, value=visit.done, aria_label=texts("rate.progress")),
            self._clip(page),
            form,
            self._leave(),
            scripts=_SCRIPTS,
            status=400 if wrong else 200,
        )

    def end(self, code: str) -> HTMLResponse:
        """Return thanks, the completion code, the way back, and the rater's code."""
        texts, settings = self._site.texts, self._study.settings
        content: list[Content] = []
        if settings.completion_code:
            shown = tag("code", settings.completion_code, class_="code", id="completion")
            content.append(tag("p", texts("end.completion"), " ", shown))
        if settings.return_address:
            back = tag(
                "a", texts("end.return"), href=settings.return_address, class_="button primary"
            )
            content.append(tag("p", back))
        return self._page(
            texts("end.title"),
            tag("p", texts("end.lead"), class_="lead"),
            *content,
            self._code(code),
            self._leave(),
        )

    def ask_to_leave(self) -> HTMLResponse:
        """Return the question whether to withdraw."""
        texts = self._site.texts
        return self._page(
            texts("withdraw.title"),
            tag("p", texts("withdraw.lead")),
            tag(
                "div",
                self._site.button("/withdraw", texts("withdraw.yes"), "danger"),
                tag("a", texts("withdraw.no"), href=self._site.url("/"), class_="button"),
                class_="row",
            ),
        )

    def delete(self, unknown: bool = False) -> HTMLResponse:
        """Return the form that deletes by a code."""
        texts = self._site.texts
        form = tag(
            "form",
            self._alert(texts("delete.unknown")) if unknown else None,
            tag("label", texts("delete.code"), class_="field", for_="code"),
            tag(
                "p",
                tag(
                    "input",
                    type="text",
                    name="code",
                    id="code",
                    required=True,
                    maxlength=40,
                    autocomplete="off",
                    autocapitalize="characters",
                    spellcheck="false",
                ),
            ),
            tag("button", texts("delete.yes"), class_="danger"),
            method="post",
            action=self._site.url("/delete"),
        )
        return self._page(
            texts("delete.title"),
            tag("p", texts("delete.lead")),
            form,
            status=404 if unknown else 200,
        )

    def deleted(self) -> HTMLResponse:
        """Return that all has been deleted."""
        texts = self._site.texts
        return self._page(texts("deleted.title"), tag("p", texts("deleted.lead"), role="status"))

    def _page(
        self, title: str, *content: Content, scripts: Sequence[str] = (), status: int = 200
    ) -> HTMLResponse:
        return self._site.page(
            title, tag("h1", title), *content, scripts=scripts, styles=_STYLES, status=status
        )

    def _clip(self, name: str) -> Markup:
        address, texts = self._site.url(f"/clips/{name}"), self._site.texts
        if name.endswith(".gif"):
            return tag("img", src=address, alt=texts("rate.clip"), class_="clip")
        video = tag(
            "video",
            tag("a", texts("rate.open"), href=address),
            src=address,
            controls=True,  # which cover a part of the road; the script has its own button
            muted=True,
            playsinline=True,
            preload="auto",
            aria_label=texts("rate.clip"),
            class_="clip",
        )
        words = {name: texts(f"play.{name}") for name in ("play", "pause", "again")}
        button = tag(
            "button",
            words["play"],
            type="button",
            id="play",
            hidden=True,
            data_play=words["play"],
            data_pause=words["pause"],
            data_again=words["again"],
        )
        return Markup(video + tag("p", button))

    def _question(self, name: str, given: str | None, wrong: bool) -> Markup:
        """Seven radio buttons; the ends' meaning is part of their labels."""
        texts = self._site.texts
        low, high = texts(f"scale.low.{name}"), texts(f"scale.high.{name}")
        points = []
        for point in range(1, POINTS + 1):
            meaning = {1: low, POINTS: high}.get(point)
            points.append(
                tag(
                    "label",
                    tag(
                        "input",
                        type="radio",
                        name=name,
                        value=point,
                        required=True,
                        checked=given == str(point),
                    ),
                    tag(
                        "span",
                        str(point),
                        tag("span", f" {meaning}", class_="hidden-label") if meaning else None,
                    ),
                )
            )
        ends = tag("div", tag("span", low), tag("span", high), class_="ends", aria_hidden="true")
        return tag(
            "fieldset",
            tag("legend", texts(f"question.{name}")),
            tag("div", *points, class_="points"),
            ends,
            class_="question card wrong" if wrong else "question card",
        )

    def _code(self, code: str) -> Markup:
        texts = self._site.texts
        shown = tag("code", code, class_="code", id="code")
        return tag("p", texts("code.lead"), " ", shown, class_="card")

    def _leave(self) -> Markup:
        texts = self._site.texts
        return tag("p", self._link("/withdraw", texts("withdraw.link")), class_="note leave")

    def _link(self, path: str, label: str) -> Markup:
        return tag("a", label, href=self._site.url(path))

    def _alert(self, text: str) -> Markup:
        return tag("p", text, role="alert", class_="alarm")
