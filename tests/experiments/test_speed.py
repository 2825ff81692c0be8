import json

import pytest

from hmi_marl.experiments.speed import BenchConfig, bench, make_report, measurements

TINY = BenchConfig(teams=(3,), threads=(1,), vehicles=2, scaling=(2,), seconds=0.05, rounds=1)


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
    assert by_name["batched world alone"].bytes_per_team > 0
    report = make_report(TINY, rows, "hmi-marl bench")
    assert all(name in report.text for name in by_name)
    assert len(json.loads(json.dumps(report.numbers))["rows"]) == len(rows)


@pytest.mark.parametrize(
    "wrong", [{"teams": ()}, {"teams": (0,)}, {"rounds": 0}, {"seconds": -1.0}, {"vehicles": 0}]
)
def test_what_cannot_be_measured_is_refused(wrong):
    with pytest.raises(ValueError, match="positive"):
        bench(BenchConfig(**wrong))
