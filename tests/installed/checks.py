"""What is checked of the wheel in an environment: rows that run, and rows that are refused."""

from __future__ import annotations

import atexit
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import cache
from itertools import accumulate
from pathlib import Path
from subprocess import CompletedProcess

from installed.environments import HERE, Environment, Spec
from installed.table import COMMANDS, OPTIONS, ROWS, STUDY_MADE, Row, page_programs, readme_block
from pages import ROOT

import hmi_marl

Check = Callable[[Environment, Path], None]


def succeeded(run: CompletedProcess[str]) -> str:
    """What a command printed, which ended well."""
    details = f"{shlex.join(map(str, run.args))}\n{run.stdout[-2000:]}\n{run.stderr[-6000:]}"
    assert run.returncode == 0, details
    assert "Traceback" not in run.stderr, details
    return run.stdout


def check_dependencies(environment: Environment, folder: Path) -> None:
    succeeded(environment.python(["-m", "pip", "check"], folder))


def check_origin(environment: Environment, folder: Path) -> None:
    code = "import hmi_marl, sysconfig; print(hmi_marl.__file__, sysconfig.get_path('purelib'))"
    place, site = succeeded(environment.python(["-c", code], folder)).split()
    assert Path(site).is_relative_to(environment.folder)
    assert Path(place) == Path(site) / "hmi_marl" / "__init__.py"


def check_version(environment: Environment, folder: Path) -> None:
    version = f"hmi-marl {hmi_marl.__version__}\n"
    assert succeeded(environment.hmi_marl(["--version"], folder)) == version
    assert succeeded(environment.python(["-m", "hmi_marl", "--version"], folder)) == version


def check_help(words: str) -> Check:
    def check(environment: Environment, folder: Path) -> None:
        run = environment.forked("hmi-marl", [*words.split(), "--help"], folder)
        assert succeeded(run).startswith("usage: hmi-marl")
        assert run.stderr == ""
        assert list(folder.iterdir()) == []

    return check


def check_row(row: Row) -> Check:
    def check(environment: Environment, folder: Path) -> None:
        if row.prepared:
            shutil.copytree(prepared(tuple(row.prepared)), folder, dirs_exist_ok=True)
        for command in row.before:
            succeeded(environment.forked("hmi-marl", shlex.split(command), folder))
        assert RUN[row.kind](row, environment, folder).strip()

    return check


def check_refusal(row: Row, missing: frozenset[str]) -> Check:
    """A command whose extras are missing names them in one line, and does nothing."""

    def check(environment: Environment, folder: Path) -> None:
        run = environment.forked("hmi-marl", command_line(row), folder)
        assert run.returncode == 2, run.stderr
        assert run.stdout == ""
        assert re.fullmatch(r"hmi-marl: [^\n]+\n", run.stderr), run.stderr
        (named,) = re.findall(r"pip install 'hmi-marl\[([\w,-]+)\]'", run.stderr)
        assert set(named.split(",")) == missing
        assert list(folder.iterdir()) == []

    return check


def command_line(row: Row) -> list[str]:
    """The arguments of a row of the command line."""
    words = row.name.split(" --")[0] if row.kind == "option" else row.name
    return [*words.split(), *shlex.split(row.arguments)]


def run_command(row: Row, environment: Environment, folder: Path) -> str:
    return succeeded(environment.forked("hmi-marl", command_line(row), folder))


def run_example(row: Row, environment: Environment, folder: Path) -> str:
    script = ROOT / "examples" / f"{row.name}.py"
    return succeeded(environment.forked(script, shlex.split(row.arguments), folder))


def run_readme(row: Row, environment: Environment, folder: Path) -> str:
    return f"ran\n{run_program(readme_block(row), environment, folder)}"  # some print nothing


def run_page(row: Row, environment: Environment, folder: Path) -> str:
    return f"ran\n{run_program(dict(page_programs())[row.name], environment, folder)}"


