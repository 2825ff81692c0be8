import numpy as np
import pytest
from trait_models import save_driver

from hmi_marl.demonstrations.recording import CollectSettings
from hmi_marl.exact.evidence_by_source import SOURCES
from hmi_marl.experiments.episodes import AlertQuality, Episodes
from hmi_marl.experiments.identification.scoring import (
    POOL,
    SECONDS,
    Read,
    compare_driving,
    compare_naming,
    is_named,
    score_naming,
)

ONE = Read("hidden", 20.0, 1)


def test_the_likeliest_is_named():
    evidence = np.array([[-1.0, -2.0], [-2.0, -1.0], [-np.inf, -5.0]])
    rng = np.random.default_rng(0)
    assert is_named(evidence, np.array([0, 0, 1]), rng).tolist() == [True, False, True]


def test_among_equals_one_is_drawn():
    equal = np.array([[-1.0, -1.0 - 1e-9, -3.0]]).repeat(4000, axis=0)
    for true, share in ((0, 0.5), (1, 0.5), (2, 0.0)):
        right = is_named(equal, np.full(4000, true), np.random.default_rng(1))
        assert right.mean() == pytest.approx(share, abs=0.03)


def test_shares_are_compared_window_by_window():
    trained = {ONE: np.array([True, True, True, False])}
    control = {ONE: np.array([True, False, False, False])}
    (row,) = compare_naming(trained, control)
    assert row.read == ONE
    assert (row.trained.mean, row.control.mean, row.difference.mean) == (0.75, 0.25, 0.5)
    assert row.difference.error == pytest.approx(np.std([0, 1, 1, 0], ddof=1) / 2)
    assert (row.trained.count, row.difference.count) == (4, 4)


def played(speeds, crashed):
    count, nothing = len(speeds), np.zeros(len(speeds))
    return Episodes(
        np.arange(count, dtype=np.uint64),
        np.full(count, 100),
        np.array(crashed),
        *np.zeros((2, count), np.int64),
        nothing,
        nothing,
        {"speed_reward": np.array(speeds, np.float64)},
        AlertQuality.nothing_yet(count),
    )


def test_driving_is_compared_episode_by_episode():
    trained = {"lisa": played([450.0, 400.0], [False, True])}
    control = {"lisa": played([440.0, 380.0], [False, False])}
    (row,) = compare_driving(trained, control)
    assert (row.speed_return.mean, row.control_speed_return.mean) == (425.0, 410.0)
    assert (row.speed_difference.mean, row.speed_difference.error) == (15.0, 5.0)
    assert (row.crash_rate.mean, row.control_crash_rate.mean) == (0.5, 0.0)


def test_windows_and_pools_are_named_by_every_source(tmp_path):
    """A control cannot tell drivers of one inflation apart by their intents: half of four."""
    save_driver(tmp_path / "all", 0)
    save_driver(tmp_path / "control", 0, knows_traits=("inflation",))
    rights = {}
    for name in ("all", "control"):
        recording = CollectSettings(
            steps=POOL * 100, vehicles=(1, 3), driver_policy=str(tmp_path / name)
        )
        rights[name] = score_naming(recording, 0)
        assert set(rights[name]) == {
            *(Read(source, seconds, 1) for source in SOURCES for seconds in SECONDS),
            *(Read(source, 20.0, POOL) for source in SOURCES),
        }
        for read, right in rights[name].items():
            assert right.shape == ((4 * POOL) if read.windows == 1 else 4,)
        assert rights[name][Read("seen", 20.0, 1)].mean() > 0.75
    alone = Read("intended", 20.0, 1)
    # 32 windows; by the control at most one half is named but for luck, four deviations.
    assert rights["control"][alone].mean() < 0.5 + 4 * np.sqrt(0.25 / 32)
    assert rights["all"][alone].mean() > rights["control"][alone].mean()
