"""Learning latent traits in a folder, round by round, resumable.

First the policy learns to imitate, and the encoder from labels, if there are any
(:attr:`TraitSettings.imitation_updates`). Then in every round the policy drives, given z of
demonstrated pools; the discriminator learns from that and from demonstrations, while the policy
goes on imitating; and the policy learns for the reward, by PPO.

The folder holds ``run.json`` (the resolved settings), ``checkpoint.safetensors``, ``curve.json``
(a row for each round), ``tensorboard/``, and what was learned, ``traits.json`` with its weights.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import hmi_marl
from hmi_marl.agents.learned.trait_model import save_traits
from hmi_marl.demonstrations.dataset import Demonstrations, alert_rate, held_out
from hmi_marl.demonstrations.env import team_of
from hmi_marl.demonstrations.parquet import OBSERVED, read_demonstrations, read_observed
from hmi_marl.envs.streams import Stream, mix
from hmi_marl.extras import needing
from hmi_marl.files import json_value, make_folder, sha256_of, write_json
from hmi_marl.training.runs.claim import SETTINGS, check_same, read_settings
from hmi_marl.training.runs.jobs import CURVE
from hmi_marl.training.runs.progress import Telling
from hmi_marl.training.traits.labels import make_labels
from hmi_marl.training.traits.settings import TraitSettings

with needing("training"):
    import torch

    from hmi_marl.training.runs.checkpoint import CHECKPOINT, Checkpoint
    from hmi_marl.training.runs.processes import Processes
    from hmi_marl.training.traits.adversary import Adversary, Labelled
    from hmi_marl.training.traits.generator import Generator
    from hmi_marl.training.traits.model import weights_of_model
    from hmi_marl.training.traits.pools import Units, Windows

PREPARING_POOLS = 64
"""From which the encoder takes its units."""
ADVERSARY, GENERATOR = "adversary", "generator"
_TELLING = 10
"""Imitation updates between two looks at how far they have come."""
_IMITATING, _ROUNDS, _DONE = range(3)
"""Phases of a run."""


def learn_traits(
    settings: TraitSettings,
    demonstrations: Path,
    folder: Path,
    preferences: Mapping[str, float] | None = None,
    quiet: bool = False,
    command_line: str = "",
    line: int = 0,
) -> None:
    """Learn from a dataset in ``folder``, going on where a run there was cut off.

    Args:
        settings: what to learn, and how.
        demonstrations: folder of the dataset. Its truth is opened for one thing alone: η of the
            labelled windows, in the preference-supervised setting without ``preferences``.
        folder: of the run.
        preferences: what people answered, by name, for the preference-supervised setting.
        quiet: no progress bar and no TensorBoard.
        typed: the command, kept with what was learned.
        line: of the terminal for the progress bar.

    Raises:
        FileNotFoundError: no demonstrations there.
        ValueError: the folder holds another run, or demonstrations that cannot be learned from, or
            preferences for a setting that asks for none.
    """
    if preferences is not None and settings.supervision != "preference":
        raise ValueError(
            f"preferences are for supervision 'preference', not {settings.supervision!r}"
        )
    threads = torch.get_num_threads()
    with torch.random.fork_rng():
        torch.set_num_threads(settings.threads)
        try:
            run = _Run(settings, demonstrations, folder, preferences, command_line)
            make_folder(folder)
            run.go(quiet, line)
        finally:
            torch.set_num_threads(threads)


class _Run:
    def __init__(
        self,
        settings: TraitSettings,
        place: Path,
        folder: Path,
        preferences: Mapping[str, float] | None,
        command_line: str,
    ) -> None:
        self._settings, self._folder, self._typed = settings, folder, command_line
        self._state = Checkpoint()
        self._saved_at = time.monotonic()
        asks_truth = settings.supervision == "preference" and preferences is None
        data = read_demonstrations(place) if asks_truth else Demonstrations(read_observed(place))
        self._about: dict[str, Any] = {
            "protocol": "traits",
            "version": hmi_marl.__version__,
            "settings": json_value(settings),
            "preferences": json_value(preferences),
            "demonstrations": sha256_of(place / OBSERVED),
        }
        if data.observed.about.get("team", {}).get("end_at_crash"):
            raise ValueError(
                "these windows end at a crash, which would tell them from the policy's, whose "
                "crashed car stands; collect with --no-end-at-crash"
            )
        learned = ~held_out(data.observed, settings.held_out)
        if not learned.any():
            raise ValueError("held_out leaves no window to learn from; demonstrate more")
        data = data.take(learned)
        observed = data.observed
        rng = np.random.default_rng(self._draw(Stream.LEARNING, 0))
        labels = make_labels(data, settings.supervision, settings.labelled, rng, preferences)
        self._units = Units.of(observed)
        self._windows = Windows(observed, labels, self._units)
        self._card = settings.card(observed.layout)
        device = Processes().device(settings.device)
        self._device = device
        torch.manual_seed(self._draw(Stream.LEARNING, 1))
        self._generator = Generator(
            self._card, settings, team_of(observed), alert_rate(observed), self._units, device
        )
        self._adversary = Adversary(self._card, settings, self._generator.policy, device)
        pools = self._windows.draw(rng, PREPARING_POOLS, settings.pool)
        self._adversary.prepare(self._windows.batch(pools, device))
        self._about_data = {"drivers": list(observed.names), "about": json_value(observed.about)}

    def go(self, quiet: bool, line: int) -> None:
        self._claim_folder()
        state, settings = self._state, self._settings
        if state.phase == _DONE:
            return
        name, board = self._folder.name, self._folder / "tensorboard"
        per_round = settings.num_teams * self._generator.horizon
        total = per_round * settings.rounds(self._generator.horizon)
        with Telling(board, name, total, state.steps, quiet, line) as telling:
            if state.phase == _IMITATING:
                self._imitate(telling)
                state.phase, state.iteration = _ROUNDS, 0
                self._save()
            telling.phase(name)
            while state.iteration < settings.rounds(self._generator.horizon):
                began = time.monotonic()
                row = self._round()
                state.iteration += 1
                state.steps += per_round
                spent = time.monotonic() - began
                state.seconds += spent
                row |= {"steps_per_second": per_round / spent, "seconds": state.seconds}
                state.curve.append({"steps": state.steps} | row)
                telling.batch(row, state.steps, per_round)
                self._save_at_times()
        weights = weights_of_model(self._adversary.model, self._generator.policy, self._units)
        training = self._about | self._about_data | {"steps": state.steps, "command": self._typed}
        save_traits(self._folder, replace(self._card, training=training), weights)
        state.phase = _DONE
        self._save()

    def _imitate(self, telling: Telling) -> None:
        state = self._state
        updates = self._settings.imitation_updates
        while state.iteration < updates:
            if state.iteration % _TELLING == 0:
                telling.phase(f"{self._folder.name}: imitating {state.iteration}/{updates}")
            began = time.monotonic()
            rng = self._seed(2 * state.iteration)
            row = self._adversary.learn(*self._demonstrated(rng))
            state.iteration += 1
            state.seconds += time.monotonic() - began
            state.curve.append({"steps": 0, "seconds": state.seconds} | row)
            self._save_at_times()

    def _round(self) -> dict[str, float]:
        settings, iteration = self._settings, self._state.iteration
        rng = self._seed(2 * iteration + 1)
        self._generator.begin(iteration / settings.rounds(self._generator.horizon))
        pools = self._windows.draw(rng, settings.num_teams // settings.pool, settings.pool)
        with torch.no_grad():
            z = self._adversary.encode(self._windows.batch(pools, self._device)).sample()
        number = np.arange(settings.num_teams) + iteration * settings.num_teams
        drives, driven = self._generator.drive(z, mix(settings.seed, Stream.TRAINING, number))
        rows = [
            self._adversary.learn(*self._demonstrated(rng), driven, z)
            for _ in range(settings.updates)
        ]
        row = {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}
        f = self._adversary.rewards(driven, z)
        learns = iteration >= settings.settling * settings.rounds(self._generator.horizon)
        row |= self._generator.learn(driven, z, f) if learns else {}
        return row | {
            "speed": float(drives.speed.mean()),
            "crash_rate": float(drives.crashed.mean()),
        }

    def _demonstrated(self, rng: np.random.Generator) -> tuple[Any, Labelled | None]:
        """A batch of demonstrations, and one of labelled ones if there are labels."""
        settings, windows = self._settings, self._windows
        which = windows.draw_pairs(rng, settings.expert_pools, settings.pool)
        experts = windows.batch(which, self._device)
        if settings.supervision == "none":
            return experts, None
        which, labels = windows.draw_labelled(rng, settings.labelled_pools, settings.pool)
        batch = windows.batch(which, self._device)
        return experts, Labelled(batch, torch.from_numpy(labels).to(self._device))

    def _seed(self, counter: int) -> np.random.Generator:
        """Seed all that is drawn in one update or round."""
        seed = self._draw(Stream.LEARNING, 2 + counter)
        torch.manual_seed(seed)
        return np.random.default_rng(seed)

    def _draw(self, stream: Stream, counter: int) -> int:
        return int(mix(self._settings.seed, stream, counter))

    def _claim_folder(self) -> None:
        path, checkpoint = self._folder / SETTINGS, self._folder / CHECKPOINT
        if not checkpoint.is_file():  # nothing was learned that could be lost
            write_json(path, self._about | {"command": self._typed})
            return
        before = read_settings(path)
        if before.get("demonstrations") != self._about["demonstrations"]:
            raise ValueError(
                f"{self._folder} holds a run that learned from other demonstrations; choose another "
                "--out, or remove the folder"
            )
        check_same(before, self._about, self._folder)
        self._state = Checkpoint.load(checkpoint)
        self._adversary.load(self._state.tensors[ADVERSARY])
        self._generator.learner.load(self._state.tensors[GENERATOR])

    def _save_at_times(self) -> None:
        if time.monotonic() - self._saved_at > self._settings.checkpoint_every:
            self._save()

    def _save(self) -> None:
        self._saved_at = time.monotonic()
        self._state.tensors = {
            ADVERSARY: self._adversary.tensors(),
            GENERATOR: self._generator.learner.tensors(),
        }
        write_json(self._folder / CURVE, self._state.curve)  # first: a kill in between loses none
        self._state.save(self._folder / CHECKPOINT)
