"""A clip of a trained pair, in which the driver's signals can be seen."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from hmi_marl.envs.drivers import get_driver
from hmi_marl.experiments.protocols.arms import SIMULTANEOUS, TWO_STAGE
from hmi_marl.experiments.protocols.results import TaskResults
from hmi_marl.reporting.blocks import Clip

_SEED = 7
_ABOUT = {
    TWO_STAGE: "The HMI infers from what the car does whether the driver is distracted",
    SIMULTANEOUS: "The driver chooses actions that differ from the last applied one, so that each "
    "step shows whether it is carried out",
}


def signal_clips(results: TaskResults) -> list[Clip]:
    """Clips of the first runs of two-stage and of simultaneous learning, with the same driver.

    The badge says whether a^H reveals d in that step, the bar shows the exact belief in d.
    """
    if results.folder is None:
        return []
    arms = [name for name in (TWO_STAGE, SIMULTANEOUS) if name in results.plan.protocols]
    driver = results.plan.settings.driver_names[-1]
    return [
        Clip(
            f"{results.plan.name}-{arm}",
            f"{arm}, {driver} at the wheel, attention hidden. {_ABOUT[arm]}.",
            partial(_drawn, results, arm),
        )
        for arm in arms
    ]


def _drawn(results: TaskResults, arm: str) -> bytes:
    from hmi_marl.reporting import clip  # draws, which takes a while to import

    assert results.folder is not None
    plan, run = results.plan, results.plan.runs_of(arm)[0]
    place = str(run.folder(results.folder))
    config = replace(plan.team(), driver=get_driver(plan.settings.drivers[-1]))
    return clip.as_gif(config, clip.episode(config, place, place, _SEED))