def run_program(text: str, environment: Environment, folder: Path) -> str:
    program = folder / "program.py"
    program.write_text(text, "utf-8")
    return succeeded(environment.forked(program, [], folder))


def run_site(row: Row, environment: Environment, folder: Path) -> str:
    run = environment.forked(ROOT / row.name, ["--site-dir", folder / "site"], folder)
    succeeded(run)
    assert (folder / "site" / "index.html").is_file()
    return run.stderr


@cache
def prepared(commands: tuple[str, ...]) -> Path:
    """A folder with what commands write, as the tests' own Python has them."""
    folder = Path(tempfile.mkdtemp())
    atexit.register(shutil.rmtree, folder)
    for command in commands:
        words = [sys.executable, "-m", "hmi_marl", *shlex.split(command)]
        succeeded(subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False))
    return folder


def check_served(program: str) -> Check:
    """The servers of the wheel have their pages, texts, styles and scripts."""

    def check(environment: Environment, folder: Path) -> None:
        script = folder / "served.py"
        script.write_text(program, "utf-8")
        assert succeeded(environment.python([script], folder)).split()[-1] == "served"

    return check


PLAY = """
import re, subprocess, sys, urllib.request as web

server = subprocess.Popen(
    [sys.executable, "-m", "hmi_marl", "play", "--port", "0", "--duration", "1"],
    stdout=subprocess.PIPE, text=True,
)
try:
    address = re.search(r"http://[^/]+", server.stdout.readline())[0]
    form = b"way=free&seat=driver&partner=never"
    opener = web.build_opener(web.HTTPCookieProcessor())
    first = opener.open(address).read().decode()
    trip = opener.open(address + "/begin", form).read().decode()
    files = set(re.findall(r'(?:href|src)="(/static/[^"?]+)', first + trip))
    names = "film input link replay road sound task texts trip"
    modules = {f"/static/play/{name}.js" for name in names.split()}
    assert len(files) >= 4
    for path in files | modules:
        assert opener.open(address + path).read()
finally:
    server.kill()
    server.wait()
print("served")
"""


STUDY = f"""
import re, subprocess, sys, urllib.request as web

subprocess.run([sys.executable, "-m", "hmi_marl", *{STUDY_MADE.split()!r}], check=True)
server = subprocess.Popen(
    [sys.executable, "-m", "hmi_marl", "study", "serve", "study", "people.db", "--port", "0"],
    stdout=subprocess.PIPE, text=True,
)
try:
    address = re.search(r"http://[^/]+", server.stdout.readline())[0]
    page = web.urlopen(address).read().decode()
    files = set(re.findall(r'(?:href|src)="(/static/[^"?]+)', page))
    assert files
    for path in files:
        assert web.urlopen(address + path).read()
finally:
    server.kill()
    server.wait()
print("served")
"""


RUN: dict[str, Callable[[Row, Environment, Path], str]] = {
    "command": run_command,
    "option": run_command,
    "example": run_example,
    "readme": run_readme,
    "page": run_page,
    "site": run_site,
}


def checks(spec: Spec) -> Iterator[tuple[str, Check]]:
    """All that is checked in an environment, by name."""
    yield "pip check", check_dependencies
    yield "imported from the wheel", check_origin
    yield "version", check_version
    if spec.extras == {"people"} and spec.python == HERE:
        yield "play", check_served(PLAY)
        yield "study serve", check_served(STUDY)
    paths = [accumulate(row.name.split(), "{} {}".format) for row in COMMANDS]
    wanted = [] if spec.extras else ["", *(path for steps in paths for path in steps)]
    for words in dict.fromkeys(wanted):  # without any extra, so no extra is needed for it
        yield f"help {words}".strip(), check_help(words)
    for row in ROWS:
        if spec.runs(row):
            yield str(row), check_row(row)
    for row in (*COMMANDS, *OPTIONS):
        missing = row.needs - spec.extras
        if missing and len(spec.extras) <= 1:
            yield f"{row} refused", check_refusal(row, missing)
