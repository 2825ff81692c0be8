"""Differences with the same reward for all, of made-up results."""

from dataclasses import replace

import pytest
from comparisons import OWN, SMALL, arm_of, comparison, number_of

from hmi_marl.experiments.protocols.same_reward import with_same_reward


def test_with_the_same_reward_protocols_are_compared_with_two_stage_of_the_team():
    def earns(pair):
        own = OWN | {"two-stage-team": 550.0, "fine-tune": 650.0, "alternating": 640.0}
        return own.get(arm_of(pair.driver), 0.0) + number_of(pair.driver)

    wider = replace(SMALL, protocols=(*SMALL.protocols, "alternating", "fine-tune"))
    found = {
        (c.protocol, c.metric): c.difference for c in with_same_reward(comparison(wider, earns))
    }
    assert {protocol for protocol, _ in found} == {"joint", "simultaneous"}  # always at once
    assert found["joint", "attention_return"].estimate.mean == pytest.approx(150.0)
    assert found["simultaneous", "attention_return"].estimate.mean == pytest.approx(230.0)
    assert found["joint", "attention_return"].pairs == SMALL.few_seeds
    assert with_same_reward(comparison(replace(SMALL, reward="team"))) == []
