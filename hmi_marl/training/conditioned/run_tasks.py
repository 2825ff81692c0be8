"""Task of learning the HMI that is conditioned on z; no torch."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from hmi_marl.training.conditioned.settings import ConditionedSettings
from hmi_marl.training.jobs import own_line
from hmi_marl.training.policies import models_read, policies_read, reading, with_models
from hmi_marl.training.run_tasks import RunTask


def conditioned_task(
    settings: ConditionedSettings, evidence: Path, folder: Path, command_line: str = ""
) -> RunTask:
    """Make the task of learning, in ``folder``, an HMI conditioned on the z of another run."""
    reads = (evidence.absolute(), *models_read(settings), *policies_read(settings))
    return RunTask(_learn_conditioned, (settings, command_line), folder, reads)


def _learn_conditioned(
    settings: ConditionedSettings,
    command_line: str,
    folder: Path,
    evidence: Path,
    *places: Path,
) -> None:
    from hmi_marl.training.conditioned.run import learn_conditioned  # torch

    settings, policies = with_models(settings, places)
    settings = replace(reading(settings, policies), threads=1)
    learn_conditioned(settings, evidence, folder, command_line=command_line, line=own_line())
