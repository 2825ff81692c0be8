"""Readers of files from others: whatever is in them, ValueError or OSError, soon and in one line.

A file with a checksum over the whole is refused, or what is read is what was written.

``make test`` tries a few mutations with each reader, ``make test-slow`` hundreds.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from file_cases import CASES, Case
from mutations import READ, REFUSED, WRONG, try_reader

FEW, MANY = 12, 600


def check(make: Callable[[Path], Case], folder: Path, seeds: range) -> None:
    case = make(folder)
    counts, wrong = try_reader(case.read, case.mutate, seeds, case.original())
    assert not wrong, f"{counts[WRONG]} of {len(seeds)}: {wrong[:3]}"
    assert counts[REFUSED] + counts[READ] == len(seeds)
    assert counts[REFUSED] > len(seeds) / 10


@pytest.mark.parametrize("name", CASES)
def test_mutated_files_are_refused_or_read(name: str, tmp_path: Path) -> None:
    check(CASES[name], tmp_path, range(FEW))


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_hundreds_of_mutated_files_are_refused_or_read(name: str, tmp_path: Path) -> None:
    check(CASES[name], tmp_path, range(FEW, FEW + MANY))
