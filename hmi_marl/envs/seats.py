"""What may sit in a seat: anything that maps a batch of observations to a batch of actions."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray


@runtime_checkable
class Policy(Protocol):
    """A policy for one seat of N teams at once.

    In a single-team environment pass ``observation[None]`` and take element 0 of the answer.
    A policy may remember what it saw of its teams: give each environment one of its own.
    """

    def reset(self, seeds: NDArray[np.uint64], which: NDArray[np.bool_] | None = None) -> None:
        """Begin new episodes in the teams marked in ``which`` (all by default).

        Args:
            seeds: of the episodes, shape (N,); a random policy draws from them alone.
            which: shape (N,). With None, N may differ from the last call's.
        """

    def act(self, observations: NDArray[np.float32]) -> NDArray[np.int64]:
        """Actions of shape (N,) for observations of shape (N, D); once per step and episode."""
        ...


def moves_sequentially(hmi: Policy) -> bool:
    """Whether a vehicle AI's policy is asked after the driver has acted, and so sees a^H_t.

    A policy that has learned to act at once with the driver says otherwise by an attribute
    ``sequential``; it is asked before, when its observation still holds a^H_{t-1}.
    """
    return bool(getattr(hmi, "sequential", True))


def check_policy(policy: object) -> Policy:
    """Return ``policy`` if it can sit in a seat, or raise; a class cannot, an object of it can."""
    if isinstance(policy, type) or not isinstance(policy, Policy):
        raise TypeError(f"a partner is a Policy object with reset() and act(), not {policy!r}")
    return policy
