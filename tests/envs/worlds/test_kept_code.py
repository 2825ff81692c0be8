"""Compiled code in files: a broken file or folder costs a compilation, never a trace."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numba
import pytest
from numba.core import caching

from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.teaming import Teaming
from hmi_marl.envs.worlds.batched import compiler
from hmi_marl.envs.worlds.batched.compiler import fcntl

PROGRAM = """
import sys
from pathlib import Path
import numpy as np
from numba.core import caching
from hmi_marl.envs.worlds.batched.compiler import kernel, prepare

@kernel
def double(progress, values):
    for k in range(len(values)):
        values[k] *= 2

@kernel
def halve(progress, values):
    for k in range(len(values)):
        values[k] /= 2

caching.CacheImpl._locator_classes = (
    [] if "no folder" in sys.argv
    else [caching.UserProvidedCacheLocator, caching.UserWideCacheLocator]
)
if "no locks" in sys.argv:
    import fcntl
    def flock(*_):
        raise OSError(37, "No locks available")
    fcntl.flock = flock
if "impatient" in sys.argv:
    from hmi_marl.envs.worlds.batched import compiler
    compiler._PATIENCE = 1.0
if "interrupted" in sys.argv:
    def replace(self, target):
        raise KeyboardInterrupt
    Path.replace = replace
if "full disk" in sys.argv:
    def write_bytes(self, data):
        self.touch()
        raise OSError(28, "No space left on device")
    Path.write_bytes = write_bytes
values = np.ones(3)
calls = [(double, (np.zeros(2, np.int64), values)), (halve, (np.zeros(2, np.int64), values))]
for _ in range(2):
    prepare(calls)
    double(np.zeros(2, np.int64), values)
print(values.sum(), sum(sum(each.stats.cache_misses.values()) for each, _ in calls))
"""
"""Two small kernels; prints 12.0 and how many of them were compiled. The folder next to the sources
is left out, so that nothing of this comes to lie there."""
CHANGED = [
    (caching.CacheImpl, "_locator_classes"),
    (compiler, "_PATIENCE"),
    (Path, "write_bytes"),
    (Path, "replace"),
    *([(fcntl, "flock")] if fcntl else []),
]
"""What the program changes."""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The program, a folder with what it keeps, and what came of its first run."""
    folder = tmp_path_factory.mktemp("made")
    (folder / "program.py").write_text(PROGRAM)
    code = folder / "missing" / "code"
    return folder / "program.py", code, run(folder / "program.py", code)


@pytest.fixture
def code(made, tmp_path):
    """A folder as the program left it that has run before."""
    return shutil.copytree(made[1], tmp_path / "code")


@pytest.fixture
def run_here(monkeypatch, capsys, tmp_path):
    """:func:`run` in this process, which has numba already and forgets here what it remembers.

    What the program changes is as it was after the test, or before its next run.
    """
    remembers = compiler._folder, compiler._say_once

    def run_once(folder, *arguments):
        for one in remembers:
            one.cache_clear()
        with monkeypatch.context() as patch:
            for owner, name in CHANGED:
                patch.setattr(owner, name, getattr(owner, name))
            patch.setattr(numba.config, "CACHE_DIR", str(folder))
            patch.setattr(sys, "argv", ["program", *arguments])
            patch.setenv("XDG_CACHE_HOME", str(tmp_path / "user"))
            capsys.readouterr()
            exec(compile(PROGRAM, "program", "exec"), {"__name__": "program"})
        return read(*capsys.readouterr())

    yield run_once
    for one in remembers:
        one.cache_clear()


