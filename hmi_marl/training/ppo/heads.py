"""Categorical heads for rsl_rl: one seat's action, or the composite π_H∘π_AI of both seats.

rsl_rl stores actions as floats; these heads take and return indices as floats, shape
(..., columns).
"""

from __future__ import annotations

from functools import cached_property

import torch
from rsl_rl.modules.distribution import Distribution  # type: ignore[import-untyped]

from hmi_marl.agents.learned.policy import INTENTS


class OneAction(Distribution):  # type: ignore[misc]  # rsl_rl has no types
    """One of ``choices`` actions. Parameters: log-probabilities of shape (..., choices)."""

    def __init__(self, output_dim: int, choices: int) -> None:
        super().__init__(output_dim)
        self.choices = choices

    @property
    def input_dim(self) -> int:
        """Number of logits."""
        return self.choices

    def update(self, mlp_output: torch.Tensor) -> None:
        """Set the distribution by the network's logits, shape (..., choices)."""
        self._choice = Choice(mlp_output)

    def sample(self, generator: torch.Generator | None = None) -> torch.Tensor:
        """Draw indices as floats, shape (..., 1); by torch's own generator if none is given."""
        return self._choice.draw(generator)

    def deterministic_output(self, mlp_output: torch.Tensor) -> torch.Tensor:
        """Return the most likely action, shape (..., 1)."""
        return self.as_deterministic_output_module()(mlp_output)

    def as_deterministic_output_module(self) -> torch.nn.Module:
        """Return the same as a module, for rsl_rl's exports to TorchScript and ONNX."""
        return LikeliestAction()

    @property
    def first(self) -> Choice:
        """The choice itself."""
        return self._choice

    @property
    def mean(self) -> torch.Tensor:
        """Probabilities, the mean of the one-hot action."""
        return self._choice.probs

    @property
    def std(self) -> torch.Tensor:
        """Standard deviations of the one-hot action."""
        return spread(self._choice.probs)

    @property
    def entropy(self) -> torch.Tensor:
        """Shape (...)."""
        return self._choice.entropy

    @property
    def params(self) -> tuple[torch.Tensor, ...]:
        """Log-probabilities."""
        return (self._choice.log_probs,)

    def log_prob(self, outputs: torch.Tensor) -> torch.Tensor:
        """Log π(a), shape (...), of indices of shape (..., 1)."""
        return self._choice.log_probs.gather(-1, outputs.long()).squeeze(-1)

    def gradient(
        self, outputs: torch.Tensor, of_log_prob: torch.Tensor, of_entropy: float
    ) -> torch.Tensor:
        """Gradient of Σ ``of_log_prob`` log π(a) + ``of_entropy`` Σ H with respect to the logits.

        Args:
            outputs: indices of shape (..., 1).
            of_log_prob: factor of each row's log π(a), shape (...).
            of_entropy: factor of every row's entropy H.
        """
        gradient = self._choice.entropy_gradient().mul_(of_entropy)
        column = of_log_prob.unsqueeze(-1)
        gradient -= self._choice.probs * column
        return gradient.scatter_add_(-1, outputs.long(), column)

    def kl_divergence(
        self, old_params: tuple[torch.Tensor, ...], new_params: tuple[torch.Tensor, ...]
    ) -> torch.Tensor:
        """KL(old || new), shape (...)."""
        return divergence(old_params[0], new_params[0])


