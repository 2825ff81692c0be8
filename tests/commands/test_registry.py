"""Commands import what they need when they run, and say which extra they lack before they begin."""

import json
import re
import subprocess
import sys
import typing
from pathlib import Path
from typing import NamedTuple

import pytest

from hmi_marl.cli import parse
from hmi_marl.commands.registry import BY_NAME, SUBCOMMANDS, extras_table
from hmi_marl.extras import EXTRAS

LEAVES = dict(leaf for each in SUBCOMMANDS for leaf in each.leaves())
GROUPS = [each.name for each in SUBCOMMANDS if each.parts]
SLOW = {
    "highway_env", "imageio_ffmpeg", "llvmlite", "matplotlib", "numba", "pandas", "PIL", "pygame",
    "scipy", *(module for modules in EXTRAS.values() for module in modules),
}  # fmt: skip
"""What no ``--help`` may import: slow, or of an extra."""
HIDING = """
import sys
from importlib.machinery import PathFinder
HIDDEN = {hidden!r}
class Others(PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        hidden = name.partition(".")[0] in HIDDEN
        return None if hidden else super().find_spec(name, path, target)
sys.meta_path[sys.meta_path.index(PathFinder)] = Others
from hmi_marl.cli import main
"""
ONE_BY_ONE = """
import contextlib, io, json
def one(hidden, arguments):
    HIDDEN.clear()
    HIDDEN.update(hidden)
    with contextlib.redirect_stdout(io.StringIO()) as out:
        with contextlib.redirect_stderr(io.StringIO()) as err:
            try:
                status = main(arguments)
            except SystemExit as stop:
                status = stop.code
    loaded = sorted({slow!r} & set(sys.modules))
    return status or 0, out.getvalue(), err.getvalue(), loaded
print(json.dumps([one(*each) for each in {cases!r}]))
"""
"""Calls of main with modules hidden, one after the other in one process: whether any of them has
loaded what is slow is told after each."""
ARGUMENTS = {
    "export": ["--policy", "trained:homer"],
    "people delete": ["people.db", "CODE"],
    "people export": ["people.db"],
    "people traits": ["trips"],
    "reproduce ship": ["--out", "agents"],
    "study analyse": ["study", "people.db"],
    "study power": ["study"],
    "study serve": ["study", "people.db"],
    "sweep": ["joint"],
    "traits evaluate": ["runs/traits-id"],
}
"""Without which a command cannot be understood."""
CHEAP = {
    "adapt": None,  # minutes even with --quick: see test_nothing_of_an_extra_is_imported_to_adapt
    "bench": "--teams 2 --threads 1 --rounds 1 --seconds 0.01 --scaling 1",
    "oracle": "--horizon 3",
    "people delete": None,  # needs a database: see test_people.py
    "people export": None,  # the same
    "reproduce map": "--windows 2 --shares 0.5 --etas 0.1 --horizon 3 --seen-cells 1 "
    "--hidden-cells 1 --points 2 --workers 1",
    "people traits": None,  # needs recordings: see test_people_traits.py
    "reproduce ship": None,  # needs a finished reproduction
    "study make": "--format gif --drivers lisa bart --controls --policy rule --clips 2 --shown 1 "
    "--duration 0.4 --vehicles 1 2 --width 160 --out study",
    "study power": None,  # needs a study folder: see test_study.py
    "table": "--drivers homer --hmis NoHMI trained:homer --driver-policy trained:driver "
    "--episodes 1 --workers 1 --duration 0.4 --vehicles 1 2 --no-clip",
    "watch": "--hmi trained:homer --policy trained:driver --duration 0.4 --out clip.gif",
}
"""Runs of the commands that need no extra."""
OPTIONS = {
    **{
        (path, "--ray"): ["--ray", "auto"]
        for path, leaf in LEAVES.items()
        if any(option.shown == "--ray" for option in leaf.options)
    },
    ("collect", "--minari"): ["--minari"],
    ("people export", "--formats parquet"): ["people.db", "--formats", "parquet"],
    ("people export", "--formats minari"): ["people.db", "--formats", "minari"],
    ("study make", "--format mp4"): ["--format", "mp4"],
    ("watch", "--out clip.mp4"): ["--out", "folder/clip.mp4"],
}


