"""Gradient descent on one loss, with a learning rate that falls along half a cosine."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import torch

from hmi_marl.training.runs.divergence import check_finite
from hmi_marl.training.runs.run import flat_moments, with_moments

LAST_RATE = 0.05
"""Learning rate at the end, as a share of the first."""
LONGEST_GRADIENT = 1.0
"""Norm to which longer gradients are cut."""


class Descent:
    """Descend by AdamW.

    Args:
        parameters: what learns.
        rate: learning rate at the start.
        weight_decay: weight decay.
        setting: name of ``rate`` among the settings, for errors.
    """

    def __init__(
        self,
        parameters: Iterable[torch.nn.Parameter],
        rate: float,
        weight_decay: float = 0.0,
        setting: str = "learning_rate",
    ) -> None:
        self._parameters = list(parameters)
        self._rate, self._setting = rate, setting
        self._optimizer = torch.optim.AdamW(self._parameters, rate, weight_decay=weight_decay)

    def step(self, loss: torch.Tensor, progress: float) -> float:
        """Take one step and return the loss; ``progress`` lies in [0, 1).

        Raises:
            FloatingPointError: learning diverges: the loss or its gradient is not finite. No weight
                has changed then.
        """
        rate = self._rate * (LAST_RATE + (1 - LAST_RATE) * 0.5 * (1 + math.cos(math.pi * progress)))
        for group in self._optimizer.param_groups:
            group["lr"] = rate
        self._optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        norm = torch.nn.utils.clip_grad_norm_(self._parameters, LONGEST_GRADIENT)
        found = loss.item()
        check_finite({"loss": found, "gradient": norm.item()}, rate, self._setting)
        self._optimizer.step()
        return found

    def tensors(self) -> dict[str, torch.Tensor]:
        """Moments of the optimizer, by flat names."""
        return flat_moments(self._optimizer.state_dict())

    def load(self, tensors: Mapping[str, torch.Tensor]) -> None:
        """Restore what :meth:`tensors` returned."""
        self._optimizer.load_state_dict(with_moments(self._optimizer.state_dict(), tensors))
