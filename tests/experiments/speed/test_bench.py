import json
import sys
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch
from cited import missing

from hmi_marl import Scene, TeamConfig, make_vec
from hmi_marl.envs.worlds.batched import BatchedWorld
from hmi_marl.experiments.speed import BenchConfig, bench, make_report, measurements
from hmi_marl.experiments.speed.contestants import MIX, vector_environment

measuring = sys.modules[BenchConfig.__module__]

TINY = BenchConfig(
    teams=(3,),
    threads=(1,),
    vehicles=2,
    scaling=(2,),
    vector_teams=(4,),
    seconds=0.05,
    rounds=1,
)


def test_everybody_is_measured_beside_highway_env():
    told = []
    rows = bench(TINY, told.append)
    assert sum(told) == measurements(TINY) == len(rows)
    by_name = {row.name: row for row in rows}
    assert {"highway-env, one process", "batched world alone", "whole team step"} <= set(by_name)
    first = rows[0]
    assert first.name == "highway-env, one process"
    assert first.ratio == 1.0
    for row in rows:
        assert row.steps_per_s > 0
        assert row.ratio == pytest.approx(row.steps_per_s / first.steps_per_s)  # of one round
    alone, whole = by_name["batched world alone"], by_name["whole team step"]
    assert 0 < alone.bytes_per_team < whole.bytes_per_team < alone.bytes_per_team + 4000
    vectors = [row for row in rows if row.name.startswith("vector environment")]
    assert len(vectors) == 4  # two seats, with the default traffic and with two vehicles
    for row, carrier in pairwise(rows):
        if row in vectors:
            assert carrier.name == row.name.replace(
                "vector environment", "its world with the lidars read"
            )
            assert row.of_world == pytest.approx(row.steps_per_s / carrier.steps_per_s)
        else:
            assert row.of_world is None
    report = make_report(TINY, rows, "hmi-marl bench")
    assert all(name in report.text for name in by_name)
    assert len(json.loads(json.dumps(report.numbers))["rows"]) == len(rows)
    assert not missing(report.blocks, report.numbers)


def test_a_vector_environment_and_its_world_alternate_within_a_turn(monkeypatch):
    order = []

    def contestant(name, speed):
        def run(seconds):
            order.append((name, seconds))
            return speed

        return measuring._Contestant(name, 1, 1, "2", run)

    names = ["highway-env", "vector environment, a", "its world", "vector environment, b", "its"]
    every = [contestant(name, 10.0 * (k + 1)) for k, name in enumerate(names)]
    monkeypatch.setattr(measuring, "_contestants", lambda *_: every)
    counted = []
    rows = bench(replace(TINY, rounds=2), counted.append)
    assert counted == [1, 2, 2] * 2
    assert [row.steps_per_s for row in rows] == [10.0, 20.0, 30.0, 40.0, 50.0]
    assert [row.of_world for row in rows] == [None, 20.0 / 30.0, None, 40.0 / 50.0, None]
    turn = [("highway-env", 0.05)]
    for pair in (names[1:3], names[3:]):
        turn += [(name, 0.005) for _ in range(10) for name in pair]
    assert order == [(name, 0.1) for name in names] + 2 * turn


@pytest.mark.parametrize(
    "wrong", [{"teams": ()}, {"teams": (0,)}, {"rounds": 0}, {"seconds": -1.0}, {"vehicles": 0}]
)
def test_what_cannot_be_measured_is_refused(wrong):
    with pytest.raises(ValueError, match=r"lies in|at least one size"):
        bench(BenchConfig(**wrong))


def test_the_world_alone_drives_as_in_the_vector_environment():
    config = TeamConfig(driver=["homer"], duration=2.0, scene=Scene(vehicles=3))
    run, drive = vector_environment(config, 5, 1, "team", ("critic",), 25)
    run(0.0)
    assert len(drive.steps) == 25
    assert sum(int(ended.sum()) for _, ended, _, _ in drive.steps) >= 10  # two episodes each
    world = BatchedWorld(config.scene, 5, 1)
    every = np.ones(5, np.bool_)
    world.reset(*drive.begins, every)
    env = make_vec(5, "team", driver="homer", duration=2.0, scene=Scene(vehicles=3))
    rng = np.random.default_rng(0)
    columns = [(rng.choice(MIX, 5), rng.choice(range(2), 5)) for _ in range(25)]
    for (intended, alerts), (applied, ended, seeds, inflation) in zip(
        columns, drive.steps, strict=True
    ):
        env.step(torch.from_numpy(np.stack([intended, alerts], axis=1)))
        world.step(applied, every)
        np.testing.assert_array_equal(world.ego().x[~ended], env.teaming.ego.x[~ended])
        world.reset(seeds, inflation, ended)
        np.testing.assert_array_equal(world.ego().x, env.teaming.ego.x)
