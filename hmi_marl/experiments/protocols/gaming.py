"""Gaming: whether a protocol's drivers crash because crashing pays.

Where the reward of a step is negative, ending the episode by a crash pays. A protocol is gamed with
a driver if both hold:

1. the driver crashes more often than the two-stage driver, who learns from the driving reward
   alone: the lower end of the crash rate's Wilson interval is more than
   ``criteria.MORE_CRASHES`` above the upper end of the two-stage driver's;
2. the mean reward of a step is negative, in the reward that the driver learns from, without the
   collision term, which is not part of the steps that a crash saves.

With the first alone a protocol "crashes more": it may have learned less, or have learned to crash
while its partner was worse than it is now. The run that was trained with ``end_at_crash=False``,
where crashing ends nothing, shows which.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from hmi_marl.experiments import criteria
from hmi_marl.experiments.episode_sums import ALL_DRIVERS, mean_metrics
from hmi_marl.experiments.protocols.arms import TWO_STAGE
from hmi_marl.experiments.protocols.pairs import Pair
from hmi_marl.experiments.protocols.results import TaskResults, crash_rate
from hmi_marl.reporting.statistics import UNKNOWN, Estimate

Finding = Literal["reference", "fine", "crashes more", "GAMED", "unknown"]
_WORST: tuple[Finding, ...] = ("GAMED", "crashes more", "unknown", "fine", "reference")


@dataclass(frozen=True)
class Gaming:
    """Crashes of one protocol with one driver, or ``ALL_DRIVERS``, and whether crashing pays."""

    protocol: str
    driver: str
    crash_rate: Estimate
    """Crash rate over all seeds; a crash ends the episode, in training and now."""
    two_stage_crash_rate: Estimate
    """Crash rate of the two-stage driver."""
    team_return: float
    """Team return per episode; of all drivers together every one counts the same."""
    team_return_per_step: float
    worth_of_a_step: float
    """Mean reward of a step that the driver learns from, without the collision term."""
    crash_rate_if_trained_standing: Estimate
    """Crash rate of the first run trained with ``end_at_crash=False``; a crash ends it now."""
    crash_rate_standing: Estimate
    """Crash rate of the same run in its own setting: the crashed car stands until the end.
    Deterministic policies crash in the same episodes."""
    team_return_standing: float
    """Team return per episode in that setting."""
    finding: Finding


def find(rate: Estimate, reference: Estimate, worth_of_a_step: float) -> Finding:
    """Apply the rule at the top of this page."""
    if not all(map(math.isfinite, (rate.low, reference.high, worth_of_a_step))):
        return "unknown"
    if rate.low <= reference.high + criteria.MORE_CRASHES:
        return "fine"
    return "GAMED" if worth_of_a_step < 0.0 else "crashes more"


def gaming_of(results: TaskResults) -> list[Gaming]:
    """Look for gaming in every protocol, with all drivers together and with each driver."""
    plan, rows = results.plan, []
    names = (ALL_DRIVERS, *plan.settings.driver_names)
    for protocol, driver in ((one, name) for one in plan.protocols for name in names):
        sums = results.pooled(results.own(protocol), driver)
        reference = UNKNOWN
        if TWO_STAGE in plan.protocols:
            reference = results.crash_rate(results.own(TWO_STAGE), driver)
        terms = [name for name in plan.driver_terms(protocol) if name != "collision"]
        worth = sums.per_step(terms)
        ends, stands = UNKNOWN, UNKNOWN
        standing_return = math.nan
        for run in plan.standing_runs:
            if run.arm == protocol:
                pairs = [Pair(plan.name, run.name, run.name, over) for over in (True, False)]
                ends = crash_rate(results.played[pairs[0]].sums[driver])
                stands = crash_rate(results.played[pairs[1]].sums[driver])
                standing_return = _team_return(results, pairs[1:], driver)
        rate = crash_rate(sums)
        rows.append(
            Gaming(
                protocol=protocol,
                driver=driver,
                crash_rate=rate,
                two_stage_crash_rate=reference,
                team_return=_team_return(results, results.own(protocol), driver),
                team_return_per_step=sums.per_step(),
                worth_of_a_step=worth,
                crash_rate_if_trained_standing=ends,
                crash_rate_standing=stands,
                team_return_standing=standing_return,
                finding="reference" if protocol == TWO_STAGE else find(rate, reference, worth),
            )
        )
    return rows


def _team_return(results: TaskResults, pairs: Sequence[Pair], driver: str) -> float:
    names = results.plan.settings.driver_names if driver == ALL_DRIVERS else (driver,)
    return mean_metrics(results.pooled(pairs, name) for name in names)["team_return"]


def worst_finding(gaming: Sequence[Gaming], protocol: str) -> Finding:
    """Return the worst of a protocol's findings."""
    found = {row.finding for row in gaming if row.protocol == protocol}
    return next(finding for finding in _WORST if finding in found)
