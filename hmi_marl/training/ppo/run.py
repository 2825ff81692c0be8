"""The training loop: the phases of a protocol, batch by batch, resumable in a folder.

Besides the files of every run (:mod:`hmi_marl.training.runs.run`) the folder holds the learned
policies, ``driver.json`` and ``vehicle_ai.json`` with their weights; on request also
``snapshots/STEPS/``, the policies after so many environment steps.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from hmi_marl.agents.catalogue import make_driver_policy, make_hmi
from hmi_marl.agents.learned.cards import is_saved
from hmi_marl.agents.learned.network import NetworkConfig, Weights
from hmi_marl.agents.learned.policy import (
    CONTEXT_OF,
    LearnedPolicy,
    PolicyCard,
    load_policy,
    save_policy,
)
from hmi_marl.agents.partners import make_vec
from hmi_marl.envs.config import AGENTS, DRIVER, VEHICLE_AI
from hmi_marl.envs.seats import Policy
from hmi_marl.envs.streams import Stream
from hmi_marl.extras import needing
from hmi_marl.files import json_value
from hmi_marl.ownership import check_free
from hmi_marl.training.protocols.anchored import load_anchor
from hmi_marl.training.protocols.settings import LEARNED, OTHER_SEAT, TEAM, Phase, TrainSettings
from hmi_marl.training.runs.exchange import SharedMemory
from hmi_marl.training.runs.folder import CHECKPOINT
from hmi_marl.training.runs.start import (
    check_processes,
    check_start,
    default_threads,
    learns_on_gpu,
    start_together,
)

with needing("training"):
    import torch
    from rsl_rl.models import MLPModel  # type: ignore[import-untyped]

    from hmi_marl.envs.vector import TeamVecEnv
    from hmi_marl.training.ppo.anchor import Anchor
    from hmi_marl.training.ppo.learner import (
        Learner,
        PPOLearner,
        TwoLearners,
        play_batch,
        weights_among,
    )
    from hmi_marl.training.ppo.models import (
        Context,
        IntentShown,
        SeatView,
        make_actor,
        make_critic,
        make_joint_actor,
        weights_of,
        weights_of_both,
    )
    from hmi_marl.training.ppo.shards import Shards
    from hmi_marl.training.runs.checkpoint import fitting
    from hmi_marl.training.runs.processes import Processes, joined
    from hmi_marl.training.runs.progress import Progress
    from hmi_marl.training.runs.run import Run, Tensors, own_torch_state

_ANCHOR = "anchor"
"""Name among the learners under which a checkpoint holds the anchor's weights."""
_INITIAL_WEIGHTS = {DRIVER: 0, OTHER_SEAT[DRIVER]: 1, TEAM: 2}


