"""Adversarial IRL by our losses on problems so small that everything but the losses is exact.

States are the cells of a ring, actions to go back, stay and go on. The expert is soft-optimal for a
known reward; the generator is soft-optimal for the present f, solved anew in every round. Batches
hold each transition as often as its occupancy says, so nothing is drawn.
"""

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.agents.learned.trait_model import TraitCard
from hmi_marl.training.traits.losses import adversarial_loss
from hmi_marl.training.traits.model import Reward

Array = NDArray[np.float64]
STATES, ACTIONS, GAMMA = 6, 3, 0.9
TRUTH = np.array([2.0, -0.5, 0.3, -1.0, 0.5, 0.0])
"""The reward of being in a state, whatever is done there."""
ROUNDS, COPIES = 500, 20_000


def ring(wall: bool = False, slip: float = 0.0) -> Array:
    """p(s' | s, a), shape (S, A, S); the wall stands between the last cell and the first."""
    dynamics = np.zeros((STATES, ACTIONS, STATES))
    for s in range(STATES):
        for a in range(ACTIONS):
            to = (s + a - 1) % STATES
            if wall and {s, to} == {0, STATES - 1}:
                to = s
            dynamics[s, a, to] += 1 - slip
            dynamics[s, a, s] += slip
    return dynamics


def by_action(reward: Array) -> Array:
    """r(s) as r(s, a)."""
    return np.repeat(reward[..., None], ACTIONS, axis=-1)


def soft_optimal(reward: Array, dynamics: Array, sweeps: int = 300) -> Array:
    """log π of the maximum-entropy policy for rewards (..., S, A), by soft value iteration."""
    value = np.zeros(reward.shape[:-1])
    for _ in range(sweeps):
        q = reward + GAMMA * np.einsum("sat,...t->...sa", dynamics, value)
        most = q.max(axis=-1)
        value = most + np.log(np.exp(q - most[..., None]).sum(axis=-1))
    return q - value[..., None]


def value_of(reward: Array, log_policy: Array, dynamics: Array) -> Array:
    """V with the policy's entropy in it, by a linear system."""
    policy = np.exp(log_policy)
    onward = np.einsum("sa,sat->st", policy, dynamics)
    return np.linalg.solve(
        np.eye(STATES) - GAMMA * onward, reward - (policy * log_policy).sum(axis=1)
    )


def occupancy(log_policy: Array, dynamics: Array) -> Array:
    """Discounted share of every (s, a, s'), from all states alike: shape (..., S, A, S)."""
    joint = np.exp(log_policy)[..., None] * dynamics
    onward = np.eye(STATES) - GAMMA * np.swapaxes(joint.sum(axis=-2), -1, -2)
    start = np.full((*onward.shape[:-1], 1), (1 - GAMMA) / STATES)
    return np.linalg.solve(onward, start)[..., None] * joint


def learn(
    f: Callable[[], torch.Tensor],
    parameters: list[torch.Tensor],
    expert: Array,
    dynamics: Array,
    rate: float = 0.3,
    rounds: int = ROUNDS,
) -> tuple[Array, float]:
    """Train f of shape (..., S, A, S) against experts log π_E (..., S, A).

    Returns:
        log π of the generator at the end, and the loss.
    """

    def batch(log_policy: Array) -> torch.Tensor:
        share = occupancy(log_policy, dynamics)
        copies = np.rint(share * COPIES).astype(np.int64).ravel()
        return torch.from_numpy(np.repeat(np.arange(share.size), copies))

    shape = (*expert.shape, STATES)
    from_experts = batch(expert)
    optimizer = torch.optim.Adam(parameters, rate, betas=(0.5, 0.99))
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, rounds)
    for _ in range(rounds):
        now = f()
        policy = soft_optimal((now.detach().numpy() * dynamics).sum(axis=-1), dynamics, sweeps=80)
        from_policy = batch(policy)
        log_policy = torch.from_numpy(np.broadcast_to(policy[..., None], shape).copy()).ravel()
        every = now.ravel()
        loss = adversarial_loss(
            every[from_experts],
            log_policy[from_experts],
            every[from_policy],
            log_policy[from_policy],
        )
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    return policy, loss.item()


def table(*shape: int) -> torch.Tensor:
    return torch.zeros(shape, dtype=torch.float64, requires_grad=True)


def shaped(base: torch.Tensor, potential: torch.Tensor) -> Callable[[], torch.Tensor]:
    """f = g + γ h(s') − h(s) of shape (..., S, A, S) from g (..., S, A or 1) and h (..., S)."""
    shape = (*potential.shape[:-1], STATES, ACTIONS, STATES)

    def f() -> torch.Tensor:
        later, before = potential[..., None, None, :], potential[..., :, None, None]
        return (base[..., None] + GAMMA * later - before).expand(shape)

    return f


