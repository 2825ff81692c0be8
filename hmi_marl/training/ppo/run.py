"""The one training loop: the phases of a protocol, batch by batch, resumable in a folder.

A run's folder holds ``run.json`` (the resolved settings), ``checkpoint.safetensors``,
``curve.json`` (a row for each batch), ``tensorboard/``, and the policies it has learned,
``driver.json`` and ``vehicle_ai.json`` with their weights; on request also ``snapshots/STEPS/``,
the same as they stood after so many environment steps.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import hmi_marl
from hmi_marl.agents.catalogue import make_driver_policy, make_hmi
from hmi_marl.agents.learned.network import NetworkConfig, Weights
from hmi_marl.agents.learned.policy import (
    CONTEXT_OF,
    LearnedPolicy,
    PolicyCard,
    load_policy,
    save_policy,
)
from hmi_marl.agents.partners import make_vec
from hmi_marl.envs.config import DRIVER
from hmi_marl.envs.seats import Policy
from hmi_marl.envs.streams import Stream, mix
from hmi_marl.extras import needing
from hmi_marl.files import json_value, make_folder, write_json
from hmi_marl.training.protocols.phase import LEARNED, OTHER, TEAM, Phase
from hmi_marl.training.protocols.settings import TrainSettings
from hmi_marl.training.runs.claim import SETTINGS, check_same, read_settings, told
from hmi_marl.training.runs.jobs import CURVE
from hmi_marl.training.runs.progress import Telling

with needing("training"):
    import torch

    from hmi_marl.envs.vector import TeamVecEnv
    from hmi_marl.training.ppo.batch import play_batch
    from hmi_marl.training.ppo.learner import Learner, PPOLearner, TwoLearners
    from hmi_marl.training.ppo.models import (
        make_actor,
        make_critic,
        make_joint_actor,
        weights_of,
        weights_of_both,
    )
    from hmi_marl.training.ppo.views import Context, IntentShown, SeatView
    from hmi_marl.training.runs.checkpoint import CHECKPOINT, Checkpoint
    from hmi_marl.training.runs.processes import Processes, joined

_INITIAL_WEIGHTS = {DRIVER: 0, OTHER[DRIVER]: 1, TEAM: 2}


def train(
    settings: TrainSettings,
    folder: Path,
    context: Context | None = None,
    quiet: bool = False,
    command_line: str = "",
    line: int = 0,
) -> None:
    """Learn what ``settings`` say in ``folder``, going on where a run there was cut off.

    Args:
        settings: a protocol with its choices.
        folder: of the run.
        context: gives a vector z for each driver, which the vehicle AI is then conditioned on
            instead of the traits. (The driver knows their own traits.)
        quiet: no progress bar and no TensorBoard.
        typed: the command, kept with the policies.
        line: of the terminal for the progress bar, where several runs go on side by side.

    Raises:
        ValueError: the folder holds a run with other settings, or the vehicle AI is to learn from
            a context beside which a driver learns afterwards.
    """
    with joined() as processes, torch.random.fork_rng():
        if processes.is_first:
            make_folder(folder)
        quiet = quiet or not processes.is_first
        threads = torch.get_num_threads()
        torch.set_num_threads(settings.threads)
        try:
            _Run(settings, folder, processes, context, quiet, command_line).go(line)
        finally:
            torch.set_num_threads(threads)


class _Run:
    def __init__(
        self,
        settings: TrainSettings,
        folder: Path,
        processes: Processes,
        context: Context | None,
        quiet: bool,
        command_line: str,
    ) -> None:
        self._settings = settings
        self._folder = folder
        self._processes = processes
        self._context = context
        self._quiet = quiet
        self._about = {
            "environment": "merge_v0",
            "version": hmi_marl.__version__,
            "protocol": type(settings).__name__,
            "settings": told(settings),
            "processes": processes.count,
            "context": 0 if context is None else context.size,
        }
        if context is not None:
            self._about[CONTEXT_OF] = context.digest
        self._typed = command_line
        self._device = processes.device(settings.device)
        self._phases = [_in_context(phase, context) for phase in settings.phases()]
        self._learners: dict[str, PPOLearner] = {}
        self._state = Checkpoint()
        self._saved_at = time.monotonic()

    def go(self, line: int) -> None:
        self._claim_folder()
        phases, state = self._phases, self._state
        if state.phase == len(phases):
            return  # all is learned
        total = sum(self._steps(phase) * self._iterations(phase) for phase in phases)
        name = self._folder.name
        board = self._folder / "tensorboard"
        with Telling(board, name, total, state.steps, self._quiet, line) as telling:
            while state.phase < len(phases):
                phase = phases[state.phase]
                telling.phase(f"{name}: {phase.name}")
                self._learn(phase, telling)
                self._save_policies(phase, self._folder)
                state.phase, state.iteration = state.phase + 1, 0
                self._save()
        self._processes.wait()  # until the last checkpoint is there for all

    def _claim_folder(self) -> None:
        """Begin a run here, or go on with the one that is here."""
        path, checkpoint = self._folder / SETTINGS, self._folder / CHECKPOINT
        if checkpoint.is_file():  # otherwise nothing was learned that could be lost
            check_same(read_settings(path), self._about, self._folder)
            self._state = Checkpoint.load(checkpoint)
        elif self._processes.is_first:
            write_json(path, self._about | {"command": self._typed})
        self._processes.wait()

    def _iterations(self, phase: Phase) -> int:
        return phase.iterations(self._settings.num_teams, self._processes.count)

    def _steps(self, phase: Phase) -> int:
        """In one batch, over all processes."""
        return self._settings.num_teams * phase.team.horizon * self._processes.count

    def _learn(self, phase: Phase, telling: Telling) -> None:
        state, iterations = self._state, self._iterations(phase)
        env = self._make_env(phase)
        learner = self._make_learner(phase, env)
        start, end = phase.progress
        while state.iteration < iterations:
            began = time.monotonic()
            seed = self._seed_batch()
            learner.begin(start + (end - start) * state.iteration / iterations)
            row = play_batch(env, learner, seed)
            played = time.monotonic()
            row |= learner.learn(env.get_observations())
            row = self._processes.mean(row)
            now = time.monotonic()
            state.iteration += 1
            state.steps += self._steps(phase)
            state.seconds += now - began
            row["steps_per_second"] = self._steps(phase) / (now - began)
            row["share_of_time_learning"] = (now - played) / (now - began)
            row["seconds"] = state.seconds
            state.curve.append({"phase": phase.name, "steps": state.steps} | row)
            telling.batch(row, state.steps, self._steps(phase))
            wanted = self._settings.snapshots
            if (
                state.iteration * wanted // iterations
                > (state.iteration - 1) * wanted // iterations
            ):
                self._save_policies(phase, self._folder / "snapshots" / str(state.steps))
            if now - self._saved_at > self._settings.checkpoint_every:
                self._save()

    def _make_env(self, phase: Phase) -> TeamVecEnv:
        settings = self._settings
        return make_vec(
            settings.num_teams,
            phase.seat,  # type: ignore[arg-type]
            self._partner(phase),
            device=self._device,
            threads=settings.threads,
            **vars(phase.team),
        )

    def _partner(self, phase: Phase) -> Policy | None:
        if phase.partner is None:
            return None
        other = OTHER[phase.seat]
        if phase.partner == LEARNED:
            return load_policy(self._folder, other, phase.team)
        make = make_driver_policy if other == DRIVER else make_hmi
        partner = make(phase.partner, phase.team)
        if isinstance(partner, LearnedPolicy) and self._processes.is_first:
            save_policy(self._folder, partner.card, partner.weights)  # so that the run is whole
        return partner

    def _make_learner(self, phase: Phase, env: TeamVecEnv) -> Learner:
        if phase.seat != TEAM or phase.joint:
            return self._learner(phase.seat, phase.cards, env)
        driver, vehicle_ai = (self._learner(card.seat, (card,), env) for card in phase.cards)
        return TwoLearners(driver, vehicle_ai, IntentShown(env) if phase.sequential else None)

    def _learner(self, name: str, cards: tuple[PolicyCard, ...], env: TeamVecEnv) -> PPOLearner:
        """The learner of this name: as it stands, as it was saved, or a new one."""
        if name in self._learners:
            return self._learners[name]
        settings, state = self._settings, self._state
        torch.manual_seed(self._draw(Stream.LEARNING, _INITIAL_WEIGHTS[name]))
        view = SeatView(env, cards, settings.critic == "team", self._context)
        critic = NetworkConfig(settings.network.hidden_dims, settings.network.activation)
        learner = PPOLearner(
            make_joint_actor(*cards) if len(cards) == 2 else make_actor(*cards),
            make_critic(view.critic_inputs, critic),
            view,
            env.get_observations(),
            env.max_episode_length,
            len(cards),
            settings.ppo,
            self._device,
            self._processes,
        )
        if name in state.tensors:
            learner.load(state.tensors[name])
        self._learners[name] = learner
        return learner

    def _seed_batch(self) -> int:
        """Seed what this process draws in the next batch; returns the seed of its teams."""
        batch = 2**32 * self._state.phase + self._state.iteration
        number = batch * self._processes.count + self._processes.rank
        torch.manual_seed(self._draw(Stream.LEARNING, len(_INITIAL_WEIGHTS) + number))
        return self._draw(Stream.TRAINING, number)

    def _draw(self, stream: Stream, counter: int) -> int:
        return int(mix(self._settings.seed, stream, counter))

    def _save_policies(self, phase: Phase, folder: Path) -> None:
        """Write the policies that learn in this phase."""
        if not self._processes.is_first:
            self._processes.wait()
            return
        training = self._about | {
            "team": json_value(phase.team),
            "steps": self._state.steps,
            "command": self._typed,
        }
        for card, weights in self._learned(phase):
            save_policy(folder, replace(card, training=training), weights)
        self._processes.wait()

    def _learned(self, phase: Phase) -> Iterable[tuple[PolicyCard, Weights]]:
        if phase.joint:
            actor = self._learners[TEAM].ppo.actor
            return zip(phase.cards, weights_of_both(actor), strict=True)
        return [(card, weights_of(self._learners[card.seat].ppo.actor)) for card in phase.cards]

    def _save(self) -> None:
        """Write a checkpoint, and the curve as far as it reaches."""
        self._saved_at = time.monotonic()
        if not self._processes.is_first:
            return
        for name, learner in self._learners.items():
            self._state.tensors[name] = learner.tensors()
        write_json(self._folder / CURVE, self._state.curve)  # first: a kill in between loses none
        self._state.save(self._folder / CHECKPOINT)


def _in_context(phase: Phase, context: Context | None) -> Phase:
    """The phase with the vehicle AI conditioned on z, if there is one."""
    if context is None:
        return phase
    if phase.seat == DRIVER and phase.partner == LEARNED:
        raise ValueError("a vehicle AI conditioned on z cannot be a partner in training")
    return replace(phase, cards=tuple(card.with_context(context.size) for card in phase.cards))
