import math

import numpy as np
import pytest

from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.rewards import (
    ATTENTION_TERMS,
    DRIVING_TERMS,
    TERMS,
    RewardWeights,
    attention_terms,
    driving_terms,
    share,
)

PAPER = RewardWeights()


def test_driving_terms_by_hand():
    terms = driving_terms(
        PAPER,
        crashed=np.array([False, True]),
        speed=np.array([24.0, 30.0]),
        in_right_lane=np.array([True, False]),
        merging_slowness=np.array([(30 - 20) / 30 + (30 - 15) / 30, 0.0]),
        changes_lane=np.array([False, True]),
    )
    assert list(terms) == list(DRIVING_TERMS)
    assert terms["collision"].tolist() == [0.0, -5.0]
    np.testing.assert_allclose(terms["speed_reward"], [4.0, 5.0])
    assert terms["right_lane"].tolist() == [0.1, 0.0]
    np.testing.assert_allclose(terms["merging"], [-1 / 12, 0.0])
    assert terms["lane_change"].tolist() == [0.0, -0.1]


@pytest.mark.parametrize(
    ("alert", "before", "now", "distraction", "sparse", "accept"),
    [
        (0, 0, 0, 0.0, 10.0, 0.0),
        (0, 0, 1, -10.0, 10.0, 0.0),
        (0, 1, 0, 0.0, 0.0, 0.0),
        (0, 1, 1, -10.0, 0.0, 0.0),
        (1, 0, 0, 0.0, 0.0, 0.0),
        (1, 0, 1, -10.0, 0.0, 0.0),
        (1, 1, 0, 0.0, 0.0, 30.0),
        (1, 1, 1, -10.0, 0.0, 0.0),
    ],
)
def test_attention_terms_by_hand(alert, before, now, distraction, sparse, accept):
    terms = attention_terms(PAPER, alert=alert, distracted_before=before, distracted=now)
    values = tuple(float(terms[name]) for name in ATTENTION_TERMS)
    assert values == (distraction, sparse, accept)


def test_weights_scale_their_own_term_alone():
    weights = RewardWeights(distraction=-1.0, accept_alert=2.0, max_speed=15.0)
    terms = attention_terms(weights, alert=1, distracted_before=1, distracted=0)
    assert float(terms["accept_alert"]) == 2.0
    quiet = {
        "crashed": np.array([False]),
        "in_right_lane": np.array([False]),
        "merging_slowness": np.array([0.0]),
        "changes_lane": np.array([False]),
    }
    assert driving_terms(weights, speed=np.array([15.0]), **quiet)["speed_reward"].item() == 5.0


def test_sharing_by_hand():
    terms = {name: np.array([float(10**k)]) for k, name in enumerate(TERMS)}
    expected = {
        "team": (11111111.0, 11111111.0),
        "individual": (111111.0, 11000000.0),
        "driving": (11111.0, 11111.0),
        "attention": (11100000.0, 11100000.0),
    }
    for sharing, (driver, vehicle_ai) in expected.items():
        both = share(terms, sharing)
        assert (both[0].item(), both[1].item()) == (driver, vehicle_ai)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: TeamConfig(reward="selfish"), "one of team, individual, driving, attention, not"),
        (lambda: RewardWeights(collision=math.nan), "collision lies in"),
        (lambda: RewardWeights(max_speed=0.0), "max_speed lies in"),
    ],
)
def test_bad_settings_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize("value", ["5", None, True, [5.0], np.array(5.0)])
def test_a_weight_that_is_no_number_is_refused_by_name(value):
    with pytest.raises(TypeError, match="reward weight speed_reward is a number, not"):
        RewardWeights(speed_reward=value)
    assert RewardWeights(speed_reward=np.float32(2)) == RewardWeights(speed_reward=2)
