import itertools
import math

import pytest
import torch
from torch.distributions import Categorical
from torch.distributions.kl import kl_divergence

from hmi_marl.training.ppo.heads import IntentThenAlert, OneAction

PAIRS = torch.tensor(list(itertools.product(range(5), range(2))), dtype=torch.float32)
LOGITS = torch.tensor([[0.0, math.log(2.0), 0.0, 0.0, math.log(3.0)]])


def one_action(logits):
    head = OneAction(1, logits.shape[-1])
    head.update(logits)
    return head


def both(logits):
    head = IntentThenAlert(2)
    head.update(logits)
    return head


def drawn(*shape, seed=0, dtype=torch.float64):
    return 2 * torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=dtype)


def table(logits):
    """Probabilities of all ten pairs, shape (..., 10) in the order of ``PAIRS``."""
    intent = torch.softmax(logits[..., :5], -1)
    alert = torch.softmax(logits[..., 5:].unflatten(-1, (5, 2)), -1)
    return (intent.unsqueeze(-1) * alert).flatten(-2)


def test_one_action_by_hand():
    head = one_action(LOGITS)  # 1/8, 1/4, 1/8, 1/8, 3/8
    assert head.input_dim == 5
    torch.testing.assert_close(head.mean, torch.tensor([[1, 2, 1, 1, 3]]) / 8)
    torch.testing.assert_close(
        head.log_prob(torch.tensor([[4.0]])), torch.tensor([math.log(3 / 8)])
    )
    entropy = 3 / 8 * math.log(8) + 1 / 4 * math.log(4) - 3 / 8 * math.log(3 / 8)
    torch.testing.assert_close(head.entropy, torch.tensor([entropy]))
    torch.testing.assert_close(head.std[0, 4], torch.tensor(15 / 64).sqrt())
    assert head.deterministic_output(LOGITS).tolist() == [[4.0]]


def test_one_action_is_torchs_categorical():
    logits, others = drawn(7, 3, 5), drawn(7, 3, 5, seed=1)
    head, known = one_action(logits), Categorical(logits=logits)
    for action in range(5):
        chosen = torch.full((7, 3, 1), float(action), dtype=torch.float64)
        torch.testing.assert_close(head.log_prob(chosen), known.log_prob(chosen[..., 0]))
    torch.testing.assert_close(head.entropy, known.entropy())
    new = one_action(others)
    torch.testing.assert_close(
        head.kl_divergence(head.params, new.params),
        kl_divergence(known, Categorical(logits=others)),
    )
    assert head.kl_divergence(head.params, head.params).abs().max() == 0


def test_intent_then_alert_equals_the_sum_over_all_ten_pairs():
    logits, others = drawn(6, 15), drawn(6, 15, seed=1)
    head, old, new = both(logits), table(logits), table(others)
    log_probs = torch.stack([head.log_prob(pair.expand(6, 2)) for pair in PAIRS], dim=-1)
    torch.testing.assert_close(log_probs, old.log())
    torch.testing.assert_close(log_probs.exp().sum(-1), torch.ones(6, dtype=torch.float64))
    torch.testing.assert_close(head.entropy, -(old * old.log()).sum(-1))
    torch.testing.assert_close(
        head.kl_divergence(head.params, both(others).params), (old * (old / new).log()).sum(-1)
    )
    assert head.kl_divergence(head.params, head.params).abs().max() == 0


def test_the_parameters_of_the_pair_are_its_two_tables():
    logits = drawn(6, 15)
    intent, alert = both(logits).params
    assert (intent.shape, alert.shape) == ((6, 5), (6, 5, 2))
    torch.testing.assert_close((intent.unsqueeze(-1) + alert).exp().flatten(-2), table(logits))
    head = both(logits)
    assert head.input_dim == head.mean.shape[-1] == 15
    torch.testing.assert_close(head.std**2, head.mean * (1 - head.mean))


