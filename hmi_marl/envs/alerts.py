r"""Alerts and their effects: one strength or several, with fatigue or without.

The paper's HMI has one bit, alert or not; the paper says that the signal may be extended. Here
a^A = 0 is no alert and a^A = j one of the j-th strength s_j in (0, 1], with s_0 = 0. While an alert
of strength s is in effect, η becomes η s; while the driver is attentive, it costs the share s of
the reward for no alert (see :func:`hmi_marl.envs.rewards.attention_terms`). The paper's alert has
s = 1.

A weaker alert does not undo a stronger one that is in effect. If it did, the optimum would give
weak alerts so that an attentive driver is distracted again, since bringing them back is what
R_accept-alert pays for.

With :class:`Fatigue`, f in 0 .. F is the driver's level of fatigue from alerts. A step with
an alert of strength s raises it by the alert's rise, ⌈r s⌉; a step without one lowers it by 1; and
what an alert does in step t is weakened by the alerts before that step:

.. math::
    \eta_t = \eta \, s_{i_t} \left(1 - \epsilon \frac{f_{t-1}}{F}\right), \qquad
    f_t = \begin{cases} \min(F, f_{t-1} + \lceil r s_{a_t} \rceil) & a_t > 0 \\
    \max(0, f_{t-1} - 1) & a_t = 0 \end{cases}

So the order within a step is c, i, d, f, and the first alert to a rested driver helps in full.
Given the alerts f moves for sure, so that (d, i, c, f) is a finite Markov state.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.checks import Check, Checked, Real, Share, Whole, shown

FULL = (1.0,)
"""The strengths of the paper's one bit."""
MOST_STRENGTHS = 100
_STRENGTH = Real(0.0, 1.0, above=True)
FatigueLevels = Annotated[int, Whole(1, 1000)]


def check_strengths(strengths: Sequence[float] | NDArray[np.float64]) -> tuple[float, ...]:
    """Return the strengths of alerts, or raise if they do not rise within (0, 1]."""
    if not isinstance(strengths, (list, tuple, np.ndarray)) or np.ndim(strengths) != 1:
        raise TypeError(f"alert_strengths is a tuple of numbers, not {shown(strengths)}")
    if len(strengths) > MOST_STRENGTHS:
        raise ValueError(
            f"there are at most {MOST_STRENGTHS} alert_strengths, not {len(strengths)}"
        )
    checked = tuple(_STRENGTH("each of alert_strengths", strength) for strength in strengths)
    if not checked or any(low >= high for low, high in pairwise(checked)):
        raise ValueError(
            f"alert_strengths rise within (0, 1], such as (0.5, 1.0), not {shown(checked)}"
        )
    return checked


Strengths = Annotated[
    tuple[float, ...],
    Check(lambda name, strengths: check_strengths(strengths), "up to 100 that rise within (0, 1]"),
]


@dataclass(frozen=True)
class Fatigue(Checked):
    """Loss of effect of alerts that pile up.

    Raises:
        ValueError, TypeError: a number out of its range, by name.
    """

    levels: FatigueLevels = 10
    """F: the highest level of fatigue, 1 to 1000."""
    per_alert: FatigueLevels = 2
    """r: levels by which an alert of strength 1 raises fatigue. Weaker ones do so in proportion,
    rounded up to a whole level; every step without an alert lowers it by one."""
    effect: Share = 0.5
    """ε: share of η that is lost at the highest level, 0 to 1."""

    def _named(self, field: str) -> str:
        return f"fatigue: {field}"

    def __str__(self) -> str:
        return f"{self.per_alert} of {self.levels} levels per alert, which take {self.effect:g} η"


class Effects(NamedTuple):
    """Effects of alerts as numbers, for :func:`help_share` and :func:`next_level`."""

    strengths: NDArray[np.float64]
    """Strength of each a^A, 0 .. k."""
    changes: NDArray[np.int64]
    """Change of the level of fatigue by each a^A."""
    levels: int
    """F, 0 without fatigue."""
    loss: float
    """ε, 0 without fatigue."""
    scale: int
    """F, 1 without fatigue."""


