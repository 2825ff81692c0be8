"""Learning an evidence model in a folder, resumable.

The folder holds ``run.json`` (the resolved settings), ``checkpoint.safetensors``, ``curve.json``
(a row for every few updates), and what was learned, ``evidence.json`` with its weights. The drives
are not kept: they follow from the settings, and are driven again when a run goes on.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

import hmi_marl
from hmi_marl.agents.adaptive.evidence_model import save_evidence
from hmi_marl.envs.observations import traits_part
from hmi_marl.envs.streams import Stream, mix
from hmi_marl.extras import needing
from hmi_marl.files import make_folder, write_json
from hmi_marl.training.evidence.drives import Drives, drive_all
from hmi_marl.training.evidence.settings import EvidenceSettings
from hmi_marl.training.runs.claim import SETTINGS, check_same, read_settings, told
from hmi_marl.training.runs.jobs import CURVE

with needing("training"):
    import torch

    from hmi_marl.training.evidence.model import Evidence
    from hmi_marl.training.runs.checkpoint import CHECKPOINT, Checkpoint, flat_moments, with_moments

_TELLING = 50
"""Updates between two rows of the curve."""
_LAST_RATE = 0.05
"""Of the learning rate, as a share of the first."""


def learn_evidence(
    settings: EvidenceSettings,
    folder: Path,
    quiet: bool = False,
    command_line: str = "",
    line: int = 0,
) -> None:
    """Learn in ``folder``, going on where a run there was cut off.

    Args:
        settings: what to learn from, and how.
        folder: of the run.
        quiet: no progress bar.
        typed: the command, kept with what was learned.
        line: of the terminal for the progress bar.

    Raises:
        ValueError: the folder holds another run, or settings that name nobody who is known.
    """
    threads = torch.get_num_threads()
    with torch.random.fork_rng():
        torch.set_num_threads(settings.threads)
        try:
            make_folder(folder)
            _Run(settings, folder, command_line).go(quiet, line)
        finally:
            torch.set_num_threads(threads)


class _Run:
    def __init__(self, settings: EvidenceSettings, folder: Path, command_line: str) -> None:
        self._settings, self._folder, self._typed = settings, folder, command_line
        self._about: dict[str, Any] = {
            "protocol": "evidence",
            "version": hmi_marl.__version__,
            "settings": told(settings),
        }
        self._state = Checkpoint()
        self._saved_at = time.monotonic()
        torch.manual_seed(int(mix(settings.seed, Stream.LEARNING, 0)))
        self._model = Evidence(settings.card(settings.team))
        self._optimizer = torch.optim.AdamW(
            self._model.parameters(), settings.learning_rate, weight_decay=settings.weight_decay
        )

    def go(self, quiet: bool, line: int) -> None:
        self._claim_folder()
        state, settings = self._state, self._settings
        if state.phase == 1:
            return
        name = self._folder.name
        with tqdm(
            total=settings.drives,
            unit=" drives",
            desc=f"{name}: driving",
            disable=quiet,
            position=line,
        ) as bar:
            began = time.monotonic()
            drives = drive_all(settings, bar.update)
            state.seconds += time.monotonic() - began
        if state.iteration == 0:
            self._take_units(drives)
        with tqdm(
            total=settings.updates,
            initial=state.iteration,
            unit=" updates",
            desc=name,
            disable=quiet,
            position=line,
        ) as bar:
            self._learn(drives, bar)
        temperature = self._temperature(drives)
        self._model.settle(temperature, self._shown(drives))
        training = self._about | {"temperature": temperature, "command": self._typed}
        save_evidence(
            self._folder, replace(self._model.card, training=training), self._model.weights()
        )
        state.phase = 1
        self._save()

    def _learn(self, drives: Drives, bar: tqdm[Any]) -> None:
        state, settings, shown = self._state, self._settings, self._shown(drives)
        whole = -(-drives.turns.shape[1] // settings.segment) * settings.segment
        learned, held_out = self._split()
        held_out = held_out[: settings.batch]
        unseen = _padded(drives.turns[held_out], drives.driving[held_out], whole)
        recent: list[float] = []
        while state.iteration < settings.updates:
            began = time.monotonic()
            draw = int(mix(settings.seed, Stream.LEARNING, 2 + state.iteration))
            which = np.random.default_rng(draw).choice(learned, settings.batch, replace=False)
            turns, driving = _padded(drives.turns[which], drives.driving[which], whole)
            share = state.iteration / settings.updates
            rate = _LAST_RATE + (1 - _LAST_RATE) * 0.5 * (1 + math.cos(math.pi * share))
            for group in self._optimizer.param_groups:
                group["lr"] = settings.learning_rate * rate
            loss = self._model.loss(turns, driving, shown[which])
            self._optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            torch.nn.utils.clip_grad_norm_(self._model.parameters(), 1.0)
            self._optimizer.step()
            state.iteration += 1
            state.seconds += time.monotonic() - began
            recent.append(loss.item())
            bar.update()
            if state.iteration % _TELLING == 0 or state.iteration == settings.updates:
                with torch.no_grad():
                    told = self._model.loss(*unseen, shown[held_out]).item()
                row = {"loss": float(np.mean(recent)), "held_out_loss": told}
                state.curve.append({"updates": state.iteration} | row | {"seconds": state.seconds})
                bar.set_postfix({name: f"{value:.4f}" for name, value in row.items()})
                recent.clear()
            if time.monotonic() - self._saved_at > settings.checkpoint_every:
                self._save()

    @staticmethod
    def _shown(drives: Drives) -> torch.Tensor:
        """The traits of who drove, as networks see them, shape (M, 4)."""
        return torch.from_numpy(traits_part(drives.traits).astype(np.float32))

    def _split(self) -> tuple[np.ndarray[Any, np.dtype[np.int64]], ...]:
        """Which drives are learned from, and which are not."""
        settings = self._settings
        order = np.random.default_rng(int(mix(settings.seed, Stream.LEARNING, 1)))
        mixed = order.permutation(settings.drives)  # drives lie by HMI
        learned, held_out = np.split(mixed, [settings.learned])
        return learned, held_out

    def _temperature(self, drives: Drives) -> float:
        """By how much to tone the evidence down, so that drives not learned from are told best.

        What was learned is too sure of itself, the more so the more of it is added up.
        """
        settings, (_, held_out) = self._settings, self._split()
        shown = self._shown(drives)
        whole = -(-drives.turns.shape[1] // settings.segment) * settings.segment
        tried = torch.linspace(0.2, 1.2, 41)
        total = torch.zeros(len(tried))
        for part in np.array_split(held_out, -(-len(held_out) // settings.batch)):
            unseen = _padded(drives.turns[part], drives.driving[part], whole)
            with torch.no_grad():
                total += len(part) * self._model.loss_at_end(*unseen, shown[part], tried)
        return float(tried[int(total.argmin())])

    def _take_units(self, drives: Drives) -> None:
        """Standardise what is read by the drives."""
        read = drives.turns[drives.driving][:, : self._model.card.read_size]
        self._model.centre.copy_(torch.from_numpy(read.mean(axis=0)))
        spread = read.std(axis=0)
        self._model.scale.copy_(torch.from_numpy(np.where(spread > 1e-3, spread, 1.0)))

    def _claim_folder(self) -> None:
        path, checkpoint = self._folder / SETTINGS, self._folder / CHECKPOINT
        if not checkpoint.is_file():
            write_json(path, self._about | {"command": self._typed})
            return
        check_same(read_settings(path), self._about, self._folder)
        self._state = Checkpoint.load(checkpoint)
        tensors = self._state.tensors
        self._model.load_state_dict(tensors["model"])
        moments = with_moments(self._optimizer.state_dict(), tensors["learner"])
        self._optimizer.load_state_dict(moments)

    def _save(self) -> None:
        self._saved_at = time.monotonic()
        self._state.tensors = {
            "model": dict(self._model.state_dict()),
            "learner": flat_moments(self._optimizer.state_dict()),
        }
        write_json(self._folder / CURVE, self._state.curve)  # first: a kill in between loses none
        self._state.save(self._folder / CHECKPOINT)


def _padded(
    turns: np.ndarray[Any, np.dtype[np.float32]],
    driving: np.ndarray[Any, np.dtype[np.bool_]],
    steps: int,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Turns (B, steps, columns), and which of them there were (B, steps)."""
    missing = steps - turns.shape[1]
    turns = np.pad(turns, ((0, 0), (0, missing), (0, 0)))
    driving = np.pad(driving, ((0, 0), (0, missing)))
    return torch.from_numpy(turns), torch.from_numpy(driving)
