r"""What knowing the driver is worth to the HMI, exactly, for many drivers at once.

A driver is (β, α, η): inflation does not enter the alert problem. A problem is the window N, the
steps T, the reward weights and, with attention hidden, the share s of revealing steps.

**Attention seen.** The best rule of :mod:`hmi_marl.exact.oracle` is compared with fixed ones. Every
value is that of the best rule within a set:

.. math::
    V_t(d, x) = \max_{a \in A_t(d, x)} E[r_t + V_{t+1}(d_t, x')], \quad x = (i, c)

where A allows both choices (the optimum), one of them (a fixed rule), or both in some states.

**Attention hidden.** With the model of :mod:`hmi_marl.exact.hidden_attention` the value of the
belief b = p(d_{t-1} = 1) is convex and piecewise linear,

.. math::
    V_t(b, x) = (1 - s) \max_a [ r_a(b) + V_{t+1}(b'_a, x'_a) ]
              + s \max_a [ r_a(b) + b'_a V_{t+1}(1, x'_a) + (1 - b'_a) V_{t+1}(0, x'_a) ]

and is kept as the lines that are the highest somewhere in [0, 1], so that there is no grid of
beliefs and no error but rounding. A rule made for another driver alerts on a belief of its own,
which between two revealing steps follows one path; the expectation over the steps in which d is
revealed is a recursion over these.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.checks import SHARE, WORKERS, Checked
from hmi_marl.envs.attention import WINDOW, distraction_probability, next_acceptance
from hmi_marl.envs.drivers import Driver, get_driver
from hmi_marl.envs.rewards import ATTENTION_TERMS, RewardWeights, attention_terms
from hmi_marl.exact import oracle

_LINES = 64
"""Lines of an envelope at first; doubled where they are too few."""
_ROOM = 2**23
"""Numbers in the working memory of the drivers that are solved at a time, at most."""
_SILENT, _ALERT, _BOTH = 1, 2, 3


@dataclass(frozen=True)
class Problem(Checked):
    """The alert problem without the driver.

    Raises:
        ValueError, TypeError: a window or horizon out of range.
    """

    window: Annotated[int, WINDOW] = oracle.DEFAULT_WINDOW
    """N, in steps."""
    horizon: Annotated[int, oracle.HORIZON] = oracle.DEFAULT_HORIZON
    """T, steps in the episode."""
    weights: RewardWeights = field(default_factory=RewardWeights)

    def __post_init__(self) -> None:
        super().__post_init__()
        oracle.check_size(self.horizon, 2, self.window + 1, self.horizon, 2)


class SeenReturns(NamedTuple):
    """Expected attention returns of an episode with attention seen, shape (G,) each."""

    optimum: NDArray[np.float64]
    """Best rule for the driver."""
    when_distracted: NDArray[np.float64]
    """An alert exactly when distracted."""
    average: NDArray[np.float64]
    """Best rule for the assumed driver."""
    never: NDArray[np.float64]
    """No alerts."""
    no_prevention: NDArray[np.float64]
    """Best rule without alerts to an attentive driver."""
    always_when_distracted: NDArray[np.float64]
    """Best rule that always alerts a distracted driver."""


class HiddenReturns(NamedTuple):
    """Expected attention returns of an episode with attention hidden, shape (G,) each."""

    own: NDArray[np.float64]
    """Best rule on the belief of the filter that knows the driver."""
    average: NDArray[np.float64]
    """Best rule for the assumed driver, on the belief of the filter that assumes it."""


def seen_returns(
    traits: ArrayLike, problem: Problem, assumed: str | Driver = "average", threads: int = 1
) -> SeenReturns:
    """Exact returns of rules that see attention, for each driver.

    Args:
        traits: β, α and η of the drivers, shape (G, 3).
        problem: the alert problem.
        assumed: driver whose best rule is one of those compared.
        threads: at most.

    Raises:
        ValueError, TypeError: traits that are no probabilities, or another shape; an unknown
            driver.
    """
    from hmi_marl.exact.worth_kernels import follow_seen  # numba is slow to import

    tables = _Tables.of(check_drivers(traits), problem)
    allowed = _rules(get_driver(assumed), problem)
    out = np.empty((len(tables.chance), len(allowed)))
    for part in _parts(len(out), 4 * allowed[0, 0].size):
        room = np.empty((part.stop - part.start, 2, *allowed.shape[2:]))
        _run(follow_seen, threads, len(room), *tables.part(part), allowed, room, out[part])
    return SeenReturns(*np.ascontiguousarray(out.T))


def hidden_returns(
    traits: ArrayLike,
    problem: Problem,
    revealing: float,
    assumed: str | Driver = "average",
    threads: int = 1,
) -> HiddenReturns:
    """Exact returns of rules on a belief about attention, for each driver.

    The HMI sees a^H_t before its alert (sequential moves). Both rules know the share.

    Args:
        traits, problem, assumed, threads: as of :func:`seen_returns`.
        revealing: share of the steps, of those after the first, in which a^H differs from the last
            applied action.

    Raises:
        ValueError, TypeError: as of :func:`seen_returns`, or a share outside [0, 1].
    """
    from hmi_marl.exact.worth_kernels import follow_hidden

    drivers = check_drivers(traits)
    shares = np.full(problem.horizon, SHARE("revealing", revealing))
    shares[0] = 0.0  # v_0 = a^H_0 reveals nothing
    tables = _Tables.of(drivers, problem)
    alerts = _unfolded(get_driver(assumed), problem, shares)
    own, average = np.empty((2, len(drivers)))
    places = problem.window + 1
    for part in _parts(len(drivers), 2 * (problem.horizon + 1) * places):
        room = np.empty((part.stop - part.start, problem.horizon + 1, 2, places))
        more = shares, alerts, room, average[part]
        _run(follow_hidden, threads, len(room), *tables.part(part), *more)
    for part in _parts(len(drivers), 4 * (places + 2) * _LINES):
        own[part] = _best(tables.part(part), shares, 2, threads)[0]
    return HiddenReturns(own, average)


def check_drivers(traits: ArrayLike) -> NDArray[np.float64]:
    """Return β, α and η of drivers, shape (G, 3), or raise if there is none or one is no driver."""
    table = np.asarray(traits)
    if table.ndim != 2 or table.shape[1] != 3 or not len(table) or table.dtype.kind not in "fiu":
        raise ValueError(f"traits are β, α and η of each driver, shape (G, 3), not {table.shape}")
    if not ((table >= 0) & (table <= 1)).all():
        raise ValueError("β, α and η lie in [0, 1]")
    return table.astype(np.float64)


class _Tables(NamedTuple):
    """The alert problem of G drivers; see :mod:`hmi_marl.exact.worth_kernels`."""

    chance: NDArray[np.float64]
    gain: NDArray[np.float64]
    after: NDArray[np.int64]

    @classmethod
    def of(cls, traits: NDArray[np.float64], problem: Problem) -> _Tables:
        beta, alpha, eta = traits.T[:, :, None, None]
        i, d = np.indices((2, 2))
        chance = distraction_probability(d, i, beta, alpha, eta)
        action, before, now = np.indices((2, 2, 2))
        terms = attention_terms(
            problem.weights, alert=action, distracted_before=before, distracted=now
        )
        each = np.sum([terms[name] for name in ATTENTION_TERMS], axis=0)
        reward = each[:, None]  # by a, i, d before and now
        gain = (1.0 - chance[:, None]) * reward[..., 0] + chance[:, None] * reward[..., 1]
        # The places of (i, c): i = 0 is one, since c does not matter there.
        place = np.arange(problem.window + 1)
        accepted, counter = np.minimum(place, 1), np.maximum(place - 1, 0)
        alert = np.arange(2)[:, None]
        next_i, next_c = next_acceptance(accepted, counter, alert, problem.window)
        return cls(chance, np.ascontiguousarray(gain), next_i * (1 + next_c))

    def part(self, which: slice) -> _Tables:
        """The same of some of the drivers."""
        return _Tables(self.chance[which], self.gain[which], self.after)


def _rules(assumed: Driver, problem: Problem) -> NDArray[np.uint8]:
    """Sets of rules in the order of :class:`SeenReturns`; see :func:`follow_seen`."""
    allowed = np.empty((len(SeenReturns._fields), problem.horizon, 2, problem.window + 1), np.uint8)
    by_attention = {
        "optimum": (_BOTH, _BOTH),
        "when_distracted": (_SILENT, _ALERT),
        "never": (_SILENT, _SILENT),
        "no_prevention": (_SILENT, _BOTH),
        "always_when_distracted": (_BOTH, _ALERT),
    }
    for name, choices in by_attention.items():
        allowed[SeenReturns._fields.index(name)] = np.reshape(choices, (1, 2, 1))
    given = problem.window, problem.horizon, problem.weights
    policy = oracle.solve_alerts(assumed, *given).policy  # [t, d, i, c]
    average = allowed[SeenReturns._fields.index("average")]
    average[:, :, 0] = 1 + policy[:, :, 0, 0]
    average[:, :, 1:] = 1 + policy[:, :, 1]
    return allowed


def _unfolded(assumed: Driver, problem: Problem, shares: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Alerts of a driver's best rule on the belief; see :mod:`hmi_marl.exact.worth_kernels`."""
    from hmi_marl.exact.worth_kernels import unfold_rule

    horizon, places = problem.horizon, problem.window + 1
    tables = _Tables.of(np.array([assumed.traits[:3]]), problem)
    _, lines, counts = _best(tables, shares, horizon + 1, 1)
    alerts = np.zeros((horizon, 2, places, horizon, 2), np.uint8)
    driver = tables.chance[0], tables.gain[0], tables.after
    _run(unfold_rule, 1, horizon, *driver, lines[0], counts[0], alerts)
    return alerts


