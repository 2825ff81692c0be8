from dataclasses import replace

import numpy as np
import pytest
import torch
from demonstrations import LAYOUT, made_up
from trait_models import SMALL

from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.training.protocols.settings import PPOSettings
from hmi_marl.training.traits import discriminator
from hmi_marl.training.traits.discriminator import DiscriminatorLearner, Labelled
from hmi_marl.training.traits.episodes import Episodes
from hmi_marl.training.traits.model import log_policy, make_policy
from hmi_marl.training.traits.settings import LossWeights, TraitSettings
from hmi_marl.training.traits.windows import Windows, transitions

SETTINGS = TraitSettings(
    supervision="id",
    num_teams=4,
    pool=2,
    expert_pools=4,
    encoder=SMALL,
    reward=NetworkConfig((4,)),
    potential=NetworkConfig((4,)),
    policy=NetworkConfig((4,)),
    ppo=PPOSettings(num_mini_batches=2),
    learning_rate=1e-2,
)
CARD = SETTINGS.card(LAYOUT)
OBSERVED = made_up([6] * 12, driver=[0, 1] * 6, names=("ada", "bob")).observed
WINDOWS = Windows(Episodes.of(OBSERVED), OBSERVED.driver.astype(float))


def pools(count, seed=0):
    return WINDOWS.batch(WINDOWS.draw_pairs(np.random.default_rng(seed), count, 2))


def labelled():
    which, labels = WINDOWS.draw_labelled(np.random.default_rng(5), 3, 2)
    return Labelled(WINDOWS.batch(which), torch.from_numpy(labels))


def adversary(**weights):
    torch.manual_seed(0)
    settings = replace(SETTINGS, weights=replace(LossWeights(), **weights))
    one = DiscriminatorLearner(CARD, settings, make_policy(CARD), "cpu")
    one.model.encoder.prepare(pools(8, seed=3))
    return one


def gradient(parameters):
    """The largest entry of their gradients; None if there is none at all."""
    found = [p.grad.abs().max().item() for p in parameters if p.grad is not None]
    return max(found, default=None)


def backward(one, name, **weights):
    losses, _ = one.losses(pools(4), labelled(), pools(2, seed=1), torch.randn(2, 2))
    losses[name].backward()


def test_every_loss_is_there_when_there_is_what_it_needs():
    one = adversary()
    z = torch.randn(2, 2)
    assert set(one.losses(pools(4))[0]) == {"imitation"}
    assert set(one.losses(pools(4), labelled())[0]) == {"imitation", "L3"}
    alone, _ = one.losses(pools(4), None, pools(2, seed=1), z)
    assert set(alone) == {"imitation", "L1", "L2", "L4"}
    every, told = one.losses(pools(4), labelled(), pools(2, seed=1), z)
    assert set(every) == {"imitation", "L1", "L2", "L3", "L4"}
    assert set(told) == {"sigma", "width", "experts_recognised", "policy_recognised"}
    assert set(every) == set(LossWeights().by_loss()) - {"cohesion"}
    more, _ = adversary(cohesion=1.0).losses(pools(4))
    assert set(more) == {"imitation", "cohesion"}


@pytest.mark.parametrize("name", ["L1", "L2", "L3", "L4"])
def test_the_policy_stays_as_it_is_for_all_losses_of_the_paper(name):
    one = adversary()
    backward(one, name)
    assert not gradient(one._policy.mlp.parameters())
    assert gradient(one.model.encoder.learning()) > 0


def test_the_reward_learns_from_l1_alone():
    for name in ("L1", "L2", "L3", "L4", "imitation"):
        one = adversary()
        backward(one, name)
        learns = gradient(one.model.reward.parameters())
        assert (learns is not None and learns > 0) == (name == "L1")


@pytest.mark.parametrize("weight", [0.0, 1.0])
def test_imitation_teaches_the_policy_and_the_encoder_if_it_is_to(weight):
    one = adversary(imitate=weight)
    backward(one, "imitation")
    assert gradient(one._policy.mlp.parameters()) > 0
    assert (gradient(one.model.encoder.learning()) > 0) == (weight > 0)


def test_a_fixed_encoder_stays_as_it_is_while_the_rest_learns():
    torch.manual_seed(0)
    settings = replace(SETTINGS, supervision="self", latent=2)
    one = DiscriminatorLearner(CARD, settings, make_policy(CARD), "cpu")
    one.model.encoder.prepare(pools(8, seed=3))
    before = {name: value.clone() for name, value in one.model.state_dict().items()}
    for _ in range(2):
        row = one.learn(pools(4), None, pools(2, seed=1), torch.randn(2, 2))
    assert set(row) > {"L1", "L2", "L4", "imitation"}
    for name, value in one.model.state_dict().items():
        stays = name.startswith("encoder.")
        assert torch.equal(value, before[name]) == stays, name


