"""Sums over the present episode of each team, as a training run logs them."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from hmi_marl.envs.rewards import TERMS
from hmi_marl.envs.teaming import StepResult


class Totals:
    """Sums over the present episode of each of N teams."""

    _names = ("return", *TERMS, "length", "alerts")

    def __init__(self, num_teams: int) -> None:
        self._sums = np.zeros((len(self._names), num_teams))

    def add(
        self, result: StepResult, rewards: NDArray[np.float64], alerted: NDArray[np.int64]
    ) -> None:
        """Take in one step; an alert counts as one, however strong."""
        terms = [result.terms[name] for name in TERMS]
        self._sums += np.stack([rewards, *terms, np.ones_like(rewards), alerted > 0])

    def of(self, which: NDArray[np.bool_]) -> dict[str, torch.Tensor]:
        """The marked teams' sums, float32 on the CPU."""
        sums = torch.from_numpy(self._sums[:, which].astype(np.float32))
        return {f"Episode/{name}": row for name, row in zip(self._names, sums, strict=True)}

    def clear(self, which: NDArray[np.bool_] | None = None) -> None:
        """Back to nothing in the marked teams, all by default."""
        self._sums[:, slice(None) if which is None else which] = 0.0
