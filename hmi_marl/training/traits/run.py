"""Learning of latent traits in a folder, round by round, resumable.

First the average driver's policy is learned by imitation, and, if self-supervised, the encoder from
which windows are of one driver. In the other settings the policy then learns to imitate given z,
and the encoder from labels, if there are any (:attr:`TraitSettings.imitation_updates`). Then in
every round the policy drives, given z of demonstrated pools; the discriminator learns from that and
from demonstrations, while the policy continues to imitate; and the policy learns from the learned
reward, by PPO.

Besides the files of every run (:mod:`hmi_marl.training.runs.run`) the folder holds the learned
model, ``traits.json`` with its weights.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.learned.trait_model import NAME, save_traits
from hmi_marl.demonstrations.dataset import held_out
from hmi_marl.demonstrations.env import team_of
from hmi_marl.demonstrations.stored import OBSERVED, TRUTH, ObservedFile, TruthFile
from hmi_marl.envs.drivers import TRAIT_NAMES
from hmi_marl.envs.streams import Stream, mix
from hmi_marl.extras import needing
from hmi_marl.files import json_value, sha256_of
from hmi_marl.training.traits.settings import LABELLED, TraitSettings

with needing("training"):
    import torch

    from hmi_marl.training.runs.processes import ALONE
    from hmi_marl.training.runs.progress import Progress
    from hmi_marl.training.runs.run import ModelRun, Tensors, own_torch_state
    from hmi_marl.training.traits.discriminator import DiscriminatorLearner, Labelled
    from hmi_marl.training.traits.episodes import PIECE, Episodes
    from hmi_marl.training.traits.generator import Generator
    from hmi_marl.training.traits.model import weights_of_model
    from hmi_marl.training.traits.self_supervision import EncoderLearning
    from hmi_marl.training.traits.windows import Batch, Windows, make_labels

DISCRIMINATOR, GENERATOR = "discriminator", "generator"
_AVERAGE_DRIVER, _ENCODER = "average", "encoder"
_SHOWN_EVERY = 10
"""Updates between two changes of the progress bar, where nothing is driven."""
_AVERAGE, _SELF, _IMITATING, _ROUNDS = range(4)
"""Phases of a run."""
_DOING = {
    _AVERAGE: "the average driver",
    _SELF: "finding drivers again",
    _IMITATING: "imitating",
}


def learn_traits(
    settings: TraitSettings,
    demonstrations: Path,
    folder: Path,
    preferences: Mapping[str, float] | None = None,
    quiet: bool = False,
    command_line: str = "",
    line: int = 0,
) -> None:
    """Learn from a dataset in ``folder``, resuming a run that was interrupted there.

    Args:
        demonstrations: folder of the dataset. Its truth is read for one thing alone: η of the
            labelled windows, in the preference-supervised setting without ``preferences``.
        preferences: people's answers by name, for the preference-supervised setting.
        quiet, command_line, line: see :class:`Run`.

    Raises:
        FileNotFoundError: there are no demonstrations.
        ValueError: the folder holds another run, or demonstrations that cannot be learned from, or
            preferences are given for a setting that does not use them.
    """
    if preferences is not None and settings.supervision != "preference":
        raise ValueError(
            f"preferences are for supervision 'preference', not {settings.supervision!r}"
        )
    with own_torch_state(settings.threads):
        shown = {"command_line": command_line, "quiet": quiet, "line": line}
        _Run(settings, demonstrations, folder, preferences, **shown).go()


class _Run(ModelRun):
    card_name = NAME

    phases = 4

    def __init__(
        self,
        settings: TraitSettings,
        dataset: Path,
        folder: Path,
        preferences: Mapping[str, float] | None,
        **shown: Any,
    ) -> None:
        stored = ObservedFile(dataset)
        about = {
            "protocol": "traits",
            "preferences": json_value(preferences),
            "demonstrations": sha256_of(dataset / OBSERVED),
        }
        super().__init__(settings, folder, about, **shown)
        self._settings = settings
        people = stored.about.get("source") == "people"  # who cannot be recorded again
        if not people and stored.about.get("team", {}).get("end_at_crash"):
            raise ValueError(
                "these windows end at a crash, which would distinguish them from the policy's, "
                "in which a crashed car stands; collect with --no-end-at-crash"
            )
        learned = ~held_out(stored.driver, settings.held_out_share)
        if not learned.any():
            raise ValueError("held_out leaves no window to learn from; record more demonstrations")
        eta = None
        if settings.supervision == "preference" and preferences is None:
            known = _etas(dataset, stored)
            eta = None if known is None else known[learned]
        episodes = Episodes.read(stored, learned, folder)
        rng = np.random.default_rng(self.draw(Stream.LEARNING, 0))
        labelled = settings.supervision, settings.labelled
        labels = make_labels(episodes, *labelled, rng, preferences, eta)
        self._units = episodes.units
        self._windows = Windows(episodes, labels)
        self._card = settings.card(episodes.layout)
        self._device = ALONE.device(settings.device)
        torch.manual_seed(self.draw(Stream.LEARNING, 1))
        made_by = team_of(episodes), episodes.alert_rate
        self._generator = Generator(self._card, settings, *made_by, self._units, self._device)
        self._discriminator = DiscriminatorLearner(
            self._card, settings, self._generator.policy, self._device
        )
        encoder = self._discriminator.model.encoder
        self._first = EncoderLearning(encoder, self._windows, settings, self._device)
        if settings.supervision == "self":
            self._windows.draw_drivers(rng, settings.drivers_per_update, settings.pool)  # or raise
        self._about_data = {"drivers": list(episodes.names), "about": json_value(episodes.about)}
        self._rounds = settings.rounds(self._generator.horizon)

    def learn(self) -> None:
        """See :meth:`Run.learn`."""
        state, settings, name = self.state, self._settings, self.folder.name
        per_round = settings.num_teams * self._generator.horizon
        with self.progress(name, per_round * self._rounds, state.steps) as progress:
            self._updates(_AVERAGE, settings.average_updates, self._first.learn_average, progress)
            self._prepare()
            count = settings.encoder_updates if settings.supervision == "self" else 0
            self._updates(_SELF, count, self._first.learn_self, progress)
            self._updates(_IMITATING, settings.imitation, self._imitate, progress)
            progress.phase(name)
            while state.iteration < self._rounds:
                began = time.monotonic()
                with self.watched():
                    row = self._round()
                row |= self.count(began, per_round)
                state.curve.append({"steps": state.steps} | row)
                progress.advance(per_round, row)
                self.save_if_due()
        self.save_model()
        self.finish_phase()

    def save_model(self) -> None:
        """See :meth:`ModelRun.save_model`."""
        made = self._discriminator
        weights = weights_of_model(
            made.model.encoder, made.averaged, self._generator.policy, self._units
        )
        about = self.about | self._about_data
        training = about | {"steps": self.state.steps, "command": self.command_line}
        save_traits(self.folder, replace(self._card, training=training), weights)

    def _updates(
        self,
        phase: int,
        count: int,
        update: Callable[[np.random.Generator, float], dict[str, float]],
        progress: Progress,
    ) -> None:
        """Make the updates of a phase in which nothing is driven."""
        state = self.state
        while state.phase == phase and state.iteration < count:
            if state.iteration % _SHOWN_EVERY == 0:
                about = f"{self.folder.name}: {_DOING[phase]} {state.iteration}/{count}"
                progress.phase(about)
            began, done = time.monotonic(), state.iteration / count
            rng = self._seed_update(4 * state.iteration + phase)
            with self.watched():
                row = update(rng, done)
            state.curve.append({"steps": 0} | self.count(began) | row)
            self.save_if_due()
        if state.phase == phase:
            self.finish_phase()

    def _imitate(self, rng: np.random.Generator, progress: float) -> dict[str, float]:
        return self._discriminator.learn(*self._demonstrated(rng))

    def _prepare(self) -> None:
        """Take the units of the encoder's means, once the average driver is known."""
        if self.state.phase == _SELF and self.state.iteration == 0:
            self._first.prepare(np.random.default_rng(self.draw(Stream.LEARNING, 2)))

    def _round(self) -> dict[str, float]:
        settings, iteration = self._settings, self.state.iteration
        rng = self._seed_update(4 * iteration + _ROUNDS)
        self._generator.begin(iteration / self._rounds)
        pools = self._windows.draw(rng, settings.num_teams // settings.pool, settings.pool)
        with torch.no_grad():
            z = self._discriminator.encode(self._windows.batch(pools, self._device)).sample()
        number = np.arange(settings.num_teams) + iteration * settings.num_teams
        drives, driven = self._generator.drive(z, mix(settings.seed, Stream.TRAINING, number))
        rows = [
            self._discriminator.learn(*self._demonstrated(rng), driven, z)
            for _ in range(settings.updates)
        ]
        self._discriminator.average()
        row = {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}
        f = self._discriminator.rewards(driven, z)
        if settings.information_reward:
            information = self._discriminator.information(driven, z)
            row["information"] = information.mean().item()
            f = f + settings.information_reward * information[:, None, None] / f.shape[2]
        if iteration >= settings.settling * self._rounds:
            row |= self._generator.learn(driven, z, f)
        row["speed"], row["crash_rate"] = float(drives.speed.mean()), float(drives.crashed.mean())
        return row

    def _demonstrated(self, rng: np.random.Generator) -> tuple[Batch, Labelled | None]:
        """A batch of demonstrations, and one of labelled ones if there are labels."""
        settings, windows = self._settings, self._windows
        which = windows.draw_pairs(rng, settings.expert_pools, settings.pool)
        experts = windows.batch(which, self._device)
        if settings.supervision not in LABELLED:
            return experts, None
        which, labels = windows.draw_labelled(rng, settings.labelled_pools, settings.pool)
        batch = windows.batch(which, self._device)
        return experts, Labelled(batch, torch.from_numpy(labels).to(self._device))

    def _seed_update(self, counter: int) -> np.random.Generator:
        """Seed torch for one update or round, and return NumPy's generator for it."""
        seed = self.draw(Stream.LEARNING, 3 + counter)
        torch.manual_seed(seed)
        return np.random.default_rng(seed)

    def tensors(self) -> Tensors:
        """See :meth:`Run.tensors`."""
        return {
            DISCRIMINATOR: self._discriminator.tensors(),
            GENERATOR: self._generator.learner.tensors(),
            _AVERAGE_DRIVER: self._first.average.descent.tensors(),
            _ENCODER: self._first.self_supervision.descent.tensors(),
        }

    def restore(self, tensors: Tensors) -> None:
        """See :meth:`Run.restore`."""
        self._discriminator.load(tensors[DISCRIMINATOR])
        self._generator.learner.load(tensors[GENERATOR])
        self._first.average.descent.load(tensors.get(_AVERAGE_DRIVER, {}))
        self._first.self_supervision.descent.load(tensors.get(_ENCODER, {}))

    def check(self, before: dict[str, Any]) -> None:
        """See :meth:`Run.check`; checksums of demonstrations would say nothing to a reader."""
        if before.get("demonstrations") != self.about["demonstrations"]:
            raise ValueError(
                f"{self.folder} holds a run that learned from other demonstrations; choose another "
                "--out, or remove the folder"
            )
        super().check(before)


def _etas(dataset: Path, stored: ObservedFile) -> NDArray[np.float64] | None:
    """Read η of each episode's driver, shape (E,); None if the truth is not known."""
    if not (dataset / TRUTH).is_file():
        return None
    truth = TruthFile(dataset, stored)
    pieces = [truth.read(k, min(k + PIECE, len(stored))) for k in range(0, len(stored), PIECE)]
    column = TRAIT_NAMES.index("eta")
    return np.concatenate([piece.traits[:, column] for piece in pieces])
