import math

import pytest
import torch

from hmi_marl.training.ppo.gru import GRU


def random_gru(inputs, units, seed):
    torch.manual_seed(seed)
    module = torch.nn.GRU(inputs, units)
    for weight in module.parameters():
        torch.nn.init.normal_(weight, std=0.8)
    return module


def sigmoid(x):
    return 1.0 / (1.0 + math.exp(-x))


@torch.no_grad()
def test_a_step_by_hand():
    module = torch.nn.GRU(1, 1)
    values = [0.5, -1.0, 2.0], [0.25, 0.75, -0.5], [0.1, 0.2, -0.3], [0.0, -0.4, 0.6]
    for weight, its in zip(module.parameters(), values, strict=True):
        weight.copy_(torch.tensor(its).view_as(weight))
    x, h = 0.3, -0.2
    reset = sigmoid(0.5 * x + 0.1 + 0.25 * h)
    update = sigmoid(-1.0 * x + 0.2 + 0.75 * h - 0.4)
    new = math.tanh(2.0 * x - 0.3 + reset * (-0.5 * h + 0.6))
    after = (1 - update) * new + update * h
    found = GRU(module).step(torch.tensor([[x]]), torch.tensor([[h]]))
    assert found.item() == pytest.approx(after, abs=1e-6)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("sizes", [None, (1, 1, 1, 1), (1, 4, 3, 5), (9, 1, 2, 4)])
def test_passes_are_those_of_autograd(sizes, seed):
    draw = torch.Generator().manual_seed(seed)
    steps, teams, columns, units = sizes or (
        int(torch.randint(1, most, (), generator=draw)) for most in (30, 9, 7, 12)
    )
    module = random_gru(columns, units, seed)
    gru = GRU(module)
    inputs = torch.randn(steps, teams, columns, generator=draw)
    carried = (torch.rand(steps, teams, generator=draw) < 0.9).float()
    carried[0] = 0.0
    factors = torch.randn(steps, teams, units, generator=draw)

    state, states = torch.zeros(1, teams, units), []
    for x, carry in zip(inputs, carried, strict=True):
        _, state = module(x[None], state * carry[None, :, None])
        states.append(state[0])
    known = torch.stack(states)
    expected = torch.autograd.grad((known * factors).sum(), list(module.parameters()))

    before = [weight.clone() for weight in module.parameters()]
    with torch.no_grad():
        hidden, passed = gru.forward(inputs, carried)
        torch.testing.assert_close(hidden, known)
        found = [torch.full_like(weight, torch.nan) for weight in module.parameters()]
        gru.backward(passed, factors, found)
    for one, other in zip(found, expected, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-5)
    assert all(map(torch.equal, before, module.parameters()))


@torch.no_grad()
def test_steps_one_by_one_are_the_forward_pass():
    gru = GRU(random_gru(5, 8, 1))
    inputs = torch.randn(20, 4, 5, generator=torch.Generator().manual_seed(2))
    carried = torch.ones(20, 4)
    carried[0], carried[7, 1], carried[13] = 0.0, 0.0, 0.0
    hidden, _ = gru.forward(inputs, carried)
    memory = None
    for x, carry, known in zip(inputs, carried, hidden, strict=True):
        memory = gru.step(x, None if memory is None else memory * carry[:, None])
        torch.testing.assert_close(memory, known)


@torch.no_grad()
def test_an_episode_does_not_know_the_one_before():
    gru = GRU(random_gru(5, 8, 3))
    draw = torch.Generator().manual_seed(4)
    before, after = (torch.randn(6, 2, 5, generator=draw) for _ in range(2))
    carried = torch.ones(12, 2)
    carried[0], carried[6] = 0.0, 0.0
    both, _ = gru.forward(torch.cat([before, after]), carried)
    alone, _ = gru.forward(after, carried[6:])
    torch.testing.assert_close(both[6:], alone)
