"""Pages of HTML, made of elements: every text is escaped, and nothing is inline.

::

    site = Site(ServerSettings(), Texts("play"))
    site.page("Welcome", tag("p", "1 < 2", class_="lead"), tag("a", "on", href=site.url("/next")))
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from html import escape
from pathlib import Path

from starlette.responses import HTMLResponse

import hmi_marl
from hmi_marl.people.web.settings import ServerSettings
from hmi_marl.people.web.texts import Texts

STATIC = Path(__file__).with_name("static")
"""Files that all services share; served under /static/web."""
_VOID = {"br", "hr", "img", "input", "link", "meta", "source"}


class Markup(str):
    """Text that is HTML already."""

    __slots__ = ()


Content = str | Markup | None | Iterable["Content"]
"""Content of an element; plain text is escaped, None is nothing."""


def markup(content: Content) -> Markup:
    """Return content as HTML."""
    if content is None:
        return Markup("")
    if isinstance(content, Markup):
        return content
    if isinstance(content, str):
        return Markup(escape(content))
    return Markup("".join(markup(each) for each in content))


def tag(element: str, *content: Content, **attributes: str | int | float | bool | None) -> Markup:
    """Return an element.

    Args:
        element: name, such as "p".
        content: texts and elements in it.
        attributes: a final _ is left out and other _ become -, as in class_ and aria_label; True
            stands alone, and None and False are left out.
    """
    words = [element]
    for key, value in attributes.items():
        name = key.rstrip("_").replace("_", "-")
        if value is True:
            words.append(name)
        elif value is not None and value is not False:
            words.append(f'{name}="{escape(str(value))}"')
    opening = f"<{' '.join(words)}>"
    if element in _VOID:
        return Markup(opening)
    return Markup(f"{opening}{markup(content)}</{element}>")


@dataclass(frozen=True)
class Site:
    """What the pages of a service have in common."""

    settings: ServerSettings
    texts: Texts

    def url(self, path: str) -> str:
        """Return the address of a path such as /trip."""
        return f"{self.settings.base_path}{path}"

    def page(
        self,
        title: str,
        *content: Content,
        scripts: Iterable[str] = (),
        styles: Iterable[str] = (),
        data: dict[str, str] | None = None,
        wide: bool = False,
        status: int = 200,
    ) -> HTMLResponse:
        """Return a page.

        Args:
            title: of the page, without the name of the site.
            content: of its main part; the first heading is up to it.
            scripts: paths of modules, such as /static/play/trip.js.
            styles: paths of more style sheets.
            data: attributes data-* of the body, for scripts; data-base is always there.
            wide: whether the page takes the whole width.
            status: of HTTP.
        """
        texts = self.texts
        name = texts("site")
        values = {"base": self.settings.base_path} | (data or {})
        head = [
            tag("meta", charset="utf-8"),
            tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
            tag("meta", name="color-scheme", content="light dark"),
            tag("meta", name="robots", content="noindex"),
            tag("title", f"{title} – {name}"),
            tag("link", rel="icon", type="image/svg+xml", href=self._file("/static/web/icon.svg")),
            *(
                tag("link", rel="stylesheet", href=self._file(path))
                for path in ("/static/web/site.css", *styles)
            ),
            *(tag("script", type="module", src=self._file(path)) for path in scripts),
        ]
        body = [
            tag("a", texts("skip"), class_="skip", href="#main"),
            tag("header", tag("a", name, href=self.url("/"), class_="brand"), class_="site"),
            tag("main", *content, id="main", class_="wide" if wide else None, tabindex="-1"),
            tag("footer", tag("p", texts("footer")), class_="site"),
        ]
        data_of = {f"data_{key}": value for key, value in values.items()}
        html = tag("html", tag("head", *head), tag("body", *body, **data_of), lang=texts.language)
        return HTMLResponse(f"<!doctype html>\n{html}", status)

    def button(
        self, path: str, label: str, class_: str | None = "primary", **hidden: str
    ) -> Markup:
        """Return a form of one button, which posts to a path.

        Args:
            path: such as /begin.
            label: of the button.
            class_: of the button.
            hidden: values that are sent.
        """
        values = [
            tag("input", type="hidden", name=key, value=value) for key, value in hidden.items()
        ]
        button = tag("button", label, class_=class_)
        return tag("form", *values, button, method="post", action=self.url(path))

    def problem(self, status: int, reason: str) -> HTMLResponse:
        """Return the page of an error."""
        texts = self.texts
        return self.page(
            texts("problem.title"),
            tag("h1", texts("problem.title")),
            tag("p", reason, role="alert"),
            tag("p", tag("a", texts("problem.back"), href=self.url("/"))),
            status=status,
        )

    def _file(self, path: str) -> str:
        """The version lets a browser keep a file until there is another."""
        return f"{self.url(path)}?v={hmi_marl.__version__}"
