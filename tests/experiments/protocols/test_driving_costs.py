"""Costs in driving, by term, of made-up results."""

from dataclasses import replace

import pytest
from comparisons import SMALL, arm_of, comparison, hidden, number_of

from hmi_marl.experiments.protocols.driving_costs import driving_costs
from hmi_marl.experiments.protocols.results import (
    given_up,
)
from hmi_marl.reporting.statistics import Estimate


def test_what_a_driver_gives_up_is_against_the_two_stage_pair_of_the_same_seed():
    def driving(pair):
        return 450.0 - (13.0 if arm_of(pair.driver) == "simultaneous" else 0.0)

    found = given_up(hidden(driving=driving).tasks["hidden"], "simultaneous")
    assert found == Estimate(13.0, 13.0, 13.0)


def test_costs_in_driving_worked_by_hand():
    def driving(pair):
        return 400.0 - (30.0 if arm_of(pair.driver) == "joint" else 0.0) + number_of(pair.driver)

    def crashes(pair):
        return 12 if arm_of(pair.driver) == "joint" else 10

    costs = {
        c.arm: c for c in driving_costs(hidden(driving=driving, crashes=crashes).tasks["hidden"])
    }
    joint = costs["joint"]
    assert joint.driving.mean == joint.by_term["speed_reward"].mean == 30.0
    assert joint.by_term["lane_change"].mean == 0.0
    assert joint.crash_rate.mean == pytest.approx(0.02)
    assert costs["two-stage"].driving == Estimate(0.0, 0.0, 0.0)
    alone = replace(SMALL, protocols=("joint",), anchor_kls=())
    assert driving_costs(comparison(alone).tasks["hidden"]) == []
