import dataclasses

import numpy as np
import pytest
from demonstrations import LAYOUT, made_up

from hmi_marl.agents.learned.situations import situations
from hmi_marl.demonstrations.dataset import alert_rate
from hmi_marl.demonstrations.parquet import write_demonstrations
from hmi_marl.demonstrations.stored import ObservedFile
from hmi_marl.training.traits import episodes
from hmi_marl.training.traits.episodes import Episodes
from hmi_marl.training.traits.windows import Windows

LENGTH = [4, 6, 1, 3, 6, 2, 4]
DATA = made_up(LENGTH, driver=[0, 1, 0, -1, 1, 0, 1], names=("ada", "bob"))
WHICH = np.array([True, False, True, True, True, False, True])


@pytest.fixture
def stored(tmp_path):
    write_demonstrations(tmp_path / "data", iter([DATA]))
    return ObservedFile(tmp_path / "data")


@pytest.mark.parametrize("piece", [1, 2, 3, 100])
def test_episodes_on_disk_are_those_in_memory(piece, stored, tmp_path, monkeypatch):
    monkeypatch.setattr(episodes, "PIECE", piece)
    chosen = DATA.observed.take(WHICH)
    read, kept = Episodes.read(stored, WHICH, tmp_path / "run"), Episodes.of(chosen)
    assert len(read) == 5
    assert (read.names, read.about, read.layout) == (chosen.names, chosen.about, LAYOUT)
    for name in ("actions", "length", "driver"):
        np.testing.assert_array_equal(getattr(read, name), getattr(chosen, name))
    there = chosen.steps_taken
    x = situations(chosen.states, chosen.actions, chosen.alerts)
    np.testing.assert_array_equal(read.situations[there], x[there])
    np.testing.assert_array_equal(kept.situations, x)
    assert read.alert_rate == pytest.approx(alert_rate(chosen), rel=1e-12)
    for one, other in zip(read.units, kept.units, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6)


def test_pools_of_both_are_the_same(stored, tmp_path):
    chosen = DATA.observed.take(WHICH)
    labels = np.full(5, np.nan)
    batches = [
        Windows(each, labels).batch(np.array([[0, 1], [3, 4]]))
        for each in (Episodes.read(stored, WHICH, tmp_path), Episodes.of(chosen))
    ]
    for one, other in zip(*batches, strict=True):
        assert one.dtype == other.dtype
    there = np.arange(6) < batches[0].length.numpy()[..., None]
    for name in ("situations", "actions"):
        one, other = (getattr(batch, name).numpy()[there] for batch in batches)
        np.testing.assert_array_equal(one, other)


def test_situations_lie_in_a_file_without_a_name(stored, tmp_path):
    before = sorted(tmp_path.rglob("*"))
    found = Episodes.read(stored, WHICH, tmp_path / "not" / "there")
    assert isinstance(found.situations, np.memmap)
    assert sorted(tmp_path.rglob("*")) == before
    with pytest.raises(ValueError, match="read-only"):
        found.situations[0] = 0.0


def test_a_large_column_keeps_its_spread(stored, tmp_path, monkeypatch):
    # Sums of squares without care would lose 1e-3 beside 1e6.
    monkeypatch.setattr(episodes, "PIECE", 2)
    moments = episodes.Moments(LAYOUT.size)
    rng = np.random.default_rng(0)
    every = [dataclasses.replace(made_up([5] * 2).observed) for _ in range(3)]
    shown = []
    for each in every:
        states = (1e6 + rng.normal(size=each.states.shape)).astype(np.float32)
        object.__setattr__(each, "states", states)  # beyond what the layout allows
        moments.add(each)
        shown.append(states.reshape(-1, LAYOUT.size))
    whole = np.concatenate(shown).astype(np.float64)
    np.testing.assert_allclose(moments.units().scale, whole.std(axis=0), rtol=1e-6)
    np.testing.assert_allclose(moments.units().centre, whole.mean(axis=0), rtol=1e-6)
