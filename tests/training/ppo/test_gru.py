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


@pytest.mark.parametrize("seed", range(6))
def test_passes_are_those_of_autograd(seed):
    draw = torch.Generator().manual_seed(seed)
    steps, teams, columns, units = (
        int(torch.randint(1, most, (), generator=draw)) for most in (30, 9, 7, 12)
    )
    module = random_gru(columns, units, seed)
    gru = GRU(module)
    inputs = torch.randn(steps, teams, columns, generator=draw)
    kept = (torch.rand(steps, teams, generator=draw) < 0.9).float()
    kept[0] = 0.0
    factors = torch.randn(steps, teams, units, generator=draw)

    state, states = torch.zeros(1, teams, units), []
    for x, keep in zip(inputs, kept, strict=True):
        _, state = module(x[None], state * keep[None, :, None])
        states.append(state[0])
    known = torch.stack(states)
    expected = torch.autograd.grad((known * factors).sum(), list(module.parameters()))

    with torch.no_grad():
        hidden, passed = gru.forward(inputs, kept)
        torch.testing.assert_close(hidden, known)
        found = [torch.full_like(weight, torch.nan) for weight in module.parameters()]
        gru.backward(passed, factors, found)
    for one, other in zip(found, expected, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-5)


@torch.no_grad()
def test_steps_one_by_one_are_the_forward_pass():
    gru = GRU(random_gru(5, 8, 1))
    inputs = torch.randn(20, 4, 5, generator=torch.Generator().manual_seed(2))
    kept = torch.ones(20, 4)
    kept[0], kept[7, 1], kept[13] = 0.0, 0.0, 0.0
    hidden, _ = gru.forward(inputs, kept)
    memory = None
    for x, keep, known in zip(inputs, kept, hidden, strict=True):
        memory = gru.step(x, None if memory is None else memory * keep[:, None])
        torch.testing.assert_close(memory, known)


@torch.no_grad()
def test_an_episode_does_not_know_the_one_before():
    gru = GRU(random_gru(5, 8, 3))
    draw = torch.Generator().manual_seed(4)
    before, after = (torch.randn(6, 2, 5, generator=draw) for _ in range(2))
    kept = torch.ones(12, 2)
    kept[0], kept[6] = 0.0, 0.0
    both, _ = gru.forward(torch.cat([before, after]), kept)
    alone, _ = gru.forward(after, kept[6:])
    torch.testing.assert_close(both[6:], alone)
