"""Compilation of the batched world's functions, and compiled code in files, once on a machine.

numba trusts its own files: one that was cut short raises an error from deep within pickle, and a
folder that cannot be written raises another while the module is imported. Here a file is named
after all it depends on (sources, types of arguments, processor, versions) and holds its checksum.
What does not fit is compiled again, and a line on stderr says once where.

The folder is the one that numba chooses: NUMBA_CACHE_DIR if it is set, else ``__pycache__`` next to
the sources, else the user's cache folder.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import IO, Any

import numba
import numpy as np
from numba import njit
from numba.core import caching
from numba.core.compiler import CompileResult

try:
    import fcntl
except ImportError:  # on Windows, processes that start together may compile the same twice
    fcntl = None  # type: ignore[assignment]

WITHOUT_COMPILER = bool(numba.config.DISABLE_JIT)  # type: ignore[attr-defined]
"""Whether NUMBA_DISABLE_JIT lets everything run as plain Python."""
_RULES = (
    "action_loops.py",
    "alerts.py",
    "attention.py",
    "compiled_rules.py",
    "elementwise.py",
    "loops.py",
    "observation_values.py",
    "observations.py",
    "rewards.py",
    "scene.py",
    "streams.py",
    "team_arrays.py",
    "team_step.py",
)
"""Modules of the environment that hold functions which are compiled."""
_DIGEST_SIZE = hashlib.sha256().digest_size
_PATIENCE = 180.0
"""Longest wait for another process that compiles [s]."""
_QUIET = 3.0
"""Wait for another process that is not worth a line [s]."""
_ABANDONED = 3600.0
"""Age from which a half-written file is one of a process that was killed [s]."""


@contextmanager
def one_process_at_a_time() -> Iterator[None]:
    """Wait while another process compiles, so that what it has kept can be taken.

    The lock ends with its process. Where files cannot be locked, no process waits.
    """
    folder = _folder()
    if folder is None or fcntl is None:
        yield
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = open(folder / "hmi_marl-compiling.lock", "w")  # noqa: SIM115 (closed below)
    except OSError:
        yield
        return
    with lock:
        _wait_for(lock)
        try:
            yield
        finally:
            with suppress(OSError):
                fcntl.flock(lock, fcntl.LOCK_UN)  # for children that were forked meanwhile too


def _wait_for(lock: IO[str]) -> None:
    """Take the lock; after a while, or where there are no locks, go on without."""
    start = time.monotonic()
    while (waited := time.monotonic() - start) < _PATIENCE:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return
        except BlockingIOError:
            if waited > min(_QUIET, _PATIENCE / 2):  # to load what is kept takes less
                _say_once("waiting for another process that compiles the batched world ...")
            time.sleep(0.1)
        except OSError:
            return


class KeptCode(caching._Cache):  # what numba asks for when it has to compile
    """The compiled code of one kernel in files, as numba's dispatcher asks for it.

    Args:
        function: the kernel.
        sources: files that it is compiled from, besides those of the environment.
    """

    def __init__(self, function: Callable[..., object], sources: Sequence[str] = ()) -> None:
        self._name = function.__name__
        self._stamp = source_stamp(*sources)[:16]  # of the sources while they are imported

    @property
    def cache_path(self) -> str | None:
        """Folder of the files, or None."""
        folder = _folder()
        return None if folder is None else str(folder)

    def load_overload(self, signature: Any, target: Any) -> Any:
        """Return the compiled code for these types of arguments, or None if it must be compiled."""
        target.refresh()
        name = self._name_of_file(signature, target.codegen())
        for folder in _folders_to_read():
            path = folder / name
            if not path.exists():
                continue
            try:
                content = path.read_bytes()
                code = content[_DIGEST_SIZE:]
                if _checksum(path, code) != content[:_DIGEST_SIZE]:
                    raise ValueError("its checksum is wrong")
                return CompileResult._rebuild(target, *pickle.loads(code))
            except Exception as error:  # any damage: it can be compiled again
                _say_once(f"cannot use {path} ({_reason(error)}); compiling again")
        folder_to_write = _folder()
        where = "" if folder_to_write is None else f", kept in {folder_to_write}"
        _say_once(f"compiling the batched world (some 20 s{where}) ...")
        return None

    def save_overload(self, signature: Any, result: Any) -> None:
        """Keep what was compiled; without a folder it lasts as long as the process."""
        folder = _folder()
        if folder is None:
            return
        path = folder / self._name_of_file(signature, result.codegen)
        part = path.with_suffix(f".{os.getpid()}.part")
        try:
            code = pickle.dumps(result._reduce())
            folder.mkdir(parents=True, exist_ok=True)
            part.write_bytes(_checksum(path, code) + code)
            part.replace(path)
        except Exception as error:  # the compiled code is there all the same
            _say_once(f"cannot keep compiled code in {folder} ({_reason(error)})")
            return
        finally:  # at a signal too
            with suppress(OSError):
                part.unlink(missing_ok=True)
        with suppress(OSError):
            _tidy(path)

    def enable(self) -> None:
        """Do nothing: kept code is always on."""

    def disable(self) -> None:
        """Do nothing: kept code is always on."""

    def flush(self) -> None:
        """Do nothing: the names of files show what is current."""

    def _name_of_file(self, signature: Any, codegen: Any) -> str:
        versions = (numba.__version__, sys.version_info[:2], codegen.magic_tuple(), str(signature))
        machine = hashlib.sha256(repr(versions).encode()).hexdigest()[:16]
        return f"hmi_marl-{self._name}-{machine}-{self._stamp}.nbc"


def _tidy(path: Path) -> None:
    """Remove what this file replaces: code of the same kernel from earlier sources, old parts."""
    machine, _, _ = path.stem.rpartition("-")
    for stale in path.parent.glob(f"{machine}-*"):
        old = time.time() - stale.stat().st_mtime > _ABANDONED
        if stale != path and (stale.suffix == ".nbc" or old):
            stale.unlink(missing_ok=True)


def _checksum(path: Path, code: bytes) -> bytes:
    """Checksum of the code and of what it is kept as, so that files cannot be exchanged."""
    return hashlib.sha256(path.name.encode() + code).digest()


@cache
def _folder() -> Path | None:
    """The folder that compiled code is kept in, or None, after saying so, if there is none."""
    wanted = numba.config.CACHE_DIR  # type: ignore[attr-defined]
    try:
        locator = caching.CompileResultCacheImpl(source_stamp.__wrapped__).locator
    except RuntimeError:
        _say_once(
            "no folder for compiled code can be written, so every process compiles anew; "
            "set NUMBA_CACHE_DIR to a folder that can be"
        )
        return None
    folder = Path(locator.get_cache_path())
    if wanted and not isinstance(locator, caching.UserProvidedCacheLocator):
        _say_once(f"cannot write to NUMBA_CACHE_DIR={wanted}; compiled code is kept in {folder}")
    return folder


def _folders_to_read() -> list[Path]:
    """Folders that may hold kept code; the one next to the sources may be read-only."""
    own, written = Path(__file__).parent / "__pycache__", _folder()
    if written is None:
        return [own]
    if numba.config.CACHE_DIR:  # type: ignore[attr-defined]
        return [written]
    return list(dict.fromkeys([written, own]))


@cache
def source_stamp(*more: str) -> str:
    """Return a fingerprint of what the environment's kernels are compiled from, and of ``more``."""
    here = Path(__file__).parent
    sources = [*sorted(here.glob("*.py")), *(here.parents[1] / name for name in _RULES)]
    digest = hashlib.sha256()
    for source in (*sources, *map(Path, more)):
        digest.update(source.read_bytes())
    return digest.hexdigest()