def start(program, folder, *arguments):
    command = [sys.executable, str(program), *arguments]
    env = os.environ | {
        "NUMBA_CACHE_DIR": str(folder),
        "XDG_CACHE_HOME": str(program.parent / "user"),
    }
    return subprocess.Popen(
        command, env=env, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def run(program, folder, *arguments):
    """(how many kernels were compiled, lines on stderr)."""
    process = start(program, folder, *arguments)
    out, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    return read(out, err)


def read(out, err):
    assert "Traceback" not in err
    total, compiled = out.split()
    assert total == "12.0"
    return int(compiled), err.splitlines()


def kept(folder):
    return sorted(folder.rglob("*.nbc"))


def test_compiling_is_announced_once_and_where_and_a_second_process_says_nothing(made):
    program, folder, (compiled, said) = made
    assert compiled == 2
    assert len(said) == 2
    assert "compiling the batched world" in said[0]
    assert str(folder) in said[0]
    assert "compiled in" in said[1]
    assert len(kept(folder)) == 2
    assert run(program, folder) == (0, [])


def test_files_that_were_cut_short_are_compiled_again(run_here, code):
    for victim, share in zip(kept(code), (0.0, 0.5), strict=True):
        whole = victim.read_bytes()
        victim.write_bytes(whole[: int(share * len(whole))])
    before = kept(code)
    compiled, said = run_here(code)
    assert compiled == 2
    for victim in before:
        assert any(str(victim) in line and "compiling again" in line for line in said)
    assert run_here(code) == (0, [])
    assert kept(code) == before


def test_a_foreign_file_is_compiled_again(run_here, code):
    victim, other = kept(code)
    victim.write_bytes(b"\x80\x04K\x01." * 50)  # pickles of the number 1
    other.write_bytes(b"not a kernel")
    compiled, said = run_here(code)
    assert compiled == 2
    assert all(any(str(path) in line for line in said) for path in (victim, other))


def test_the_file_of_another_kernel_is_not_taken_for_this_one(run_here, code):
    victim, other = kept(code)
    victim.write_bytes(other.read_bytes())
    compiled, said = run_here(code)
    assert compiled == 1
    assert str(victim) in said[0]


def test_one_changed_byte_is_noticed(run_here, code):
    victim = kept(code)[0]
    content = bytearray(victim.read_bytes())
    content[len(content) // 2] ^= 1
    victim.write_bytes(content)
    assert run_here(code)[0] == 1


def test_a_folder_that_cannot_be_written_is_named_once(run_here, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("in the way")
    _, said = run_here(blocked / "code")
    assert sum(str(blocked) in line for line in said) == 1


def test_without_any_folder_it_compiles_in_every_process_and_says_how_to_change_that(
    run_here, tmp_path
):
    for _ in range(2):
        compiled, said = run_here(tmp_path, "no folder")
        assert compiled == 2
        assert sum("set NUMBA_CACHE_DIR" in line for line in said) == 1
    assert kept(tmp_path) == []


def test_a_folder_that_is_taken_away_while_it_is_in_use(run_here, code, tmp_path):
    for path in code.rglob("*"):
        if path.is_file():
            path.unlink()
    path = next(path for path in code.iterdir() if path.is_dir())
    path.rmdir()
    path.write_text("in the way")
    assert run_here(code)[0] == 2
    assert len(kept(tmp_path / "user")) == 2


def test_a_full_disk_costs_a_line_and_leaves_no_part_of_a_file(run_here, tmp_path):
    compiled, said = run_here(tmp_path / "code", "full disk")
    assert compiled == 2
    assert sum("No space left on device" in line for line in said) == 1
    assert not [path for path in (tmp_path / "code").rglob("*") if path.suffix in (".nbc", ".part")]


def test_a_signal_while_code_is_written_leaves_no_part_of_a_file(run_here, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        run_here(tmp_path / "code", "interrupted")
    assert not [path for path in (tmp_path / "code").rglob("*") if path.suffix in (".nbc", ".part")]
    assert run_here(tmp_path / "code")[0] == 2


def test_where_files_cannot_be_locked_it_compiles_all_the_same(run_here, tmp_path):
    assert run_here(tmp_path, "no locks")[0] == 2


def test_it_waits_for_a_process_that_compiles_but_not_for_ever(run_here, code):
    if fcntl is None:
        pytest.skip("files cannot be locked")
    lock = next(code.rglob("*.lock"))
    for path in kept(code):
        path.unlink()
    with lock.open("w") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        compiled, said = run_here(code, "impatient")
    assert compiled == 2
    assert sum("waiting for another process" in line for line in said) == 1


def test_parts_of_files_that_killed_processes_left_are_removed_when_old(run_here, code):
    victim = kept(code)[0]
    old, new = (victim.with_suffix(f".{number}.part") for number in (1, 2))
    for part in (old, new):
        part.write_bytes(b"half")
    os.utime(old, (1, 1))
    victim.unlink()
    assert run_here(code)[0] == 1
    assert not old.exists()
    assert new.exists()


@pytest.mark.usefixtures("unmeasured")
@pytest.mark.slow
def test_processes_that_start_together_compile_once(made, tmp_path):
    processes = [start(made[0], tmp_path) for _ in range(2)]
    ended = [process.communicate(timeout=120) for process in processes]
    assert sorted(int(out.split()[1]) for out, _ in ended) == [0, 2]
    assert sum("compiling the batched world (" in err for _, err in ended) == 1


@pytest.mark.usefixtures("unmeasured")
def test_the_real_world_is_compiled_at_most_once_on_a_machine():
    code = (
        "from hmi_marl import merge_v0\n"
        "env = merge_v0.parallel_env(world='batched', duration=0.4)\n"
        "env.reset(seed=0); env.step({'driver': 1, 'vehicle_ai': 0})\n"
        "from hmi_marl.envs.worlds.batched import kernels\n"
        "loops = kernels.begin_worlds, kernels.step_worlds, kernels.look_around\n"
        "print(sum(sum(loop.stats.cache_misses.values()) for loop in loops))"
    )
    teams = Teaming(TeamConfig(duration=0.4), 1, "batched")
    teams.reset([0])
    teams.observe("driver")
    teams.turn([1], [0])
    command = [sys.executable, "-c", code]
    run = subprocess.run(command, capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "0"
    assert run.stderr == ""
