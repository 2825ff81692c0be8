"""The two seats of a team: the policies that sit in them, and turns with a partner in one."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.envs.config import DRIVER, VEHICLE_AI
from hmi_marl.envs.step_result import StepResult, Then
from hmi_marl.envs.teaming import Teaming, Views


@runtime_checkable
class Policy(Protocol):
    """A policy for one seat of N teams.

    In a single-team environment pass ``observation[None]`` and take element 0 of the answer.
    A policy may remember what it saw of its teams: give each environment its own object, unless it
    has an attribute ``memoryless`` that is true. It may have an attribute ``reads``, the names of
    the parts of its observation that it reads; a partner in an environment is then shown 0 in the
    others.
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

    A policy that was trained with simultaneous moves has an attribute ``sequential`` that is
    false; it is asked before the driver acts, when its observation still holds a^H_{t-1}.
    """
    return bool(getattr(hmi, "sequential", True))


def parts_read(policy: Policy) -> tuple[str, ...] | None:
    """Return the names of the parts of its observation that a policy reads, or None for all.

    They are its attribute ``reads``; one that a class inherits counts only if it inherits ``act``
    too, since another ``act`` may read more.
    """
    if "reads" in getattr(policy, "__dict__", {}):
        return policy.reads  # type: ignore[attr-defined]
    for kind in type(policy).__mro__:
        if "reads" in vars(kind):
            return policy.reads  # type: ignore[attr-defined]
        if "act" in vars(kind):
            return None
    return None


def _unchanged(actions: NDArray[np.int64]) -> NDArray[np.int64]:
    return actions


class _Places:
    """Which environment each policy with memory plays in, to find one that is in several.

    Its memory of one would be mixed up with that of the other.
    """

    def __init__(self) -> None:
        self._of: dict[int, tuple[weakref.ref[Any], weakref.ref[Any]]] = {}

    def take(self, policy: Policy, place: object) -> None:
        """Note that the policy begins episodes in this place."""
        key, places = id(policy), self._of
        try:
            seen = weakref.ref(policy, lambda _: places.pop(key, None))
        except TypeError:  # an object of a class that allows none
            return
        places[key] = seen, weakref.ref(place)

    def check(self, policy: Policy, place: object) -> None:
        """Raise RuntimeError if the policy has begun episodes somewhere else since."""
        if getattr(policy, "memoryless", False):
            return
        found = self._of.get(id(policy))
        if found is None or found[0]() is not policy or found[1]() is None:
            self.take(policy, place)  # a copy, or its other environment is gone
        elif found[1]() is not place:
            raise RuntimeError(
                f"this {type(policy).__name__} remembers what it saw, and another environment has "
                "begun episodes with the same object; give each environment its own"
            )


_PLACES = _Places()


class Asked:
    """A policy that is asked for actions, and shown only the parts that it reads.

    The others are 0, and a lidar that is not read is not traced; see :func:`parts_read`.

    Args:
        policy: is asked.
        check: returns the actions, or raises if they are not valid.

    Raises:
        RuntimeError: when a policy with memory is asked that another environment uses too.
    """

    def __init__(
        self,
        policy: Policy,
        check: Callable[[NDArray[np.int64]], NDArray[np.int64]] = _unchanged,
    ) -> None:
        self._policy, self._check = policy, check

    def begin(self, seeds: NDArray[np.uint64], which: NDArray[np.bool_] | None = None) -> None:
        """Begin episodes; see :meth:`Policy.reset`."""
        if which is None:
            _PLACES.take(self._policy, self)
        else:
            _PLACES.check(self._policy, self)
        self._policy.reset(seeds, which)

    @property
    def reads(self) -> tuple[str, ...] | None:
        """Parts that it reads; None for all."""
        return parts_read(self._policy)

    def __call__(self, observations: NDArray[np.float32]) -> NDArray[np.int64]:
        """Return the policy's actions, shape (N,)."""
        _PLACES.check(self._policy, self)
        return self._check(self._policy.act(observations))


def check_policy(policy: object) -> Policy:
    """Return ``policy`` if it can sit in a seat, or raise; a class cannot, an object of it can."""
    if isinstance(policy, type) or not isinstance(policy, Policy):
        raise TypeError(f"a partner is a Policy object with reset() and act(), not {policy!r}")
    return policy


class PartnerTurns:
    """Turns of N teams in which a partner acts in the other seat.

    A partner who drives has acted before the vehicle AI observes (:meth:`prepare`), or acts at the
    same time.

    Args:
        teaming: the teams.
        seat: the seat whose actions :meth:`step` takes, "driver" or "vehicle_ai".
        partner: the policy in the other seat.
        check: returns the partner's actions, or raises if they are not valid.
        sequential: whether a partner who drives acts first. (A vehicle AI as the partner moves as
            it was trained; see :func:`moves_sequentially`.)
    """

    def __init__(
        self,
        teaming: Teaming,
        seat: str,
        partner: Policy,
        check: Callable[[NDArray[np.int64]], NDArray[np.int64]] = _unchanged,
        sequential: bool = True,
    ) -> None:
        self._teaming, self._seat, self._partner = teaming, seat, partner
        self._asked = Asked(partner, check)
        self._drives_first = seat == VEHICLE_AI and sequential

    def begin(self, seeds: NDArray[np.uint64], which: NDArray[np.bool_] | None = None) -> None:
        """Begin the partner's episodes; see :meth:`Policy.reset`."""
        self._asked.begin(seeds, which)

    def prepare(self) -> None:
        """Let a partner who drives act, if it has not acted in this turn."""
        if self._drives_first and not self._teaming.intent_given.all():
            self._teaming.intend(self._teaming.ask(DRIVER, self._asked))

    def step(
        self,
        actions: NDArray[np.int64] | list[int],
        views: Views = (),
        then: Then | None = None,
        looking_away: ArrayLike | None = None,
    ) -> StepResult:
        """Take one step of every team from this seat's actions, shape (N,).

        Where the partner fails, no team has moved, and the step can be taken again. For the other
        arguments see :meth:`Teaming.step`.
        """
        more = views, then, looking_away
        if self._seat == DRIVER:
            sequential = moves_sequentially(self._partner)
            return self._teaming.turn(actions, self._asked, sequential, *more)
        if not self._drives_first:
            return self._teaming.turn(self._asked, actions, False, *more)
        self.prepare()  # again, if the partner failed when it was asked first
        return self._teaming.step(actions, *more)
