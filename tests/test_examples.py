import ast
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from fresh import run_each

ROOT = Path(__file__).parents[1]
SB3 = "sb3_parameter_sharing"
TINY = {
    "turn_taking": (["--duration", "2"], "vehicle_ai  return"),
    "new_driver": ([], "with the optimal one"),
    "new_experiment": (["--episodes", "2", "--windows", "1", "7"], "homer: fewer alerts"),
    "new_hmi": (["--episodes", "2", "--duration", "2"], "optimum"),
    "new_protocol": (
        ["--steps", "160", "--teams", "16", "--duration", "2", "--out", "runs/first"],
        "learned: runs/first",
    ),
    "new_world": (["--episodes", "3", "--duration", "4"], "merge_v0: crashed after keeping"),
    "latent_traits": (["--windows", "10", "--updates", "1", "--steps", "1600"], "homer  z = ["),
    "unknown_driver": (
        ["--drives", "2", "--trips", "2", "--adaptive", "adapt:bayes"],
        "in the last trip, knowing bart gains",
    ),
    "supersuit_vector": (["--cars", "2", "--steps", "5"], "car 1  vehicle_ai "),
    "policy_gradient_hmi": (["--episodes", "2", "--duration", "1"], "attention return"),
    "sb3_parameter_sharing": (
        ["--steps", "64", "--cars", "2", "--batch", "16", "--duration", "2", "--episodes", "2"],
        "rule, optimal HMI",
    ),
}


def run_example(name, arguments, folder):
    command = [sys.executable, str(ROOT / "examples" / f"{name}.py"), *arguments]
    run = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    return run


