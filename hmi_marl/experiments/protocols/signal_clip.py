"""A clip of a trained pair, in which the driver's signals can be seen."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

from hmi_marl.envs.drivers import get_driver
from hmi_marl.experiments.protocols.results import TaskResults, revealing, signalling_arms
from hmi_marl.reporting.blocks import Clip

_SEED = 7


def signal_clips(results: TaskResults) -> list[Clip]:
    """Clips of the first runs of two-stage and of simultaneous learning, with the same driver.

    The badge says whether a^H reveals d in that step, the bar shows the exact belief in d. The
    caption says how often it does so with this driver in all episodes of the run.
    """
    return [
        Clip(
            f"{results.plan.name}-{arm}",
            f"{arm}, {shown['driver']} at the wheel, attention hidden. The HMI infers from what "
            "the car does whether the driver is distracted. In "
            f"{100 * shown['revealing']:.0f} % of this run's steps with {shown['driver']} the "
            "driver's action differs from the last applied one, so that the car shows it.",
            partial(_drawn, results, arm),
            [results.place("clips", arm)],
        )
        for arm, shown in clips_of(results).items()
    ]


def clips_of(results: TaskResults) -> dict[str, dict[str, Any]]:
    """Run, driver and seed of the clips, and the share of that driver's steps that reveal d.

    By arm; none without a folder or with attention seen.
    """
    task, driver = results.plan.task, results.plan.settings.driver_names[-1]
    if results.folder is None or not (task.hidden and task.sequential):
        return {}
    clips = {}
    for arm in signalling_arms(results):
        pair = results.own(arm)[0]
        share = revealing(results.played[pair], driver)
        clips[arm] = {"run": pair.driver, "driver": driver, "seed": _SEED, "revealing": share}
    return clips


def _drawn(results: TaskResults, arm: str) -> bytes:
    from hmi_marl.reporting import clip  # draws, which takes a while to import

    assert results.folder is not None
    plan, run = results.plan, results.plan.runs_of(arm)[0]
    place = str(run.folder(results.folder))
    config = replace(plan.team(), driver=get_driver(plan.settings.drivers[-1]))
    return clip.as_gif(config, clip.episode(config, place, place, _SEED))