def help_share(effects: Effects, accepted: Any, fatigue: Any) -> Any:
    """Share of η that helps in step t, in [0, 1], from i_t and f_{t-1}."""
    return effects.strengths[accepted] * (1.0 - effects.loss * (fatigue / effects.scale))


def next_level(effects: Effects, fatigue: Any, alert: Any) -> Any:
    """f_t from f_{t-1} and a^A_t."""
    return np.minimum(np.maximum(fatigue + effects.changes[alert], 0), effects.levels)


@dataclass(frozen=True)
class Alerts(Checked):
    """The alerts that an HMI can give.

    Raises:
        ValueError, TypeError: strengths that do not rise within (0, 1], or no Fatigue.
    """

    strengths: Strengths = FULL
    """s_1 < s_2 < ... < s_k, each in (0, 1]."""
    fatigue: Fatigue | None = None
    """Fatigue from alerts, if there is any."""

    @property
    def choices(self) -> int:
        """Number of the vehicle AI's actions, k + 1."""
        return len(self.strengths) + 1

    @property
    def strongest(self) -> int:
        """The a^A of the strongest alert, k."""
        return len(self.strengths)

    @property
    def levels(self) -> int:
        """F, 0 without fatigue."""
        return self.fatigue.levels if self.fatigue else 0

    @property
    def plain(self) -> bool:
        """Whether this is the paper's one bit."""
        return self == PLAIN

    def shape(self, window: int) -> tuple[int, ...]:
        """Shape of the states (d, i, c): (2, k + 1, N), or (..., F + 1) of (d, i, c, f)."""
        levels = (self.levels + 1,) if self.fatigue else ()
        return (2, self.choices, window, *levels)

    def strength(self, alert: ArrayLike) -> NDArray[np.float64]:
        """The strength s of every a^A or i, integers 0 .. k of any shape."""
        return self.effects.strengths[np.asarray(alert)]

    def nearest(self, strength: ArrayLike) -> NDArray[np.int64]:
        """The a^A or i, 0 .. k, nearest in strength: the inverse of :meth:`strength`.

        Strengths may be rounded to single precision, as observations show them.
        """
        strengths = self.effects.strengths
        middle = (strengths[1:] + strengths[:-1]) / 2
        return np.searchsorted(middle, np.asarray(strength)).astype(np.int64)

    def help(self, accepted: ArrayLike, fatigue: ArrayLike) -> NDArray[np.float64]:
        """The share of η that helps in step t, in [0, 1], from i_t and f_{t-1}, broadcast."""
        return help_share(self.effects, np.asarray(accepted), np.asarray(fatigue))

    def next_fatigue(self, fatigue: ArrayLike, alert: ArrayLike) -> NDArray[np.int64]:
        """f_t from f_{t-1} and a^A_t, broadcast; stays as it is without fatigue."""
        return next_level(self.effects, np.asarray(fatigue, np.int64), np.asarray(alert))

    @cached_property
    def effects(self) -> Effects:
        """The effects of each a^A as numbers, in arrays that cannot be written to."""
        effects = self._effects()
        effects.strengths.flags.writeable = effects.changes.flags.writeable = False
        return effects

    def _effects(self) -> Effects:
        strengths = np.array((0.0, *self.strengths))
        if self.fatigue is None:
            return Effects(strengths, np.zeros(self.choices, np.int64), 0, 0.0, 1)
        # Rounded first, so that 100 x 0.07 = 7.000000000000001 is 7 levels and not 8.
        rises = [math.ceil(round(self.fatigue.per_alert * s, 9)) for s in self.strengths]
        changes = np.array([-1, *(max(1, rise) for rise in rises)])
        return Effects(strengths, changes, self.levels, self.fatigue.effect, self.levels)


def need_plain(alerts: Alerts, method: str) -> None:
    """Raise ``ValueError`` unless the alerts are the paper's, for which ``method`` is derived."""
    if not alerts.plain:
        raise ValueError(
            f"{method} is for alerts of one strength, 1, without fatigue, but alert_strengths = "
            f"{alerts.strengths} and fatigue = {alerts.fatigue}"
        )


PLAIN = Alerts()
"""The paper's one bit: alert or not, without fatigue."""
