"""Episodes of two policies: every turn in order, with observers.

All episodes of two policies go through here, and all that records, counts or draws is an
:class:`Observer`. The order of moves within a turn is that of :meth:`Teaming.turn`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import Traits
from hmi_marl.envs.seats import Policy, moves_sequentially, parts_read
from hmi_marl.envs.step_result import StepResult
from hmi_marl.envs.teaming import Teaming
from hmi_marl.envs.worlds import World


class Observer:
    """Watch N teams play. Each method does nothing unless it is overridden."""

    def before(self, teaming: Teaming) -> None:
        """Called before each turn, when neither agent has moved."""

    def seen(self, teaming: Teaming, observations: NDArray[np.float32]) -> None:
        """Called with the observations that the vehicle AI is about to act on, shape (N, D)."""

    def after(self, teaming: Teaming, result: StepResult) -> None:
        """Called after each turn with its rewards and ends."""


class HandsOver(Observer):
    """Change drivers before a step, without notice to the HMI.

    Args:
        step: number of turns before the change.
        traits: of the N new drivers.
        notify: is called with these traits at the change.
    """

    def __init__(
        self, step: int, traits: Traits, notify: Callable[[Traits], object] = lambda traits: None
    ) -> None:
        self._turns_left, self._traits, self._notify = step, traits, notify

    def before(self, teaming: Teaming) -> None:
        """Hand over at the given step."""
        if self._turns_left == 0:
            teaming.hand_over(self._traits)
            self._notify(self._traits)
        self._turns_left -= 1


def begin(
    config: TeamConfig, driver: Policy, hmi: Policy, seeds: NDArray[np.uint64], world: str | World
) -> Teaming:
    """Make teams, begin the episodes of these seeds, and reset both seats' policies."""
    teaming = Teaming(config, len(seeds), world)
    for seat in (teaming, driver, hmi):
        seat.reset(seeds)
    return teaming


@dataclass(frozen=True)
class _Acting:
    """A function that acts, shown only the parts that it reads; all with None."""

    act: Callable[[NDArray[np.float32]], NDArray[np.int64]]
    reads: tuple[str, ...] | None

    def __call__(self, observations: NDArray[np.float32]) -> NDArray[np.int64]:
        return self.act(observations)


def turn(
    teaming: Teaming,
    driver: Policy,
    hmi: Policy,
    observers: Sequence[Observer] = (),
    looking_away: ArrayLike | None = None,
) -> StepResult:
    """Take one step of every team.

    The HMI moves after the driver and sees a^H_t, or at the same time and sees a^H_{t-1}; see
    :func:`hmi_marl.envs.seats.moves_sequentially`.

    A policy with an attribute ``reads`` is shown 0 in the parts that it does not read, except for
    an HMI whose observations an observer wants to see. For ``looking_away`` see
    :meth:`Teaming.step`.
    """
    curious = [observer for observer in observers if type(observer).seen is not Observer.seen]

    def alert(observations: NDArray[np.float32]) -> NDArray[np.int64]:
        for observer in curious:
            observer.seen(teaming, observations)
        return hmi.act(observations)

    for observer in observers:
        observer.before(teaming)
    drive = _Acting(driver.act, parts_read(driver))
    react = _Acting(alert, None if curious else parts_read(hmi))
    result = teaming.turn(drive, react, moves_sequentially(hmi), looking_away=looking_away)
    for observer in observers:
        observer.after(teaming, result)
    return result


def turns(
    teaming: Teaming, driver: Policy, hmi: Policy, observers: Sequence[Observer] = ()
) -> Iterator[StepResult]:
    """Take turns until every team's episode has ended; yields each result."""
    while not teaming.over.all():
        yield turn(teaming, driver, hmi, observers)


def play(
    teaming: Teaming,
    driver: Policy,
    hmi: Policy,
    observers: Sequence[Observer] = (),
    steps: int | None = None,
) -> Teaming:
    """Play every team's episode to its end.

    Args:
        teaming: N teams whose episodes have begun (see :func:`begin`).
        driver, hmi: policies of the two seats, reset for the same episodes.
        observers: watch each turn, in their order.
        steps: number of turns, also after every episode has ended; until then by default. A policy
            that remembers its teams over several episodes then has the same age in all of them.

    Returns:
        The same teams, at the end of their episodes.
    """
    if steps is None:
        for _ in turns(teaming, driver, hmi, observers):
            pass
    else:
        for _ in range(steps):
            turn(teaming, driver, hmi, observers)
    return teaming
