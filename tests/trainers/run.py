"""Test each trainer that needs an environment of its own: make that anew, and run its tests in it.

A trainer is a dependency group of pyproject.toml, ``pins/NAME.txt`` the versions it is tested with
and ``test_NAME.py`` its tests.

Run: python tests/trainers/run.py torchrl rllib
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
import tomllib
import venv
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
TRAINERS = tuple(sorted(pins.stem for pins in (HERE / "pins").glob("*.txt")))


def main() -> int:
    """Returns how many trainers failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("trainers", nargs="*", metavar="NAME", help=f"all: {', '.join(TRAINERS)}")
    parser.add_argument("--folder", type=Path, default=ROOT / "build" / "trainers")
    arguments = parser.parse_args()
    unknown = sorted(set(arguments.trainers) - set(TRAINERS))
    if unknown:
        parser.error(f"unknown trainer {unknown[0]!r}; known: {', '.join(TRAINERS)}")
    ends = {}
    for name in arguments.trainers or TRAINERS:
        start = time.monotonic()
        try:
            test(name, arguments.folder / name)
            end = "passed"
        except subprocess.CalledProcessError:
            end = "FAILED"
        ends[name] = f"{end} in {time.monotonic() - start:.0f} s"
    for name, end in ends.items():
        print(f"{name:<12}{end}")
    return sum("FAILED" in end for end in ends.values())


def test(name: str, folder: Path) -> None:
    """Make the environment, check it and run the trainer's tests in it."""
    venv.create(folder, clear=True, with_pip=True)
    python = folder / "bin" / "python"
    group = tomllib.loads((ROOT / "pyproject.toml").read_text())["dependency-groups"][name]
    pins = HERE / "pins" / f"{name}.txt"
    pip = (python, "-m", "pip", "--disable-pip-version-check")
    install = (*pip, "install", "--quiet", "-c", pins)
    call(*install, "torch")  # first and alone, as everywhere: others would ask for more of it
    call(*install, ROOT, *group)
    call(*pip, "check")
    # Not the settings of tests/conftest.py, which need what only our own tests do.
    pytest = (python, "-m", "pytest", "-q", "-p", "no:cacheprovider", f"--confcutdir={HERE}")
    call(*pytest, HERE / f"test_{name}.py")


def call(*command: str | Path) -> None:
    """Run a command of the trainer's environment in the repository's folder."""
    print("$", *command, flush=True)
    surroundings = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    subprocess.run([str(part) for part in command], cwd=ROOT, env=surroundings, check=True)


if __name__ == "__main__":
    sys.exit(main())
