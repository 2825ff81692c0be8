"""Attack the commands: kills, signals, full disks, read-only folders, two owners.

    python tests/torture --kills 60 --seed 0      (make torture)

Prints a table of what was tried and what came out right, and each wrong outcome with the command
that repeats it. The exit status is 1 if there is one. POSIX only, since it forks.
"""

import argparse
import random
import sys
import tempfile
import time
from pathlib import Path

from attacks import ATTACKS, Counts, Options
from targets import Bench


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="make torture", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--kills", type=int, default=60, help="SIGKILLs in all (60)")
    parser.add_argument("--signals", type=int, default=20, help="SIGINTs and SIGTERMs in all (20)")
    parser.add_argument("--early", type=int, default=20, help="signals to starting commands (20)")
    parser.add_argument("--disks", type=int, default=20, help="full disks in all (20)")
    parser.add_argument("--mutations", type=int, default=500, help="altered files a reader (500)")
    parser.add_argument("--seed", type=int, default=0, help="seed of all moments (0)")
    names = [attack.__name__ for attack in ATTACKS]
    parser.add_argument("--only", nargs="+", choices=names, default=names, help="attacks to run")
    return parser.parse_args()


def main() -> int:
    chosen = parse()
    options = Options(chosen.kills, chosen.signals, chosen.early, chosen.disks, chosen.mutations)
    found: dict[str, Counts] = {}
    with tempfile.TemporaryDirectory(prefix="hmi-marl-torture-") as place:
        bench = Bench(Path(place))
        for attack in ATTACKS:
            if attack.__name__ not in chosen.only:
                continue
            began = time.monotonic()
            rows = attack(bench, options, random.Random(f"{chosen.seed} {attack.__name__}"))
            for row in rows:
                found[row.name] = row
                print(f"{row.name}: {row.right} of {row.tried} right", file=sys.stderr, flush=True)
            print(f"  in {time.monotonic() - began:.0f} s", file=sys.stderr, flush=True)
    print(f"| attack | tried | right | wrong |  seed {chosen.seed}\n| --- | --- | --- | --- |")
    for row in found.values():
        print(f"| {row.name} | {row.tried} | {row.right} | {len(row.wrong)} |")
    wrong = [reason for row in found.values() for reason in row.wrong]
    print("\n".join(wrong) or "nothing wrong")
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())
