"""HMIs of a trial in blinded order, and alerts of a calibration."""

from collections import Counter

import numpy as np
import pytest

from hmi_marl.agents.catalogue import make_hmi
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import DRIVERS, Driver
from hmi_marl.exact.oracle import solve_alerts
from hmi_marl.people.measure.hmis import TRIAL, best_hmis, blinded_order, calibration_alerts
from hmi_marl.people.measure.steps import chain_steps

CONFIG = TeamConfig(driver="average")


def test_half_of_a_calibration_is_within_windows():
    hmi = make_hmi(calibration_alerts(CONFIG), CONFIG)
    seeds = np.arange(50, dtype=np.uint64)
    hmi.reset(seeds)
    alerts = np.stack([hmi.act(np.zeros((50, 1), np.float32)) for _ in range(400)], axis=1)
    steps = chain_steps([(np.zeros_like(own), own) for own in alerts], CONFIG.alert_window)
    assert steps.accepted.mean() == pytest.approx(0.5, abs=0.02)


def test_the_own_hmi_is_the_optimum_for_the_measured_traits():
    driver = Driver("visitor-17", 0.3, 0.4, 0.2, 5.0)
    found = best_hmis(driver, CONFIG)
    assert tuple(found) == TRIAL
    assert make_hmi(found["own"].partner, CONFIG).model == driver
    assert make_hmi(found["average"].partner, CONFIG).model == DRIVERS["average"]
    optimum = solve_alerts(driver, CONFIG.alert_window, CONFIG.horizon)
    assert found["own"].attention_return == pytest.approx(optimum.total_return)
    assert found["own"].attention_return >= found["average"].attention_return
    assert found["average"].attention_return > found["none"].attention_return
    assert found["none"].alerts == 0.0


def test_without_attention_nothing_exact_is_told():
    found = best_hmis(DRIVERS["bart"], TeamConfig(driver="average", ai_sees_attention=False))
    assert found["own"].attention_return is None
    assert found["none"].alerts == 0.0


@pytest.mark.parametrize("seed", [0, 7])
def test_orders_are_balanced_in_every_six_visitors(seed):
    for block in range(3):
        orders = [blinded_order(6 * block + k, seed) for k in range(6)]
        assert len(set(orders)) == 6
        for place in range(3):
            assert set(Counter(order[place] for order in orders).values()) == {2}


def test_orders_depend_on_the_seed_alone():
    def many(seed):
        return [blinded_order(k, seed) for k in range(30)]

    assert many(1) == many(1)
    assert many(1) != many(2)


def test_bad_numbers_are_refused():
    with pytest.raises(ValueError, match="number lies in"):
        blinded_order(-1)
    with pytest.raises(ValueError, match="seed lies in"):
        blinded_order(0, -1)
