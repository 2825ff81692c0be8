"""Screenshots of every page of the rating study, on a phone and a laptop.

Makes a tiny study, serves it, and goes through it in Chromium as a rater does::

    python benchmarks/study_pages.py --out docs/study

writes NAME-390.png and NAME-1280.png for each page. Playwright and Chromium are needed.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from io import BytesIO
from pathlib import Path
from typing import Any

from PIL import Image

from hmi_marl.files import write_bytes
from hmi_marl.people.store import Store
from hmi_marl.people.study.app import StudyService
from hmi_marl.people.study.make import make_study
from hmi_marl.people.study.settings import RATINGS, StudySettings
from hmi_marl.people.study.visits import Visits
from hmi_marl.people.web.cookies import signing_key
from hmi_marl.people.web.pages import Site
from hmi_marl.people.web.server import ServerThread
from hmi_marl.people.web.settings import ServerSettings
from hmi_marl.people.web.texts import Texts

WIDTHS = {390: 844, 1280: 800}
"""Widths and heights of the windows [CSS pixels]."""
COLOURS = 128
SETTINGS = StudySettings(
    drivers=("lisa", "bart"),
    controls=(),
    clips=2,
    shown=2,
    duration=8.0,
    completion_code="C0DE42",
    return_address="https://panel.example/return",
)
CHECK_SHOWN = 5.0
"""Moment of the attention check that is shown [s]."""


def shoot(page: Any, out: Path, name: str) -> None:
    """Write a page in both widths, with few colours."""
    for width, height in WIDTHS.items():
        page.set_viewport_size({"width": width, "height": height})
        page.evaluate("() => new Promise(requestAnimationFrame)")
        picture = Image.open(BytesIO(page.screenshot(full_page=True))).convert("RGB")
        content = BytesIO()
        picture.quantize(COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(
            content, "PNG", optimize=True
        )
        write_bytes(out / f"{name}-{width}.png", content.getvalue())
        print(f"written: {out / f'{name}-{width}.png'}")


def go_through(page: Any, address: str, check: str, out: Path) -> None:
    """Take part, and show every page once."""
    page.goto(address)
    shoot(page, out, "consent")
    page.check("[name=agree]")
    page.click("button:text-is('Begin')")
    page.wait_for_selector("#code")
    shoot(page, out, "instructions")
    page.click("button.primary")
    shown = set()
    while True:
        page.wait_for_selector("#answer, #completion")
        if not page.locator("#answer").count():
            break
        clip = page.locator("[name=page]").get_attribute("value")
        name = "check" if clip == check else "clip"
        if name not in shown:
            page.evaluate(
                """moment => new Promise(done => {
                    const video = document.querySelector("video");
                    video.pause();
                    video.addEventListener("seeked", () => requestAnimationFrame(done));
                    video.currentTime = moment;
                })""",
                CHECK_SHOWN,
            )
            page.check("[name=safe][value='5']")
            shoot(page, out, name)
            shown.add(name)
        for rating in RATINGS:
            page.check(f"[name={rating}][value='4']")
        page.click("button.primary")
        page.wait_for_function(
            "clip => document.querySelector('[name=page]')?.value !== clip", arg=clip
        )
    shoot(page, out, "end")
    page.click("text=Withdraw")
    page.wait_for_selector("button.danger")
    shoot(page, out, "withdraw")
    page.click("button.danger")
    page.wait_for_selector("[role=status]")
    shoot(page, out, "deleted")
    page.goto(f"{address}delete")
    shoot(page, out, "delete")


def main() -> None:
    """Make, serve and show."""
    from playwright.sync_api import sync_playwright

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("docs/study"))
    parser.add_argument("--chromium", default=shutil.which("chromium"))
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        study = make_study(SETTINGS, Path(folder) / "study")
        server = ServerSettings(port=0)
        database = Path(folder) / "people.db"
        with Store(database) as store, sync_playwright() as play:
            site = Site(server, Texts("study"))
            service = StudyService(Visits(study, store), site, signing_key(database))
            thread = ServerThread(service.app(), server)
            address = thread.start()
            browser = play.chromium.launch(executable_path=options.chromium, args=["--no-sandbox"])
            go_through(browser.new_page(), address, study.check.name, options.out)
            browser.close()
            thread.stop()


if __name__ == "__main__":
    main()
