"""Make the documentation site: ``python docs/making``, or make docs.

Pages are put together in an empty folder: those of ``docs/`` with their made parts filled in, those
of the API from the sources, those of the notebooks. There zensical makes the site from them.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import api_pages
import notebook_pages
from made_parts import ROOT, fill
from mathml import with_mathml

DOCS = ROOT / "docs"
MAKING = DOCS / "making"
NOTEBOOKS = ROOT / "examples" / "notebooks"
_NOTEBOOK = re.compile(r"\]\(\.\./examples/notebooks/(\w+)\.ipynb\)")


def texts(target: Path) -> dict[str, str]:
    """Return the Markdown of every page by its path; write what notebooks show into ``target``."""
    found = {}
    for path in sorted(DOCS.rglob("*.md")):
        written = path.read_text("utf-8")
        text = _NOTEBOOK.sub(r"](notebooks/\1.md)", fill(written))
        found[path.relative_to(DOCS).as_posix()] = _edited_at(_home(written), text)
    for name, text in api_pages.Reference(ROOT).pages().items():
        folder = "" if name == "api/index.md" else f"/{Path(name).stem}"
        found[name] = _edited_at(f"tree/main/hmi_marl{folder}", text)
    for name, text in notebook_pages.pages(NOTEBOOKS, target).items():
        home = f"blob/main/examples/notebooks/{Path(name).stem}.ipynb"
        found[name] = _edited_at(home, text)
    return found


def make(site: Path) -> int:
    """Make the site in a folder, in place of what is there; return the exit status."""
    with tempfile.TemporaryDirectory(prefix="hmi-marl-site-") as name:
        work = Path(name).resolve()
        omitted = shutil.ignore_patterns("making", "*.md", "__pycache__")
        shutil.copytree(DOCS, work / "docs", ignore=omitted)
        shutil.copytree(MAKING / "theme", work / "theme")
        for path, text in texts(work / "docs").items():
            page = work / "docs" / path
            page.parent.mkdir(parents=True, exist_ok=True)
            page.write_text(with_mathml(text), "utf-8")
        (work / "mkdocs.yml").write_text(
            f"INHERIT: {ROOT / 'mkdocs.yml'}\ndocs_dir: docs\nsite_dir: site\n"
            "theme: {custom_dir: theme}\n",
            "utf-8",
        )
        command = [sys.executable, "-m", "zensical", "build", "--strict"]
        run = subprocess.run([*command, "--config-file", work / "mkdocs.yml"], check=False)
        if run.returncode == 0:
            (work / "site" / "404.html").unlink()  # its addresses hold at a server's root alone
            shutil.rmtree(site, ignore_errors=True)
            shutil.copytree(work / "site", site)
        return run.returncode


def _home(page: str) -> str:
    """File of the repository that a page is wholly made from, as an address; or nothing."""
    found = re.fullmatch(r"# .*\n+<!-- made: file (\S+) -->\n(?:.*\n)*?<!-- end -->\n*", page)
    return f"edit/main/{found[1]}" if found else ""


def _edited_at(home: str, page: str) -> str:
    """Name where a page is edited, where that is no page of ``docs/``."""
    return f"---\nhome: {home}\n---\n{page}" if home else page


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Make the documentation site.")
    parser.add_argument("--site-dir", type=Path, default=ROOT / "site", help="where it is put")
    sys.exit(make(parser.parse_args().site_dir))