@pytest.mark.parametrize("shape", [(7,), (3, 4)])
@pytest.mark.parametrize("alerts", [None, 2, 4])
def test_written_gradients_are_those_of_autograd(alerts, shape):
    outputs = 5 if alerts is None else 5 + 5 * alerts
    head = OneAction(1, 5) if alerts is None else IntentThenAlert(2, alerts)
    logits = drawn(*shape, outputs, seed=3).requires_grad_()
    factors = drawn(*shape, seed=4)
    generator = torch.Generator().manual_seed(5)
    sizes = (5,) if alerts is None else (5, alerts)
    actions = torch.stack(
        [torch.randint(size, shape, generator=generator) for size in sizes], dim=-1
    ).double()
    head.update(logits)
    objective = (factors * head.log_prob(actions)).sum() + 0.7 * head.entropy.sum()
    (known,) = torch.autograd.grad(objective, logits)
    with torch.no_grad():
        head.update(logits)
        written = head.gradient(actions, factors, 0.7)
    torch.testing.assert_close(written, known)


@pytest.mark.parametrize("make", [one_action, both])
def test_the_divergence_of_a_h_and_its_gradient_are_those_of_autograd(make):
    logits = drawn(7, 3, 5 if make is one_action else 15, seed=6).requires_grad_()
    others = Categorical(logits=drawn(7, 3, 5, seed=7))
    known = kl_divergence(Categorical(logits=logits[..., :5]), others)
    factors = drawn(7, 3, seed=8)
    (gradient,) = torch.autograd.grad((factors * known).sum(), logits)
    found, of_intent = make(logits.detach()).first.divergence(others.logits)
    torch.testing.assert_close(found, known)
    torch.testing.assert_close(of_intent * factors.unsqueeze(-1), gradient[..., :5])
    assert gradient[..., 5:].abs().sum() == 0  # the vehicle AI's half is not held


def test_the_divergence_by_hand():
    head = one_action(LOGITS)  # 1/8, 1/4, 1/8, 1/8, 3/8
    even = torch.full((1, 5), math.log(1 / 5))
    found, gradient = head.first.divergence(even)
    expected = math.log(5) - float(head.entropy)
    assert float(found) == pytest.approx(expected, rel=1e-5)
    assert float(gradient[0, 4]) == pytest.approx(3 / 8 * (math.log(15 / 8) - expected), rel=1e-5)
    assert head.first.divergence(head.first.log_probs)[0].item() == 0


@pytest.mark.parametrize("make", [one_action, both])
def test_draws_come_as_often_as_they_are_likely(make):
    torch.manual_seed(3)
    count = 40_000
    logits = LOGITS[0] if make is one_action else drawn(15, dtype=torch.float32)
    actions = make(logits.expand(count, -1)).sample()
    assert actions.dtype == torch.float32
    if make is one_action:
        assert actions.shape == (count, 1)
        place, expected = actions[:, 0], torch.softmax(logits, -1)
    else:
        assert actions.shape == (count, 2)
        place, expected = 2 * actions[:, 0] + actions[:, 1], table(logits)
    seen = torch.bincount(place.long(), minlength=len(expected)) / count
    tolerance = 4 * (expected * (1 - expected) / count).sqrt()  # one run in 1600 for ten of them
    assert ((seen - expected).abs() < tolerance).all()


def test_every_row_draws_from_its_own_table():
    certain = torch.full((5, 5), -50.0).fill_diagonal_(50.0)
    assert one_action(certain).sample()[:, 0].tolist() == [0, 1, 2, 3, 4]
    alerts = torch.full((5, 5, 2), -50.0)
    for intent in range(5):
        alerts[:, intent, intent % 2] = 50.0
    pairs = both(torch.cat([certain, alerts.flatten(-2)], dim=-1)).sample()
    assert pairs.tolist() == [[0, 0], [1, 1], [2, 0], [3, 1], [4, 0]]


def test_leading_dimensions_are_kept_as_a_recurrent_batch_has_them():
    head = both(drawn(3, 4, 15, dtype=torch.float32))
    actions = head.sample()
    assert actions.shape == (3, 4, 2)
    assert head.log_prob(actions).shape == head.entropy.shape == (3, 4)
    assert head.kl_divergence(head.params, head.params).shape == (3, 4)


def test_greedy_takes_the_likeliest_intent_and_the_likeliest_alert_given_it():
    # The likeliest pair would be (0, 1), but the driver decides first.
    intent = torch.tensor([0.40, 0.45, 0.05, 0.05, 0.05]).log()
    alert = torch.tensor([[0.0, 1.0], [0.6, 0.4], [0.5, 0.5], [0.5, 0.5], [0.5, 0.5]])
    logits = torch.cat([intent, (alert + 1e-9).log().flatten()])
    assert both(logits).deterministic_output(logits).tolist() == [1.0, 0.0]


