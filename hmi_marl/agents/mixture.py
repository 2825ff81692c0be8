"""Mixture of policies for one seat: in each episode one of them plays, drawn from its seed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.learned.policy import INTENT
from hmi_marl.envs.config import AGENTS, VEHICLE_AI
from hmi_marl.envs.seats import Policy, check_policy, moves_sequentially, parts_read
from hmi_marl.envs.streams import Stream, uniform


class Mixture:
    """In each episode one of several policies plays, each with the same chance.

    Which one depends on the episode's seed alone, and is independent of a mixture in the other
    seat. All of them observe every turn, so that each plays its episodes as it would alone.

    Args:
        policies: each a separate object.
        seat: the seat that they are for, "driver" or "vehicle_ai".

    Raises:
        TypeError: what is no policy.
        ValueError: fewer than two policies, the same object twice, a mixture among them, or HMIs
            that see a^H_t together with some that see a^H_{t-1}.
    """

    def __init__(self, policies: Sequence[Policy], seat: str) -> None:
        self.policies = tuple(check_policy(policy) for policy in policies)
        if len(self.policies) < 2:
            raise ValueError(f"a mixture takes two policies or more, but got {len(self.policies)}")
        if len({id(policy) for policy in self.policies}) < len(self.policies):
            raise ValueError("a mixture takes separate objects, since policies have a memory")
        if any(isinstance(policy, Mixture) for policy in self.policies):
            raise ValueError("a mixture holds no other mixture; name all policies in one")
        self.sequential = seat != VEHICLE_AI or _see_intent(self.policies)
        """Whether its HMIs see a^H_t rather than a^H_{t-1}."""
        self._number = AGENTS.index(seat)
        self._playing = np.zeros(0, np.int64)

    @property
    def reads(self) -> tuple[str, ...] | None:
        """Parts of the observation that any of its policies reads; None for all."""
        every: dict[str, None] = {}
        for policy in self.policies:
            reads = parts_read(policy)
            if reads is None:
                return None
            every |= dict.fromkeys(reads)
        return tuple(every)

    @property
    def playing(self) -> NDArray[np.int64]:
        """Index of the policy that plays in each team, shape (N,)."""
        return self._playing.copy()

    def reset(self, seeds: NDArray[np.uint64], which: NDArray[np.bool_] | None = None) -> None:
        """See :meth:`hmi_marl.envs.seats.Policy.reset`."""
        drawn = uniform(seeds, Stream.MIXTURE, self._number) * len(self.policies)
        now = drawn.astype(np.int64)
        self._playing = now if which is None else np.where(which, now, self._playing)
        for policy in self.policies:
            policy.reset(seeds, which)

    def act(self, observations: NDArray[np.float32]) -> NDArray[np.int64]:
        """See :meth:`hmi_marl.envs.seats.Policy.act`.

        Raises:
            RuntimeError: for another number of teams than the last :meth:`reset`.
        """
        count = len(observations)
        if len(self._playing) != count:
            raise RuntimeError(
                "a mixture draws who plays when episodes begin: call reset(seeds) for "
                f"{count} teams first"
            )
        actions = np.stack([policy.act(observations) for policy in self.policies])
        chosen: NDArray[np.int64] = actions[self._playing, np.arange(count)]
        return chosen


def _see_intent(hmis: Sequence[Policy]) -> bool:
    """Return whether HMIs see a^H_t. One that does not read a^H may be asked at either time."""
    read = [parts_read(hmi) for hmi in hmis]
    reading = [k for k, parts in enumerate(read) if parts is None or INTENT in parts]
    late = [k for k in reading if not moves_sequentially(hmis[k])]
    if late and late != reading:
        early = [k for k in reading if k not in late]
        raise ValueError(
            "HMIs in a mixture move all after the driver or all at the same time, but number "
            f"{_numbers(late)} has learned with simultaneous moves and number {_numbers(early)} "
            "sees a^H_t"
        )
    return not late


def _numbers(indices: Sequence[int]) -> str:
    return " and ".join(str(k + 1) for k in indices)
