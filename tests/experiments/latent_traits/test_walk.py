"""The way of a demonstrations file to its figure stays short: see ``benchmarks/walk.py``."""

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[3]


def test_the_way_from_the_data_to_the_figure_takes_at_most_35_stops() -> None:
    command = [sys.executable, ROOT / "benchmarks" / "walk.py", "--list"]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    found = re.search(r"(\d+) stops in (\d+) files, (\d+) returns", printed)
    assert found is not None
    stops, files, returns = map(int, found.groups())
    assert stops == files + returns
    assert 10 < stops <= 35
    functions = ("read_demonstrations", "TraitModel.encode", "embeddings_figure", "write_bytes")
    assert all(name in printed for name in functions)
