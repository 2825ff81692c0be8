import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch.distributions import Normal, kl_divergence

from hmi_marl.training.traits.losses import (
    adversarial_loss,
    cohesion_loss,
    contrastive_loss,
    information_loss,
    log_discriminator,
    regularisation_loss,
    same_driver_loss,
)

moderate = st.floats(-5, 5)
seeds = st.integers(0, 2**32 - 1)
POINTS = torch.tensor([[0.0, 0.0], [3.0, 4.0], [0.0, 1.0]])
"""5, 1 and sqrt(9 + 9) = 4.2426 apart: 0 from 1, 0 from 2, 1 from 2."""


def near(value: float, tolerance: float = 1e-6) -> object:
    return pytest.approx(value, abs=tolerance)


def random(seed: int, *shape: int) -> torch.Tensor:
    return torch.from_numpy(np.random.default_rng(seed).standard_normal(shape))


# L1.


def test_the_discriminator_by_hand() -> None:
    # e^f = 3 against π = 1: D = 3 / 4. e^f = 1/4 against π = 1/2: D = 1 / 3.
    reward, policy = torch.tensor([3.0, 0.25]).log(), torch.tensor([1.0, 0.5]).log()
    expected = torch.tensor([3 / 4, 1 / 3]).log()
    torch.testing.assert_close(log_discriminator(reward, policy), expected)


def test_the_discriminator_is_finite_where_one_side_is_nothing() -> None:
    reward, policy = torch.tensor([0.0, -1000.0]), torch.tensor([-1000.0, 0.0])
    assert log_discriminator(reward, policy).tolist() == [0.0, -1000.0]


def test_l1_by_hand() -> None:
    # Experts: D = 3/4 and 1/3, so -log D is log(4/3) and log 3, the mean 1/2 log 4 = log 2.
    # Policy: e^f = 3 against 1, e^f = 1 against 1 and 1 against 1/3: D = 3/4, 1/2, 3/4, and
    # -log(1 - D) is log 4, log 2 and log 4, the mean 5/3 log 2.
    loss = adversarial_loss(
        torch.tensor([3.0, 0.25]).log(),
        torch.tensor([1.0, 0.5]).log(),
        torch.tensor([3.0, 1.0, 1.0]).log(),
        torch.tensor([1.0, 1.0, 1 / 3]).log(),
    )
    assert loss.shape == ()
    assert loss.item() == near(8 / 3 * math.log(2))


@given(seeds)
def test_l1_is_the_cross_entropy_of_the_discriminator(seed: int) -> None:
    f_e, f_p = random(seed, 6), random(seed + 1, 4)
    log_pi_e, log_pi_p = -random(seed + 2, 6).abs(), -random(seed + 3, 4).abs()
    of_experts = log_discriminator(f_e, log_pi_e)
    of_policy = torch.log1p(-log_discriminator(f_p, log_pi_p).exp())
    expected = -of_experts.mean() - of_policy.mean()
    torch.testing.assert_close(adversarial_loss(f_e, log_pi_e, f_p, log_pi_p), expected)


@given(st.lists(st.floats(0.01, 1.0), min_size=1, max_size=6))
def test_at_the_optimum_nobody_can_be_told(shares: list[float]) -> None:
    # Batches that hold the same transitions, and f = log π_E = log π: D = 1/2 on each, the loss is
    # 2 log 2, and no f changes it at first order.
    log_policy = torch.tensor(shares, dtype=torch.float64).log()
    reward = log_policy.clone().requires_grad_()
    torch.testing.assert_close(
        log_discriminator(reward, log_policy).exp(), torch.full_like(log_policy, 0.5)
    )
    loss = adversarial_loss(reward, log_policy, reward, log_policy)
    loss.backward()
    assert loss.item() == near(2 * math.log(2))
    assert reward.grad is not None
    torch.testing.assert_close(reward.grad, torch.zeros_like(reward), atol=1e-12, rtol=0)


def test_the_gradient_of_l1_asks_for_more_where_experts_are_oftener() -> None:
    # With D = 1/2 throughout the slope in f is 1/2 (share of the policy - share of the experts):
    # (1/4 - 3/4) / 2 and (3/4 - 1/4) / 2.
    reward = torch.zeros(2, requires_grad=True)
    experts, policy = torch.tensor([0, 0, 0, 1]), torch.tensor([0, 1, 1, 1])
    adversarial_loss(reward[experts], torch.zeros(4), reward[policy], torch.zeros(4)).backward()
    assert reward.grad is not None
    assert reward.grad.tolist() == [-0.25, 0.25]


