"""Alerts of a calibration, and HMIs of a within-person trial in blinded order."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import numpy as np

from hmi_marl.agents.catalogue import make_hmi
from hmi_marl.agents.hmis import AttentionRule
from hmi_marl.checks import Whole
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import Driver, spelled_out
from hmi_marl.envs.streams import check_seed
from hmi_marl.exact import oracle

TRIAL = ("own", "average", "none")
"""HMIs of a trial: the optimum for the measured traits, that for the average driver, no alerts."""
_NUMBER = Whole(0, 10**9)


@dataclass(frozen=True)
class TrialHMI:
    """One HMI of a trial."""

    partner: str
    """Its name in the catalogue, as a trip's record keeps it; it also makes the policy."""
    attention_return: float | None
    """Exact expected attention return of an episode of the measured driver; None if the HMI does
    not see attention."""
    distraction_return: float | None
    """Exact expected distraction return."""
    alerts: float | None
    """Exact expected number of alerts."""


def calibration_alerts(config: TeamConfig) -> str:
    """Name of the HMI of a calibration, which alerts at random.

    At its rate half of all steps are within a window: 1 - 0.5^(1/N) for a window of N steps.
    """
    return f"random:{1.0 - 0.5 ** (1.0 / config.alert_window):.4f}"


def best_hmis(driver: Driver, config: TeamConfig) -> dict[str, TrialHMI]:
    """Return the HMIs of a trial with a driver, by name: own, average and none.

    Args:
        driver: the measured traits.
        config: settings of the teams; its driver is not read.
    """
    names = {"own": f"optimal:{spelled_out(driver)}", "average": "average", "none": "never"}
    found = {}
    for name in TRIAL:
        policy = make_hmi(names[name], config)
        worth: tuple[float, ...] | tuple[None, ...] = (None, None, None)
        if isinstance(policy, AttentionRule):
            returns = oracle.evaluate(
                policy.alert_probability(),
                driver,
                config.alert_window,
                config.horizon,
                config.weights,
                strengths=config.alert_strengths,
                fatigue=config.fatigue,
            )
            worth = (returns.total_return, returns.distraction_return, returns.alerts)
        found[name] = TrialHMI(names[name], *worth)
    return found


def blinded_order(number: int, seed: int = 0) -> tuple[str, ...]:
    """Order of the three HMIs for a visitor.

    Each six visitors in a row get the six orders once each, so that every HMI comes equally often
    in every place and after every other (Williams' design, two Latin squares). Which of the six
    gets which order is drawn from the seed.

    Args:
        number: of the visitor, counted from 0.
        seed: of the study.

    Raises:
        ValueError, TypeError: a number or a seed out of range.
    """
    block, place = divmod(_NUMBER("number", number), 6)
    rows = np.random.default_rng([check_seed(seed), block]).permutation(6)
    return tuple(permutations(TRIAL))[rows[place]]