def train(
    settings: TrainSettings,
    folder: Path,
    context: Context | None = None,
    quiet: bool = False,
    command_line: str = "",
    line: int = 0,
    processes: int = 1,
) -> None:
    """Train by a protocol in ``folder``, resuming a run that was interrupted there.

    Args:
        settings: a protocol with its settings.
        context: gives a vector z for each driver, which the vehicle AI observes instead of the
            traits. (The driver observes its own traits.)
        quiet, command_line, line: see :class:`Run`.
        processes: processes that share the work. More than one are started for it, so the caller's
            program needs ``if __name__ == "__main__":``. Does not change results (on the CPU).

    Raises:
        ValueError: the folder holds a run with other settings, or a context is given and a driver
            is to learn with the conditioned vehicle AI afterwards, or the teams cannot be shared
            among so many processes.
    """
    shown = {"command_line": command_line, "quiet": quiet, "line": line}
    check_free(folder)
    check_start(settings)
    if processes == 1:
        train_rank(settings, folder, context, shown)
        return
    check_processes(processes, settings)
    threads = settings.threads or max(1, default_threads(settings.device) // processes)
    settings = replace(settings, threads=threads)
    start_together(processes, train_rank, settings, folder, context, shown, threads=threads)


def train_rank(
    settings: TrainSettings,
    folder: Path,
    context: Context | None,
    shown: dict[str, Any],
    memory: SharedMemory | None = None,
    rank: int = 0,
) -> None:
    """Train in this process, alone or as one of those that share ``memory``."""
    processes = joined(memory, rank, learns_on_gpu(settings.device))
    check_processes(processes.count, settings)
    threads = settings.threads or default_threads(settings.device)
    with own_torch_state(threads):
        _Run(replace(settings, threads=threads), folder, context, processes, **shown).go()


class _Run(Run):
    def __init__(
        self,
        settings: TrainSettings,
        folder: Path,
        context: Context | None,
        processes: Processes,
        **shown: Any,
    ) -> None:
        about = {
            "environment": "merge_v0",
            "protocol": type(settings).__name__,
            "context": 0 if context is None else context.size,
        }
        if context is not None:
            about[CONTEXT_OF] = context.digest
        super().__init__(settings, folder, about, processes, **shown)
        self._settings, self._context = settings, context
        self._device = processes.device(settings.device)
        on_cpu = self._device == "cpu"
        self._shards = Shards(settings.shards_used if on_cpu else processes.count, processes)
        self._phases = [_in_context(phase, context) for phase in settings.phases()]
        self.phases = len(self._phases)
        self._learners: dict[str, PPOLearner] = {}
        self._groups: dict[str, tuple[str, ...]] = {}
        """Groups of observations that each learner reads."""
        self._restored: Tensors = {}
        self._own_driver: Weights = {}
        """Weights of the driver before the phase that is anchored to it."""

    def learn(self) -> None:
        """See :meth:`Run.learn`."""
        name = self.folder.name
        total = sum(self._steps(phase) * self._iterations(phase) for phase in self._phases)
        with self.progress(name, total, self.state.steps) as progress:
            for phase in self._phases[self.state.phase :]:
                progress.phase(f"{name}: {phase.name}")
                self._learn_phase(phase, progress)
                self._save_policies(phase, self.folder)
                self.finish_phase()

    def tensors(self) -> Tensors:
        """See :meth:`Run.tensors`."""
        tensors = {name: learner.tensors() for name, learner in self._learners.items()}
        if self._own_driver:
            tensors[_ANCHOR] = {n: torch.from_numpy(v) for n, v in self._own_driver.items()}
        return tensors

    def restore(self, tensors: Tensors) -> None:
        """See :meth:`Run.restore`; a learner is made and restored when its phase begins."""
        self._restored = tensors
        self._own_driver = {n: v.numpy() for n, v in tensors.get(_ANCHOR, {}).items()}

    def save_lost(self) -> None:
        """See :meth:`Run.save_lost`; of each seat, the policy of the last phase that it learned in.

        Also policies of other runs that were copied here.
        """
        steps, last = 0, dict[str, tuple[Phase, int]]()
        for phase in self._phases[: self.state.phase]:
            steps += self._steps(phase) * self._iterations(phase)
            last |= {card.seat: (phase, steps) for card in phase.cards}
            other = OTHER_SEAT.get(phase.seat)
            if other and other not in last and not is_saved(self.folder / f"{other}.json"):
                self._partner(phase)
        now = self._phases[self.state.phase : self.state.phase + 1]
        learning = {card.seat for phase in now for card in phase.cards}
        for seat in last.keys() - learning:  # those will be saved when they have learned
            phase, steps = last[seat]
            if not is_saved(self.folder / f"{seat}.json"):
                self._write_policies(phase, self.folder, steps, (seat,))

    def _iterations(self, phase: Phase) -> int:
        return phase.iterations(self._settings.num_teams)

    def _steps(self, phase: Phase) -> int:
        """Steps of one batch, over all processes."""
        return self._settings.num_teams * phase.team.horizon

    def _learn_phase(self, phase: Phase, progress: Progress) -> None:
        state, iterations, steps = self.state, self._iterations(phase), self._steps(phase)
        env = self._make_env(phase)
        learner = self._make_learner(phase, env)
        (start, end), wanted = phase.progress, self._settings.snapshots
        while state.iteration < iterations:
            began, waited = time.monotonic(), self.processes.seconds_waited
            seed, generators = self._seed_batch()
            learner.begin(start + (end - start) * state.iteration / iterations, generators)
            row = play_batch(env, learner, seed, self._shards)
            played = time.monotonic()
            with self.watched():
                row |= learner.learn(env.get_observations())
            learning = time.monotonic() - played
            row |= self.count(began, steps)
            waiting = self.processes.seconds_waited - waited
            row["share_of_time_learning"] = learning * row["steps_per_second"] / steps
            row["share_of_time_waiting"] = waiting * row["steps_per_second"] / steps
            state.curve.append({"phase": phase.name, "steps": state.steps} | row)
            progress.advance(steps, row)
            done = state.iteration
            if done * wanted // iterations > (done - 1) * wanted // iterations:
                self._save_policies(phase, self.folder / "snapshots" / str(state.steps))
            self.save_if_due()

    def _make_env(self, phase: Phase) -> TeamVecEnv:
        settings = self._settings
        return make_vec(
            settings.num_teams // self.processes.count,
            phase.seat,  # type: ignore[arg-type]
            self._partner(phase),
            device=self._device,
            threads=settings.threads,
            sequential=phase.seat != VEHICLE_AI or phase.sequential,
            **vars(phase.team),
        )

    def _partner(self, phase: Phase) -> Policy | None:
        if phase.partner is None:
            return None
        other = OTHER_SEAT[phase.seat]
        if phase.partner == LEARNED:
            return load_policy(self.folder, other, phase.team)
        make = make_driver_policy if other == DRIVER else make_hmi
        partner = make(phase.partner, phase.team)
        if isinstance(partner, LearnedPolicy) and self.processes.is_first:
            save_policy(self.folder, partner.card, partner.weights)  # so that the run is complete
        return partner

    def _make_learner(self, phase: Phase, env: TeamVecEnv) -> Learner:
        if phase.seat != TEAM or phase.joint:
            learner = self._learner(phase.seat, phase.cards, env)
            learner.anchor_to(self._anchor(phase, env))
            env.groups = self._groups[phase.seat]  # the others need not be computed
            return learner
        driver, vehicle_ai = (self._learner(card.seat, (card,), env) for card in phase.cards)
        driver.anchor_to(self._anchor(phase, env))
        env.groups = {name for card in phase.cards for name in self._groups[card.seat]}
        return TwoLearners(driver, vehicle_ai, IntentShown(env) if phase.sequential else None)

    def _anchor(self, phase: Phase, env: TeamVecEnv) -> Anchor | None:
        """Driver policy that the driver of this phase is held close to."""
        if phase.anchor is None:
            return None
        if phase.anchor != LEARNED:
            policy = load_anchor(phase.anchor, phase.team)
        else:
            card = phase.cards[0]
            if self.state.iteration == 0:  # the driver has not gone on yet
                self._own_driver = weights_of(self._actor(DRIVER, (card,)))
            with fitting(self.folder / CHECKPOINT):
                policy = LearnedPolicy(card, self._own_driver, phase.team)
        return Anchor(policy, env, phase.anchor_kl, self._device)

    def _learner(self, name: str, cards: tuple[PolicyCard, ...], env: TeamVecEnv) -> PPOLearner:
        """Learner of this name: the current one, the restored one, or a new one."""
        if name in self._learners:
            return self._learners[name]
        settings = self._settings
        torch.manual_seed(self.draw(Stream.LEARNING, _INITIAL_WEIGHTS[name]))
        teams = settings.num_teams // self._shards.count
        view = SeatView(env, cards, settings.critic == "team", self._context, teams)
        self._groups[name] = view.groups
        critic = NetworkConfig(settings.network.hidden_dims, settings.network.activation)
        learner = PPOLearner(
            _new_actor(cards),
            make_critic(view.critic_inputs, critic),
            view,
            env.get_observations(),
            env.max_episode_length,
            len(cards),
            settings.ppo,
            self._device,
            self._shards,
        )
        if name in self._restored:
            with fitting(self.folder / CHECKPOINT):
                learner.load(self._restored[name])
        self._learners[name] = learner
        return learner

    def _seed_batch(self) -> tuple[int, list[torch.Generator]]:
        """Seed of the next batch, and a seeded generator for each own shard."""
        batch = 2**32 * self.state.phase + self.state.iteration
        first = len(_INITIAL_WEIGHTS) + batch * self._shards.count
        generators = [
            torch.Generator().manual_seed(self.draw(Stream.LEARNING, first + number))
            for number in self._shards.own
        ]
        return self.draw(Stream.TRAINING, batch), generators

    def _save_policies(self, phase: Phase, folder: Path) -> None:
        """Save the policies that learn in this phase."""
        if self.processes.is_first:
            self._write_policies(phase, folder, self.state.steps)
        self.processes.wait()

    def _write_policies(
        self, phase: Phase, folder: Path, steps: int, seats: Collection[str] = AGENTS
    ) -> None:
        training = self.about | {"team": json_value(phase.team), "steps": steps}
        training["command"] = self.command_line
        for card, weights in self._learned(phase):
            if card.seat in seats:
                save_policy(folder, replace(card, training=training), weights)

    def _learned(self, phase: Phase) -> Iterable[tuple[PolicyCard, Weights]]:
        if phase.joint:
            actor = self._actor(TEAM, phase.cards)
            return zip(phase.cards, weights_of_both(actor), strict=True)
        return [(card, weights_of(self._actor(card.seat, (card,)))) for card in phase.cards]

    def _actor(self, name: str, cards: tuple[PolicyCard, ...]) -> MLPModel:
        """Policy of the learner of this name, or the one restored."""
        if name in self._learners:
            return self._learners[name].actor
        actor = _new_actor(cards)
        actor.load_state_dict(weights_among(self._restored[name], "actor"))
        return actor


def _new_actor(cards: tuple[PolicyCard, ...]) -> MLPModel:
    """Policy of one seat, or of both, with new weights."""
    return make_joint_actor(*cards) if len(cards) == 2 else make_actor(*cards)


def _in_context(phase: Phase, context: Context | None) -> Phase:
    """Return the phase with the vehicle AI conditioned on z, if there is a context."""
    if context is None:
        return phase
    if phase.seat == DRIVER and phase.partner == LEARNED:
        raise ValueError("a vehicle AI conditioned on z cannot be a partner in training")
    return replace(phase, cards=tuple(card.with_context(context.size) for card in phase.cards))