@given(st.lists(st.tuples(st.integers(1, 9), st.integers(1, 9)), min_size=1, max_size=5))
def test_at_its_best_l1_is_2_log_2_less_twice_jensen_shannon(counts: list[tuple[int, int]]) -> None:
    # p and q say how often k comes up among experts and among the policy's. The best D is p/(p+q),
    # so f = log π + log p/q; whatever π is, it drops out.
    copies = torch.tensor(counts)
    p, q = (copies / copies.sum(dim=0)).double().T
    log_policy = -random(0, len(counts)).abs()
    reward = log_policy + (p / q).log()
    of_experts, of_policy = (torch.arange(len(counts)).repeat_interleave(n) for n in copies.T)
    loss = adversarial_loss(
        reward[of_experts], log_policy[of_experts], reward[of_policy], log_policy[of_policy]
    )
    middle = (p + q) / 2
    divergence = 0.5 * (p * (p / middle).log() + q * (q / middle).log()).sum()
    assert loss.item() == near(2 * math.log(2) - 2 * divergence.item(), 1e-5)


# L2.


def test_l2_by_hand() -> None:
    # -log N(z; μ, σ²) = 1/2 [(z - μ)²/σ² + log σ² + log 2π], a sum over columns:
    # first:  (1 - 0)²/1 + 0 + log 2π  and  (2 - 2)²/4 + log 4 + log 2π:  1 + log 4 + 2 log 2π
    # second: (0 - 3)²/1 + 0 + log 2π  and  (1 - 3)²/4 + log 4 + log 2π: 10 + log 4 + 2 log 2π
    # half of each, then the mean: 11/4 + 1/2 log 4 + log 2π.
    loss = information_loss(
        torch.tensor([[1.0, 2.0], [0.0, 1.0]]),
        torch.tensor([[0.0, 2.0], [3.0, 3.0]]),
        torch.tensor([[1.0, 4.0], [1.0, 4.0]]).log(),
    )
    assert loss.item() == near(11 / 4 + math.log(2) + math.log(2 * math.pi))


@given(seeds, st.integers(1, 4), st.integers(1, 3))
def test_l2_is_the_cross_entropy_of_gaussians(seed: int, pools: int, latent: int) -> None:
    z, mean, log_variance = random(seed, 3, pools, latent)
    expected = -Normal(mean, (0.5 * log_variance).exp()).log_prob(z).sum(dim=1).mean()
    torch.testing.assert_close(information_loss(z, mean, log_variance), expected)


# L3.


def test_l3_brings_one_label_together() -> None:
    # Squared distances 25, 1 and 18: the mean of all ordered pairs is that of unordered ones.
    loss = contrastive_loss(POINTS, torch.tensor([7, 7, 7]), margin=2.0)
    assert loss.item() == near(44 / 3, 1e-5)


def test_l3_moves_labels_apart_up_to_the_margin() -> None:
    # Margin 2: 5 and 4.2426 apart are outside, 1 apart is inside by 1. Mean of 0, 1, 0.
    labels = torch.tensor([0, 1, 2])
    assert contrastive_loss(POINTS, labels, margin=2.0).item() == near(1 / 3)
    # Margin 6: (6 - 5)² + (6 - 1)² + (6 - sqrt 18)² = 1 + 25 + 54 - 12 sqrt 18.
    expected = (80 - 12 * math.sqrt(18)) / 3
    assert contrastive_loss(POINTS, labels, margin=6.0).item() == near(expected, 1e-5)
    # Exactly at the margin, and beyond it, there is nothing to gain.
    assert contrastive_loss(POINTS[:2], labels[:2], margin=5.0).item() == near(0.0)


def test_l3_of_some_alike_and_some_not() -> None:
    # 0 and 2 are alike: 1² = 1. 1 differs from both: (6 - 5)² = 1 and (6 - sqrt 18)².
    loss = contrastive_loss(POINTS, torch.tensor([1, 0, 1]), margin=6.0)
    assert loss.item() == near((2 + (6 - math.sqrt(18)) ** 2) / 3, 1e-5)


