"""Shifts, and what posteriors believe of them."""

from dataclasses import replace

import pytest

from hmi_marl.demonstrations.recording import CollectSettings
from hmi_marl.envs.drivers import PAPER_DRIVERS, Uniform
from hmi_marl.experiments.trait_shifts.scoring import has_probabilities
from hmi_marl.experiments.trait_shifts.shifts import (
    NONE,
    SHIFTS,
    knowing_belief,
    unshifted_belief,
)

BASE = CollectSettings(drivers=(), population=3, windows=2, driver_policy="trained:driver")
BY_NAME = {shift.name: shift for shift in SHIFTS}


@pytest.mark.parametrize("shift", SHIFTS, ids=lambda shift: shift.name)
def test_each_shift_records_the_same_strangers_in_the_same_episodes(shift):
    recording = shift.recording(BASE)
    assert (recording == BASE) == (shift is NONE)
    assert (recording.episodes()[1] == BASE.episodes()[1]).all()
    for (stranger, _), (own, _) in zip(recording.cast(), BASE.cast(), strict=True):
        same = [a == b for a, b in zip(stranger.traits, own.traits, strict=True)]
        assert same.count(False) <= 1  # ranges move one trait


def test_names_and_descriptions_differ():
    assert len({shift.name for shift in SHIFTS}) == len({shift.what for shift in SHIFTS})
    assert SHIFTS[0] is NONE


def test_the_unaware_posterior_believes_in_the_usual_driver_window_and_range():
    for name in ("control-driver", "window-9", "high-inflation", "traffic"):
        belief = unshifted_belief(BASE, BY_NAME[name].recording(BASE))
        assert belief.driver_policy == "trained:driver"
        assert belief.config.alert_window == 7
        assert belief.prior.inflation == Uniform(1.0, 9.0)
    assert belief.config.scene.vehicles == (25, 30)  # which it sees


def test_the_knowing_posterior_knows_what_has_shifted():
    def known(name):
        recording = BY_NAME[name].recording(BASE)
        return knowing_belief(recording, has_probabilities(recording.driver_policy))

    unaware = unshifted_belief(BASE, BASE)
    assert known("none") == known("no-alerts") == unaware
    assert known("control-driver") == replace(unaware, driver_policy="trained:driver-inflation")
    assert known("rule-driver").driver_policy is None
    assert known("window-9").config == replace(BASE.team(PAPER_DRIVERS), alert_window=9)
    assert known("high-inflation").prior.inflation == Uniform(9.0, 13.0)
    for name in ("adaptive-hmi", "average-hmi", "drift-small", "drift-large"):
        assert known(name) is None