def test_a_discriminator_learns_to_tell_the_policy_from_the_experts():
    one = adversary()
    experts, driven, z = pools(4), pools(2, seed=1), torch.randn(2, 2)
    # The policy drives with one action alone, which experts take a fifth of the time.
    driven = driven._replace(actions=torch.full_like(driven.actions, 2))
    first = one.learn(experts, None, driven, z)
    for _ in range(150):
        last = one.learn(experts, None, driven, z)
    assert last["L1"] < first["L1"]
    assert last["experts_recognised"] > 0.7
    assert last["policy_recognised"] > 0.7


def test_labels_pull_drivers_apart():
    one = adversary()
    for _ in range(100):
        row = one.learn(pools(4), labelled())
    batch = pools(6, seed=8)
    with torch.no_grad():
        z = one.encode(batch).mean
    assert row["L3"] < 1.0
    assert torch.isfinite(z).all()


def test_rewards_are_f_of_every_step_but_the_last():
    one = adversary()
    driven, z = pools(2, seed=1), torch.randn(2, 2)
    rewards = one.rewards(driven, z)
    assert rewards.shape == (2, 2, 5)
    steps = transitions(driven)
    with torch.no_grad():
        f = one.model.reward(steps.before, steps.actions, steps.after, z[steps.pool])
    torch.testing.assert_close(rewards.flatten(), f)


def test_log_pi_is_of_the_action_that_was_taken():
    one = adversary()
    driven, z = pools(2, seed=1), torch.randn(2, 2)
    _, log_pi = one._judge(driven, z)
    steps = transitions(driven)
    with torch.no_grad():
        every = log_policy(one._policy, steps.before, z[steps.pool])
    expected = every[torch.arange(len(every)), steps.actions]
    torch.testing.assert_close(log_pi, expected)


def test_it_goes_on_from_what_it_kept():
    one, other = adversary(), adversary()
    for _ in range(3):
        one.learn(pools(4), labelled(), pools(2, seed=1), torch.ones(2, 2))
    kept = {name: value.clone() for name, value in one.tensors().items()}
    other.load(kept)
    other._policy.load_state_dict(one._policy.state_dict())
    for each in (one, other):
        torch.manual_seed(7)
        each.learn(pools(4), labelled(), pools(2, seed=1), torch.ones(2, 2))
    for name, value in one.tensors().items():
        torch.testing.assert_close(value, other.tensors()[name], rtol=0, atol=0)


def test_weights_of_another_model_are_refused():
    other = DiscriminatorLearner(
        replace(CARD, encoder=replace(SMALL, span=2)), SETTINGS, make_policy(CARD), "cpu"
    )
    with pytest.raises(RuntimeError, match="size mismatch"):
        adversary().load(other.tensors())


def test_the_reward_that_is_kept_is_an_average_over_rounds(monkeypatch):
    monkeypatch.setattr(discriminator, "AVERAGED", 3)
    one = adversary()

    def first(reward):
        return next(reward.parameters()).detach().clone()

    seen = []
    for number in range(5):
        one.learn(pools(4, seed=number), labelled(), pools(2, seed=1), torch.randn(2, 2))
        one.average()
        seen.append(first(one.model.reward))
        expected = torch.stack(seen[:3]).mean(dim=0)  # equally at first, then exponentially
        for present in seen[3:]:
            expected = (2 * expected + present) / 3
        torch.testing.assert_close(first(one.averaged), expected)
    assert not torch.equal(first(one.averaged), seen[-1])


def test_the_average_goes_on_after_an_interruption():
    one, other = adversary(), adversary()
    for number in range(2):
        one.average()
        one.learn(pools(4, seed=number), labelled(), pools(2, seed=1), torch.randn(2, 2))
    other.load({name: value.clone() for name, value in one.tensors().items()})
    for each in (one, other):
        each.average()
    before = one.averaged.state_dict()
    assert before.keys() == other.averaged.state_dict().keys()
    for name, value in other.averaged.state_dict().items():
        torch.testing.assert_close(value, before[name])


def test_information_is_the_log_density_of_z_under_q():
    one, driven, z = adversary(), pools(4), torch.randn(4, 2)
    with torch.no_grad():
        one.model.width.copy_(torch.tensor([0.4, -0.7]))
        mean, width = one.encode(driven).mean, one.model.width
    expected = torch.distributions.Normal(mean, (0.5 * width).exp()).log_prob(z).sum(dim=1)
    torch.testing.assert_close(one.information(driven, z), expected)
