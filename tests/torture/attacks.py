"""Attacks: each a function that returns what it tried and what was wrong.

To add one, write ``attack(bench, options, rng) -> list[Counts]`` and add it to ``ATTACKS``.
"""

import os
import random
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from file_cases import CASES
from mutations import try_reader
from targets import TARGETS, Bench, Outcome, content, difference, full_after


@dataclass(frozen=True)
class Options:
    """Numbers of tries."""

    kills: int
    signals: int
    disks: int
    mutations: int


@dataclass
class Counts:
    """Outcomes of an attack on one thing."""

    name: str
    tried: int = 0
    wrong: list[str] = field(default_factory=list)
    """What went wrong, one line each."""

    @property
    def right(self) -> int:
        return self.tried - len(self.wrong)

    def note(self, what: str, *reasons: str) -> None:
        """Note one try, with reasons if something was wrong."""
        self.tried += 1
        found = "; ".join(reason for reason in reasons if reason)
        print(f"{self.name}, {what}: {found or 'right'}", file=sys.stderr, flush=True)
        if found:
            self.wrong.append(f"{self.name}, {what}: {found}")


def _after(seconds: float, number: int) -> Callable[[int], None]:
    def disturb(pid: int) -> None:
        time.sleep(seconds)
        os.kill(pid, number)

    return disturb


def _resumed(bench: Bench, target: str, out: Path, whole: dict[str, object]) -> str:
    """Start the same command again; return how its results differ from the undisturbed ones."""
    outcome = bench.run(f"{TARGETS[target]} --out {out.name}", out.parent)
    if outcome.status:
        return f"cannot be resumed: {outcome.line}"
    odd = difference(content(out), whole)
    return f"{odd} differ" if odd else ""


def _untidy(outcome: Outcome) -> str:
    """What is wrong with how a command ended by itself."""
    if "Traceback" in outcome.errors:
        return f"a traceback: {outcome.errors[-300:]!r}"
    if not outcome.line.startswith("hmi-marl: "):
        return f"no line that says why: {outcome.line!r}"
    return "" if outcome.alone else "it left processes behind"


def kills(bench: Bench, options: Options, rng: random.Random) -> list[Counts]:
    """SIGKILL at random moments, up to three times in a row; then it ends as if undisturbed."""
    rows = {target: Counts(f"SIGKILL, {target}") for target in TARGETS}
    left = options.kills
    while left > 0:
        for target, row in rows.items():
            whole, seconds = bench.undisturbed(target)
            out, moments, reasons = bench.fresh(), [], []
            for _ in range(min(left, rng.choice((1, 1, 2, 3)))):
                left -= 1
                moments.append(rng.uniform(0, seconds))
                command = f"{TARGETS[target]} --out {out.name}"
                outcome = bench.run(command, out.parent, _after(moments[-1], signal.SIGKILL))
                reasons += [] if outcome.alone else ["it left processes behind"]
            if moments:
                for moment in moments[:-1]:
                    row.note(f"killed after {moment:.2f} s")
                when = ", ".join(f"{moment:.2f}" for moment in moments)
                row.note(f"killed after {when} s", *reasons, _resumed(bench, target, out, whole))
    return list(rows.values())


