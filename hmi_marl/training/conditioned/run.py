"""Learning, in a folder, of an HMI that is conditioned on z; resumable.

In half of each round's trips alerts are drawn from the HMI as it is learned so far, so that it
learns what to do in the situations that it gets into (DAgger); AvgHMI, with exceptions at random,
alerts in the others. The HMI acts as a :class:`ConditionedHMI` does later: z comes from an
estimator that reads the trip under way. It learns what has the highest value that is expected under
the same belief, by the exact rules for the candidates; it never knows who drives.

Besides the files of every run (:mod:`hmi_marl.training.runs.run`) the folder holds the policy,
``vehicle_ai.json`` with its weights.
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hmi_marl.agents.adaptive.advantages import Advantages
from hmi_marl.agents.adaptive.evidence_model import LearnedEvidence, load_evidence
from hmi_marl.agents.adaptive.hmis import TYPES, ConditionedHMI
from hmi_marl.agents.adaptive.trait_estimator import TraitEstimator
from hmi_marl.agents.catalogue import make_driver_policy
from hmi_marl.agents.learned.policy import CONTEXT_OF, LearnedPolicy, save_policy
from hmi_marl.agents.learned.trait_model import load_traits
from hmi_marl.envs.config import VEHICLE_AI
from hmi_marl.envs.drivers import Driver, Traits, get_driver
from hmi_marl.envs.streams import Stream, mix
from hmi_marl.extras import needing
from hmi_marl.training.conditioned.settings import (
    ConditionedSettings,
    strangers,
    with_any_inflation,
)
from hmi_marl.training.conditioned.trips import DrivenTrips, drive

with needing("training"):
    import torch

    from hmi_marl.training.conditioned.student import Student
    from hmi_marl.training.runs.descent import Descent
    from hmi_marl.training.runs.run import ModelRun, Tensors, own_torch_state


def learn_conditioned(
    settings: ConditionedSettings,
    evidence: Path | str,
    folder: Path,
    quiet: bool = False,
    command_line: str = "",
    line: int = 0,
) -> None:
    """Learn in ``folder``, resuming a run that was interrupted there; arguments: :class:`Run`.

    Args:
        settings: settings of the learning.
        evidence: evidence model that gives z, of another run or ``trained:NAME``.
        folder: of the run.
        quiet, command_line, line: see :class:`Run`.

    Raises:
        FileNotFoundError, ValueError: there is no such evidence model, trait model or driver
            policy, they do not fit, or the folder holds another run.
    """
    with own_torch_state(settings.threads):
        run = _Run(settings, evidence, folder, command_line=command_line, quiet=quiet, line=line)
        run.go()


class _Run(ModelRun):
    card_name = f"{VEHICLE_AI}.json"

    def __init__(
        self, settings: ConditionedSettings, evidence: Path | str, folder: Path, **shown: Any
    ) -> None:
        self._evidence, self._traits = load_evidence(evidence), load_traits(settings.traits)
        LearnedEvidence(self._evidence, self._traits, TYPES, settings.team)  # or raise
        about = {
            "protocol": "conditioned",
            CONTEXT_OF: self._evidence.card.encoder,
            "evidence": self._evidence.digest,
        }
        super().__init__(settings, folder, about, **shown)
        self._settings = settings
        self._driver = make_driver_policy(settings.driver_policy, settings.team)
        self._card = settings.card(self._evidence.card.context)
        torch.manual_seed(self.draw(Stream.LEARNING, 0))
        self._student = Student(self._card)
        self._descent = Descent(
            self._student.parameters(), settings.learning_rate, settings.weight_decay
        )

    def learn(self) -> None:
        """See :meth:`Run.learn`."""
        settings, state, name = self._settings, self.state, self.folder.name
        others = [get_driver(each) for each in strangers(settings.strangers, settings.seed)]
        known = [driver for driver in TYPES for _ in range(settings.types)]
        with self.progress(name, settings.rounds, state.iteration, "rounds") as progress:
            while state.iteration < settings.rounds:
                began = time.monotonic()
                groups = (others, self._candidates()), (known, TYPES)
                trips = [self._drive(number, *group) for number, group in enumerate(groups)]
                row = {"loss": self._update(DrivenTrips.joined(trips))}
                regrets = [self._regret(part) for part in trips]
                row |= {"regret": regrets[0], "regret_types": regrets[1]}
                steps = int(sum(part.driving.sum() for part in trips))
                rate = self.count(began, steps)
                state.curve.append({"rounds": state.iteration} | row | rate)
                progress.advance(row=row)
                self.save_if_due()
        self.save_model()
        self.finish_phase()

    def save_model(self) -> None:
        """See :meth:`ModelRun.save_model`."""
        training = self.about | {"steps": self.state.steps, "command": self.command_line}
        save_policy(self.folder, replace(self._card, training=training), self._student.weights())

    def tensors(self) -> Tensors:
        """See :meth:`Run.tensors`."""
        return {"model": dict(self._student.state_dict()), "learner": self._descent.tensors()}

    def restore(self, tensors: Tensors) -> None:
        """See :meth:`Run.restore`."""
        self._student.load_state_dict(tensors["model"])
        self._descent.load(tensors["learner"])

    def _candidates(self) -> tuple[Driver, ...]:
        """Drivers that the estimator considers for strangers in this round."""
        settings = self._settings
        seed = self.draw(Stream.CANDIDATES, self.state.iteration)
        return with_any_inflation(strangers(settings.candidates, seed), settings.inflations)

    def _drive(
        self, number: int, drivers: list[Driver], candidates: tuple[Driver, ...]
    ) -> DrivenTrips:
        """Drive this round's trips of one group of drivers."""
        settings, team = self._settings, self._settings.team
        evidence = LearnedEvidence(self._evidence, self._traits, candidates, team)
        policy = LearnedPolicy(self._card, self._student.weights(), team, greedy=False)
        latents = self._evidence.expected(Traits.of(candidates))
        hmi = ConditionedHMI(TraitEstimator(evidence, team), policy, latents)
        first = self.draw(Stream.TRAINING, 2 * self.state.iteration + number)
        counters = np.arange(len(drivers) * settings.trips, dtype=np.uint64)
        seeds = mix(first, Stream.TRAINING, counters).reshape(len(drivers), settings.trips)
        return drive(
            team,
            self._driver,
            hmi,
            drivers,
            Advantages(candidates, team, settings.revealing),
            settings.revealing,
            seeds,
            settings.threads,
        )

    def _regret(self, trips: DrivenTrips) -> float:
        """Mean expected loss of a group's trips with the learned HMI, of every second driver."""
        return float(trips.regret.reshape(self._settings.trips, -1)[:, ::2].mean())

    def _update(self, trips: DrivenTrips) -> float:
        """Take this round's gradient steps; return the mean loss."""
        settings, done = self._settings, self.state.iteration
        rng = np.random.default_rng(self.draw(Stream.LEARNING, 1 + done))
        losses = []
        for number in range(settings.updates):
            which = rng.choice(len(trips.inputs), settings.batch, replace=False)
            inputs, advantage, driving = (
                torch.from_numpy(values[which])
                for values in (trips.inputs, trips.advantage, trips.driving)
            )
            loss = self._student.loss(inputs, advantage, driving)
            progress = (done + number / settings.updates) / settings.rounds
            with self.watched():
                losses.append(self._descent.step(loss, progress))
        return float(np.mean(losses))
