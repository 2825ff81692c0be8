"""A run in a folder that can be resumed: claimed, restored, saved, timed and shown in one place.

The folder holds ``run.json`` (the resolved settings), ``checkpoint.safetensors``, ``curve.json``
(rows of losses and measures) and, unless the run is quiet, ``tensorboard/``. A subclass learns and
saves its models there. The environment's state is not kept: a batch is a whole episode of every
team from its start, and all random numbers follow from the run's seed and the batch's number.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any, ClassVar, Protocol

import torch

import hmi_marl
from hmi_marl.agents.learned.cards import is_saved
from hmi_marl.envs.streams import Stream, mix
from hmi_marl.files import write_json
from hmi_marl.ownership import owned
from hmi_marl.training.runs.checkpoint import Checkpoint, fitting
from hmi_marl.training.runs.divergence import are_finite
from hmi_marl.training.runs.folder import (
    CHECKPOINT,
    CURVE,
    SETTINGS,
    check_same,
    read_settings,
    run_settings,
    settings_digest,
)
from hmi_marl.training.runs.processes import ALONE, Processes
from hmi_marl.training.runs.progress import Progress
from hmi_marl.training.runs.reports import listener
from hmi_marl.workers import check_threads_here

OPTIMIZER = "optimizer"


def flat_moments(state: Mapping[str, Any]) -> dict[str, torch.Tensor]:
    """Return the moments in an optimizer's state dict by flat names."""
    return {
        f"{OPTIMIZER}.{parameter}.{name}": torch.as_tensor(value)
        for parameter, moments in state["state"].items()
        for name, value in moments.items()
    }


def with_moments(state: Mapping[str, Any], tensors: Mapping[str, torch.Tensor]) -> dict[str, Any]:
    """Return the state dict with the moments that :func:`flat_moments` returned, among others."""
    moments: dict[int, dict[str, torch.Tensor]] = {}
    for full_name, value in tensors.items():
        kind, name = full_name.split(".", 1)
        if kind == OPTIMIZER:
            parameter, moment = name.split(".")
            moments.setdefault(int(parameter), {})[moment] = value
    return {**state, "state": moments}


Tensors = dict[str, dict[str, torch.Tensor]]


class RunSettings(Protocol):
    """Settings that every run has."""

    @property
    def seed(self) -> int:
        """Random seed."""

    @property
    def checkpoint_every(self) -> float:
        """Least time between checkpoints [s]."""


