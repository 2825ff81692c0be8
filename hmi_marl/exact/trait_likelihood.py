r"""Log likelihood of driving for many candidates at once, other ones for each person.

The model of a window is that of :mod:`hmi_marl.exact.bayes_filter`: d is hidden, i and c follow
from the alerts. With the d that candidate k would have,

.. math::
    p(v_t | d_t = 1) = 1(v_t = v_{t-1}), \quad p(v_t | d_t = 0) = \chi_t

where v_0 = a^H_0 whatever d_0, and χ_t depends on what is known:

==============  ========================  ===================================================
a^H             driver policy             χ_t, and a further factor of the step
==============  ========================  ===================================================
hidden          known                     π_k(v_t | o^k_t)
seen            known                     1(v_t = a^H_t), times π_k(a^H_t | o^k_t)
seen            unknown                   1(v_t = a^H_t)
hidden          unknown                   1 - s if v_t = v_{t-1}, else s; 1 in the first step
==============  ========================  ===================================================

s is the share of revealing steps of :mod:`hmi_marl.exact.hidden_attention`. Windows of one person
are independent given the traits and s, so that their log likelihoods add up.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.envs.attention import next_acceptance
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import TRAIT_NAMES, Traits
from hmi_marl.envs.observations import driver_layout, traits_part
from hmi_marl.envs.team_step import NO_ACTION
from hmi_marl.envs.worlds import VEHICLE_ACTIONS
from hmi_marl.exact.bayes_filter import check_whole
from hmi_marl.exact.identify import StochasticPolicy, check_windows, intents, replay
from hmi_marl.exact.intent_network import network_of

if TYPE_CHECKING:
    from hmi_marl.envs.worlds.batched.threads import Pace

_CELLS = 2**16
"""Windows times candidates followed side by side at most, which bounds the memory."""


@dataclass(frozen=True, eq=False)
class Windows:
    """E windows of P persons, at most T steps long."""

    seeds: NDArray[np.uint64] | None
    """Seeds that play them again, shape (E,); None where none are played again."""
    actions: NDArray[np.int64]
    """v_t, shape (E, T)."""
    alerts: NDArray[np.int64]
    """a^A_t, shape (E, T)."""
    length: NDArray[np.int64]
    """Steps of each window, shape (E,); what is later is 0 and not read."""
    intended: NDArray[np.int64] | None
    """a^H_t, shape (E, T); None if hidden."""
    of_person: tuple[NDArray[np.int64], ...]
    """Windows of each person, in their order."""

    @classmethod
    def checked(
        cls,
        config: TeamConfig,
        seeds: ArrayLike | None,
        actions: ArrayLike,
        alerts: ArrayLike,
        length: ArrayLike,
        intended: ArrayLike | None,
        person: ArrayLike | None,
    ) -> Windows:
        """Check the arguments of :func:`trait_posterior`, for its errors."""
        given = np.zeros(np.shape(actions)[:1], np.uint64) if seeds is None else seeds
        place, actions, alerts, length = check_windows(config, given, actions, alerts, length)
        if len(place) == 0:
            raise ValueError("a posterior takes at least one window")
        if not (np.issubdtype(place.dtype, np.integer) and np.issubdtype(length.dtype, np.integer)):
            raise TypeError(f"seeds and lengths are integers, not {place.dtype} and {length.dtype}")
        within = np.arange(actions.shape[1]) < length[:, None]
        actions = check_whole("applied actions", actions, len(VEHICLE_ACTIONS), within)
        alerts = check_whole("alerts", alerts, 2, within)
        if intended is not None:
            intended = check_whole("intended actions", intended, len(VEHICLE_ACTIONS), within)
        who = np.zeros(len(place), np.int64) if person is None else np.asarray(person)
        if who.shape != place.shape or not np.issubdtype(who.dtype, np.integer):
            raise ValueError(
                f"person holds a number for each window, integers of shape {place.shape}, but got "
                f"{who.dtype} of shape {who.shape}"
            )
        count = int(who.max()) + 1
        windows = tuple(np.flatnonzero(who == p) for p in range(count))
        if who.min() < 0 or not all(map(len, windows)):
            raise ValueError("persons are numbered 0, 1, 2, ... without a gap")
        return cls(None if seeds is None else place, actions, alerts, length, intended, windows)

    def take(self, which: NDArray[np.int64]) -> Windows:
        """Select windows, without saying whose."""
        seeds = None if self.seeds is None else self.seeds[which]
        intended = None if self.intended is None else self.intended[which]
        data = self.actions[which], self.alerts[which], self.length[which]
        return Windows(seeds, *data, intended, ())


class TraitLikelihood:
    """Log likelihood of windows, by person and candidate.

    Args:
        config: settings of the teams.
        policy: the driver policy, or None if it is unknown; see the module.
        windows: of P persons.
    """

    def __init__(
        self, config: TeamConfig, policy: StochasticPolicy | None, windows: Windows
    ) -> None:
        self._config, self._policy, self._windows = config, policy, windows
        from hmi_marl.envs.worlds.batched.threads import Pace  # numba is slow to import

        self._pace = Pace()
        self._network = None if policy is None else network_of(policy, driver_layout(config))

    def __call__(
        self,
        persons: NDArray[np.int64],
        traits: NDArray[np.float64],
        revealing: NDArray[np.float64] | None = None,
    ) -> NDArray[np.float64]:
        """Log likelihood of all windows of each person for each of their candidates.

        Args:
            persons: numbers of p of the P persons, shape (p,).
            traits: of their candidates, shape (p, M, J, 4), columns as in ``TRAIT_NAMES``. The J
                candidates of a row have the same inflation.
            revealing: s of each candidate, shape (p, M, J); read only if the policy is unknown and
                a^H is hidden.

        Returns:
            Shape (p, M, J); -inf for candidates who cannot have driven so.

        Raises:
            ValueError: a window goes on after its end when it is played again.
        """
        found = np.empty(traits.shape[:3])
        sizes = [len(self._windows.of_person[p]) for p in persons]
        candidates = traits.shape[1] * traits.shape[2]
        for part in _parts(sizes, max(1, _CELLS // candidates)):
            rows = [self._windows.of_person[p] for p in persons[part]]
            owner = np.repeat(np.arange(len(rows)), sizes[part])
            share = None if revealing is None else revealing[part]
            by_window = self._follow(np.concatenate(rows), owner, traits[part], share)
            for place, person in enumerate(range(part.start, part.stop)):
                own = by_window[owner == place]
                found[person] = own.sum(axis=0).reshape(traits.shape[1:3])
        return found

    def _follow(
        self,
        rows: NDArray[np.int64],
        owner: NDArray[np.int64],
        traits: NDArray[np.float64],
        revealing: NDArray[np.float64] | None,
    ) -> NDArray[np.float64]:
        """Log likelihood of these windows of p persons, shape (E, M J)."""
        from hmi_marl.exact.trait_kernels import filter_windows  # numba is slow to import

        windows = self._windows.take(rows)
        flat = np.ascontiguousarray(traits.reshape(len(traits), -1, len(TRAIT_NAMES)))
        shape = len(rows), flat.shape[1]
        distracted, attentive, log_evidence = np.zeros(shape), np.ones(shape), np.zeros(shape)
        accepted, counter = np.zeros((2, len(rows)), np.int64)
        applied = np.full(len(rows), NO_ACTION)
        seen = windows.intended is not None
        for t, chance in enumerate(self._chances(windows, owner, traits, revealing)):
            active, v = t < windows.length, windows.actions[:, t]
            accepted, counter = next_acceptance(
                accepted, counter, windows.alerts[:, t], self._config.alert_window
            )
            follows = v == windows.intended[:, t] if windows.intended is not None else active
            step = t == 0, _as_float(v == applied), _as_float(accepted), _as_float(follows), seen
            _run(
                filter_windows, None, active, owner, *step, flat, chance,
                distracted, attentive, log_evidence,
            )  # fmt: skip
            applied = v
        return log_evidence

    def _chances(
        self,
        windows: Windows,
        owner: NDArray[np.int64],
        traits: NDArray[np.float64],
        revealing: NDArray[np.float64] | None,
    ) -> Iterator[NDArray[np.float64]]:
        """π of each step's v_t, or of a^H_t if seen, for each candidate: shape (E, M J)."""
        if self._policy is not None:
            yield from self._intended(windows, owner, traits)
            return
        shape = len(owner), traits.shape[1] * traits.shape[2]
        certain = np.ones(shape)
        share = certain if revealing is None else revealing.reshape(len(traits), -1)[owner]
        for t in range(int(windows.length.max())):
            if t == 0 or windows.intended is not None:
                yield certain
            else:
                kept = windows.actions[:, t] == windows.actions[:, t - 1]
                yield np.where(kept[:, None], 1.0 - share, share)

    def _intended(
        self, windows: Windows, owner: NDArray[np.int64], traits: NDArray[np.float64]
    ) -> Iterator[NDArray[np.float64]]:
        """The same by a known policy."""
        assert self._policy is not None
        assert windows.seeds is not None
        people, inflations, same, _ = traits.shape
        inflation = np.ascontiguousarray(traits[owner, :, 0, TRAIT_NAMES.index("inflation")].T)
        data = windows.seeds, windows.actions, windows.alerts, windows.length
        replayed = replay(self._config, inflation, *data)
        chosen = windows.actions if windows.intended is None else windows.intended
        table = traits_part(Traits.from_array(traits.reshape(-1, len(TRAIT_NAMES))))
        shown = table.astype(np.float32).reshape(people, inflations * same, len(TRAIT_NAMES))
        if self._network is None:
            self._policy.reset(np.tile(windows.seeds, inflations * same))
        else:
            room = self._network.room(len(owner))
            out = np.empty((len(owner), inflations * same))
        for t, seen in enumerate(replayed):
            if self._network is None:
                yield self._asked(seen, owner, shown, chosen[:, t])
                continue
            arguments = t < windows.length, owner, seen, np.ascontiguousarray(chosen[:, t]), shown
            more = *self._network.arrays(self._policy), room, out
            _run(self._network.kernel, self._pace, *arguments, *more)
            yield out

    def _asked(
        self,
        seen: NDArray[np.float32],
        owner: NDArray[np.int64],
        shown: NDArray[np.float32],
        action: NDArray[np.int64],
    ) -> NDArray[np.float64]:
        """Probability of the actions by asking the policy, which may remember what it has seen."""
        assert self._policy is not None
        inflations, count, _ = seen.shape
        same = shown.shape[1] // inflations
        each = np.repeat(seen, same, axis=0)  # (M J, E, D)
        layout = driver_layout(self._config)
        if "traits" in layout:
            each[..., layout["traits"]] = shown[owner].swapaxes(0, 1)
        chances = intents(self._policy, each.reshape(-1, each.shape[-1]))
        chances = chances.reshape(inflations * same, count, -1)
        return np.ascontiguousarray(chances[:, np.arange(count), action].T)


def _parts(sizes: list[int], most: int) -> Iterator[slice]:
    """Cut persons into runs of ``most`` windows at most, but of one person at least."""
    start, total = 0, 0
    for place, size in enumerate(sizes):
        if place > start and total + size > most:
            yield slice(start, place)
            start, total = place, 0
        total += size
    yield slice(start, len(sizes))


def _as_float(values: NDArray[Any]) -> NDArray[np.float64]:
    return values.astype(np.float64)


def _run(loop: Any, pace: Pace | None, active: NDArray[np.bool_], *arguments: Any) -> None:
    """Run a compiled loop over windows, on one thread or, by ``pace``, on whatever is faster."""
    from hmi_marl.envs.worlds.batched.compiler import prepare_once
    from hmi_marl.envs.worlds.batched.threads import available, share

    prepare_once(loop, active, *arguments)
    if pace is None:
        share(loop, len(active), 1, active, *arguments)
    else:
        pace.run(loop, len(active), available(), active, *arguments)
