"""What a step of a vector environment returns, as tensors over arrays that the step fills in."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict

from hmi_marl.envs.team_arrays import Room

CPU = torch.device("cpu")
_unchecked: Any = getattr(TensorDict, "_new_unsafe", TensorDict)
"""Makes a TensorDict, where there is such a way, without checks that each group is of one batch."""


def groups_of(arrays: Mapping[str, NDArray[np.float32]], count: int) -> TensorDict:
    """Return groups of observations of so many teams, over arrays of shape (count, size)."""
    tensors = {group: torch.from_numpy(rows) for group, rows in arrays.items()}
    made: TensorDict = _unchecked(tensors, batch_size=torch.Size((count,)), device=CPU)
    return made


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
        room: that the step fills in.
        names: of observations in it, by group.
        rewards: names of the rewards in it.
    """

    def __init__(self, room: Room, names: Mapping[str, str], rewards: Sequence[str]) -> None:
        _, own, dones, time_outs = room.scores
        arrays = {group: room.groups[name].rows for group, name in names.items()}
        self.observations = groups_of(arrays, len(dones))
        """Groups of shape (N, size)."""
        self.rewards = {name: torch.from_numpy(own[k]) for k, name in enumerate(rewards)}
        """Rewards by name, float32 of shape (N,)."""
        self.dones, self.time_outs = torch.from_numpy(dones), torch.from_numpy(time_outs)
        """Where episodes ended: 1, else 0, int64; and by their time alone, bool. Shape (N,)."""


def on_device(values: Any, device: torch.device) -> Any:
    """Return tensors on a device, also those in tuples and dicts; all else stays as it is."""
    if device.type == "cpu":
        return values
    if isinstance(values, dict):
        return {name: on_device(value, device) for name, value in values.items()}
    if isinstance(values, tuple):
        return tuple(on_device(value, device) for value in values)
    return values.to(device) if isinstance(values, (torch.Tensor, TensorDict)) else values
