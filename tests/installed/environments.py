"""Fresh virtual environments with nothing in them but the wheel and what it asks for."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from installed.started import Started
from installed.table import ROWS, Row
from pages import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
EXTRAS = tuple(extra for extra in PROJECT["optional-dependencies"] if extra != "dev")
_MINOR = "Programming Language :: Python :: 3."
VERSIONS = tuple(
    classifier.removeprefix("Programming Language :: Python :: ")
    for classifier in PROJECT["classifiers"]
    if classifier.startswith(_MINOR)
)
"""The Pythons that the package says it runs on."""
HERE = "{}.{}".format(*sys.version_info)
"""The Python that runs the tests."""
PYTHONS = "HMI_MARL_PYTHONS"
"""Variable that names more interpreters, separated as in PATH."""
_LIMIT = 600
"""Longest that a command may take [s]; they take seconds."""


@dataclass(frozen=True)
class Spec:
    """What is installed."""

    extras: frozenset[str]
    python: str = HERE

    @property
    def name(self) -> str:
        """For a test's name."""
        extras = "+".join(extra for extra in EXTRAS if extra in self.extras) or "core"
        return extras if self.python == HERE else f"{extras}-{self.python}"

    def runs(self, row: Row) -> bool:
        """Whether a row is really run here: where nothing is installed beyond what it needs."""
        return not row.not_run and row.needs == self.extras


def _specs() -> Iterator[Spec]:
    yield Spec(frozenset())
    for version in VERSIONS:  # which no other grows out of: made while another process makes that
        if version != HERE:
            yield Spec(frozenset(), version)
    sets = dict.fromkeys(frozenset({extra}) for extra in EXTRAS)
    sets |= dict.fromkeys(row.needs for row in ROWS if row.needs)
    for extras in sets:
        yield Spec(extras)


SPECS = tuple(_specs())
"""Core, core for the other Pythons, every extra alone, and what some rows need together."""


@dataclass(frozen=True)
class Environment:
    """A virtual environment, and a home folder for what runs in it."""

    folder: Path

    @property
    def bin(self) -> Path:
        """Where its python and its hmi-marl lie."""
        return self.folder / "venv" / "bin"

    def python(
        self, arguments: Sequence[str | Path], folder: Path
    ) -> subprocess.CompletedProcess[str]:
        """Run its Python in a folder, with nothing of the checkout in reach."""
        return self._run([self.bin / "python", *arguments], folder)

    def hmi_marl(self, arguments: Sequence[str], folder: Path) -> subprocess.CompletedProcess[str]:
        """Run its hmi-marl command in a folder."""
        return self._run([self.bin / "hmi-marl", *arguments], folder)

    def forked(
        self, script: str | Path, arguments: Sequence[str | Path], folder: Path
    ) -> subprocess.CompletedProcess[str]:
        """Run a script in a folder, in a fork of its Python that has imported what takes long.

        Args:
            script: a path; in the environment's ``bin`` if it is relative, as ``hmi-marl``.
            arguments: of the script.
            folder: its working folder.
        """
        return self._started.run([self.bin / script, *arguments], folder)

    def close(self) -> None:
        """End the Python that forks."""
        if "_started" in vars(self):
            self._started.close()

    @cached_property
    def _started(self) -> Started:
        return Started(self.bin / "python", self.folder, self._variables(), _LIMIT)

    def _run(self, command: Sequence[str | Path], folder: Path) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            command,
            cwd=folder,
            env=self._variables(),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            encoding="utf-8",
            timeout=_LIMIT,
            check=False,
        )

    def _variables(self) -> dict[str, str]:
        ours = {
            "HOME": str(self.folder / "home"),  # no caches and settings of whoever runs this
            "PATH": os.pathsep.join([str(self.bin), os.environ["PATH"]]),
            "PYTHONNOUSERSITE": "1",
            "PYTHONSAFEPATH": "1",  # neither the working folder nor that of a script
        }
        return clean(os.environ) | ours


def clean(variables: os._Environ[str]) -> dict[str, str]:
    """Variables without those that change what Python imports or where caches lie."""
    prefixes = ("PYTHON", "VIRTUAL_ENV", "COV", "PYTEST", "XDG_", "NUMBA_", "MPL")
    return {name: value for name, value in variables.items() if not name.startswith(prefixes)}


def make(spec: Spec, interpreter: Path, wheel: Path, folder: Path) -> Environment:
    """Make an environment with the wheel and a spec's extras."""
    environment = Environment(folder)
    (folder / "home").mkdir(parents=True)
    _call([interpreter, "-m", "venv", folder / "venv"])
    return _install(spec, wheel, environment)


def grow(spec: Spec, base: Environment, wheel: Path, folder: Path) -> Environment:
    """Make an environment out of another that nothing ran in, by installing what it lacks.

    Files of the other are linked, not copied: pip and Python replace files, and write into none.
    """
    environment = Environment(folder)
    (folder / "home").mkdir(parents=True)
    shutil.copytree(base.folder / "venv", folder / "venv", symlinks=True, copy_function=os.link)
    for script in environment.bin.iterdir():  # which name the Python that runs them
        if not script.is_symlink() and bytes(base.bin) in (text := script.read_bytes()):
            mode = script.stat().st_mode
            script.unlink()
            script.write_bytes(text.replace(bytes(base.bin), bytes(environment.bin)))
            script.chmod(mode)
    return _install(spec, wheel, environment)


def _install(spec: Spec, wheel: Path, environment: Environment) -> Environment:
    extras = f"[{','.join(sorted(spec.extras))}]" if spec.extras else ""
    wanted = ["-c", ROOT / "constraints.txt", f"{wheel}{extras}"]
    # What is imported is compiled then; all that is installed would take longer than the rest.
    _call([environment.bin / "python", *_PIP, "install", "--no-compile", *wanted])
    return environment


def build_wheel(folder: Path) -> Path:
    """Build the wheel of the checkout into a folder."""
    _call([sys.executable, *_PIP, "wheel", "--no-deps", "--wheel-dir", folder, ROOT])
    (wheel,) = folder.glob("*.whl")
    return wheel


def find_python(version: str) -> Path | None:
    """The first interpreter of a version: of those named, the one that runs this, on PATH."""
    named = [name for name in os.environ.get(PYTHONS, "").split(os.pathsep) if name]
    for candidate in (*named, sys.executable, f"python{version}"):
        found = _ask(candidate, version)
        if found is not None:
            return found
    return None


def _ask(candidate: str, version: str) -> Path | None:
    code = "import sys; print('{}.{}'.format(*sys.version_info), sys.executable, sep='\\n')"
    try:
        run = subprocess.run(
            [candidate, "-c", code],
            env=clean(os.environ) | {"PYENV_VERSION": version},  # whose commands ask for it
            capture_output=True,
            text=True,
            check=True,
        )
    except (OSError, subprocess.CalledProcessError):
        return None
    told = run.stdout.splitlines()
    return Path(told[1]) if told[:1] == [version] else None


_PIP = ("-m", "pip", "--quiet", "--disable-pip-version-check")


def _call(command: Sequence[str | Path]) -> None:
    pins = str(ROOT / "constraints.txt")
    variables = clean(os.environ) | {"PYTHONSAFEPATH": "1"}
    variables |= {"PIP_CONSTRAINT": pins, "PIP_BUILD_CONSTRAINT": pins}  # the build backend's too
    run = subprocess.run(command, env=variables, capture_output=True, text=True, check=False)
    if run.returncode:
        raise RuntimeError(f"{' '.join(map(str, command))} failed:\n{run.stdout}{run.stderr}")
