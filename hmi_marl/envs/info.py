"""What ``info`` tells about one team after each step, for evaluation and pictures."""

from __future__ import annotations

from typing import Any

from hmi_marl.envs.alerts import FULL
from hmi_marl.envs.rewards import TERMS
from hmi_marl.envs.teaming import StepResult, Teaming


def team_info(teaming: Teaming, result: StepResult | None, team: int = 0) -> dict[str, Any]:
    """Plain numbers about one team.

    ``distracted`` (d), ``accepted`` (i), ``counter`` (c), ``applied_action`` (v, -1 before the
    first step), ``crashed``, ``speed`` [m/s], ``time_headway`` [s] to whatever is ahead in the
    lane (inf if nothing is), ``beta``, ``alpha``, ``eta``, ``inflation``, and one entry per
    reward term, 0 before the first step. With alerts of other strengths than 1 also ``strength``,
    that of the alert in effect, 0 if none is; with fatigue also ``fatigue``, its level.
    """
    attention, ego, traits = teaming.attention, teaming.ego, teaming.traits
    alerts = teaming.alerts
    more: dict[str, float] = {}
    if alerts.strengths != FULL:
        more["strength"] = float(alerts.strength(attention.accepted[team]))
    if alerts.fatigue is not None:
        more["fatigue"] = int(attention.fatigue[team])
    return {
        "distracted": bool(attention.distracted[team]),
        "accepted": bool(attention.accepted[team]),
        "counter": int(attention.counter[team]),
        "applied_action": int(teaming.applied[team]),
        "crashed": bool(ego.crashed[team]),
        "speed": float(ego.speed[team]),
        "time_headway": float(teaming.time_headway()[team]),
        "beta": float(traits.beta[team]),
        "alpha": float(traits.alpha[team]),
        "eta": float(traits.eta[team]),
        "inflation": float(traits.inflation[team]),
        **more,
        **{name: float(result.terms[name][team]) if result else 0.0 for name in TERMS},
    }
