"""Curves of a run for TensorBoard, in their groups."""

import pytest

from hmi_marl.training.runs.progress import Progress

event_accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")


def test_curves_are_grouped_by_what_they_are_of(tmp_path):
    row = {
        "return": 1.0,
        "crash_rate": 0.1,
        "surrogate": 0.2,
        "vehicle_ai_entropy": 0.3,
        "anchor_kl": 0.4,
        "learning_rate": 1e-3,
        "L1": 0.5,
        "steps_per_second": 1e4,
    }
    with Progress("run", 10, board=tmp_path) as progress:
        progress.advance(10, row)
    events = event_accumulator.EventAccumulator(str(tmp_path))
    events.Reload()
    assert sorted(events.Tags()["scalars"]) == [
        "episode/crash_rate",
        "episode/return",
        "learning/L1",
        "learning/anchor_kl",
        "learning/learning_rate",
        "learning/surrogate",
        "learning/vehicle_ai_entropy",
        "speed/steps_per_second",
    ]
