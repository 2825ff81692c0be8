"""What a step of a vector environment returns, as tensors over arrays that the step fills in."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict

from hmi_marl.envs.step_result import StepResult

_CPU = torch.device("cpu")


class EpisodeLog(Mapping[str, torch.Tensor]):
    """Values of M episodes that ended, by name: float32 of shape (M,) on the CPU.

    Args:
        totals: sums over the episodes, shape (M, 14).
        columns: column of each name.
    """

    def __init__(self, totals: NDArray[np.float64], columns: Mapping[str, int]) -> None:
        self._totals, self._columns = totals, columns

    def __getitem__(self, name: str) -> torch.Tensor:
        return torch.from_numpy(self._totals[:, self._columns[name]].astype(np.float32))

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)


class Outcome:
    """Observations, rewards and ends of one step of N teams.

    Make it before the step: a step displaces torch's code from the processor's cache, so that
    making tensors after it takes four times as long.

    Args:
        count: N.
        groups: columns of each group of observations.
        rewards: columns of :attr:`StepResult.table` that each reward is the sum of, by name.
    """

    def __init__(
        self, count: int, groups: Mapping[str, int], rewards: Mapping[str, tuple[int, ...]]
    ) -> None:
        self.rows = {name: np.empty((count, size), np.float32) for name, size in groups.items()}
        """Observations by group, to be filled in, float32 of shape (N, size)."""
        self._columns = rewards
        self._rewards = {name: np.empty(count, np.float32) for name in rewards}
        self._dones, self._time_outs = np.empty(count, np.int64), np.empty(count, np.bool_)
        tensors = {name: torch.from_numpy(rows) for name, rows in self.rows.items()}
        self.observations = TensorDict(tensors, batch_size=[count], device=_CPU)
        """Groups of shape (N, size)."""
        self.rewards = {name: torch.from_numpy(row) for name, row in self._rewards.items()}
        """Rewards by name, float32 of shape (N,)."""
        self.dones = torch.from_numpy(self._dones)
        """1 where an episode ended, else 0; int64 of shape (N,)."""
        self.time_outs = torch.from_numpy(self._time_outs)
        """Where it ended by its time alone, bool of shape (N,)."""

    def fill(self, result: StepResult) -> None:
        """Fill in rewards and ends."""
        for name, (first, *others) in self._columns.items():
            reward = result.table[:, first]
            for other in others:
                reward = reward + result.table[:, other]
            self._rewards[name][:] = reward
        self._dones[:] = result.ended
        self._time_outs[:] = result.truncated


def on_device(values: Any, device: torch.device) -> Any:
    """Return tensors on a device, also those in tuples and dicts; all else stays as it is."""
    if device.type == "cpu":
        return values
    if isinstance(values, dict):
        return {name: on_device(value, device) for name, value in values.items()}
    if isinstance(values, tuple):
        return tuple(on_device(value, device) for value in values)
    return values.to(device) if isinstance(values, (torch.Tensor, TensorDict)) else values