def run(code: str, folder: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", code]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


class Outcome(NamedTuple):
    """What a call of main said, and which slow modules had been loaded when it ended."""

    status: int
    out: str
    err: str
    loaded: list[str]


def one_by_one(cases: list[tuple[list[str], list[str]]], folder: Path) -> list[Outcome]:
    """What calls of main say, each a pair of the modules to hide and the arguments."""
    code = HIDING.format(hidden=set()) + ONE_BY_ONE.format(slow=SLOW, cases=cases)
    done = run(code, folder)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return [Outcome(*each) for each in json.loads(done.stdout)]


def test_help_imports_nothing_slow_and_nothing_of_an_extra(tmp_path: Path) -> None:
    paths = ["", *GROUPS, *LEAVES]
    every = one_by_one([([], [*path.split(), "--help"]) for path in paths], tmp_path)
    for path, told in zip(paths, every, strict=True):
        assert (told.status, told.err) == (0, ""), path
        assert f"usage: hmi-marl {path}".strip() in told.out
        assert told.loaded == [], f"hmi-marl {path} --help, or one before it"


def test_only_the_module_of_the_subcommand_is_imported(tmp_path: Path) -> None:
    code = (
        "import sys\nfrom hmi_marl.cli import parse\nparse(['watch'])\n"
        "print(*sorted(m for m in sys.modules if m.startswith('hmi_marl.commands.')))"
    )
    assert run(code, tmp_path).stdout.split() == [
        "hmi_marl.commands.registry",
        "hmi_marl.commands.watch",
    ]


def test_the_version_imports_no_parser_and_no_settings(tmp_path: Path) -> None:
    code = (
        "import sys\nfrom hmi_marl.cli import main\nmain(['--version'])\n"
        "print(*sorted(m for m in sys.modules if m == 'tyro' or m.startswith('hmi_marl.')))"
    )
    names = ("cli", "commands", "commands.registry", "experiments", "experiments.registry")
    names += ("extras", "interrupts", "registry", "text")
    assert run(code, tmp_path).stdout.splitlines()[-1].split() == [
        f"hmi_marl.{name}" for name in names
    ]


def test_a_missing_extra_is_named_before_anything_is_done(tmp_path: Path) -> None:
    lacking = [
        (path, extra, [module for module in modules if module in leaf.needs])
        for path, leaf in LEAVES.items()
        for extra, modules in EXTRAS.items()
    ]
    lacking = [each for each in lacking if each[2]]
    assert {path for path, *_ in lacking} == {path for path, leaf in LEAVES.items() if leaf.needs}
    cases = [
        (list(EXTRAS[extra]), [*path.split(), *ARGUMENTS.get(path, [])])
        for path, extra, _ in lacking
    ]
    for (path, extra, missed), told in zip(lacking, one_by_one(cases, tmp_path), strict=True):
        assert (told.status, told.out) == (2, "")
        who = re.escape(path)
        line = rf"hmi-marl: {who} needs ({'|'.join(missed)}): pip install 'hmi-marl\[{extra}\]'\n"
        assert re.fullmatch(line, told.err), told.err
    assert list(tmp_path.iterdir()) == []


def test_an_option_that_needs_an_extra_says_so_before_anything_is_done(tmp_path: Path) -> None:
    found = {(path, each.shown): each for path, leaf in LEAVES.items() for each in leaf.options}
    assert set(found) == set(OPTIONS)
    cases = [
        (list(option.needs), [*path.split(), *OPTIONS[path, shown]])
        for (path, shown), option in found.items()
    ]
    for (path, shown), told in zip(found, one_by_one(cases, tmp_path), strict=True):
        assert told.status == 2
        line = rf"hmi-marl: {re.escape(f'{path} {shown}')} needs \w+: pip install 'hmi-marl\[\w+\]'"
        assert re.fullmatch(line + "\n", told.err), told.err
    assert list(tmp_path.iterdir()) == []


def test_every_command_without_extras_is_among_the_cheap_runs() -> None:
    assert set(CHEAP) == {path for path, leaf in LEAVES.items() if not leaf.needs}


def test_a_command_that_needs_no_extra_runs_without_any(tmp_path: Path) -> None:
    every = [module for modules in EXTRAS.values() for module in modules]
    cases = {path: [*path.split(), *words.split()] for path, words in CHEAP.items() if words}
    ended = one_by_one([(every, arguments) for arguments in cases.values()], tmp_path)
    for path, told in zip(cases, ended, strict=True):
        assert told.status == 0, (path, told.err)


def test_nothing_of_an_extra_is_imported_where_none_is_needed(tmp_path: Path) -> None:
    modules = [
        "experiments.adaptation.evaluation",
        "experiments.adaptation.experiment",
        "reproduction.suite",
        "reproduction.report",
        "experiments.speed",
        "agents",
        "envs.merge_v0",
        "envs.render",
        "agents.partners",
    ]
    every = {module for modules in EXTRAS.values() for module in modules}
    code = HIDING.format(hidden=every - {"pyarrow"})  # which pandas imports where it is there
    done = run(code + "".join(f"import hmi_marl.{module}\n" for module in modules), tmp_path)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("code", "extra"),
    [
        ("import hmi_marl; hmi_marl.make_vec(2)", "train"),
        ("from hmi_marl.training.ppo.run import train", "train"),
        ("from hmi_marl.training.traits.run import learn_traits", "train"),
        ("from hmi_marl.training.evidence.run import learn_evidence", "train"),
        ("from hmi_marl.training.conditioned.run import learn_conditioned", "train"),
        ("from hmi_marl.agents.learned.onnx_export import export_onnx", "train"),
        ("from hmi_marl.demonstrations.parquet import read_observed", "data"),
        ("from hmi_marl.demonstrations.minari import export_minari", "data"),
    ],
)
def test_the_python_interface_names_the_extra_too(code: str, extra: str, tmp_path: Path) -> None:
    hidden = set(EXTRAS["train"]) | {"minari"} if extra == "train" else set(EXTRAS["data"])
    done = run(HIDING.format(hidden=hidden) + code, tmp_path)
    last = done.stderr.splitlines()[-1]
    assert re.search(rf"needs \w+: pip install 'hmi-marl\[{extra}\]'$", last), done.stderr


