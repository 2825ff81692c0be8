r"""Evidence of each step of a trip about the driver, from the vehicle AI's observations.

An :class:`Evidence` reads the vehicle AI's observations with sequential moves, and gives the log
likelihood of what is new for each of K candidates. :class:`ChainEvidence` is exact; a learned one
can take its place.

:class:`ChainEvidence` uses a^H, v and a^A alone. With a^H seen, d is hidden only where a^H_t agrees
with v_{t-1}. How often d is 1 elsewhere, and how alerts change that, depends on β, α and η:

.. math::
    p_k(v_t | a^H_t, v_{<t}) = b' 1(v_t = v_{t-1}) + (1 - b') 1(v_t = a^H_t)

with b' = p_k(d_t = 1) as :class:`BayesFilter` predicts it. It is exact for every HMI, since
all that the HMI sees has been seen here too. The choice of a^H_t itself is not counted: it depends
on inflation, but its likelihood needs the driver's policy and perception.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hmi_marl.envs.alerts import need_plain
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import Driver
from hmi_marl.envs.observations import one_hot, vehicle_ai_layout
from hmi_marl.envs.team_step import NO_ACTION
from hmi_marl.envs.worlds import VEHICLE_ACTIONS
from hmi_marl.exact.bayes_filter import BayesFilter, check_candidates


class Evidence(Protocol):
    """Log likelihood of each of K candidates for each of N drivers, step by step."""

    drivers: tuple[Driver, ...]
    """The candidates."""

    def reset(self, count: int, which: NDArray[np.bool_] | None = None) -> None:
        """Begin trips of unknown drivers.

        Args:
            count: N, which may change if ``which`` is None.
            which: the teams concerned, shape (N,); all by default.
        """

    def begin(self, which: NDArray[np.bool_]) -> None:
        """Begin other trips of the same drivers where ``which``, shape (N,), is set."""

    def observe(
        self, observations: NDArray[np.float32], new: NDArray[np.bool_]
    ) -> NDArray[np.float64]:
        """Log likelihood of what is new since the last observation, up to a constant for each team.

        Args:
            observations: of the vehicle AI's seat, which holds a^H_t; shape (N, D).
            new: teams in a turn that has not been observed yet, shape (N,).

        Returns:
            Shape (N, K), 0 where nothing is new; -inf where a candidate is impossible.
        """
        ...


def chains(drivers: Sequence[Driver]) -> tuple[tuple[Driver, ...], NDArray[np.int64]]:
    """Drivers who differ in β, α or η, and for each of K drivers the index of the equal one, (K,).

    Drivers who differ in inflation alone have the same chain.
    """
    table = np.array([driver.traits[:3] for driver in drivers])
    _, first, alike = np.unique(table, axis=0, return_index=True, return_inverse=True)
    return tuple(drivers[k] for k in first), alike.reshape(-1)


class ChainEvidence:
    """The exact evidence of the chain (d, i, c): from a^H, v and a^A. See the module.

    Args:
        drivers: the candidates.
        config: settings of the teams.

    Raises:
        ValueError, TypeError: no candidates, something that is no driver, or graded alerts.
    """

    def __init__(self, drivers: Sequence[str | Driver], config: TeamConfig) -> None:
        self.drivers = check_candidates(drivers)
        need_plain(config.alerts, "the exact evidence of the chain")
        self._chains, self._alike = chains(self.drivers)
        self._layout = vehicle_ai_layout(config)
        self._window = config.alert_window
        self.reset(1)

    def reset(self, count: int, which: NDArray[np.bool_] | None = None) -> None:
        """See :meth:`Evidence.reset`."""
        if which is None:
            self.filter = BayesFilter(self._chains, self._window, count)
            """p_k(d_{t-1} = 1), i_{t-1} and c_{t-1} of every different chain."""
        else:
            self.filter.forget(which)

    def begin(self, which: NDArray[np.bool_]) -> None:
        """See :meth:`Evidence.begin`."""
        self.filter.begin(which)

    def observe(
        self, observations: NDArray[np.float32], new: NDArray[np.bool_]
    ) -> NDArray[np.float64]:
        """See :meth:`Evidence.observe`."""
        layout = self._layout
        applied = layout.chosen(observations, "applied_action")
        intended = layout.chosen(observations, "previous_intended_action")
        alerted = (layout.scalar(observations, "alerted") == 1).astype(np.int64)
        seen = one_hot(intended, len(VEHICLE_ACTIONS))
        intents = np.broadcast_to(seen, (len(self._chains), *seen.shape))
        gains = self.filter.update(intents, applied, alerted, new & (applied != NO_ACTION))
        return gains[:, self._alike]
