"""A clip of a trained pair, in which the driver's signals can be seen."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

from hmi_marl.envs.drivers import get_driver
from hmi_marl.experiments.protocols.arms import SIMULTANEOUS, TWO_STAGE
from hmi_marl.experiments.protocols.results import TaskResults, signalling_arms
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
    return [
        Clip(
            f"{results.plan.name}-{arm}",
            f"{arm}, {shown['driver']} at the wheel, attention hidden. {_ABOUT[arm]}.",
            partial(_drawn, results, arm),
            [results.place("clips", arm)],
        )
        for arm, shown in clips_of(results).items()
    ]


def clips_of(results: TaskResults) -> dict[str, dict[str, Any]]:
    """Run, driver and seed of the clips, by arm; none without a folder or with attention seen."""
    task, driver = results.plan.task, results.plan.settings.driver_names[-1]
    if results.folder is None or not (task.hidden and task.sequential):
        return {}
    return {
        arm: {"run": results.plan.runs_of(arm)[0].name, "driver": driver, "seed": _SEED}
        for arm in signalling_arms(results)
    }


def _drawn(results: TaskResults, arm: str) -> bytes:
    from hmi_marl.reporting import clip  # draws, which takes a while to import

    assert results.folder is not None
    plan, run = results.plan, results.plan.runs_of(arm)[0]
    place = str(run.folder(results.folder))
    config = replace(plan.team(), driver=get_driver(plan.settings.drivers[-1]))
    return clip.as_gif(config, clip.episode(config, place, place, _SEED))