class Run(ABC):
    """One run in its folder. Same seed, same weights, however often it was interrupted.

    Args:
        about: more facts that must be the same when the run is resumed.
        processes: processes that learn together; the first one writes.
        command_line: command that started it, kept with the results.
        quiet: no progress bar and no TensorBoard.
        line: line of the terminal for the progress bar, where several runs go side by side.
    """

    phases: int = 1
    """Number of phases, after which the run is finished."""

    def __init__(
        self,
        settings: RunSettings,
        folder: Path,
        about: Mapping[str, Any],
        processes: Processes = ALONE,
        command_line: str = "",
        quiet: bool = False,
        line: int = 0,
    ) -> None:
        self.folder, self.processes, self.command_line = folder, processes, command_line
        self.about: dict[str, Any] = {
            "version": hmi_marl.__version__,
            "settings": run_settings(settings),
            **about,
        }
        self.state = Checkpoint(settings=settings_digest(self.about))
        self._seed, self._checkpoint_every = settings.seed, settings.checkpoint_every
        self._quiet, self._line = quiet or not processes.is_first, line
        self._saved_at = time.monotonic()

    @abstractmethod
    def learn(self) -> None:
        """Learn from ``state`` on until the last phase, and save the models."""

    @abstractmethod
    def tensors(self) -> Tensors:
        """Everything learned so far, by the name of the learner."""

    @abstractmethod
    def restore(self, tensors: Tensors) -> None:
        """Restore what :meth:`tensors` returned when the run was interrupted."""

    @abstractmethod
    def save_lost(self) -> None:
        """Save again the models of finished phases whose files are gone, from what was restored."""

    def check(self, before: dict[str, Any]) -> None:
        """Raise ``ValueError`` unless the run in the folder, begun with ``before``, is this one."""
        check_same(before, self.about, self.folder)

    def go(self) -> None:
        """Learn what is not learned yet, and save models whose files are gone again.

        Raises:
            FloatingPointError: learning has diverged; the last checkpoint is sound.
            FolderInUseError: another process writes into the folder.
            OSError: the folder cannot be written to.
            ValueError: the folder holds another run, or a damaged one.
        """
        with owned(self.folder) if self.processes.is_first else nullcontext():
            self._go()

    def _go(self) -> None:
        settings, checkpoint = self.folder / SETTINGS, self.folder / CHECKPOINT
        if checkpoint.is_file():  # otherwise nothing was learned that could be lost
            before = read_settings(settings)
            self.check(before)
            self.state = Checkpoint.load(checkpoint, settings_digest(before), self.phases)
            with fitting(checkpoint):
                self.restore(self.state.tensors)
            if self.processes.is_first:
                self.save_lost()
                if not (self.folder / CURVE).is_file():
                    write_json(self.folder / CURVE, self.state.curve)
        elif self.processes.is_first:
            write_json(settings, self.about | {"command": self.command_line})
        self.processes.wait()
        if self.state.phase < self.phases:
            self.learn()
            self.processes.wait()  # until the last checkpoint is written

    @contextmanager
    def watched(self) -> Iterator[None]:
        """Say in which batch learning diverged, and what to do, if it does within the block.

        Raises:
            FloatingPointError: it did. Nothing of the batch has been saved.
        """
        try:
            yield
        except FloatingPointError as error:
            kept = self.folder / CHECKPOINT
            there = f" ({kept} is from before)" if kept.is_file() else ""
            raise FloatingPointError(
                f"learning diverged in batch {self.state.iteration + 1} of phase "
                f"{self.state.phase + 1}: {error}, and choose another --out{there}"
            ) from None

    def finish_phase(self) -> None:
        """Save, and begin the next phase."""
        self.state.phase, self.state.iteration = self.state.phase + 1, 0
        self.save()

    def draw(self, stream: Stream, counter: int) -> int:
        """Random number that follows from the run's seed, a stream and a counter."""
        return int(mix(self._seed, stream, counter))

    def progress(self, name: str, total: int, done: int = 0, unit: str = "steps") -> Progress:
        """Progress bar, with curves for TensorBoard if the unit is environment steps."""
        board = self.folder / "tensorboard" if unit == "steps" else None
        return Progress(name, total, done, unit, self._quiet, self._line, board)

    def count(self, began: float, steps: int = 0) -> dict[str, float]:
        """Count an iteration of ``steps`` that began at ``began`` by ``time.monotonic()``.

        Return the seconds of the whole run and, if there are ``steps``, their number per second.
        """
        spent = time.monotonic() - began
        self.state.iteration += 1
        self.state.steps += steps
        self.state.seconds += spent
        seconds = {"seconds": self.state.seconds}
        return {"steps_per_second": steps / spent} | seconds if steps else seconds

    def save_if_due(self) -> None:
        """Save, unless that was done a short time ago."""
        if time.monotonic() - self._saved_at > self._checkpoint_every:
            self.save()

    def save(self) -> None:
        """Write a checkpoint, and the curve up to it.

        Raises:
            FloatingPointError: learning has diverged; the checkpoint before stays.
        """
        self._saved_at = time.monotonic()
        if not self.processes.is_first:
            return
        tensors = self.tensors()
        with self.watched():
            for learner, named in tensors.items():
                if not are_finite(named.values()):
                    raise FloatingPointError(
                        f"weights of {learner} not finite; lower learning_rate"
                    )
        self.state.tensors |= tensors
        write_json(self.folder / CURVE, self.state.curve)  # first: a kill in between loses none
        self.state.save(self.folder / CHECKPOINT)
        if (hears := listener()) is not None:
            hears.saved(self.folder)


class ModelRun(Run):
    """A run that learns one model, and saves it when it is finished."""

    card_name: ClassVar[str]
    """File name of the model's card."""

    @abstractmethod
    def save_model(self) -> None:
        """Write the model's card and weights."""

    def save_lost(self) -> None:
        """See :meth:`Run.save_lost`."""
        if self.state.phase == self.phases and not is_saved(self.folder / self.card_name):
            self.save_model()


@contextmanager
def own_torch_state(threads: int) -> Iterator[None]:
    """Run a block with its own random state and number of threads in torch.

    Raises:
        ValueError: this machine has not so many cores.
    """
    check_threads_here(threads)
    before = torch.get_num_threads()
    with torch.random.fork_rng():
        torch.set_num_threads(threads)
        try:
            yield
        finally:
            torch.set_num_threads(before)