def signals(bench: Bench, options: Options, rng: random.Random) -> list[Counts]:
    """SIGINT and SIGTERM at random moments: one line, status 130 or 143; then as if undisturbed."""
    rows = {"SIGINT": Counts("SIGINT"), "SIGTERM": Counts("SIGTERM")}
    for number in range(options.signals):
        name, row = list(rows.items())[number % 2]
        target = list(TARGETS)[(number // 2) % len(TARGETS)]
        whole, seconds = bench.undisturbed(target)
        out, moment = bench.fresh(), rng.uniform(0.05, seconds)
        sent = getattr(signal, name)
        command = f"{TARGETS[target]} --out {out.name}"
        outcome = bench.run(command, out.parent, _after(moment, sent))
        reasons = []
        if outcome.status != 0:  # else it was done before
            expected = 128 + sent
            reasons = [
                _untidy(outcome),
                f"status {outcome.status}" if outcome.status != expected else "",
            ]
        row.note(f"{target} after {moment:.2f} s", *reasons, _resumed(bench, target, out, whole))
    return list(rows.values())


def disks(bench: Bench, options: Options, rng: random.Random) -> list[Counts]:
    """Full disks: one line, and with room again it ends as if undisturbed."""
    row = Counts("full disk")
    for number in range(options.disks):
        target = list(TARGETS)[number % len(TARGETS)]
        whole, _ = bench.undisturbed(target)
        out, size = bench.fresh(), int(2 ** rng.uniform(6, 17))
        command = f"{TARGETS[target]} --out {out.name}"
        outcome = bench.run(command, out.parent, prepare=full_after(size))
        reasons = [_untidy(outcome)] if outcome.status else []
        row.note(f"{target} at {size} bytes", *reasons, _resumed(bench, target, out, whole))
    return [row]


def owners(bench: Bench, options: Options, rng: random.Random) -> list[Counts]:
    """A second command in the same folder: refused in one line, and the first is not disturbed."""
    row = Counts("two owners")
    for target, command in TARGETS.items():
        whole, _ = bench.undisturbed(target)
        out = bench.fresh()
        second: list[Outcome] = []

        def start_second(
            pid: int, out: Path = out, command: str = command, second: list[Outcome] = second
        ) -> None:
            while not (out / ".owner").exists() and os.waitpid(pid, os.WNOHANG) == (0, 0):
                time.sleep(0.005)
            os.killpg(pid, signal.SIGSTOP)  # so that it is still there, however fast it is
            other = Bench.__new__(Bench)
            other.folder = bench.folder / "second"
            other.folder.mkdir(exist_ok=True)
            second.append(other.run(f"{command} --seed 1 --out {out.name}", out.parent))
            os.killpg(pid, signal.SIGCONT)

        first = bench.run(f"{command} --out {out.name}", out.parent, start_second)
        odd = difference(content(out), whole)
        refused = second[0].status == 2 and "is in use by process" in second[0].line
        row.note(
            target,
            "" if refused else f"the second ended with {second[0].status}: {second[0].line}",
            "" if first.status == 0 else f"the first ended with {first.status}: {first.line}",
            f"{odd} differ" if odd else "",
        )
    return [row]


def read_only(bench: Bench, options: Options, rng: random.Random) -> list[Counts]:
    """Folders that cannot be written to: refused in one line."""
    row = Counts("read-only folder")

    def without_rights() -> None:
        if os.geteuid() == 0:
            os.setgid(65534)  # of the real user too, whose rights os.access asks about
            os.setuid(65534)

    for target, command in TARGETS.items():
        out = bench.fresh()
        out.parent.chmod(0o555)
        bench.folder.chmod(0o755)
        outcome = bench.run(f"{command} --out {out.name}", out.parent, prepare=without_rights)
        out.parent.chmod(0o755)
        left = [path.name for path in out.parent.iterdir()]
        status = "" if outcome.status == 2 else f"status {outcome.status}"
        row.note(target, _untidy(outcome), status, f"{left} left behind" if left else "")
    return [row]


def readers(bench: Bench, options: Options, rng: random.Random) -> list[Counts]:
    """Altered files, so many for each reader: read, or refused soon and in one line."""
    rows = []
    for name, make in CASES.items():
        folder = bench.fresh()
        folder.mkdir()
        case, first = make(folder), rng.randrange(10**6)
        seeds = range(first, first + options.mutations)
        _, wrong = try_reader(case.read, case.mutate, seeds, case.original())
        rows.append(Counts(f"altered files, {name}", len(seeds), wrong))
    return rows


ATTACKS = [kills, signals, disks, owners, read_only, readers]
