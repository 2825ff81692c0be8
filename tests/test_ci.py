"""``.ci/run`` with a stand-in for make: what it tries, where, and what it leaves."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PARTS = ["run", "test", "test-slow", "lint", "wheel"]
MAKE = """#!/bin/sh
# make -C FOLDER VENV=.venv PART
{ echo "$4 $3"; cd "$2"; pwd -P; ls -A; cat file; env | grep -c '^PYTHONPATH='
  echo "$4 with $PYTEST_ADDOPTS"; } >> "$LOG"
mkdir -p runs/table
echo page > runs/table/index.html
[ "$4" != "$FAILING" ] || exit 3
"""


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    """A checkout with one change that is not committed and a virtual environment."""
    folder = tmp_path / "checkout"
    (folder / ".ci").mkdir(parents=True)
    shutil.copy(ROOT / ".ci" / "run", folder / ".ci" / "run")
    (folder / ".gitignore").write_text(".venv/\n")
    (folder / "file").write_text("committed\n")
    author = ["-c", "user.name=A", "-c", "user.email=a@example.org"]
    for command in (["init", "-q"], ["add", "-A"], [*author, "commit", "-qm", "All"]):
        subprocess.run(["git", *command], cwd=folder, check=True)
    (folder / "file").write_text("changed\n")
    (folder / ".venv").mkdir()
    (folder / ".venv" / "mine").touch()
    return folder


class Tried:
    """What came of a run."""

    def __init__(self, repository: Path, **variables: str) -> None:
        work = repository.parent
        for name in ("bin", "tmp"):
            (work / name).mkdir()
        (work / "bin" / "make").write_text(MAKE)
        (work / "bin" / "make").chmod(0o755)
        log = work / "log"
        log.touch()
        ours = {"LOG": str(log), "TMPDIR": str(work / "tmp"), "PYTHONPATH": str(repository)}
        path = os.pathsep.join([str(work / "bin"), os.environ["PATH"]])
        before = _files(repository)
        self.run = subprocess.run(
            [repository / ".ci" / "run"],
            env=os.environ | ours | {"PATH": path, "PYTEST_ADDOPTS": ""} | variables,
            capture_output=True,
            text=True,
            check=False,
        )
        self.log = log.read_text()
        self.parts = [line.split()[0] for line in self.log.splitlines() if " VENV=" in line]
        assert _files(repository) == before, "the checkout is as it was"
        assert list((work / "tmp").iterdir()) == [], "nothing is left"


def _files(folder: Path) -> dict[str, str]:
    found = (path for path in folder.rglob("*") if ".git" not in path.parts and path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_text() for path in found}


def test_every_part_is_tried_in_a_fresh_folder_with_what_is_committed(repository: Path) -> None:
    tried = Tried(repository)
    assert tried.run.returncode == 0, tried.run.stderr
    assert tried.parts == PARTS
    assert tried.log.count("committed\n") == len(PARTS)
    assert "\n.venv\n" not in tried.log
    assert str(repository) not in tried.log
    assert tried.log.count("\n0\n") == len(PARTS), "no PYTHONPATH"
    assert "only what is committed is tried" in tried.run.stdout
    last = tried.run.stdout.splitlines()[-1]
    times = ", ".join(rf"{part} \d s" for part in PARTS)
    assert re.fullmatch(f"ci: all is well: {times}", last)


def test_lines_are_counted_while_the_tests_run(repository: Path) -> None:
    tried = Tried(repository, CI_PARTS="lint test test-slow")
    assert re.search("^test with --cov .*--cov-fail-under=95$", tried.log, re.MULTILINE)
    assert "lint with \n" in tried.log
    assert "test-slow with \n" in tried.log


def test_the_first_part_that_fails_is_named_and_ends_it(repository: Path) -> None:
    tried = Tried(repository, FAILING="test")
    assert tried.run.returncode == 1
    assert tried.parts == ["run", "test"]
    expected = r"ci: part test FAILED with status 3 after \d s \(before it: run \d s\)\n"
    assert re.search(expected, tried.run.stderr)
    assert "all is well" not in tried.run.stdout


def test_some_parts_can_be_chosen(repository: Path) -> None:
    tried = Tried(repository, CI_PARTS="lint wheel")
    assert tried.run.returncode == 0
    assert tried.parts == ["lint", "wheel"]


def test_an_unknown_part_is_refused(repository: Path) -> None:
    tried = Tried(repository, CI_PARTS="lint wheels")
    assert tried.run.returncode == 2
    assert "unknown part 'wheels'" in tried.run.stderr
    assert tried.parts == []


def test_files_without_a_repository_are_tried_as_they_are(repository: Path) -> None:
    shutil.rmtree(repository / ".git")
    tried = Tried(repository, CI_PARTS="test")
    assert tried.run.returncode == 0, tried.run.stderr
    assert "is no git repository" in tried.run.stdout
    assert "changed\n" in tried.log
    assert "\n.venv\n" not in tried.log
