"""Time the README's "Ten minutes": its commands, one after the other, in a fresh clone.

The commands are read from the table of that section. ``make play`` is left out, since it serves
until it is stopped. What each printed last is shown, so that one sees that it did what the table
says.

Run: python benchmarks/ten_minutes.py
     python benchmarks/ten_minutes.py --keep clone    # leave the clone there, to look at the pages
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

ROOT = Path(__file__).parents[1]
_HEADING = "## Ten minutes"
_ROW = re.compile(r"^\| `([^`]+)` \|", re.M)
_LEFT_OUT = ("make play", ". .venv/bin/activate")
"""A server, and what a shell alone can do; the variable PATH does it here."""


def commands(readme: str) -> list[str]:
    """Commands of the table, in their order.

    Raises:
        ValueError: there is no such section, or no command in it.
    """
    _, heading, rest = readme.partition(_HEADING)
    found = _ROW.findall(rest.partition("\n## ")[0])
    if not heading or not found:
        raise ValueError(f"the README has no section {_HEADING!r} with a table of commands")
    return found


def main() -> None:
    """Clone, run every command, and print its time."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--keep", type=Path, help="folder to clone into, and to leave there")
    kept: Path | None = parser.parse_args().keep
    with ExitStack() as open_:
        folder = kept or Path(open_.enter_context(tempfile.TemporaryDirectory())) / "hmi-marl"
        subprocess.run(["git", "clone", "--quiet", ROOT, folder], check=True)
        clean = {k: v for k, v in os.environ.items() if k not in ("VIRTUAL_ENV", "PYTHONPATH")}
        paths = os.pathsep.join([str(folder.resolve() / ".venv" / "bin"), clean["PATH"]])
        total = 0.0
        for command in commands((folder / "README.md").read_text("utf-8")):
            if command in _LEFT_OUT:
                continue
            began = time.monotonic()
            run = subprocess.run(
                command.split(),
                cwd=folder,
                env=clean | {"PATH": paths},
                capture_output=True,
                text=True,
            )
            spent = time.monotonic() - began
            total += spent
            last = (run.stdout.strip().splitlines() or [""])[-1]
            print(f"{spent:6.0f} s  {command}\n          {last}", flush=True)
            if run.returncode:
                raise SystemExit(f"{command} ended with {run.returncode}:\n{run.stderr[-3000:]}")
        print(f"{total:6.0f} s  in all")


if __name__ == "__main__":
    main()
