"""Differences between HMIs, paired by episode."""

import numpy as np
import pytest

from hmi_marl.envs.rewards import TERMS
from hmi_marl.experiments.episodes import Episodes
from hmi_marl.experiments.metrics_table.differences import ALL, AVERAGE, NONE, OWN, Differences

COUNT = 400


def episodes(speed: np.ndarray, distraction: float, length: np.ndarray) -> Episodes:
    nothing, whole = np.zeros(len(length)), np.zeros(len(length), np.int64)
    returns = dict.fromkeys(TERMS, nothing)
    returns |= {"speed_reward": speed, "distraction": nothing + distraction}
    seeds, crashed = np.arange(len(length), dtype=np.uint64), np.zeros(len(length), np.bool_)
    return Episodes(seeds, length, crashed, whole, whole, nothing, nothing, returns)


@pytest.fixture(scope="module")
def found() -> Differences:
    """Luck of 30 that all rows share; own HMIs are 2.3 better in episodes of 5 steps more."""
    rng = np.random.default_rng(0)
    luck, played = rng.normal(450.0, 30.0, COUNT), {}
    length = rng.integers(80, 90, COUNT)
    for driver, distraction in (("marge", -80.0), ("homer", -120.0)):
        noise = [rng.normal(0.0, 1.0, COUNT) for _ in range(3)]
        played[driver, driver] = episodes(luck + 2.3 + noise[0], distraction, length + 5)
        played[AVERAGE, driver] = episodes(luck + noise[1], distraction - 10.0, length)
        played[NONE, driver] = episodes(luck + noise[2], distraction - 100.0, length)
    return Differences.of(played, ["marge", "homer"])


def test_pairing_shows_what_two_intervals_would_hide(found: Differences) -> None:
    own, none = (found.rows[row]["speed_return"] for row in (OWN, NONE))
    assert own.low < none.high, "the intervals overlap"
    less = found.between_rows["own - NoHMI"]["speed_return"]
    assert less[ALL].mean == pytest.approx(own.mean - none.mean)
    assert less[ALL].low > 1.9
    assert less[ALL].count == COUNT
    assert less["marge"].error == pytest.approx(np.sqrt(2 / COUNT), rel=0.1)
    assert less[ALL].error == pytest.approx(np.sqrt(1 / COUNT), rel=0.1)


def test_longer_episodes_earn_more_and_less_per_step(found: Differences) -> None:
    less = found.between_rows["own - NoHMI"]
    assert less["steps"][ALL].mean == 5.0
    per_step = less["speed_return_per_step"][ALL]
    assert per_step.high < 0.0 < less["speed_return"][ALL].low
    assert per_step.mean == pytest.approx(452.3 / 89.5 - 450.0 / 84.5, abs=0.05)


def test_shares_and_drivers_worked_by_hand(found: Differences) -> None:
    # Marge: -80 with the own HMI, -90 with AvgHMI, -180 without
    assert found.spared["marge"].mean == pytest.approx(100 / 180)
    assert found.average_share["homer"].mean == pytest.approx(0.9)
    assert found.between_drivers[OWN]["marge"]["homer"].mean == 40.0
    more = found.extra_speed_lost["homer"]["marge"]
    assert more.low < 0.0 < more.high
    assert more.count == COUNT