def test_l3_with_softened_labels() -> None:
    # Labels one s apart: w = exp(-1/2). Points 1 apart under a margin of 3: w 1² + (1 - w) 2².
    w = math.exp(-0.5)
    points, labels = POINTS[[0, 2]], torch.tensor([0.1, 0.3])
    loss = contrastive_loss(points, labels, margin=3.0, bandwidth=0.2)
    assert loss.item() == near(w + 4 * (1 - w))
    alike = contrastive_loss(points, torch.tensor([0.3, 0.3]), margin=3.0, bandwidth=0.2)
    assert alike.item() == near(1.0)
    apart = contrastive_loss(points, labels * 100, margin=3.0, bandwidth=0.2)
    assert apart.item() == near(4.0)


def test_graded_labels_are_equal_or_not_unless_softened() -> None:
    loss = contrastive_loss(POINTS[[0, 2]], torch.tensor([0.1, 0.1001]), margin=3.0)
    assert loss.item() == near(4.0)


@pytest.mark.parametrize("bandwidth", [0.0, 0.5])
@pytest.mark.parametrize("labels", [[0.0, 0.0], [0.0, 1.0]])
def test_l3_of_a_pair_in_one_point_has_a_finite_gradient(
    labels: list[float], bandwidth: float
) -> None:
    z = torch.ones(2, 2, requires_grad=True)
    loss = contrastive_loss(z, torch.tensor(labels), margin=2.0, bandwidth=bandwidth)
    loss.backward()
    w = (math.exp(-2) if bandwidth else 0.0) if labels[1] else 1.0  # (1 / 0.5)² / 2 = 2
    assert loss.item() == near(4 * (1 - w), 1e-4)
    assert z.grad is not None
    assert torch.isfinite(z.grad).all()


def test_l3_moves_vectors_as_it_says() -> None:
    # d/dz of (z_0 - z_1)² is 2 (z_0 - z_1) = -2; of (3 - |z_0 - z_1|)² it is
    # -2 (3 - 1) sign(z_0 - z_1) = 4: downhill is towards each other, and away.
    for labels, slope in ((torch.tensor([0, 0]), -2.0), (torch.tensor([0, 1]), 4.0)):
        z = torch.tensor([[0.0], [1.0]], requires_grad=True)
        contrastive_loss(z, labels, margin=3.0).backward()
        assert z.grad is not None
        assert z.grad.flatten().tolist() == pytest.approx([slope, -slope], abs=1e-5)


@pytest.mark.parametrize("count", [0, 1])
def test_l3_of_fewer_than_two_vectors_is_nothing(count: int) -> None:
    z = torch.ones(count, 2, requires_grad=True)
    loss = contrastive_loss(z, torch.zeros(count), margin=2.0)
    loss.backward()
    assert loss.item() == 0.0
    assert z.grad is not None
    assert not z.grad.any()


@given(seeds, st.permutations(range(5)), st.sampled_from([0.0, 0.7]))
def test_l3_is_the_mean_over_ordered_pairs(seed: int, order: list[int], bandwidth: float) -> None:
    z, labels = random(seed, 5, 2), torch.tensor([0.0, 0.0, 1.0, 1.0, 3.0])
    total = 0.0
    for k in range(5):
        for other in set(range(5)) - {k}:
            gap = float(labels[k] - labels[other])
            w = math.exp(-(gap**2) / (2 * bandwidth**2)) if bandwidth else float(gap == 0)
            distance = float((z[k] - z[other]).norm())
            total += w * distance**2 + (1 - w) * max(0.0, 1.5 - distance) ** 2
    for way in ([0, 1, 2, 3, 4], order):
        loss = contrastive_loss(z[way], labels[way], margin=1.5, bandwidth=bandwidth)
        assert loss.item() == near(total / 20)


def test_cohesion_by_hand() -> None:
    # (0 - 3)² + (0 - 4)² = 25 and (1 - 1)² + (2 - 0)² = 4: the mean is 14.5.
    first, second = torch.tensor([[0.0, 0.0], [1.0, 2.0]]), torch.tensor([[3.0, 4.0], [1.0, 0.0]])
    assert cohesion_loss(first, second).item() == near(14.5)
    assert cohesion_loss(first, first).item() == 0.0


# L4.


def test_l4_by_hand() -> None:
    assert regularisation_loss(torch.zeros(3, 2), torch.zeros(3, 2)).item() == 0.0
    # 1/2 (σ² + μ² - 1 - log σ²), a sum over columns:
    # first:  1/2 (1 + 4 - 1 - 0) + 1/2 (4 + 0 - 1 - log 4) = 2 + 3/2 - log 2
    # second: 0. The mean of both: 7/4 - 1/2 log 2.
    mean = torch.tensor([[2.0, 0.0], [0.0, 0.0]])
    log_variance = torch.tensor([[1.0, 4.0], [1.0, 1.0]]).log()
    assert regularisation_loss(mean, log_variance).item() == near(7 / 4 - 0.5 * math.log(2))


