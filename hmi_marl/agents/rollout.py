"""Episodes of two policies: every turn in order, with observers.

Whatever two policies play goes through here, and whatever records, counts or draws is an
:class:`Observer`. The order of moves within a turn is that of :meth:`Teaming.turn`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import Traits
from hmi_marl.envs.seats import Policy, moves_sequentially
from hmi_marl.envs.teaming import StepResult, Teaming
from hmi_marl.envs.worlds import World


class Observer:
    """Watch N teams play. Each method does nothing unless it is overridden."""

    def before(self, teaming: Teaming) -> None:
        """Called before each turn, when neither agent has moved."""

    def seen(self, teaming: Teaming, observations: NDArray[np.float32]) -> None:
        """Called with what the vehicle AI is about to act on, shape (N, D)."""

    def after(self, teaming: Teaming, result: StepResult) -> None:
        """Called after each turn with its rewards and ends."""


class HandsOver(Observer):
    """Let other drivers take the wheel before a step, unannounced.

    Args:
        step: turns that are taken before.
        traits: of the new drivers, N of them.
        tell: is called with these traits when it happens.
    """

    def __init__(
        self,
        step: int,
        traits: Traits,
        tell: Callable[[Traits], object] = lambda traits: None,
    ) -> None:
        self._turns_left, self._traits, self._tell = step, traits, tell

    def before(self, teaming: Teaming) -> None:
        """Hand over when it is time."""
        if self._turns_left == 0:
            teaming.hand_over(self._traits)
            self._tell(self._traits)
        self._turns_left -= 1


def begin(
    config: TeamConfig, driver: Policy, hmi: Policy, seeds: NDArray[np.uint64], world: str | World
) -> Teaming:
    """Make teams at the start of the episodes of these seeds, and reset both seats' policies."""
    teaming = Teaming(config, len(seeds), world)
    for seat in (teaming, driver, hmi):
        seat.reset(seeds)
    return teaming


def turn(
    teaming: Teaming, driver: Policy, hmi: Policy, observers: Sequence[Observer] = ()
) -> StepResult:
    """Take one step of every team.

    The HMI moves after the driver and sees a^H_t, or at the same time and sees a^H_{t-1}; see
    :func:`hmi_marl.envs.seats.moves_sequentially`.
    """

    def alert(observations: NDArray[np.float32]) -> NDArray[np.int64]:
        for observer in observers:
            observer.seen(teaming, observations)
        return hmi.act(observations)

    for observer in observers:
        observer.before(teaming)
    result = teaming.turn(driver.act, alert, moves_sequentially(hmi))
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
        steps: turns to take, also after every episode has ended; until then by default. A policy
            that remembers its teams over several episodes then ages alike in all of them.

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
