import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
TINY = {
    "turn_taking": (["--duration", "2"], "vehicle_ai  return"),
    "new_driver": ([], "with the optimal one"),
    "latent_traits": (["--windows", "10", "--updates", "1", "--steps", "1600"], "homer  z = ["),
    "unknown_driver": (
        ["--drives", "2", "--trips", "2", "--adaptive", "adapt:bayes"],
        "believed in the end: lisa",
    ),
    "supersuit_vector": (["--cars", "2", "--steps", "5"], "2 cars, 4 agents"),
    "policy_gradient_hmi": (["--episodes", "2", "--duration", "1"], "attention return"),
    "sb3_parameter_sharing": (
        ["--steps", "64", "--cars", "2", "--batch", "16", "--duration", "2", "--episodes", "2"],
        "vehicle_ai",
    ),
}


@pytest.mark.parametrize("name", TINY)
def test_an_example_runs(name, tmp_path):
    arguments, told = TINY[name]
    command = [sys.executable, str(ROOT / "examples" / f"{name}.py"), *arguments]
    run = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert told in run.stdout


def test_every_example_is_run():
    assert {path.stem for path in (ROOT / "examples").glob("*.py")} == set(TINY)


def test_the_benchmark_of_the_highway_world_runs(tmp_path):
    run_benchmark("highway_world", "--steps 3 --episodes 1 --vehicles 2", tmp_path)
    assert (tmp_path / "runs" / "benchmarks" / "highway_world.json").exists()


def test_the_benchmark_of_training_tells_where_time_goes(tmp_path):
    ours = "--rounds 1 --steps 2 --teams 32 --vehicles 2"
    sb3 = "--processes 1 --sb3-steps 4 --sb3-batch 4"
    run_benchmark("training", f"{ours} {sb3}", tmp_path)
    written = json.loads((tmp_path / "runs" / "bench" / "training.json").read_text())
    driver, hmi, both, plain = written["rows"]
    parts = ("world", "partner", "policy", "record", "learn", "rest")
    for row in (driver, hmi, both):
        assert sum(row[part] for part in parts) == pytest.approx(1)
        assert all(0 <= row[part] < 1 for part in parts)
    assert driver["partner"] == 0 < hmi["partner"]
    assert driver["steps"] == hmi["steps"] == 3200  # a whole batch
    assert plain["steps"] == 4
    assert plain["ratio"] == 1


def test_the_benchmark_of_startup_tells_ratios_to_numpy(tmp_path):
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


def run_benchmark(name, arguments, folder):
    command = [sys.executable, str(ROOT / "benchmarks" / f"{name}.py"), *arguments.split()]
    run = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr


def test_the_benchmark_of_worlds_is_the_command():
    command = [sys.executable, str(ROOT / "benchmarks" / "worlds.py"), "--rounds", "0"]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 2
    assert "positive" in run.stdout + run.stderr
