from dataclasses import replace

import pytest
from demonstrations import LAYOUT

from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.training.traits.settings import LossWeights, TraitSettings


def test_the_losses_weigh_as_the_paper_says():
    weights = LossWeights().by_loss()
    assert {name: weights[name] for name in ("L1", "L2", "L3", "L4")} == {
        "L1": 1.0,
        "L2": 5.0,
        "L3": 10.0,
        "L4": 1e-4,
    }


def test_the_model_is_the_papers():
    settings = TraitSettings(supervision="none")
    card = settings.card(LAYOUT)
    assert (card.latent, card.pool) == (2, 8)
    assert card.reward == NetworkConfig((32, 32))
    assert card.potential == card.policy == NetworkConfig((32,))
    assert card.gamma == settings.ppo.gamma
    assert card.state_size == LAYOUT.size


@pytest.mark.parametrize("supervision", ["self", "none", "id", "preference"])
def test_z_is_the_papers_unless_self_supervised_or_chosen(supervision):
    settings = TraitSettings(supervision=supervision)
    assert settings.latent_size == (8 if supervision == "self" else 2)
    assert settings.fixed_encoder == (supervision == "self")
    assert replace(settings, latent=4).latent_size == 4
    assert replace(settings, latent=4).card(LAYOUT).latent == 4


@pytest.mark.parametrize("supervision", ["self", "none", "id", "preference"])
def test_the_policy_imitates_first_where_the_encoder_learns_from_it(supervision):
    settings = TraitSettings(supervision=supervision)
    assert settings.imitation == (0 if supervision == "self" else 600)
    assert replace(settings, imitation_updates=7).imitation == 7


def test_the_papers_settings_differ_in_supervision_alone():
    weights = LossWeights()
    assert weights.cohesion == 0.0  # which needs no labels, so that it would be in all of them


def test_rounds_are_whole():
    settings = TraitSettings(steps=1001, num_teams=8)
    assert settings.rounds(100) == 2
    assert replace(settings, steps=800).rounds(100) == 1


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ({"labelled": 0.0}, r"labelled lies in \(0, 1\]"),
        ({"labelled": 1.1}, "labelled lies in"),
        ({"held_out": 1.0}, r"held_out lies in \[0, 1\)"),
        ({"settling": -0.1}, "settling lies in"),
        ({"labelled_pools": 1}, "labelled_pools lies in 2 to"),
        ({"expert_pools": 3}, "expert_pools is an even number"),
        ({"imitation_updates": -1}, "imitation_updates lies in 0 to"),
        ({"num_teams": 12}, "teams is a multiple of pool = 8, .*, but got 12"),
        (
            {"num_teams": 2, "pool": 2},
            "cannot split 2 teams into 4 mini-batches; lower --ppo.num-mini-batches",
        ),
        ({"drivers_per_update": 1}, "drivers_per_update lies in 2 to"),
        ({"encoder_updates": -1}, "encoder_updates lies in 0 to"),
        ({"average_updates": -1}, "average_updates lies in 0 to"),
        ({"encoder_rate": 0.0}, "encoder_rate lies in"),
        ({"weight_decay": -1.0}, "weight_decay lies in"),
        ({"latent": 0}, "latent lies in 1 to"),
        ({"steps": 0}, "steps lies in 1 to"),
        ({"margin": 0.0}, "margin lies in"),
        ({"label_bandwidth": float("nan")}, "label_bandwidth lies in"),
        ({"learning_rate": float("inf")}, "learning_rate lies in"),
        ({"checkpoint_every": -1.0}, "checkpoint_every lies in"),
        ({"seed": -1}, "seed"),
        ({"supervision": "foo"}, "supervision is one of self, none, id, preference, not 'foo'"),
        ({"supervision": "id", "label_bandwidth": 0.1}, "drivers are not graded; set it to 0"),
    ],
)
def test_what_makes_no_training_is_refused(choice, message):
    with pytest.raises(ValueError, match=message):
        TraitSettings(**choice)


@pytest.mark.parametrize("name", vars(LossWeights()))
def test_weights_are_numbers_of_at_least_none(name):
    with pytest.raises(ValueError, match=f"{name} lies in .*, but got -1"):
        LossWeights(**{name: -1.0})
