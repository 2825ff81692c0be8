"""Measure how long commands take to start, as ratios to importing NumPy, all in one run.

    python benchmarks/startup.py

Every round starts each command once, in a process of its own; the least time of all rounds counts,
as other programs can only add to it. Also writes what it prints as JSON.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from pathlib import Path

from hmi_marl.commands.registry import SUBCOMMANDS
from hmi_marl.files import write_json

NUMPY = 'python -c "import numpy"'


def contestants(only: list[str]) -> dict[str, list[str]]:
    """Arguments of the programs to start, by the command line shown."""
    command_line = {"version": "--version", "help": "--help"}
    for subcommand in SUBCOMMANDS:
        for path in (subcommand.name, *(path for path, _ in subcommand.leaves())):
            command_line[path] = f"{path} --help"
    chosen = {name: command_line[name] for name in only} if only else command_line
    return {
        NUMPY: ["-c", "import numpy"],
        'python -c "import hmi_marl"': ["-c", "import hmi_marl"],
    } | {f"hmi-marl {words}": ["-m", "hmi_marl", *words.split()] for words in chosen.values()}


def seconds(arguments: list[str]) -> float:
    """Seconds that a Python process with these arguments takes, from start to end."""
    begun = time.perf_counter()
    subprocess.run([sys.executable, *arguments], stdout=subprocess.DEVNULL, check=True)
    return time.perf_counter() - begun


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5, help="starts of each command")
    parser.add_argument("--only", nargs="+", default=[], help="version, help, or subcommands")
    parser.add_argument("--out", type=Path, default=Path("runs/bench/startup.json"))
    args = parser.parse_args()
    if args.rounds < 1:
        parser.error(f"--rounds is at least 1, but got {args.rounds}")
    started = contestants(args.only)
    for arguments in started.values():
        seconds(arguments)  # reads the files once, and compiles what is not compiled yet
    least = dict.fromkeys(started, float("inf"))
    for _ in range(args.rounds):
        for command, arguments in started.items():
            least[command] = min(least[command], seconds(arguments))
    rows = [
        {"command": command, "seconds": spent, "ratio": spent / least[NUMPY]}
        for command, spent in least.items()
    ]
    print(f"{'command':<44}{'seconds':>9}{'ratio':>8}")
    for row in rows:
        print(f"{row['command']:<44}{row['seconds']:>9.3f}{row['ratio']:>8.2f}")
    write_json(args.out, {"rounds": args.rounds, "rows": rows})
    print(f"written: {args.out}")


if __name__ == "__main__":
    main()