@pytest.mark.parametrize("path", LEAVES)
def test_the_help_of_a_command_is_its_first_line(path: str) -> None:
    leaf = LEAVES[path]
    assert leaf.load().__doc__.splitlines()[0] == leaf.help


@pytest.mark.parametrize("group", GROUPS)
def test_the_parts_are_those_that_the_class_chooses_among(group: str) -> None:
    subcommand = BY_NAME[group]
    assert subcommand.load().__doc__.splitlines()[0] == subcommand.help
    chosen = typing.get_type_hints(subcommand.load())[subcommand.choice]
    assert typing.get_args(chosen) == tuple(part.load() for part in subcommand.parts)
    for part in subcommand.parts:
        arguments = [group, part.name, *ARGUMENTS.get(f"{group} {part.name}", [])]
        assert type(getattr(parse(arguments), subcommand.choice)) is part.load()


def test_the_table_of_extras_has_a_row_for_every_command() -> None:
    rows = extras_table().splitlines()
    assert len(rows) == 2 + len(LEAVES)
    assert "| `hmi-marl sweep` | `train`, `data` | `--ray`: `ray` |" in rows
    assert "| `hmi-marl collect` | `data` | `--minari`: `data` |" in rows
    assert "| `hmi-marl reproduce traits` | `train`, `data` | `--ray`: `ray` |" in rows
    assert "| `hmi-marl watch` | nothing more | `--out clip.mp4`: `video` |" in rows
