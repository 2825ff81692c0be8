"""Tasks of learning an evidence model and the HMI that is conditioned on it; no torch."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from hmi_marl.training.evidence.conditioned import learn_conditioned
from hmi_marl.training.evidence.settings import EvidenceSettings
from hmi_marl.training.jobs import own_line
from hmi_marl.training.policies import policies_read, reading
from hmi_marl.training.protocols.two_stage import TwoStage
from hmi_marl.training.run_tasks import RunTask


def evidence_task(settings: EvidenceSettings, folder: Path, command_line: str = "") -> RunTask:
    """Make the task of learning an evidence model in ``folder``."""
    reads = policies_read(settings)
    return RunTask(_learn_evidence, (settings, command_line), folder, reads)


def conditioned_task(
    settings: TwoStage, evidence: Path, folder: Path, command_line: str = ""
) -> RunTask:
    """Make the task of learning, in ``folder``, an HMI conditioned on the model of another run."""
    reads = (evidence.absolute(), *policies_read(settings))
    return RunTask(_learn_conditioned, (settings, command_line), folder, reads)


def _learn_evidence(
    settings: EvidenceSettings, command_line: str, folder: Path, *policies: Path
) -> None:
    from hmi_marl.training.evidence.run import learn_evidence  # torch, with the threads just set

    settings = replace(reading(settings, policies), threads=1)
    learn_evidence(settings, folder, command_line=command_line, line=own_line())


def _learn_conditioned(
    settings: TwoStage, command_line: str, folder: Path, evidence: Path, *policies: Path
) -> None:
    settings = reading(settings, policies)
    learn_conditioned(settings, evidence, folder, command_line, own_line())
