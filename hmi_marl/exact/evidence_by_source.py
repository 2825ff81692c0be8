r"""Exact evidence about the driver of recorded windows, by what is read of them, and over time.

Two things tell drivers apart. The driver policy intends other actions for another driver, and the
attention chain repeats actions and answers alerts as often as β, α and η say. With π_k, o^k_t and
the forward algorithm of :mod:`hmi_marl.exact.bayes_filter`, a window's evidence for candidate k is

==========  ==========================  ==========================================================
source      reads                       log evidence
==========  ==========================  ==========================================================
intended    a^H                         :math:`\sum_t \log \pi_k(a^H_t | o^k_t)`
chain       a^H, v, alerts              :math:`\log p_k(v_0, v_1, ... | a^H, a^A)`, whatever π_k
seen        a^H, v, alerts              the sum of both
hidden      v, alerts                   :math:`\log p_k(v_0, v_1, ... | a^A)`, all d and a^H summed
==========  ==========================  ==========================================================

With a driver policy that reads only its inflation of its traits, π_k and o^k_t are the same for
drivers of the same inflation, so that nothing but the chain tells them apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.checks import COUNT
from hmi_marl.envs.alerts import need_plain
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import Driver
from hmi_marl.envs.worlds import VEHICLE_ACTIONS
from hmi_marl.exact.bayes_filter import BayesFilter, check_candidates, check_whole
from hmi_marl.exact.identify import (
    Identification,
    StochasticPolicy,
    check_stochastic,
    check_windows,
    parts_of,
    replay_intents,
)

SOURCES = ("intended", "chain", "seen", "hidden")
"""What is read; see the module."""


def evidence_by_source(
    config: TeamConfig,
    policy: StochasticPolicy,
    drivers: Sequence[str | Driver],
    seeds: ArrayLike,
    actions: ArrayLike,
    alerts: ArrayLike,
    length: ArrayLike,
    intended: ArrayLike,
    steps: Sequence[int],
) -> dict[str, list[Identification]]:
    """Compute the evidence of E windows for K candidates, from the first steps of each.

    Args:
        config, policy, drivers, seeds, actions, alerts, length: as of
            :func:`~hmi_marl.exact.identify.identify`.
        intended: a^H_t, 0 to 4, shape (E, T).
        steps: numbers of steps that are read, rising; a window that is shorter is read as a whole.

    Returns:
        By source, the evidence after each number of steps.

    Raises:
        TypeError, ValueError: see :func:`~hmi_marl.exact.identify.identify`; also numbers of steps
            that do not rise, or intended actions of another shape or out of their range.
    """
    check_stochastic(policy)
    need_plain(config.alerts, "evidence_by_source()")
    candidates = check_candidates(drivers)
    ends = [COUNT("steps", each) for each in steps]
    if not ends or any(low >= high for low, high in pairwise(ends)):
        raise ValueError(f"steps are one or more rising numbers, not {list(steps)}")
    seeds, actions, alerts, length = check_windows(config, seeds, actions, alerts, length)
    within = np.arange(actions.shape[1]) < length[:, None]
    if np.shape(intended) != actions.shape:
        raise ValueError(f"intended has shape {actions.shape}, not {np.shape(intended)}")
    intended = check_whole("intended actions", intended, len(VEHICLE_ACTIONS), within)
    found = {source: np.zeros((len(ends), len(seeds), len(candidates))) for source in SOURCES}
    for part in parts_of(len(seeds), len(candidates)):
        read = np.minimum(length[part], ends[-1])
        data = seeds[part], actions[part], alerts[part], read
        own = _Sources(candidates, config.alert_window, len(read))
        for t, chances in enumerate(replay_intents(config, policy, candidates, *data)):
            now = actions[part, t], alerts[part, t], intended[part, t]
            own.update(chances, *now, t < read)
            for place, end in enumerate(ends):
                if t < end:  # what is later overwrites it, up to the end
                    for source, values in own.log_evidence.items():
                        found[source][place, part] = values
    return {
        source: [Identification(candidates, after) for after in values]
        for source, values in found.items()
    }


class _Sources:
    """Evidence of N windows so far, by source."""

    def __init__(self, candidates: Sequence[Driver], window: int, count: int) -> None:
        self._hidden, self._chain = (BayesFilter(candidates, window, count) for _ in range(2))
        self._intended = np.zeros((count, len(candidates)))

    def update(
        self,
        chances: NDArray[np.float64],
        applied: NDArray[np.int64],
        alerts: NDArray[np.int64],
        intended: NDArray[np.int64],
        active: NDArray[np.bool_],
    ) -> None:
        """Update with one step of the active windows; chances have shape (K, N, 5)."""
        self._hidden.update(chances, applied, alerts, active=active)
        certain = (np.arange(len(VEHICLE_ACTIONS)) == intended[:, None]).astype(np.float64)
        known = np.broadcast_to(certain, chances.shape)
        self._chain.update(known, applied, alerts, active=active)
        chosen = chances[:, np.arange(len(intended)), intended].T
        gain = np.log(chosen, out=np.full(chosen.shape, -np.inf), where=chosen > 0)
        self._intended = np.where(active[:, None], self._intended + gain, self._intended)

    @property
    def log_evidence(self) -> dict[str, NDArray[np.float64]]:
        """Shape (N, K), by source."""
        chain = self._chain.log_evidence
        seen = self._intended + chain
        return dict(
            zip(SOURCES, (self._intended, chain, seen, self._hidden.log_evidence), strict=True)
        )