def centred(values: Array) -> Array:
    return values - values.mean(axis=-1, keepdims=True)


@pytest.mark.parametrize("slip", [pytest.param(0.0, marks=pytest.mark.slow), 0.2])
def test_a_free_f_becomes_the_experts_log_policy(slip: float) -> None:
    dynamics = ring(slip=slip)
    expert = soft_optimal(by_action(TRUTH), dynamics)
    f = table(STATES, ACTIONS, 1)
    policy, loss = learn(lambda: f.expand(-1, -1, STATES), [f], expert, dynamics)
    np.testing.assert_allclose(policy, expert, atol=0.02)
    np.testing.assert_allclose(f.detach().numpy()[..., 0], expert, atol=0.02)
    assert loss == pytest.approx(2 * math.log(2), abs=1e-4)


def test_a_reward_of_states_alone_is_recovered_and_survives_a_wall() -> None:
    # Steps are certain, and from every cell three neighbours can be reached, which links all
    # cells: AIRL's condition under which f tells g and h apart, each up to a constant.
    open_road, walled = ring(), ring(wall=True)
    expert = soft_optimal(by_action(TRUTH), open_road)
    base, potential = table(STATES, 1), table(STATES)
    learn(shaped(base, potential), [base, potential], expert, open_road)
    reward = base.detach().numpy()[:, 0]
    assert np.corrcoef(reward, TRUTH)[0, 1] > 0.999
    np.testing.assert_allclose(centred(reward), centred(TRUTH), atol=0.03)
    value = value_of(TRUTH, expert, open_road)
    np.testing.assert_allclose(centred(potential.detach().numpy()), centred(value), atol=0.03)

    found = soft_optimal(by_action(reward), walled)
    np.testing.assert_allclose(found, soft_optimal(by_action(TRUTH), walled), atol=0.03)


def test_a_reward_of_actions_too_explains_the_experts_but_does_not_survive_a_wall() -> None:
    open_road, walled = ring(), ring(wall=True)
    expert = soft_optimal(by_action(TRUTH), open_road)
    base, potential = table(STATES, ACTIONS), table(STATES)
    policy, _ = learn(shaped(base, potential), [base, potential], expert, open_road)
    np.testing.assert_allclose(policy, expert, atol=0.05)
    found = soft_optimal(base.detach().numpy(), walled)
    best = soft_optimal(by_action(TRUTH), walled)
    assert best[-1].argmax() == 0  # back, the long way round
    assert found[-1].argmax() == 2  # on, into the wall
    assert np.abs(np.exp(found) - np.exp(best)).max() > 0.3


def test_opposite_experts_are_told_apart_by_z() -> None:
    dynamics = ring()
    truth = np.stack([-TRUTH, TRUTH])
    expert = soft_optimal(by_action(truth), dynamics)
    base, potential = table(2, STATES, 1), table(2, STATES)
    policy, _ = learn(shaped(base, potential), [base, potential], expert, dynamics)
    np.testing.assert_allclose(policy, expert, atol=0.05)
    for found, wanted in zip(base.detach().numpy()[..., 0], truth, strict=True):
        assert np.corrcoef(found, wanted)[0, 1] > 0.99
        np.testing.assert_allclose(centred(found), centred(wanted), atol=0.05)


def test_our_network_f_given_z_recovers_both_of_two_opposite_experts() -> None:
    card = TraitCard(
        (("cell", STATES),),
        latent=1,
        gamma=GAMMA,
        reward=NetworkConfig((32,), "tanh"),
        potential=NetworkConfig((32,), "tanh"),
    )
    dynamics = ring()
    expert = soft_optimal(by_action(np.stack([-TRUTH, TRUTH])), dynamics)
    torch.manual_seed(0)
    network = Reward(card).double()
    there = torch.from_numpy(np.stack([dynamics, dynamics]) > 0)
    which, before, action, after = there.nonzero(as_tuple=True)
    cells = torch.eye(STATES, card.situation_size, dtype=torch.float64)
    z = torch.tensor([[-1.0], [1.0]], dtype=torch.float64)

    def f() -> torch.Tensor:
        values = network(cells[before], action, cells[after], z[which])
        return torch.zeros(there.shape, dtype=torch.float64).index_put(
            (which, before, action, after), values
        )

    policy, loss = learn(f, list(network.parameters()), expert, dynamics, 0.02)
    np.testing.assert_allclose(np.exp(policy), np.exp(expert), atol=0.03)
    found = (f().detach().numpy() * dynamics).sum(axis=-1)
    np.testing.assert_allclose(np.exp(found), np.exp(expert), atol=0.03)
    assert loss == pytest.approx(2 * math.log(2), abs=1e-3)