@cache
def _say_once(message: str) -> None:
    print(f"hmi-marl: {message}", file=sys.stderr, flush=True)


def _reason(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__


_OPTIONS: dict[str, Any] = {"error_model": "numpy", "_nrt": False}

compiled: Any = njit(**_OPTIONS)
"""A function of one world. It divides by zero as NumPy does, and it makes no arrays and counts no
references to them, which would cost more than all the rest."""

inlined: Any = njit(forceinline=True, **_OPTIONS)
"""The same, always merged into its caller."""


def kernel(loop: Callable[..., object], sources: Sequence[str] = ()) -> Any:
    """Compile a loop over worlds when :func:`prepare` is called, or take what was kept of it.

    Args:
        loop: the kernel.
        sources: files that it is compiled from, besides those of the environment.
    """
    function: Any = njit(nogil=True, **_OPTIONS)(loop)
    if not WITHOUT_COMPILER:
        function._cache = KeptCode(loop, sources)
    return function


_ready: dict[str, Callable[..., Any]] = {}
"""Kernels that :func:`ready` has compiled, by name, without numba's dispatcher around them."""


def ready(loop: Any, *arguments: Any) -> Callable[..., Any]:
    """Return a compiled kernel, to be called with arguments of the same types as these.

    It does not look at their types again, which takes numba 10 µs for a hundred of them, as long as
    all else around a step of a few hundred teams. So the types, and for arrays their order in
    memory, have to be the same in every call of the process, and what comes from a caller is to be
    checked before. ``arguments`` are those after its progress.
    """
    name = loop.__name__
    if name not in _ready:
        given = np.zeros(3, np.int64), *arguments
        prepare([(loop, given)])
        types = tuple(map(numba.typeof, given))
        _ready[name] = loop if WITHOUT_COMPILER else loop.overloads[types].entry_point
    return _ready[name]


def prepare_once(loop: Any, *arguments: Any) -> None:
    """Compile a kernel before its first call, whose arguments are of the types of these.

    ``arguments`` are those after its progress.
    """
    ready(loop, *arguments)


def prepare(calls: Sequence[tuple[Any, tuple[Any, ...]]]) -> None:
    """Compile kernels for the types of the arguments that they will be called with.

    Compiles all of them together, so that a user waits, and reads about it, only once. ``calls``
    are pairs of a kernel and an example of its arguments.
    """
    if WITHOUT_COMPILER:
        return
    wanted = [(each, tuple(numba.typeof(one) for one in given)) for each, given in calls]
    if all(types in each.overloads for each, types in wanted):
        return
    start = time.perf_counter()
    with one_process_at_a_time():
        for each, types in wanted:
            each.compile(types)
    if any(each.stats.cache_misses.get(types) for each, types in wanted):
        print(f"hmi-marl: compiled in {time.perf_counter() - start:.0f} s", file=sys.stderr)
