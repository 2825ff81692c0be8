"""Make the pictures of docs/people: every page of hmi-marl play, on a phone and a laptop.

    python docs/making/play_pictures.py

A scripted visitor goes through a whole visit in the machine's Chromium.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tests"))

from browsing import browser  # noqa: E402
from PIL import Image  # noqa: E402

from hmi_marl.envs.config import TeamSettings  # noqa: E402
from hmi_marl.people.play.app import Play  # noqa: E402
from hmi_marl.people.play.settings import PlaySettings  # noqa: E402
from hmi_marl.people.store import Store  # noqa: E402
from hmi_marl.people.web.server import ServerThread  # noqa: E402
from hmi_marl.people.web.settings import ServerSettings  # noqa: E402

FOLDER = ROOT / "docs" / "people"
SIZES = {390: 844, 1280: 800}
"""Height of each width [CSS pixels]."""
COLOURS = 64
"""Of the pictures' palettes, which keep them below 60 kB."""


def visit(page, address: str, shoot: Callable[[str], None]) -> None:
    """Go through all pages."""
    page.goto(address)
    shoot("welcome")
    page.click("text=Begin the calibration")
    shoot("calibration")
    for trip in range(5):
        page.click("button:has-text('Begin trip')")
        page.click("#start")
        look_away(page)
        if trip == 0:
            page.keyboard.press("ArrowUp")
            page.wait_for_timeout(1200)
            shoot("drive")
            look_away(page, shoot)
        page.wait_for_selector("#on:visible")
        if trip == 0:
            shoot("arrived")
        page.click("#on")
        page.wait_for_selector("text=The trip that ended")
        if trip == 2:
            shoot("trial")
    shoot("result")
    page.click("text=Watch it again")
    page.wait_for_function("() => document.getElementById('place').max > 1")
    page.evaluate(
        "() => { const place = document.getElementById('place');"
        " place.value = '3'; place.dispatchEvent(new Event('input')); }"
    )
    shoot("replay")
    page.goto(address)
    page.select_option("#vehicle_ai-partner", "rule")
    page.click("button:has-text('Watch and alert')")
    page.click("#start")
    page.wait_for_timeout(2000)
    page.keyboard.press(" ")
    page.wait_for_selector("#banner:visible")
    shoot("be-the-hmi")
    page.wait_for_selector("#on:visible")
    page.goto(f"{address}data")
    hide_code(page)
    shoot("data")
    page.reload()
    page.click("text=Delete my data")
    shoot("deleted")


def look_away(page, shoot: Callable[[str], None] | None = None) -> None:
    """Search for numbers for a second."""
    page.keyboard.press("n")
    page.wait_for_timeout(900)
    if shoot is not None:
        shoot("number-search")
    target = page.inner_text("#task h2").split()[-1]
    page.click(f"#task .grid button:text-is('{target}')")
    page.wait_for_timeout(400)
    page.keyboard.press("n")


def hide_code(page) -> None:
    """Show a made-up code."""
    page.evaluate(
        "() => { document.querySelector('code').textContent = 'K7QF 2M9P XW4Z H8TD';"
        " document.getElementById('code').value = 'K7QF 2M9P XW4Z H8TD'; }"
    )


def main() -> None:
    """Make all pictures."""
    FOLDER.mkdir(exist_ok=True)
    team = TeamSettings(duration=8.0, end_at_crash=False)
    settings = PlaySettings(team, hmis=("average", "never"), calibration_trips=2, seed=3)
    with tempfile.TemporaryDirectory() as folder, browser() as started:
        for width, height in SIZES.items():
            with Store(Path(folder) / f"{width}.db") as store:
                server = ServerSettings(port=0)
                thread = ServerThread(Play(store, b"k" * 64, settings, server).app(), server)
                address = thread.start()
                page = started.new_page(viewport={"width": width, "height": height})

                def shoot(name: str, page=page, width=width) -> None:
                    path = FOLDER / f"{name}-{width}.png"
                    page.screenshot(path=path, full_page=True)
                    with Image.open(path) as picture:
                        small = picture.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
                    small.save(path, optimize=True)
                    print(path.relative_to(ROOT), path.stat().st_size)

                visit(page, address, shoot)
                page.close()
                thread.stop()


if __name__ == "__main__":
    main()
