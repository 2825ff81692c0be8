"""HMIs trained with simultaneous moves as partners where moves are sequential."""

import dataclasses

import gymnasium
import numpy as np
import pytest
import torch

from hmi_marl.agents import make_hmi, save_policy
from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.agents.learned.policy import LearnedPolicy, make_card
from hmi_marl.agents.partners import make_vec
from hmi_marl.envs.config import TeamConfig

TEAM = TeamConfig(driver="bart", duration=1.0)
DRIVEN = [3, 4, 1]


class Seen(LearnedPolicy):
    """Keeps the a^H that it sees."""

    def __init__(self, card, weights, config):
        super().__init__(card, weights, config)
        self.intents = []

    def act(self, observations):
        self.intents.append(int(self._layout.chosen(observations, "intended_action")[0]))
        return super().act(observations)


def hmi(at_once, made=Seen):
    card = make_card("vehicle_ai", TEAM, NetworkConfig((4,)), True, sequential=not at_once)
    return made(card, {name: np.zeros(shape, "f4") for name, shape in card.shapes.items()}, TEAM)


@pytest.mark.parametrize(("at_once", "expected"), [(True, [-1, 3, 4]), (False, [3, 4, 1])])
def test_they_see_the_last_step_whatever_environment_they_are_in(at_once, expected):
    partner = hmi(at_once)
    env = gymnasium.make("hmi_marl/MergeDriver-v0", partner=partner, driver="bart", duration=1.0)
    env.reset(seed=0)
    for action in DRIVEN:
        env.step(action)
    assert partner.intents == expected

    partner = hmi(at_once)
    vec = make_vec(1, seat="driver", partner=partner, world="highway", driver="bart", duration=1.0)
    for action in DRIVEN:
        vec.step(torch.tensor([[action]]))
    assert partner.intents == expected


def test_one_who_takes_turns_is_refused_where_both_act_at_once(tmp_path):
    for at_once in (True, False):
        policy = hmi(at_once)
        save_policy(tmp_path / str(at_once), dataclasses.replace(policy.card), policy.weights)
    assert not make_hmi(str(tmp_path / "True"), TEAM, sequential=False).sequential
    with pytest.raises(ValueError, match="train with --no-sequential"):
        make_hmi(str(tmp_path / "False"), TEAM, sequential=False)
