"""Learning of an evidence model in a folder, resumable, from drives of drivers with known traits.

Besides the files of every run (:mod:`hmi_marl.training.runs.run`) the folder holds the learned
model, ``evidence.json`` with its weights. The drives are not kept: they follow from the settings,
and are driven again when a run is resumed.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.adaptive.evidence_model import NAME, Turns, save_evidence
from hmi_marl.agents.adaptive.trip_encoder import TripEncoder
from hmi_marl.agents.catalogue import make_driver_policy, make_hmi
from hmi_marl.agents.learned.trait_model import TraitModel, load_traits
from hmi_marl.agents.rollout import Observer, begin, play
from hmi_marl.envs.config import VEHICLE_AI, TeamConfig
from hmi_marl.envs.drivers import DRIVERS, DriverList, TraitDistributions, Traits
from hmi_marl.envs.observations import traits_part
from hmi_marl.envs.streams import Stream, mix, uniform
from hmi_marl.envs.teaming import Teaming
from hmi_marl.envs.worlds import make_world
from hmi_marl.extras import needing
from hmi_marl.training.evidence.settings import EvidenceSettings

with needing("training"):
    import torch

    from hmi_marl.training.evidence.model import EvidenceNetwork
    from hmi_marl.training.runs.descent import Descent
    from hmi_marl.training.runs.progress import Progress
    from hmi_marl.training.runs.run import ModelRun, Tensors, own_torch_state


_AT_ONCE = 1000
"""Drives in parallel; bounds the memory."""
_KIND = 2**32
"""Counter of the random number that decides whether a named driver drives."""


@dataclass(frozen=True)
class MixedPopulation:
    """Population of the named drivers and of others with uniformly drawn traits."""

    known: float
    """Share of named drivers, in [0, 1]."""

    def draw(self, seeds: NDArray[np.uint64]) -> Traits:
        """See :meth:`Population.draw`."""
        is_known = uniform(seeds, Stream.TRAITS, _KIND) < self.known
        named = DriverList(tuple(DRIVERS.values())).draw(seeds).as_array()
        others = TraitDistributions().draw(seeds).as_array()
        return Traits.from_array(np.where(is_known[:, None], named, others))


@dataclass(frozen=True, eq=False)
class RecordedDrives:
    """M drives of at most T turns."""

    turns: NDArray[np.float32]
    """Inputs of an evidence model, shape (M, T, inputs)."""
    driving: NDArray[np.bool_]
    """Whether the episode was still running, shape (M, T)."""
    z: NDArray[np.float32]
    """Mean of q(z | drive), shape (M, Z)."""
    traits: Traits
    """Traits of the M drivers."""


def drive_all(
    settings: EvidenceSettings, progress: Callable[[int], object] = lambda drives: None
) -> RecordedDrives:
    """Drive many episodes, each HMI with an equal share of the drivers.

    ``progress`` is called with the number of drives done since the last call.

    Raises:
        ValueError: an unknown HMI or driver policy.
    """
    team = replace(settings.team, driver=MixedPopulation(settings.known))
    traits = load_traits(settings.traits)
    seeds = mix(settings.seed, Stream.TRAINING, np.arange(settings.drives, dtype=np.uint64))
    parts = []
    for name, chosen in zip(settings.hmis, np.array_split(seeds, len(settings.hmis)), strict=True):
        for start in range(0, len(chosen), _AT_ONCE):
            part = chosen[start : start + _AT_ONCE]
            parts.append(_drive(team, settings, traits, name, part))
            progress(len(part))
    return RecordedDrives(
        np.concatenate([part.turns for part in parts]),
        np.concatenate([part.driving for part in parts]),
        np.concatenate([part.z for part in parts]),
        Traits.from_array(np.concatenate([part.traits.as_array() for part in parts])),
    )


def _drive(
    team: TeamConfig,
    settings: EvidenceSettings,
    traits: TraitModel,
    hmi_name: str,
    seeds: NDArray[np.uint64],
) -> RecordedDrives:
    driver, hmi = make_driver_policy(settings.driver_policy, team), make_hmi(hmi_name, team)
    world = make_world("batched", team.scene, len(seeds), settings.threads)
    teaming = begin(team, driver, hmi, seeds, world)
    encoder = TripEncoder(traits, team)
    recorder = _Recorder(Turns(settings.reads, teaming.layouts[VEHICLE_AI]), encoder, teaming)
    play(teaming, driver, hmi, [recorder], steps=team.horizon)
    turns, driving = np.stack(recorder.turns, axis=1), np.stack(recorder.driving, axis=1)
    sums = encoder.sums
    sums[:, -1] = np.maximum(sums[:, -1], 1.0)  # of a drive that ended in its first step
    z = traits.encoder.latent(sums).mean.astype(np.float32)
    return RecordedDrives(turns, driving, z, teaming.traits)


class _Recorder(Observer):
    """Record the inputs of an evidence model, when the vehicle AI acts."""

    def __init__(self, reader: Turns, encoder: TripEncoder, teaming: Teaming) -> None:
        self.turns: list[NDArray[np.float32]] = []
        self.driving: list[NDArray[np.bool_]] = []
        self._reader, self._encoder = reader, encoder
        reader.reset(teaming.num_teams)
        encoder.reset(teaming.num_teams)

    def seen(self, teaming: Teaming, observations: NDArray[np.float32]) -> None:
        """Record one turn."""
        new = ~teaming.over
        self.driving.append(new)
        features = self._encoder.observe(observations, new)
        read = self._reader.read(observations, new)
        self.turns.append(np.concatenate([features, read], axis=1, dtype=np.float32))


_SETTLED = "settled"
"""Name in a checkpoint of what is calibrated after the learning."""
_ROW_EVERY = 50
"""Updates between two rows of the curve."""
_TEMPERATURES = torch.linspace(0.2, 1.2, 41)
"""Temperatures to choose from."""


def _check_seats(settings: EvidenceSettings, traits: TraitModel) -> None:
    """Make all that will drive or read once, before a folder is made.

    Raises:
        FileNotFoundError, ValueError: an unknown HMI or driver policy, or a trait model that reads
            other states than these teams show.
    """
    TripEncoder(traits, settings.team)
    make_driver_policy(settings.driver_policy, settings.team)
    for name in settings.hmis:
        make_hmi(name, settings.team)


def learn_evidence(
    settings: EvidenceSettings,
    folder: Path,
    quiet: bool = False,
    command_line: str = "",
    line: int = 0,
) -> None:
    """Learn in ``folder``, resuming a run that was interrupted there; arguments: :class:`Run`.

    Raises:
        FileNotFoundError, ValueError: the folder holds another run, the settings name an HMI, a
            driver policy or a trait model that is not there, or the latter does not fit the teams.
    """
    with own_torch_state(settings.threads):
        _Run(settings, folder, command_line=command_line, quiet=quiet, line=line).go()


class _Run(ModelRun):
    card_name = NAME

    def __init__(self, settings: EvidenceSettings, folder: Path, **shown: Any) -> None:
        super().__init__(settings, folder, {"protocol": "evidence"}, **shown)
        self._settings = settings
        traits = load_traits(settings.traits)
        _check_seats(settings, traits)
        self._calibrated: float | None = None
        """Softmax temperature, once everything is learned."""
        torch.manual_seed(self.draw(Stream.LEARNING, 0))
        self._model = EvidenceNetwork(settings.card(settings.team, traits))
        self._descent = Descent(
            self._model.parameters(), settings.learning_rate, settings.weight_decay
        )

    def learn(self) -> None:
        """See :meth:`Run.learn`."""
        state, settings, name = self.state, self._settings, self.folder.name
        with self.progress(f"{name}: driving", settings.drives, unit="drives") as progress:
            began = time.monotonic()
            drives = drive_all(settings, progress.advance)
            state.seconds += time.monotonic() - began
        if state.iteration == 0:
            self._take_units(drives)
        with self.progress(name, settings.updates, state.iteration, "updates") as progress:
            self._update(drives, progress)
        self._calibrated = self._temperature(drives)
        self._model.settle(self._calibrated, self._shown(drives))
        self.save_model()
        self.finish_phase()

    def save_model(self) -> None:
        """See :meth:`ModelRun.save_model`."""
        training = self.about | {"temperature": self._calibrated, "command": self.command_line}
        model = self._model
        save_evidence(self.folder, replace(model.card, training=training), model.weights())

    def tensors(self) -> Tensors:
        """See :meth:`Run.tensors`."""
        tensors = {"model": dict(self._model.state_dict()), "learner": self._descent.tensors()}
        if self._calibrated is not None:
            tensors[_SETTLED] = {"temperature": torch.tensor(self._calibrated)}
        return tensors

    def restore(self, tensors: Tensors) -> None:
        """See :meth:`Run.restore`."""
        self._model.load_state_dict(tensors["model"])
        if _SETTLED in tensors:
            self._calibrated = float(tensors[_SETTLED]["temperature"])
        self._descent.load(tensors["learner"])

    def _update(self, drives: RecordedDrives, progress: Progress) -> None:
        state, settings, shown = self.state, self._settings, self._shown(drives)
        learned, held_out = self._split()
        held_out = held_out[: settings.batch]
        z = torch.from_numpy(drives.z)
        unseen = self._turns(drives, held_out)
        recent: list[float] = []
        while state.iteration < settings.updates:
            began = time.monotonic()
            rng = np.random.default_rng(self.draw(Stream.LEARNING, 2 + state.iteration))
            which = rng.choice(learned, settings.batch, replace=False)
            turns, driving = self._turns(drives, which)
            loss = self._model.loss(turns, driving, shown[which])
            loss = loss + self._model.expected_loss(z[which], shown[which])
            with self.watched():
                recent.append(self._descent.step(loss, state.iteration / settings.updates))
            seconds = self.count(began)
            row = {}
            if state.iteration % _ROW_EVERY == 0 or state.iteration == settings.updates:
                with torch.no_grad():
                    held_out_loss = self._model.loss(*unseen, shown[held_out]).item()
                row = {"loss": float(np.mean(recent)), "held_out_loss": held_out_loss}
                state.curve.append({"updates": state.iteration} | row | seconds)
                recent.clear()
            progress.advance(row=row)
            self.save_if_due()

    @staticmethod
    def _shown(drives: RecordedDrives) -> torch.Tensor:
        """Traits of the drivers as networks observe them, shape (M, 4)."""
        return torch.from_numpy(traits_part(drives.traits).astype(np.float32))

    def _split(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Indices of the drives to learn from, and of the held-out drives."""
        rng = np.random.default_rng(self.draw(Stream.LEARNING, 1))
        mixed = rng.permutation(self._settings.drives)  # drives are sorted by HMI
        learned, held_out = np.split(mixed, [self._settings.learned])
        return learned, held_out

    def _temperature(self, drives: RecordedDrives) -> float:
        """Calibrate the softmax temperature on held-out drives.

        The learned evidence is overconfident, the more so the more of it is added up.
        """
        _, held_out = self._split()
        shown = self._shown(drives)
        total = torch.zeros(len(_TEMPERATURES))
        for part in np.array_split(held_out, -(-len(held_out) // self._settings.batch)):
            unseen = self._turns(drives, part)
            with torch.no_grad():
                losses = self._model.loss_at_end(*unseen, shown[part], _TEMPERATURES)
                total += len(part) * losses
        return float(_TEMPERATURES[int(total.argmin())])

    def _take_units(self, drives: RecordedDrives) -> None:
        """Take the units of the inputs from the drives."""
        read = drives.turns[..., : self._model.card.standardised][drives.driving]
        self._model.centre.copy_(torch.from_numpy(read.mean(axis=0)))
        spread = read.std(axis=0)
        self._model.scale.copy_(torch.from_numpy(np.where(spread > 1e-3, spread, 1.0)))

    def _turns(
        self, drives: RecordedDrives, which: NDArray[np.int64]
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Turns of B drives, (B, T, inputs), and which of them are real, (B, T)."""
        turns, driving = drives.turns[which], drives.driving[which]
        return torch.from_numpy(turns), torch.from_numpy(driving)
