"""Task of learning an evidence model; no torch."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from hmi_marl.training.evidence.settings import EvidenceSettings
from hmi_marl.training.jobs import own_line
from hmi_marl.training.policies import models_read, policies_read, reading, with_models
from hmi_marl.training.run_tasks import RunTask


def evidence_task(settings: EvidenceSettings, folder: Path, command_line: str = "") -> RunTask:
    """Make the task of learning an evidence model in ``folder``."""
    reads = (*models_read(settings), *policies_read(settings))
    return RunTask(_learn_evidence, (settings, command_line), folder, reads)


def _learn_evidence(
    settings: EvidenceSettings, command_line: str, folder: Path, *places: Path
) -> None:
    from hmi_marl.training.evidence.run import learn_evidence  # torch, with the threads just set

    settings, policies = with_models(settings, places)
    settings = replace(reading(settings, policies), threads=1)
    learn_evidence(settings, folder, command_line=command_line, line=own_line())