@given(st.lists(st.tuples(moderate, moderate), min_size=1, max_size=6))
def test_l4_is_the_divergence_from_the_unit_gaussian(columns: list[tuple[float, float]]) -> None:
    mean, log_variance = torch.tensor(columns, dtype=torch.float64).T[:, None]
    q, unit = Normal(mean, (0.5 * log_variance).exp()), Normal(0.0, 1.0)
    expected = kl_divergence(q, unit).sum(dim=1).mean()
    loss = regularisation_loss(mean, log_variance)
    torch.testing.assert_close(loss, expected, atol=1e-9, rtol=1e-9)
    assert loss.item() >= -1e-12


@pytest.mark.parametrize("copies", [2, 5])
def test_no_loss_grows_with_the_batch(copies: int) -> None:
    z, mean, log_variance = random(3, 3, 4, 2)
    f, log_pi = random(4, 2, 6)
    for loss, arguments in (
        (adversarial_loss, (f, log_pi, f[:3], log_pi[:3])),
        (information_loss, (z, mean, log_variance)),
        (cohesion_loss, (z, mean)),
        (regularisation_loss, (mean, log_variance)),
    ):
        repeated = [torch.cat([one] * copies) for one in arguments]
        torch.testing.assert_close(loss(*repeated), loss(*arguments))


# Finding the other pool of a driver.


def test_finding_the_other_pool_by_hand() -> None:
    # Two drivers with z of one number. First pools at 0 and 4, σ² of 1; other pools at 1 and 4, σ²
    # of 3: differences -1, -4, 3 and 0, of variance 4.
    first, other = torch.tensor([[0.0], [4.0]]), torch.tensor([[1.0], [4.0]])
    variances = torch.zeros(2, 1), torch.full((2, 1), math.log(3))
    found = same_driver_loss(first, variances[0], other, variances[1])
    likely = np.exp([[-1 / 8, -16 / 8], [-9 / 8, 0.0]])
    right = np.diag(likely)
    expected = -0.5 * (
        np.log(right / likely.sum(axis=1)).mean() + np.log(right / likely.sum(axis=0)).mean()
    )
    assert found.item() == near(expected)


def test_with_one_sigma_a_wider_one_counts_differences_less() -> None:
    # Three axes; a driver whose σ is larger is likelier far away, and less likely nearby.
    first, other = random(0, 5, 3), random(1, 5, 3)
    log_variance = torch.zeros(5, 3, dtype=torch.float64)
    log_variance[2] = 2.0
    found = same_driver_loss(first, log_variance, other, log_variance)
    logits = torch.zeros(5, 5, dtype=torch.float64)
    for k in range(5):
        for m in range(5):
            spread = (log_variance[k].exp() + log_variance[m].exp()).sqrt()
            logits[k, m] = Normal(0.0, spread).log_prob(first[k] - other[m]).sum()
    labels = torch.arange(5)
    expected = 0.5 * (
        torch.nn.functional.cross_entropy(logits, labels)
        + torch.nn.functional.cross_entropy(logits.T, labels)
    )
    torch.testing.assert_close(found, expected)


@given(seeds, st.integers(2, 6))
def test_without_knowledge_every_driver_is_as_likely(seed: int, count: int) -> None:
    point, log_variance = torch.ones(count, 2), torch.full((count, 2), float(seed % 3))
    found = same_driver_loss(point, log_variance, point, log_variance)
    assert found.item() == near(math.log(count), 1e-5)


def test_sigma_is_learned_as_it_is() -> None:
    # Pools of 1,500 drivers on a line differ by noise of σ = 0.5: half of the variance each.
    rng = torch.Generator().manual_seed(0)
    z = 10.0 * torch.randn(1500, 1, generator=rng)
    first, other = (z + 0.5 * torch.randn(1500, 1, generator=rng) for _ in range(2))
    losses = {
        sigma: same_driver_loss(
            *(
                part
                for mean in (first, other)
                for part in (mean, torch.full_like(mean, 2 * math.log(sigma)))
            )
        ).item()
        for sigma in (0.25, 0.35, 0.5, 0.7, 1.0)
    }
    assert min(losses, key=losses.__getitem__) == 0.5