def printed_by_each(programs, folder, forked=False):
    """What scripts print, each with its arguments, all in one process; one that fails is named.

    ``make wheel`` runs each example in a process of its own.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.delenv("COVERAGE_PROCESS_CONFIG", raising=False)
        return run_each(*programs, forked=forked)


def example(name, arguments):
    return ROOT / "examples" / f"{name}.py", arguments


REGISTERING = ("new_experiment", "new_hmi", "new_protocol")
"""Each registers what it brings, so it runs where nothing of the others is registered. What they
show is tested in make test by ``tests/**/test_extending.py``."""


@pytest.fixture(scope="module")
def printed(tmp_path_factory):
    """What each example prints for ``--help``, and what those that register nothing print."""
    folder = tmp_path_factory.mktemp("examples")
    empty = tmp_path_factory.mktemp("check") / "empty.py"
    empty.write_text(f"import os\nassert os.listdir({str(folder)!r}) == []\n")
    run = [name for name in TINY if name not in REGISTERING]
    helps = [example(name, ["--help"]) for name in TINY]
    programs = [*helps, (empty, []), *(example(name, TINY[name][0]) for name in run)]
    every = printed_by_each(programs, folder)
    return (
        dict(zip(TINY, every[: len(TINY)], strict=True)),
        dict(zip(run, every[len(TINY) + 1 :], strict=True)),
    )


@pytest.fixture(scope="module")
def outputs(printed):
    return printed[1]


@pytest.mark.parametrize("name", [name for name in TINY if name not in REGISTERING])
def test_an_example_runs(name, outputs):
    assert TINY[name][1] in outputs[name]


@pytest.mark.slow
def test_each_example_that_registers_something_runs(tmp_path):
    programs = [example(name, TINY[name][0]) for name in REGISTERING]
    for name, printed in zip(
        REGISTERING, printed_by_each(programs, tmp_path, forked=True), strict=True
    ):
        assert TINY[name][1] in printed


@pytest.fixture(scope="module")
def helps(printed):
    return printed[0]


@pytest.mark.parametrize("name", TINY)
def test_the_help_of_an_example_explains_every_option(name, helps):
    text = (ROOT / "examples" / f"{name}.py").read_text(encoding="utf-8")
    docstring = ast.get_docstring(ast.parse(text))
    assert docstring in helps[name]
    assert f"Run: python examples/{name}.py" in docstring
    options = re.split(r"\n  (?=-)", helps[name].partition("options:")[2])[1:]
    assert len(options) > 1
    for option in options:
        assert re.search(r"\s{2,}\S", option), f"{option} is not explained"


@pytest.mark.slow
def test_the_example_for_sb3_shows_how_far_it_is(tmp_path):
    assert "64/64" in run_example(SB3, TINY[SB3][0], tmp_path).stderr


def test_the_example_for_sb3_compares(outputs):
    rows = [re.split(r"\s{2,}", line) for line in outputs[SB3].splitlines()[2:]]
    assert [row[0] for row in rows] == [
        "untrained",
        "learned",
        "rule, no HMI",
        "rule, optimal HMI",
    ]
    for _, driver, vehicle_ai, together in rows:
        assert float(driver) + float(vehicle_ai) == pytest.approx(float(together), abs=0.11)


EXTENSIONS = sorted(path.stem for path in (ROOT / "examples").glob("new_*.py"))


def test_there_is_an_example_for_each_extension():
    kinds = ("driver", "experiment", "hmi", "protocol", "world")
    assert [f"new_{kind}" for kind in kinds] == EXTENSIONS
    page = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
    for name in EXTENSIONS:
        assert f"`examples/{name}.py`" in page


def test_every_example_is_run():
    assert {path.stem for path in (ROOT / "examples").glob("*.py")} == set(TINY)


@pytest.mark.usefixtures("unmeasured")
def test_the_benchmark_of_the_highway_world_runs(tmp_path):
    run_benchmark("highway_world", "--steps 3 --episodes 1 --vehicles 2", tmp_path)
    assert (tmp_path / "runs" / "benchmarks" / "highway_world.json").exists()


def test_the_benchmark_of_recurrent_layers_runs(tmp_path):
    done = run_benchmark("recurrent", "--steps 3 --teams 2 --units 2 --pairs 1", tmp_path)
    assert "of 1 pairs" in done.stdout


@pytest.mark.slow
def test_the_benchmark_of_training_shows_where_time_goes(tmp_path):
    ours = "--rounds 1 --steps 2 --num-teams 32 --vehicles 2"
    others = "--processes 2 --shards 1 --sb3-steps 4 --sb3-batch 4"
    run_benchmark("training", f"{ours} {others}", tmp_path)
    written = json.loads((tmp_path / "runs" / "bench" / "training.json").read_text())
    driver, hmi, both, *two, one_shard, plain = written["rows"]
    parts = ("world", "partner", "policy", "record", "learn", "rest")
    for row in (driver, hmi, both):
        assert sum(row[part] for part in parts) == pytest.approx(1)
        assert all(0 <= row[part] < 1 for part in parts)
    assert driver["partner"] == 0 < hmi["partner"]
    assert driver["steps"] == hmi["steps"] == 3200  # a whole batch
    assert [row["name"] for row in two] == [f"ours, {s}, 2 processes" for s in ("driver", "hmi")]
    for row in two:
        assert row["steps"] == 3200
        assert row["learn"] + row["wait"] + row["rest"] == pytest.approx(1)
        assert 0 < row["wait"] < 1
    assert one_shard["steps"] == 6400
    assert one_shard["processor_seconds"] > 0
    assert written["machine"]["cores"] >= 1
    assert plain["steps"] == 8
    assert plain["ratio"] == 1


@pytest.mark.slow  # a process that trains
def test_the_benchmark_of_checks_times_both_kinds_of_batches(tmp_path):
    run_benchmark("divergence", "--pairs 2 --num-teams 32", tmp_path)
    written = json.loads((tmp_path / "runs" / "bench" / "divergence.json").read_text())
    assert [len(written[f"seconds_{kind}"]) for kind in ("checked", "unchecked")] == [2, 2]
    assert all(seconds > 0 for seconds in written["seconds_of_checks"])
    assert 0 < written["share_of_checks"] < 0.5
    assert written["ratio"] > 0


@pytest.mark.slow
def test_the_benchmark_of_startup_prints_ratios_to_numpy(tmp_path):
    run_benchmark("startup", "--rounds 1 --only version watch", tmp_path)
    written = json.loads((tmp_path / "runs" / "bench" / "startup.json").read_text())
    assert [row["command"] for row in written["rows"]] == [
        'python -c "import numpy"',
        'python -c "import hmi_marl"',
        "hmi-marl --version",
        "hmi-marl watch --help",
    ]
    assert written["rows"][0]["ratio"] == 1.0
    assert all(row["seconds"] > 0 and row["ratio"] > 0 for row in written["rows"])


@pytest.mark.slow
def test_the_benchmark_of_collecting_prints_ratios_to_both_environments(tmp_path):
    options = "--population 4 --num-teams 32 --threads 1 --rounds 2 --driver-policy rule"
    run_benchmark("collecting", options, tmp_path)
    written = json.loads((tmp_path / "runs" / "benchmarks" / "collecting.json").read_text())
    for name in ("collect", "acting", "alone"):
        speeds = written["steps_per_s"][name]
        assert {clock: len(each) for clock, each in speeds.items()} == {"wall": 2, "cpu": 2}
    for name in ("acting", "alone"):
        middle, least, most = written["ratios_median_least_most"][name]["cpu"]
        assert 0 < least <= middle <= most


@pytest.mark.slow
def test_the_walk_from_a_demonstrations_file_to_its_figure_is_counted_and_short(tmp_path):
    lines = run_benchmark("walk", "--list", tmp_path).stdout.splitlines()
    stops, files, returns = map(int, re.findall(r"\d+", lines[-1]))
    listed = [line.split() for line in lines if re.match(r" *\d+  \S+\.py  ", line)]
    assert [int(number) for number, *_ in listed] == list(range(1, stops + 1))
    assert len({file for _, file, _ in listed}) == files == stops - returns
    assert listed[0][1:] == ["commands/traits.py", "EvaluateTraits.run"]
    assert 10 < stops <= 84  # numbers are worked out, written and given sources before a figure
    wanted = {"read_demonstrations", "TraitModel.encode", "embeddings_figure", "Figure.drawn"}
    assert wanted <= {function for *_, function in listed}


def run_benchmark(name, arguments, folder):
    command = [sys.executable, str(ROOT / "benchmarks" / f"{name}.py"), *arguments.split()]
    run = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    return run


def test_the_benchmark_of_worlds_is_the_command():
    command = [sys.executable, str(ROOT / "benchmarks" / "worlds.py"), "--rounds", "0"]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 2
    assert "rounds lies in 1 to" in run.stdout + run.stderr
