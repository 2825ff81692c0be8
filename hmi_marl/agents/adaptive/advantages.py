"""What an alert is worth now with each of several drivers, by the exact rules for them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.memory import AttentionWatch
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import Driver
from hmi_marl.exact.evidence import chains
from hmi_marl.exact.hidden_attention import look_up, solve_belief


class Advantages:
    """Advantage of alerting now over silence in N teams, for each candidate k who may be driving.

    It is A_k(t, b_k, i, c) of the rule that is optimal on b_k = p_k(d = 1) and followed from then
    on; see :func:`solve_belief`. Candidates who differ in inflation alone have the same chain of
    attention and so the same advantage: K candidates have C different chains.

    Args:
        candidates: the K drivers.
        config: settings of the teams.
        revealing: assumed share of steps in which a^H differs from the last applied action.
    """

    def __init__(self, candidates: Sequence[Driver], config: TeamConfig, revealing: float) -> None:
        different, alike = chains(candidates)
        self._attention = AttentionWatch(different, config)
        game = config.alert_window, config.horizon, config.weights, revealing
        tables = (solve_belief(driver, *game).advantage for driver in different)
        self._tables = _stacked(tables, len(different))
        """[chain, t, m, b, i, c]; see :class:`BeliefSolution`."""
        self._has_chain = (alike[:, None] == np.arange(len(different))).astype(np.float64)

    def reset(self, count: int, which: NDArray[np.bool_] | None = None) -> None:
        """Begin episodes in the marked teams out of ``count``; in all by default."""
        self._attention.reset(count, which)

    def observe(self, observations: NDArray[np.float32]) -> NDArray[np.float64]:
        """Return the advantage for each chain in the vehicle AI's turn, shape (N, C).

        To be called in every turn; ``observations`` are the vehicle AI's, shape (N, D).
        """
        step = self._attention.observe(observations)
        reveals = self._attention.reveals(observations).astype(np.int64)
        now = self._attention.filter
        who = np.arange(len(self._tables))
        t, m, i, c = (x[:, None] for x in (step, reveals, now.accepted, now.counter))
        return look_up(self._tables, (who, t, m), now.distracted, (i, c))

    def by_chain(self, probabilities: NDArray[np.float64]) -> NDArray[np.float64]:
        """Sum probabilities of candidates, shape (N, K), over those of each chain: (N, C)."""
        return probabilities @ self._has_chain


def _stacked(tables: Iterable[NDArray[np.float32]], count: int) -> NDArray[np.float32]:
    """Stack so many tables of one shape, each as it comes: hundreds take a gigabyte."""
    rest = iter(tables)
    first = next(rest)
    whole = np.empty((count, *first.shape), first.dtype)
    whole[0] = first
    for place, table in zip(whole[1:], rest, strict=True):
        place[...] = table
    return whole