def test_gradients_are_those_of_the_table():
    logits = drawn(6, 15).requires_grad_()
    pairs = PAIRS[[0, 3, 4, 7, 9, 5]].double()
    (ours,) = torch.autograd.grad(both(logits).log_prob(pairs).sum(), logits)
    place = (2 * pairs[:, :1] + pairs[:, 1:]).long()
    (known,) = torch.autograd.grad(table(logits).log().gather(-1, place).sum(), logits)
    torch.testing.assert_close(ours, known)
    (ours,) = torch.autograd.grad(both(logits).entropy.sum(), logits)
    probs = table(logits)
    (known,) = torch.autograd.grad(-(probs * probs.log()).sum(), logits)
    torch.testing.assert_close(ours, known)
    # only the row of the a^H that was drawn learns from the alert
    (row,) = torch.autograd.grad(both(logits).log_prob(pairs)[1], logits)
    learns = row[1, 5:].unflatten(-1, (5, 2)).abs().sum(-1) > 0
    assert learns.tolist() == [False, True, False, False, False]


@pytest.mark.parametrize("make", [one_action, both])
def test_certainty_gives_no_nan(make):
    logits = torch.full((1, 15), -500.0)
    logits[0, ::2] = 500.0
    logits = (logits[:, :5] if make is one_action else logits).requires_grad_()
    head = make(logits)
    columns = 1 if make is one_action else 2
    total = head.log_prob(torch.zeros(1, columns)) + head.entropy
    total = total + head.kl_divergence(head.params, head.params)
    assert total.isfinite().all()
    assert torch.autograd.grad(total.sum(), logits)[0].isfinite().all()
    assert head.std.isfinite().all()


def test_the_pair_with_three_strengths_equals_the_sum_over_all_twenty_pairs():
    logits, others = drawn(6, 25), drawn(6, 25, seed=1)
    head, other = IntentThenAlert(2, alerts=4), IntentThenAlert(2, alerts=4)
    assert head.input_dim == 25
    head.update(logits)
    other.update(others)
    old, new = (
        (
            torch.softmax(x[..., :5], -1).unsqueeze(-1)
            * torch.softmax(x[..., 5:].unflatten(-1, (5, 4)), -1)
        ).flatten(-2)
        for x in (logits, others)
    )
    pairs = torch.tensor(list(itertools.product(range(5), range(4))), dtype=torch.float32)
    log_probs = torch.stack([head.log_prob(pair.expand(6, 2)) for pair in pairs], dim=-1)
    torch.testing.assert_close(log_probs, old.log())
    torch.testing.assert_close(head.entropy, -(old * old.log()).sum(-1))
    torch.testing.assert_close(
        head.kl_divergence(head.params, other.params), (old * (old / new).log()).sum(-1)
    )
    certain = torch.full((5, 25), -50.0)
    for row in range(5):
        certain[row, row] = certain[row, 5 + 4 * row + row % 4] = 50.0
    head.update(certain)
    assert head.sample().tolist() == [[row, row % 4] for row in range(5)]
    assert head.deterministic_output(certain).tolist() == head.sample().tolist()


@pytest.mark.filterwarnings("ignore:.torch.jit.script. is deprecated:DeprecationWarning")
@pytest.mark.parametrize("alerts", [2, 4])
def test_greedy_output_as_a_module_is_the_same_and_can_be_scripted(alerts):
    for head, columns in (
        (OneAction(1, 5), 5),
        (IntentThenAlert(2, alerts), 5 + 5 * alerts),
    ):
        logits = drawn(3, 6, columns, dtype=torch.float32)
        expected = head.deterministic_output(logits)
        module = head.as_deterministic_output_module()
        assert not list(module.parameters())
        torch.testing.assert_close(module(logits), expected, rtol=0, atol=0)
        torch.testing.assert_close(torch.jit.script(module)(logits), expected, rtol=0, atol=0)


def test_the_greedy_alert_is_that_of_the_greedy_intent():
    logits = drawn(50, 5 + 5 * 3, dtype=torch.float32)
    pairs = IntentThenAlert(2, 3).deterministic_output(logits)
    for row, (intent, alert) in zip(logits, pairs.long().tolist(), strict=True):
        assert intent == int(row[:5].argmax())
        assert alert == int(row[5 + 3 * intent : 8 + 3 * intent].argmax())
