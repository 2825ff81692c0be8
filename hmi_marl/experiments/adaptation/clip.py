"""A clip of an HMI that gets to know its driver, and then another one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from hmi_marl.agents.adaptive.factory import EXPECTED, Trained, make_adaptive
from hmi_marl.agents.catalogue import make_driver_policy
from hmi_marl.agents.rollout import begin
from hmi_marl.envs.drivers import Traits, get_driver
from hmi_marl.experiments.adaptation.evaluation import TEAM
from hmi_marl.experiments.adaptation.settings import AdaptSettings
from hmi_marl.reporting import clip

FIRST, SECOND = "bart", "homer"
SEED = 4
_PICTURES_PER_STEP = 1


def record_change(
    path: Path, driver_policy: str, trained: Trained, settings: AdaptSettings, seed: int = SEED
) -> None:
    """Write one trip in the middle of which Homer takes the wheel from Bart, as .gif or .mp4.

    Args:
        path: of the clip.
        driver_policy: who steers.
        trained: what the HMI is made of.
        settings: share of revealing steps and caution, as the HMI assumes them.
        seed: of the trip.
    """
    config = replace(TEAM, driver=FIRST)
    hmi = make_adaptive(
        EXPECTED,
        config,
        trained=trained,
        revealing=settings.revealing,
        caution=settings.caution,
    )
    driver = make_driver_policy(driver_policy, config)
    teaming = begin(config, driver, hmi, np.array([seed], np.uint64), "highway")
    change = config.horizon // 2, Traits.of([get_driver(SECOND)])
    moments = clip.moments(teaming, driver, hmi, change)
    clip.record(path, config, moments, _PICTURES_PER_STEP)
