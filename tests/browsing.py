"""Pages as a reader's browser shows them: what overflows, is faint, fails, or leads nowhere.

Debian's Chromium, or the one that HMI_MARL_CHROMIUM names, opens files of a folder.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import unquote, urldefrag, urlparse

WIDTHS = (390, 768, 1280)
"""Widths of a phone, a tablet and a laptop [CSS pixels]."""
_NAMES = ("chromium", "chromium-browser", "google-chrome")
ANOTHER_MACHINE = "lab.example"
"""A host that is this machine, and that the browser trusts no more than any on the net."""
_QUIET = (
    f"--host-resolver-rules=MAP {ANOTHER_MACHINE} 127.0.0.1",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)

_OVERFLOWS = (Path(__file__).parent / "overflows.js").read_text("utf-8")
_FAINT = (Path(__file__).parent / "faint.js").read_text("utf-8")
_LINKS = "() => [...document.querySelectorAll('a[href]')].map(a => a.href)"
_CORNERS = """async () => {
  const found = [];
  for (const image of document.images) {
    await image.decode();
    const canvas = document.createElement('canvas'), of = canvas.getContext('2d');
    of.drawImage(image, 0, 0);
    found.push([...of.getImageData(0, 0, 1, 1).data].slice(0, 3));
  }
  return found;
}"""
_IDS = "() => [...document.querySelectorAll('[id]')].map(e => e.id)"


def chromium() -> str | None:
    """Path of the browser, or None where there is none."""
    named = os.environ.get("HMI_MARL_CHROMIUM")
    return named or next((path for path in map(shutil.which, _NAMES) if path), None)


@dataclass
class Walk:
    """What is wrong with pages that were visited."""

    problems: list[str] = field(default_factory=list)
    links: dict[str, set[str]] = field(default_factory=dict)
    """Addresses that each page leads to."""
    ids: dict[Path, set[str]] = field(default_factory=dict)
    """Anchors of each page."""

    def dead_links(self) -> list[str]:
        """Links to files that are not there, and to anchors that their page lacks."""
        dead = []
        for page, links in self.links.items():
            for link in sorted(links):
                address, anchor = urldefrag(link)
                if urlparse(address).scheme != "file":
                    continue
                target = Path(unquote(urlparse(address).path))
                known = self.ids.get(target)
                if not target.is_file():
                    dead.append(f"{page}: {link} is not there")
                elif anchor and known is not None and unquote(anchor) not in known:
                    dead.append(f"{page}: {link} has no such anchor")
        return dead

    def elsewhere(self) -> set[str]:
        """Addresses on the net that pages lead to."""
        every = set().union(*self.links.values()) if self.links else set()
        return {link for link in every if urlparse(link).scheme in ("http", "https")}


class Reader:
    """A browser with one open page."""

    def __init__(self, browser, dark: bool = False) -> None:
        self.scheme = "dark" if dark else "light"
        self.context = browser.new_context(color_scheme=self.scheme)
        self.page = self.context.new_page()
        self.page.set_default_timeout(120_000)
        self.said: list[str] = []
        self.page.on("console", self._hear)
        self.page.on("pageerror", lambda error: self.said.append(f"error: {error}"))
        self.page.on("request", self._watch)
        self.page.on("requestfailed", lambda asked: self.said.append(f"failed: {asked.url[:200]}"))

    def _hear(self, message) -> None:
        if message.type in ("error", "warning"):
            self.said.append(f"{message.type}: {message.text}")

    def _watch(self, request) -> None:
        if urlparse(request.url).scheme not in ("file", "data", "blob"):
            self.said.append(f"asks the net for {request.url}")

    def open(self, path: Path) -> None:
        """Open a file, and wait until its scripts have run."""
        self.page.goto(path.as_uri(), wait_until="load")
        self.page.evaluate(
            "() => document.fonts.ready.then(() => new Promise(requestAnimationFrame))"
        )

    def corners(self) -> list[tuple[int, int, int]]:
        """Colour of the first pixel of every image, which is that of its background."""
        return [tuple(colour) for colour in self.page.evaluate(_CORNERS)]

    def overflows(self, width: int) -> list[str]:
        """What leaves its box or the page at a width."""
        self.page.set_viewport_size({"width": width, "height": 900})
        self.page.evaluate("() => new Promise(done => setTimeout(done, 60))")
        return self.page.evaluate(_OVERFLOWS)

    def faint(self) -> list[str]:
        """Texts that are hard to read on what is behind them, by day and by night."""
        self.page.add_style_tag(content="* { transition: none !important; }")
        found = []
        for scheme in ("light", "dark"):
            self.page.emulate_media(color_scheme=scheme)
            self.page.evaluate("() => new Promise(requestAnimationFrame)")
            found += [f"in the {scheme}, {what}" for what in self.page.evaluate(_FAINT)]
        self.page.emulate_media(color_scheme=self.scheme)
        return found


@contextmanager
def browser() -> Iterator:
    """A browser that talks to nobody but its pages."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        started = play.chromium.launch(executable_path=chromium(), args=list(_QUIET))
        try:
            yield started
        finally:
            started.close()


def walk(started, folder: Path, pages: list[Path], *, dark: bool = False) -> Walk:
    """Read pages of a folder at all widths."""
    found, reader = Walk(), Reader(started, dark)
    for path in pages:
        name = path.relative_to(folder).as_posix()
        reader.said.clear()
        reader.open(path)
        for width in WIDTHS:
            found.problems += [f"{name} at {width}: {what}" for what in reader.overflows(width)]
        found.problems += [f"{name}: {what}" for what in [*reader.faint(), *reader.said]]
        found.links[name] = set(reader.page.evaluate(_LINKS))
        found.ids[path] = set(reader.page.evaluate(_IDS))
    reader.context.close()
    return found
