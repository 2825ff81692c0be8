import copy
from dataclasses import replace

import numpy as np
import pytest
import torch
from standing_world import standing_teams
from tensordict import TensorDict

from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.agents.learned.policy import FORMAT, LearnedPolicy, make_card
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.vector import TeamVecEnv
from hmi_marl.training.ppo.heads import IntentThenAlert, OneAction
from hmi_marl.training.ppo.models import (
    SeatView,
    make_actor,
    make_critic,
    make_joint_actor,
    weights_of,
    weights_of_both,
)

CONFIG = TeamConfig(driver=["bart", "lisa", "homer"])
SMALL = NetworkConfig((7, 6), "elu")


def cards(memory=0):
    remembers = replace(SMALL, rnn_hidden_dim=memory)
    return (
        make_card("driver", CONFIG, SMALL, knows_traits=True),
        make_card("vehicle_ai", CONFIG, remembers, knows_traits=True, by_intent=True),
    )


def loud(model):
    """The model with weights that make its choices differ."""
    for weight in model.parameters():
        torch.nn.init.normal_(weight, std=0.7)
    return model


def group(name, values):
    return TensorDict({name: values}, batch_size=[len(values)])


@pytest.mark.parametrize("memory", [0, 4])
@pytest.mark.parametrize("seat", ["driver", "vehicle_ai"])
def test_an_actors_weights_fit_its_card(seat, memory):
    card = make_card(seat, CONFIG, NetworkConfig((7, 6), rnn_hidden_dim=memory), knows_traits=True)
    actor = make_actor(card)
    assert actor.is_recurrent == bool(memory)
    assert isinstance(actor.distribution, OneAction)
    FORMAT.check(card, weights_of(actor))


def test_weights_are_copies():
    actor = make_actor(cards()[0])
    weights = weights_of(actor)
    before = weights["layer0.bias"].copy()
    with torch.no_grad():
        actor.mlp[0].bias.add_(1.0)
    np.testing.assert_array_equal(weights["layer0.bias"], before)


@pytest.mark.parametrize("memory", [0, 4])
def test_the_policy_of_the_weights_acts_as_the_actor(memory):
    config = NetworkConfig((7, 6), "tanh", memory)
    card = make_card("vehicle_ai", CONFIG, config, knows_traits=True)
    torch.manual_seed(2)
    actor = loud(make_actor(card))
    policy = LearnedPolicy(card, weights_of(actor), CONFIG)
    env = TeamVecEnv(standing_teams(6, **vars(CONFIG)))
    seeds = np.arange(6, dtype=np.uint64)
    policy.reset(seeds)
    rng = np.random.default_rng(4)
    with torch.inference_mode():
        for _ in range(5):
            seen = env.get_observations()["vehicle_ai"]
            actor(group("actor", seen), stochastic_output=True)
            np.testing.assert_allclose(
                policy.probabilities(seen.numpy()), actor.output_mean, atol=1e-5
            )
            env.step(torch.from_numpy(rng.integers(0, (5, 2), (6, 2))))


@pytest.mark.parametrize("memory", [0, 4])
def test_the_halves_of_the_composite_policy_act_alone_as_it_acts(memory):
    torch.manual_seed(5)
    driver, vehicle_ai = cards(memory)
    actor = loud(make_joint_actor(driver, vehicle_ai))
    of_driver, of_vehicle_ai = weights_of_both(actor)
    rng = np.random.default_rng(6)
    alone = (
        LearnedPolicy(driver, of_driver, CONFIG),
        LearnedPolicy(vehicle_ai, of_vehicle_ai, CONFIG),
    )
    env = TeamVecEnv(standing_teams(5, **vars(CONFIG)))
    teams, seeds = env.teaming, np.arange(5, dtype=np.uint64)
    begins = np.ones(5, bool)
    for _ in range(6):
        actor.reset(torch.from_numpy(begins))
        for policy in alone:
            policy.reset(seeds, None if begins.all() else begins)
        begins = rng.random(5) < 0.3  # what was remembered is forgotten in some of the teams
        seen = env.get_observations()
        read = SeatView(env, (driver, vehicle_ai), centralised=True)(seen)
        with torch.no_grad():
            actor(group("actor", read.actor), stochastic_output=True)
            intent, alert = (log_probs.exp().numpy() for log_probs in actor.distribution.params)
            greedy = actor.distribution.deterministic_output(actor.output_mean).long().numpy()
        np.testing.assert_allclose(
            alone[0].probabilities(teams.observe("driver")), intent, atol=1e-5
        )
        for intended in range(5):  # taking turns, the vehicle AI sees what the driver intends
            teams.intend(np.full(5, intended))
            shown = teams.observe("vehicle_ai")
            found = copy.deepcopy(alone[1]).probabilities(shown)  # remembers this step only once
            np.testing.assert_allclose(found, alert[:, intended], atol=1e-5)
            teams.withdraw()
        intents = alone[0].act(teams.observe("driver"))
        teams.intend(intents)
        assert intents.tolist() == greedy[:, 0].tolist()
        assert alone[1].act(teams.observe("vehicle_ai")).tolist() == greedy[:, 1].tolist()
        teams.withdraw()
        env.step(torch.from_numpy(greedy))


@pytest.mark.parametrize("memory", [0, 4])
def test_each_half_reads_its_own_seat_alone(memory):
    driver, vehicle_ai = cards(memory)
    actor = loud(make_joint_actor(driver, vehicle_ai))
    assert isinstance(actor.distribution, IntentThenAlert)
    x = torch.randn(3, driver.inputs + vehicle_ai.inputs, requires_grad=True)
    logits = actor.mlp(actor.get_latent(group("actor", x)))
    for columns, seat in ((slice(0, 5), slice(0, driver.inputs)), (slice(5, 15), None)):
        (gradient,) = torch.autograd.grad(logits[:, columns].sum(), x, retain_graph=True)
        reads = gradient.abs().sum(0) > 0
        if seat is None:
            assert not reads[: driver.inputs].any()
            assert reads[driver.inputs :].any()
        else:
            assert reads[seat].any()
            assert not reads[driver.inputs :].any()


@pytest.mark.parametrize("memory", [0, 4])
def test_the_weights_of_both_halves_fit_their_cards(memory):
    both = cards(memory)
    actor = make_joint_actor(*both)
    assert actor.is_recurrent == bool(memory)
    weights = weights_of_both(actor)
    for card, its in zip(both, weights, strict=True):
        FORMAT.check(card, its)
    numbers = sum(values.size for its in weights for values in its.values())
    assert numbers == sum(parameter.numel() for parameter in actor.parameters())


def test_a_composite_policy_that_cannot_be_is_refused():
    driver, vehicle_ai = cards()
    remembers = replace(driver, network=NetworkConfig((7,), rnn_hidden_dim=2))
    with pytest.raises(ValueError, match="choose rnn_hidden_dim = 0 for the driver"):
        make_joint_actor(remembers, vehicle_ai)
    reads_intent = make_card("vehicle_ai", CONFIG, SMALL, knows_traits=True)
    with pytest.raises(ValueError, match="needs a vehicle AI with logits by intent"):
        make_joint_actor(driver, reads_intent)


def test_a_critic_gives_one_value_and_has_no_head():
    critic = make_critic(9, SMALL)
    assert critic(group("critic", torch.zeros(4, 9))).shape == (4, 1)
    assert critic.distribution is None
    assert not critic.is_recurrent
    assert not any(isinstance(layer, torch.nn.ReLU) for layer in critic.mlp)
