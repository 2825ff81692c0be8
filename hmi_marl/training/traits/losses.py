r"""The losses of the paper's loss table, as pure functions.

:math:`L_1` matches driving under the reward to the demonstrations, :math:`L_2` keeps z readable in
what the policy does, :math:`L_3` brings latent variables of one label together and others apart,
:math:`L_4` regularises them:

.. math::
    L = L_1 + 5 L_2 + 10 L_3 + 10^{-4} L_4

Every function returns a scalar, a mean over transitions, vectors or pairs, so that a loss does not
grow with the batch.
"""

from __future__ import annotations

import math

import torch
from torch.nn.functional import softplus


def log_discriminator(reward: torch.Tensor, log_policy: torch.Tensor) -> torch.Tensor:
    r"""Return log D of the adversarial IRL form :math:`D = e^f / (e^f + π)`.

    At the optimum :math:`f = \log π_E`, so D = 1/2 wherever the policy acts like the experts.

    Args:
        reward: f(s, a, s', z), any shape.
        log_policy: log π(a | s, z), the same shape.
    """
    return -softplus(log_policy - reward)


def adversarial_loss(
    expert_reward: torch.Tensor,
    expert_log_policy: torch.Tensor,
    policy_reward: torch.Tensor,
    policy_log_policy: torch.Tensor,
) -> torch.Tensor:
    r"""Return L1: the cross-entropy of classifying transitions as the experts' or the policy's.

    .. math::
        L_1 = -E_{π_E}[\log D] - E_π[\log(1 - D)]

    With an optimal D this is a constant minus twice the Jensen-Shannon divergence between the two
    distributions of transitions, which the generator then lowers; f and π enter through D alone.

    Args:
        expert_reward: f on demonstrated transitions, shape (A,).
        expert_log_policy: log π on them, shape (A,).
        policy_reward: f on the policy's transitions, shape (B,).
        policy_log_policy: log π on them, shape (B,).
    """
    of_experts = softplus(expert_log_policy - expert_reward).mean()
    of_policy = softplus(policy_reward - policy_log_policy).mean()
    return of_experts + of_policy


def information_loss(
    z: torch.Tensor, mean: torch.Tensor, log_variance: torch.Tensor
) -> torch.Tensor:
    r"""Return L2, minus the variational lower bound on I(z; τ) without its constant H(z).

    .. math::
        -I(z; τ) \le -E_{z \sim p, τ \sim π(\cdot|z)}[\log q(z | τ)] - H(z)

    Args:
        z: latent vectors given to the policy, shape (P, Z).
        mean: mean of q(z | τ) for the resulting driving, shape (P, Z).
        log_variance: log variance of the same, shape (P, Z).
    """
    return information_losses(z, mean, log_variance).mean()


def information_losses(
    z: torch.Tensor, mean: torch.Tensor, log_variance: torch.Tensor
) -> torch.Tensor:
    """Return -log q(z | τ) of each pool, shape (P,); see :func:`information_loss`."""
    squares = (z - mean) ** 2 / log_variance.exp()
    return 0.5 * (squares + log_variance + math.log(2 * math.pi)).sum(dim=1)


def contrastive_loss(
    z: torch.Tensor, labels: torch.Tensor, margin: float, bandwidth: float = 0.0
) -> torch.Tensor:
    r"""Return L3: latent vectors of one label attract, others repel up to a distance ``margin``.

    .. math::
        L_3 = E_{k \ne l}[w_{kl} \|z_k - z_l\|^2 + (1 - w_{kl}) \max(0, ε - \|z_k - z_l\|)^2]

    with :math:`w_{kl} = 1(y_k = y_l)`, or, softened for graded labels,
    :math:`w_{kl} = \exp(-(y_k - y_l)^2 / 2 s^2)`.

    Args:
        z: latent vectors, shape (P, Z).
        labels: y, shape (P,).
        margin: ε.
        bandwidth: s, in units of the labels; 0 for the indicator.

    Returns:
        The mean over ordered pairs; 0 if there are fewer than two vectors.
    """
    count = len(z)
    if count < 2:
        return z.sum() * 0.0
    first, second = torch.triu_indices(count, count, offset=1, device=z.device)
    squared = ((z[first] - z[second]) ** 2).sum(dim=1)
    apart = (labels[first] - labels[second]).to(z.dtype)
    same = torch.exp(-0.5 * (apart / bandwidth) ** 2) if bandwidth else (apart == 0).to(z.dtype)
    # The root's slope is infinite at 0, where equal vectors should have no gradient.
    distance = torch.sqrt(squared.clamp_min(1e-12))
    return (same * squared + (1 - same) * (margin - distance).clamp_min(0.0) ** 2).mean()


def cohesion_loss(first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
    r"""Return the part of L3 that needs no labels: pools of one driver attract each other.

    .. math::
        E_k[\|z_k - z'_k\|^2]

    Args:
        first, second: latent vectors of the same drivers, both of shape (P, Z).
    """
    return ((first - second) ** 2).sum(dim=1).mean()


def same_driver_loss(
    mean: torch.Tensor,
    log_variance: torch.Tensor,
    other_mean: torch.Tensor,
    other_log_variance: torch.Tensor,
) -> torch.Tensor:
    r"""Return the loss of finding the other pool of the same driver among those of P drivers.

    This is InfoNCE with the likelihood that the posteriors themselves give: if both estimate one z,
    they differ by :math:`μ_k - μ'_l \sim N(0, σ_k^2 + σ'^2_l)`, so

    .. math::
        L = -E_k[\log p(l = k | k)], \quad
        p(l | k) \propto N(μ_k - μ'_l; 0, σ_k^2 + σ'^2_l)

    averaged with the same from the other pools to these. It is least if z holds what distinguishes
    drivers, and if σ is how far the means of one driver lie apart.

    Args:
        mean: μ of one pool of each driver, shape (P, Z).
        log_variance: log σ², shape (P, Z).
        other_mean, other_log_variance: the same of the drivers' other pools.
    """
    variance = log_variance.exp()[:, None] + other_log_variance.exp()[None]
    squares = (mean[:, None] - other_mean[None]) ** 2 / variance
    return found_again_loss(-0.5 * (squares + variance.log()).sum(dim=2))


def found_again_loss(scores: torch.Tensor) -> torch.Tensor:
    r"""Return InfoNCE: the cross-entropy of finding the other pool of a driver by scores.

    Args:
        scores: log likelihood, up to a constant, that pools k and l are of one driver, shape
            (P, P); those on the diagonal are.
    """
    of_one, of_other = (torch.log_softmax(scores, dim=axis).diagonal() for axis in (1, 0))
    return -0.5 * (of_one.mean() + of_other.mean())


def regularisation_loss(mean: torch.Tensor, log_variance: torch.Tensor) -> torch.Tensor:
    r"""Return L4: the Kullback-Leibler divergence of q(z | τ) from the unit Gaussian.

    .. math::
        L_4 = E_τ[\tfrac12 \sum_j (σ_j^2 + μ_j^2 - 1 - \log σ_j^2)]

    Args:
        mean: μ, shape (P, Z).
        log_variance: log σ², shape (P, Z).
    """
    return 0.5 * (log_variance.exp() + mean**2 - 1.0 - log_variance).sum(dim=1).mean()
