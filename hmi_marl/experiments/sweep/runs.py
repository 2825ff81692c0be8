"""Train one run of a sweep and play its evaluation episodes, in its folder, on any machine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import hmi_marl
from hmi_marl.checks import Checked, Count
from hmi_marl.envs.config import AGENTS, DRIVER, VEHICLE_AI, TeamConfig
from hmi_marl.envs.drivers import PAPER_DRIVERS, DriverName, get_driver
from hmi_marl.experiments.episode_sums import ALL_DRIVERS, Sums
from hmi_marl.experiments.episodes import play_named
from hmi_marl.experiments.sweep.plan import SweptRun
from hmi_marl.files import json_value, sha256_of, write_json
from hmi_marl.ownership import owned
from hmi_marl.reading import read_json
from hmi_marl.training.jobs import Job, train_in
from hmi_marl.training.policies import reading
from hmi_marl.training.protocols.settings import TrainSettings
from hmi_marl.training.run_tasks import RunTask
from hmi_marl.training.runs.folder import FREE, read_curve, run_settings
from hmi_marl.typed_json import read_as

RESULT = "result.json"
"""File in a run's folder that says how it was evaluated, and what came out."""


@dataclass(frozen=True)
class Evaluation(Checked):
    """Evaluation episodes, the same for every run.

    Raises:
        ValueError: unknown drivers, or some of the same name.
    """

    drivers: tuple[DriverName, ...] = PAPER_DRIVERS
    """Drivers, each of whom drives all of them."""
    episodes: Count = 500
    """Number of the episodes."""

    def __post_init__(self) -> None:
        super().__post_init__()
        TeamConfig(driver=self.drivers)
        names = self.names
        if len(set(names)) < len(names) or ALL_DRIVERS in names:
            raise ValueError(f"drivers need names of their own, not {', '.join(names)}")

    @property
    def names(self) -> list[str]:
        """Names of the drivers."""
        return [get_driver(driver).name for driver in self.drivers]


@dataclass(frozen=True)
class DriverResult:
    """Results of a run with one driver, or with all."""

    episodes: int
    crashes: int
    metrics: dict[str, float | None]
    """Means by name, see :meth:`Sums.metrics`; None where there are none."""

    @classmethod
    def of(cls, sums: Sums) -> DriverResult:
        """Take them from sums over the episodes."""
        return cls(sums.episodes, sums.crashes, json_value(sums.metrics()))


@dataclass(frozen=True)
class Result:
    """Results of one run."""

    steps: int
    """Environment steps of its training."""
    seconds: float
    """Duration of its training [s]."""
    by_driver: dict[str, DriverResult]
    """Episodes with each driver, and for ``ALL_DRIVERS``."""


def task(
    run: SweptRun, evaluation: Evaluation, folder: Path, command_line: str, processes: int
) -> RunTask:
    """Make the task of a run, in a folder of its own below ``folder``."""
    job = Job(run.settings, folder / run.name)
    arguments = (run.settings, evaluation, command_line, processes)
    return RunTask(train_and_play, arguments, job.folder, job.reads, job.on_gpu)


def train_and_play(
    settings: TrainSettings,
    evaluation: Evaluation,
    command_line: str,
    processes: int,
    folder: Path,
    *policies: Path,
) -> None:
    """Train in ``folder`` what is not trained yet, play, and write the result there."""
    settings = reading(settings, policies)
    train_in(settings, command_line, False, processes, folder)
    with owned(folder):
        result = _play(settings, evaluation, folder)
        about = _about(settings, evaluation) | {"weights": _weights(folder)}
        write_json(folder / RESULT, about | {"result": json_value(result)})


def read_result(run: SweptRun, evaluation: Evaluation, folder: Path) -> Result | None:
    """Read the result of a run in its folder; None if it is not there, or one of other weights.

    Raises:
        ValueError: the file is damaged.
    """
    path = folder / RESULT
    try:
        content = read_json(path)
    except FileNotFoundError:
        return None
    wanted = _about(run.settings, evaluation)
    if not isinstance(content, dict) or any(content.get(name) != wanted[name] for name in wanted):
        return None  # trained or played otherwise; training says so if it is another run
    if content.get("weights") != _weights(folder):
        return None
    try:
        return read_as(Result, content.get("result"))
    except ValueError as error:
        raise ValueError(f"{path} is damaged ({error}); remove it, to have it made again") from None


def _play(settings: TrainSettings, evaluation: Evaluation, folder: Path) -> Result:
    """Play with what was learned in ``folder``, and with what was the partner of the rest."""
    driver = str(folder) if (folder / f"{DRIVER}.json").is_file() else _given_driver(settings)
    hmi = str(folder) if (folder / f"{VEHICLE_AI}.json").is_file() else "never"
    sums: dict[str, Sums] = {}
    everything = np.ones(evaluation.episodes, np.bool_)
    for name in evaluation.drivers:
        team = settings.team((name,))
        episodes = play_named(team, driver, hmi, evaluation.episodes)
        sums[get_driver(name).name] = Sums.of(episodes, everything, team.scene.policy_frequency)
    last = read_curve(folder)[-1]
    sums = {ALL_DRIVERS: Sums.join(sums.values())} | sums
    played = {name: DriverResult.of(each) for name, each in sums.items()}
    return Result(int(last["steps"]), float(last["seconds"]), played)


def _given_driver(settings: TrainSettings) -> str:
    return getattr(settings, "driver_policy", None) or "rule"


def _about(settings: TrainSettings, evaluation: Evaluation) -> dict[str, Any]:
    found = run_settings(settings)
    return {
        "version": hmi_marl.__version__,
        "protocol": type(settings).__name__,
        "settings": {name: value for name, value in found.items() if name not in FREE},
        "evaluation": json_value(evaluation),
    }


def _weights(folder: Path) -> dict[str, str]:
    files: Sequence[Path] = [folder / f"{seat}.safetensors" for seat in AGENTS]
    return {file.name: sha256_of(file) for file in files if file.is_file()}
