"""Policies that several experiments learn or share, and the episodes that all of them play."""

from __future__ import annotations

from pathlib import Path

from hmi_marl.envs.drivers import PAPER_DRIVERS, Driver
from hmi_marl.training.jobs import Job
from hmi_marl.training.protocols.two_stage import TwoStage

EVALUATION_SEED = 10**9
"""Seed of the first evaluation episode; no training comes near it."""
DRIVER_RUN = "driver"
"""Folder of a run that learns a driver policy."""
MODELS = (*PAPER_DRIVERS, "average")
"""Drivers that HMIs without sight of attention are learned for."""
HIDDEN_RUN = "hmi-{}"
"""Folder of the run of each of these HMIs, {} for the driver model."""
HIDDEN_EXPERIMENT = "hidden"
"""Experiment that learns them, and its folder in a reproduction."""


def spec(driver: Driver) -> str:
    """Write a driver as the command line takes one."""
    return f"{driver.name}:{driver.beta:g},{driver.alpha:g},{driver.eta:g},{driver.inflation:g}"


def driver_job(
    drivers: tuple[str, ...], steps: int, num_teams: int, seed: int, folder: Path
) -> Job:
    """Training of one driver policy over these drivers, in a run below ``folder``."""
    settings = TwoStage(
        drivers=drivers, driver_steps=steps, hmi_steps=0, num_teams=num_teams, seed=seed
    )
    return Job(settings, folder / DRIVER_RUN)
