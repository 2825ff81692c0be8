"""The table is complete: nothing can be added to the package that the wheel is not tried for."""

from __future__ import annotations

import os
import sys
from collections import Counter
from pathlib import Path

import pytest
from installed import environments
from installed.checks import checks, command_line
from installed.environments import EXTRAS, HERE, PYTHONS, SPECS, VERSIONS, Spec, find_python
from installed.table import (
    COMMANDS,
    EXAMPLES,
    OPTIONS,
    README_BLOCKS,
    ROWS,
    SITE_PAGES,
    Row,
    page_programs,
    readme_block,
)
from pages import README, ROOT, blocks

from hmi_marl import extras
from hmi_marl.cli import parse
from hmi_marl.commands.registry import SUBCOMMANDS

LEAVES = dict(leaf for subcommand in SUBCOMMANDS for leaf in subcommand.leaves())


def extras_of(modules: tuple[str, ...]) -> frozenset[str]:
    return frozenset(
        extra for extra, own in extras.EXTRAS.items() if not set(own).isdisjoint(modules)
    )


def test_every_subcommand_is_in_the_table_once() -> None:
    assert Counter(row.name for row in COMMANDS) == Counter(list(LEAVES))


@pytest.mark.parametrize("row", COMMANDS, ids=str)
def test_a_subcommand_needs_what_it_is_registered_with(row: Row) -> None:
    assert row.needs == extras_of(LEAVES[row.name].needs)


def test_every_option_that_needs_an_extra_is_in_the_table_once() -> None:
    registered = {
        f"{path} {option.shown}": extras_of(leaf.needs + option.needs)
        for path, leaf in LEAVES.items()
        for option in leaf.options
    }
    assert len(OPTIONS) == len(registered)
    assert {row.name: row.needs for row in OPTIONS} == registered


@pytest.mark.parametrize("row", [*COMMANDS, *OPTIONS], ids=str)
def test_the_arguments_of_a_row_are_understood(row: Row) -> None:
    parse(command_line(row))  # exits where it does not understand
    for command in (*row.prepared, *row.before):
        parse(command.split())


def test_every_example_is_in_the_table_once() -> None:
    files = [path.stem for path in (ROOT / "examples").glob("*.py")]
    assert Counter(row.name for row in EXAMPLES) == Counter(files)


def test_every_block_of_the_readme_is_in_the_table_once() -> None:
    found = blocks(README.read_text("utf-8"), "python")
    assert Counter(readme_block(row) for row in README_BLOCKS) == Counter(found)


def test_every_page_with_code_is_in_the_table_once() -> None:
    assert Counter(row.name for row in SITE_PAGES) == Counter(name for name, _ in page_programs())


@pytest.mark.parametrize("row", ROWS, ids=str)
def test_every_row_runs_with_what_it_needs_alone(row: Row) -> None:
    alone = [spec for spec in SPECS if spec.extras == row.needs and spec.python == HERE]
    assert len(alone) == 1
    assert alone[0].runs(row) != bool(row.not_run)


def test_every_extra_has_an_environment_of_its_own() -> None:
    assert set(extras.EXTRAS) | {"docs"} == set(EXTRAS)
    for wanted in (frozenset(), *(frozenset({extra}) for extra in EXTRAS)):
        assert Spec(wanted) in SPECS


def test_core_is_tried_under_every_python_that_is_named() -> None:
    assert len(VERSIONS) >= 3
    for version in VERSIONS:
        assert Spec(frozenset(), version) in SPECS


@pytest.mark.parametrize(
    "spec", [spec for spec in SPECS if len(spec.extras) <= 1], ids=lambda spec: spec.name
)
def test_commands_without_their_extra_are_refused_with_each_extra_alone(spec: Spec) -> None:
    named = [name for name, _ in checks(spec)]
    assert len(named) == len(set(named))
    for row in (*COMMANDS, *OPTIONS):
        assert (f"{row} refused" in named) == (not row.needs <= spec.extras)


def test_everything_runs_where_nothing_is_installed_beyond_what_it_needs() -> None:
    row = Row("command", "adapt", frozenset())
    assert Spec(frozenset()).runs(row)
    assert not Spec(frozenset({"video"})).runs(row)
    for each in ROWS:
        assert any(spec.runs(each) for spec in SPECS) == (not each.not_run), each


def script(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)
    return path


def test_pythons_are_found_by_the_variable_and_on_the_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv(PYTHONS, raising=False)
    assert find_python(HERE) == Path(sys.executable)
    assert find_python("3.99") is None
    script(tmp_path, "python3.99", "exit 127")  # as a shim of a version that is not there
    assert find_python("3.99") is None
    script(tmp_path, "python3.99", "echo 3.99; echo /on/the/path")
    assert find_python("3.99") == Path("/on/the/path")
    named = script(tmp_path, "mine", "echo 3.99; echo /mine")
    monkeypatch.setenv(PYTHONS, os.pathsep.join(["/nowhere", sys.executable, str(named)]))
    assert find_python("3.99") == Path("/mine")


def test_nothing_of_the_callers_reaches_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV", "COVERAGE_PROCESS_START"):
        monkeypatch.setenv(name, "somewhere")
    assert not {"PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV", "COVERAGE_PROCESS_START"} & set(
        environments.clean(os.environ)
    )