class IntentThenAlert(Distribution):  # type: ignore[misc]
    r"""a^H, then a^A given the a^H that was drawn: π(a^H) π(a^A | a^H).

    Takes 5 logits of a^H and then, for each a^H, A of a^A, of which there are A = 2 (k + 1 with k
    strengths of alert). Entropy and KL follow the chain rule,
    H(a^H, a^A) = H(a^H) + Σ π(a^H) H(a^A | a^H), and need no sampling.
    """

    def __init__(self, output_dim: int, alerts: int = 2) -> None:
        super().__init__(output_dim)
        self.alerts = alerts

    @property
    def input_dim(self) -> int:
        """Number of logits."""
        return INTENTS + INTENTS * self.alerts

    def update(self, mlp_output: torch.Tensor) -> None:
        """Set the distribution by the network's logits, shape (..., 5 + 5 A)."""
        intent, alert = self._split(mlp_output)
        self._intent, self._alert = Choice(intent), Choice(alert)

    def sample(self, generator: torch.Generator | None = None) -> torch.Tensor:
        """Draw a^H and a^A as floats, shape (..., 2); see :meth:`OneAction.sample`."""
        intent = self._intent.draw(generator)
        return torch.cat(
            [intent, draw(_row(self._alert.probs, intent).movedim(-1, 0), generator)], dim=-1
        )

    def deterministic_output(self, mlp_output: torch.Tensor) -> torch.Tensor:
        """Return the most likely a^H, and the most likely a^A given that, shape (..., 2)."""
        return self.as_deterministic_output_module()(mlp_output)

    def as_deterministic_output_module(self) -> torch.nn.Module:
        """Return the same as a module, for rsl_rl's exports to TorchScript and ONNX."""
        return LikeliestPair(INTENTS, self.alerts)

    @property
    def first(self) -> Choice:
        """Choice of a^H, whose logits come first."""
        return self._intent

    @property
    def mean(self) -> torch.Tensor:
        """Probabilities of a^H, and of a^A given each a^H, shape (..., 5 + 5 A)."""
        return torch.cat([self._intent.probs, self._alert.probs.flatten(-2)], dim=-1)

    @property
    def std(self) -> torch.Tensor:
        """Standard deviations of the one-hot actions."""
        return spread(self.mean)

    @property
    def entropy(self) -> torch.Tensor:
        """Entropy of the pair, shape (...)."""
        return self._intent.entropy + (self._intent.probs * self._alert.entropy).sum(-1)

    @property
    def params(self) -> tuple[torch.Tensor, ...]:
        """Log-probabilities of a^H, shape (..., 5), and of a^A given a^H, shape (..., 5, A)."""
        return self._intent.log_probs, self._alert.log_probs

    def log_prob(self, outputs: torch.Tensor) -> torch.Tensor:
        """Log π(a^H, a^A), shape (...), of indices of shape (..., 2)."""
        intent, alert = outputs[..., :1].long(), outputs[..., 1:].long()
        given = _row(self._alert.log_probs, intent).gather(-1, alert)
        return (self._intent.log_probs.gather(-1, intent) + given).squeeze(-1)

    def gradient(
        self, outputs: torch.Tensor, of_log_prob: torch.Tensor, of_entropy: float
    ) -> torch.Tensor:
        """Gradient as of :meth:`OneAction.gradient`, of indices of shape (..., 2)."""
        intent, alert = outputs[..., :1].long(), outputs[..., 1:].long()
        chance, given, column = self._intent.probs, self._alert.entropy, of_log_prob.unsqueeze(-1)
        # H = H(a^H) + Σ π(a^H) H(a^A | a^H): the logits of a^H also weigh the entropies given a^H.
        of_intent = self._intent.entropy_gradient()
        of_intent += chance * (given - (chance * given).sum(-1, keepdim=True))
        of_intent = of_intent.mul_(of_entropy).sub_(chance * column)
        of_intent.scatter_add_(-1, intent, column)
        of_alert = self._alert.entropy_gradient().mul_(of_entropy * chance.unsqueeze(-1))
        drawn = torch.zeros_like(chance).scatter_(-1, intent, column).unsqueeze(-1)
        of_alert -= self._alert.probs * drawn
        of_alert = of_alert.flatten(-2)
        of_alert.scatter_add_(-1, self.alerts * intent + alert, column)
        return torch.cat([of_intent, of_alert], dim=-1)

    def kl_divergence(
        self, old_params: tuple[torch.Tensor, ...], new_params: tuple[torch.Tensor, ...]
    ) -> torch.Tensor:
        """KL(old || new) of the pair, shape (...)."""
        of_alert = divergence(old_params[1], new_params[1])
        return divergence(old_params[0], new_params[0]) + (old_params[0].exp() * of_alert).sum(-1)

    def _split(self, logits: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        alerts = torch.unflatten(logits[..., INTENTS:], -1, (INTENTS, self.alerts))
        return logits[..., :INTENTS], alerts


class LikeliestAction(torch.nn.Module):
    """Most likely action for logits, as a module that TorchScript and ONNX support."""

    def forward(self, logits: torch.Tensor) -> torch.Tensor:
        """Return an index as a float, shape (..., 1), for logits of shape (..., choices)."""
        return logits.argmax(dim=-1, keepdim=True).to(logits.dtype)


class LikeliestPair(torch.nn.Module):
    """Most likely a^H, and most likely a^A given that, for TorchScript and ONNX."""

    def __init__(self, intents: int, alerts: int) -> None:
        super().__init__()
        self.intents, self.alerts = intents, alerts

    def forward(self, logits: torch.Tensor) -> torch.Tensor:
        """Return indices as floats, (..., 2), for logits of shape (..., intents + intents A)."""
        intent = logits[..., : self.intents].argmax(dim=-1, keepdim=True)
        alerts = torch.unflatten(logits[..., self.intents :], -1, (self.intents, self.alerts))
        alert = _row(alerts, intent).argmax(dim=-1, keepdim=True)
        return torch.cat([intent, alert], dim=-1).to(logits.dtype)


class Choice:
    """Probabilities of a few choices, by logits of shape (..., choices).

    They lie in memory choice by choice: in this order a softmax of a few choices is faster.
    """

    def __init__(self, logits: torch.Tensor) -> None:
        moved = logits.movedim(-1, 0).contiguous()
        self._logits = moved - moved.amax(0)
        self._odds = self._logits.exp()

    @cached_property
    def _total(self) -> torch.Tensor:
        return self._odds.sum(0)

    @cached_property
    def probs(self) -> torch.Tensor:
        """Shape (..., choices)."""
        return (self._odds / self._total).movedim(0, -1)

    @cached_property
    def log_probs(self) -> torch.Tensor:
        """Shape (..., choices)."""
        return (self._logits - self._total.log()).movedim(0, -1)

    @cached_property
    def entropy(self) -> torch.Tensor:
        """Shape (...)."""
        return -(self.probs * self.log_probs).sum(-1)

    def entropy_gradient(self) -> torch.Tensor:
        """Gradient of the entropy with respect to the logits, -p (log p + H)."""
        return (self.log_probs + self.entropy.unsqueeze(-1)).mul_(self.probs).neg_()

    def divergence(self, other: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return KL(this || other), shape (...), and its gradient with respect to the logits.

        The gradient is p (log p - log q - KL), shape (..., choices).

        Args:
            other: log-probabilities log q, shape (..., choices).
        """
        apart = self.log_probs - other
        found = (self.probs * apart).sum(-1)
        return found, apart.sub_(found.unsqueeze(-1)).mul_(self.probs)

    def draw(self, generator: torch.Generator | None = None) -> torch.Tensor:
        """Draw an index, shape (..., 1); see :func:`draw`."""
        return draw(self._odds, generator)


def draw(odds: torch.Tensor, generator: torch.Generator | None = None) -> torch.Tensor:
    """Draw an index as a float, shape (..., 1), by inverting the cumulative distribution.

    Args:
        odds: probabilities, or multiples of them, of shape (choices, ...).
        generator: one of the CPU; None for torch's own.
    """
    below = odds.cumsum(0)
    chance = torch.rand(odds.shape[1:], generator=generator).to(odds.device) * below[-1]
    return (chance >= below[:-1]).sum(0, dtype=odds.dtype).unsqueeze(-1)


def spread(probs: torch.Tensor) -> torch.Tensor:
    """Return the standard deviation of each component of the one-hot action, sqrt(p (1 - p))."""
    return (probs * (1.0 - probs)).sqrt()


def divergence(old: torch.Tensor, new: torch.Tensor) -> torch.Tensor:
    """Return KL(old || new) over the last dimension of log-probabilities."""
    return (old.exp() * (old - new)).sum(-1)


def _row(table: torch.Tensor, intent: torch.Tensor) -> torch.Tensor:
    """Return the row of a^H, shape (..., A), out of (..., 5, A)."""
    return torch.take_along_dim(table, intent.long().unsqueeze(-1), dim=-2).squeeze(-2)
