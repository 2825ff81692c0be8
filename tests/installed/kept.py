"""Environments that are made once, and kept while something is checked in them."""

from __future__ import annotations

import fcntl
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from installed.environments import (
    HERE,
    PYTHONS,
    Environment,
    Spec,
    build_wheel,
    find_python,
    grow,
    make,
)


class MissingPythonError(RuntimeError):
    """An interpreter that this machine does not have."""


class Shared:
    """What the processes that test make once for all of them, in a folder of theirs.

    The last of them that closes it removes it. One process makes a thing while others wait for it.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(exist_ok=True)
        self._folder = folder
        self._user = folder / f"user-{os.getpid()}"
        with self._alone("users"):
            self._user.touch()

    def wheel(self) -> Path:
        """The wheel of the checkout."""
        with self._alone("wheel"):
            folder = self._folder / "wheel"
            if not folder.exists():
                made = build_wheel(self._folder / "building")
                made.parent.rename(folder)
            (wheel,) = folder.glob("*.whl")
            return wheel

    def base(self, extras: frozenset[str], interpreter: Path) -> Environment:
        """An environment that nothing is ever run in but what compiles what is imported.

        The batched world is compiled too, and all that grow out of it find that.
        """
        spec, wheel = Spec(extras), self.wheel()
        folder = self._folder / f"base-{spec.name}"
        below = self.base(frozenset(), interpreter) if extras else None
        with self._alone(folder.name):
            made = folder / "made"
            if not made.exists():
                shutil.rmtree(folder, ignore_errors=True)
                if below:
                    base = grow(spec, below, wheel, folder)
                else:
                    base = make(spec, interpreter, wheel, folder)
                _compile(base, spec)
                made.touch()
            return Environment(folder)

    def close(self) -> None:
        """Remove all of it, unless others still use it."""
        with self._alone("users"):
            self._user.unlink()
            if not any(self._folder.glob("user-*")):
                for path in self._folder.iterdir():
                    if path.is_dir():
                        shutil.rmtree(path)

    @contextmanager
    def _alone(self, name: str) -> Iterator[None]:
        with (self._folder / f"{name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield


class Environments:
    """One environment at a time, made when it is first asked for and kept until another is.

    Those of this Python grow out of one with core, or with core and the extra train.
    """

    def __init__(self, shared: Shared, folder: Path) -> None:
        self._shared, self._folder = shared, folder
        self._spec: Spec | None = None
        self._made: Environment | RuntimeError | None = None

    def of(self, spec: Spec) -> Environment:
        """The environment of a spec.

        Raises:
            MissingPythonError: there is no such Python.
            RuntimeError: it cannot be installed. Both are raised again without another try.
        """
        if spec != self._spec:
            self._remove()
            self._spec = spec
            try:
                self._made = self._make(spec)
            except RuntimeError as error:
                self._made = error
        if not isinstance(self._made, Environment):
            raise self._made or RuntimeError(f"making {spec.name} was interrupted")
        return self._made

    def close(self) -> None:
        """Remove what is there."""
        self._remove()
        shutil.rmtree(self._folder)

    def _remove(self) -> None:
        if isinstance(self._made, Environment):
            self._made.close()
        if self._spec is not None:  # with torch it is a gigabyte and more
            shutil.rmtree(self._folder / self._spec.name, ignore_errors=True)
        self._spec = self._made = None

    def _make(self, spec: Spec) -> Environment:
        interpreter = find_python(spec.python)
        if interpreter is None:
            raise MissingPythonError(
                f"there is no Python {spec.python}: put python{spec.python} on the PATH, or name "
                f"it in {PYTHONS}"
            )
        folder = self._folder / spec.name
        if spec.python != HERE:
            return make(spec, interpreter, self._shared.wheel(), folder)
        known = frozenset({"train"}) if "train" in spec.extras else frozenset()
        return grow(spec, self._shared.base(known, interpreter), self._shared.wheel(), folder)


def _compile(environment: Environment, spec: Spec) -> None:
    """Compile what all environments that grow out of this one import, and the batched world."""
    table = "table --world batched --hmis NoHMI --drivers homer --episodes 2 --duration 2"
    joint = "train joint --steps 160 --num-teams 16 --duration 2 --out run --processes 1"
    run = environment.hmi_marl((joint if spec.extras else table).split(), environment.folder)
    if run.returncode:
        raise RuntimeError(f"nothing runs in the environment {spec.name}:\n{run.stderr}")
