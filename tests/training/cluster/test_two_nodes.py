"""A real cluster of two nodes on this machine, of which one is killed in the middle of a sweep."""

from __future__ import annotations

import json
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from fresh import run

pytest.importorskip("ray")

SWEEP = """
import os, signal, sys, threading, time
from pathlib import Path

from ray.cluster_utils import Cluster as Nodes

from hmi_marl.experiments.experiment import Place, conduct
from hmi_marl.experiments.sweep.experiment import Sweep
from hmi_marl.training.cluster.cluster import connected

SWEEP = Sweep(
    ("simultaneous", "two-stage"),
    (
        "simultaneous:steps=4000", "two-stage:driver_steps=2000", "two-stage:hmi_steps=2000",
        "num_teams=8", "duration=2", "ppo.num_mini_batches=2", "ppo.num_learning_epochs=1",
        "checkpoint_every=0", "snapshots=1",
    ),
    seeds=1,
    episodes=4,
)


def kill_when_both_have_begun(folder, raylet):
    checkpoints = [folder / run.name / "checkpoint.safetensors" for run in SWEEP.plan]
    while not all(checkpoint.exists() for checkpoint in checkpoints):
        time.sleep(0.02)
    os.kill(raylet, signal.SIGKILL)  # its workers end with it


def main(here, there):
    soon = {"health_check_period_ms": 500, "health_check_failure_threshold": 3}
    head = {"num_cpus": 1, "include_dashboard": False, "_system_config": soon}
    nodes = Nodes(initialize_head=True, head_node_args=head)
    other = nodes.add_node(num_cpus=1)
    nodes.wait_for_nodes()
    (raylet,) = (each.process.pid for each in other.all_processes["raylet"])
    killer = threading.Thread(target=kill_when_both_have_begun, args=(there, raylet), daemon=True)
    killer.start()
    with connected(nodes.address) as cluster:
        conduct(SWEEP, Place(there, there, 1, "hmi-marl sweep", cluster=cluster))
    killer.join()
    nodes.shutdown()
    conduct(SWEEP, Place(here, here, 2, "hmi-marl sweep"))
    print(*(run.name for run in SWEEP.plan))


if __name__ == "__main__":
    sys.stderr = sys.stdout
    main(*map(Path, sys.argv[1:]))
"""
TIMES = ("seconds", "steps_per_second", "share_of_time_learning", "share_of_time_waiting")


def without_times(content):
    """JSON content without durations."""
    if isinstance(content, dict):
        return {k: without_times(v) for k, v in content.items() if k not in TIMES}
    return [without_times(each) for each in content] if isinstance(content, list) else content


def files(folder: Path) -> dict[str, Path]:
    return {
        path.relative_to(folder).as_posix(): path
        for path in folder.rglob("*")
        if path.is_file() and "tensorboard" not in path.parts
    }


@pytest.mark.slow
def test_a_sweep_ends_with_the_same_bytes_though_a_node_is_killed(tmp_path, unmeasured):
    script, here, there = (tmp_path / name for name in ("sweep.py", "here", "there"))
    script.write_text(SWEEP)
    left = tmp_path / "left"  # by the worker of the node that is killed
    left.mkdir()
    quiet = {"RAY_USAGE_STATS_ENABLED": "0", "RAY_TMPDIR": "/tmp", "TMPDIR": str(left)}
    printed = run(script, here, there, **quiet)
    assert printed.count("was lost (") >= 1, printed
    names = printed.splitlines()[-1].split()
    assert len(names) == 2
    for name in names:
        ours, theirs = files(here / name), files(there / name)
        assert set(ours) == set(theirs)
        assert {"snapshots", "driver.safetensors", "vehicle_ai.json", "result.json"} <= {
            part for path in ours for part in Path(path).parts
        }
        for path in set(ours) - {"checkpoint.safetensors", "curve.json", "result.json"}:
            assert ours[path].read_bytes() == theirs[path].read_bytes(), path
        for path in ("curve.json", "result.json"):
            one, other = (json.loads(each[path].read_text()) for each in (ours, theirs))
            assert without_times(one) == without_times(other), path
        assert list((there / name / "tensorboard").iterdir())
    one, other = (pq.read_table(each / "sweep.parquet") for each in (here, there))
    column = "training_seconds"
    assert one.drop_columns(column).equals(other.drop_columns(column), check_metadata=True)
