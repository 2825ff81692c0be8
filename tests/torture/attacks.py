"""Attacks: each a function that returns what it tried and what was wrong.

To add one, write ``attack(bench, options, rng) -> list[Counts]`` and add it to ``ATTACKS``.
"""

import os
import random
import re
import shutil
import signal
import subprocess
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
    early: int
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


_STARTING = 4.0
"""Time in which a command starts, and half of the early signals come [s]."""
_EARLY = "collect --steps 300 --duration 1 --vehicles 1 2 --num-teams 16 --out out"
_UNHANDLED = re.compile(r'File "[^"]*hmi_marl/(?!__init__\.py|interrupts\.py)')
"""A line of a traceback from a module of the package that signals should not reach."""


def _started(
    folder: Path, number: int, cache: Path, moment: float = 0.0, sent: int = 0
) -> subprocess.CompletedProcess[str]:
    """Start a command as a shell does, by its script or as a module; send it a signal."""
    script = [str(Path(sys.executable).with_name("hmi-marl"))]
    how = script if number % 2 else [sys.executable, "-m", "hmi_marl"]
    process = subprocess.Popen(
        [*how, *_EARLY.split()],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"NUMBA_CACHE_DIR": str(cache)},
        start_new_session=True,
    )
    if sent:
        time.sleep(moment)
        process.send_signal(sent)
    _, errors = process.communicate()
    return subprocess.CompletedProcess(how, process.returncode, "", errors)


def _compiled(cache: Path) -> dict[str, Path]:
    """Files of compiled code and what is written of them, by their names."""
    return {path.name: path for path in cache.rglob("*") if path.suffix in (".nbc", ".part")}


def _untidy_start(ended: subprocess.CompletedProcess[str], sent: int) -> list[str]:
    """What is wrong with how a command ended by a signal while it started or compiled."""
    if ended.returncode == -sent and _UNHANDLED.search(ended.stderr) is None:
        return []  # before the first line of the package: by Python itself, or by the system
    last = ended.stderr.replace("\r", "\n").rstrip().rpartition("\n")[2]
    told = {signal.SIGINT: "hmi-marl: interrupted", signal.SIGTERM: "hmi-marl: terminated"}[sent]
    return [
        "" if ended.returncode == 128 + sent else f"status {ended.returncode}",
        "" if last.endswith(told) else f"no line that says why: {last!r}",
        f"a traceback: {ended.stderr[-600:]!r}" if "Traceback" in ended.stderr else "",
    ]


def early_signals(bench: Bench, options: Options, rng: random.Random) -> list[Counts]:
    """SIGINT and SIGTERM while the interpreter starts, modules are imported or loops are compiled.

    Each command is a process of its own with an empty cache of compiled code. Then the same command
    works, and takes what the first has kept; what is missing is put there, which saves a minute.
    """
    place = bench.folder / "early"
    place.mkdir()
    began = time.monotonic()
    whole_run = _started(place, 0, place / "whole")
    assert whole_run.returncode == 0, whole_run.stderr
    whole, longest = content(place / "out"), time.monotonic() - began
    spans = {"starting": (0.0, _STARTING), "compiling": (_STARTING, longest)}
    rows = [Counts(f"{name} while {what}") for what in spans for name in ("SIGINT", "SIGTERM")]
    for number in range(options.early):
        row = rows[number % len(rows)]
        sent = getattr(signal, row.name.split()[0])
        first, last = spans[row.name.split()[-1]]
        moment = first + (last - first) * rng.random() ** 2  # more of them early
        shutil.rmtree(place / "out", ignore_errors=True)
        shutil.rmtree(place / "cache", ignore_errors=True)
        ended = _started(place, number // len(rows), place / "cache", moment, sent)
        reasons = _untidy_start(ended, sent) if ended.returncode else []
        kept = _compiled(place / "cache")
        reasons += [f"{name} left behind" for name in kept if not name.endswith(".nbc")]
        for name, path in _compiled(place / "whole").items():
            if name not in kept:
                there = place / "cache" / path.relative_to(place / "whole")
                there.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(path, there)
        again = _started(place, number, place / "cache")
        compiled = "compiling" in again.stderr or "cannot use" in again.stderr
        differ = difference(content(place / "out"), whole) if not again.returncode else ""
        reasons += [
            f"the next command ended with {again.returncode}" if again.returncode else "",
            "the next command could not use what was compiled" if compiled else "",
            f"{differ} differ" if differ else "",
        ]
        row.note(f"after {moment:.2f} s, status {ended.returncode}", *reasons)
    return rows


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


ATTACKS = [kills, signals, early_signals, disks, owners, read_only, readers]
