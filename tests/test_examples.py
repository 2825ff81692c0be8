import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
TINY = {
    "turn_taking": (["--duration", "2"], "vehicle_ai  return"),
    "new_driver": ([], "with the optimal one"),
    "supersuit_vector": (["--cars", "2", "--steps", "5"], "2 cars, 4 agents"),
    "policy_gradient_hmi": (["--episodes", "2", "--duration", "1"], "attention return"),
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


def test_the_benchmark_runs(tmp_path):
    script = ROOT / "benchmarks" / "highway_world.py"
    arguments = ["--steps", "3", "--episodes", "1", "--vehicles", "2"]
    command = [sys.executable, str(script), *arguments]
    run = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert (tmp_path / "runs" / "benchmarks" / "highway_world.json").exists()


def test_the_other_benchmark_is_the_command():
    command = [sys.executable, str(ROOT / "benchmarks" / "worlds.py"), "--rounds", "0"]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 2
    assert "positive" in run.stdout + run.stderr