def _best(
    tables: _Tables, shares: NDArray[np.float64], slots: int, threads: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Value of each driver's best rule on the belief, with the lines; see :func:`solve_hidden`."""
    from hmi_marl.exact.worth_kernels import solve_hidden

    count, places, most = len(tables.chance), tables.after.shape[1], _LINES
    while True:
        lines = np.empty((count, slots, places, most, 2))
        counts = np.empty((count, slots, places), np.int64)
        room, out = np.empty((count, 2, most, 2)), np.empty(count)
        more = shares, lines, counts, room, np.empty((count, 2, most)), out
        _run(solve_hidden, threads, count, *tables, *more)
        if not np.isnan(out).any():
            return out, lines, counts
        most *= 2


def _parts(count: int, each: int) -> list[slice]:
    """Cut so many drivers into parts whose working memory, ``each`` a driver, is bounded."""
    size = max(1, _ROOM // each)
    return [slice(start, min(start + size, count)) for start in range(0, count, size)]


def _run(loop: object, threads: int, count: int, *arguments: object) -> None:
    from hmi_marl.envs.worlds.batched.compiler import prepare_once
    from hmi_marl.envs.worlds.batched.threads import share

    prepare_once(loop, *arguments)
    share(loop, count, WORKERS("threads", threads), *arguments)  # type: ignore[arg-type]
