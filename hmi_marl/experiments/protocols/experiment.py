"""Experiment "protocols": train by every protocol on every task, play, judge and show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from hmi_marl.agents.learned.policy import find_policy
from hmi_marl.experiments.experiment import Agent, Experiment, Place
from hmi_marl.experiments.protocols import tables
from hmi_marl.experiments.protocols.answer import answer
from hmi_marl.experiments.protocols.arms import TWO_STAGE
from hmi_marl.experiments.protocols.content import content_of
from hmi_marl.experiments.protocols.equal_gradients import at_equal_gradients
from hmi_marl.experiments.protocols.figures import (
    cross_figure,
    curves_figure,
    profile_figure,
    sweep_figure,
)
from hmi_marl.experiments.protocols.findings import differences, judge, sweep
from hmi_marl.experiments.protocols.kept import code_digest
from hmi_marl.experiments.protocols.pairs import Pair, all_pairs, own_pair
from hmi_marl.experiments.protocols.plan import ComparisonSettings, coarse
from hmi_marl.experiments.protocols.playing import play_all, play_curves, play_tuning
from hmi_marl.experiments.protocols.results import (
    Comparison,
    TaskResults,
    Training,
    revealing,
)
from hmi_marl.experiments.protocols.same_reward import with_same_reward
from hmi_marl.experiments.protocols.shippable import shippable
from hmi_marl.experiments.protocols.signal_clip import signal_clips
from hmi_marl.experiments.protocols.task_plan import Shares, TaskPlan
from hmi_marl.reporting.blocks import Block, Figure, Heading
from hmi_marl.reporting.verdicts import Verdict


@dataclass(frozen=True)
class ProtocolComparison(ComparisonSettings, Experiment[Comparison]):
    """Train by every protocol with equal environment steps and several seeds, and compare them.

    Raises:
        ValueError, TypeError: a value out of its range, saying what to use instead.
    """

    name = "protocols"
    files = "compare"
    indexed = True
    title = "Sequential or joint training?"

    @classmethod
    def quick(cls) -> ProtocolComparison:
        """See :meth:`Experiment.quick`."""
        return coarse(cls())

    def run(self, place: Place) -> Comparison:
        """See :meth:`Experiment.run`. Tasks come one after the other, each trained in waves.

        All are trained before any is played, since that takes longest. What is trained and what is
        played is kept when it is interrupted.
        """
        code_digest()  # of the code that will play, before anybody edits it
        shares: dict[str, Shares] = {}
        tried: dict[str, dict[str, float]] = {}
        trained = []
        for plan in self.plans():
            plan.check_partners(place.folder)
        for untuned in self.plans():
            tried[untuned.name], shares[untuned.name] = self._tune(untuned, place)
            plan = replace(untuned, shares=shares[untuned.name])
            for wave in plan.waves():
                place.train(plan.jobs(place.folder, wave))
            trained.append(plan)
        found = {plan.name: self._play(plan, place) for plan in trained}
        return Comparison(self, found, shares, tried, place.workers)

    def _tune(self, plan: TaskPlan, place: Place) -> tuple[dict[str, float], Shares]:
        """Try out the shares of the driver's stage; team returns by arm, and the best shares."""
        runs, arms = plan.tuning_runs, plan.tuning_arms.values()
        if not runs:
            return {}, {}
        place.train(plan.jobs(place.folder, runs))
        returns = {}
        with place.playing(len(runs), "runs") as progress:
            played = play_tuning(plan, place.folder, place.workers)
            for arm, found in zip(arms, played, strict=True):
                returns[arm.name] = found
                progress(1)
        best: dict[str, float] = {}
        for protocol in {arm.protocol: None for arm in arms}:
            own = [arm for arm in arms if arm.protocol == protocol]
            best[protocol] = max(own, key=lambda arm: returns[arm.name]).driver_share or 0.0
        return returns, best

    def _play(self, plan: TaskPlan, place: Place) -> TaskResults:
        """Play all pairs of a task and the snapshots of its protocols."""
        folder, workers, pairs = place.folder, place.workers, all_pairs(plan)
        crossed = [run for arm in plan.protocols for run in plan.runs_of(arm)]
        training = {
            run.name: Training.of(plan.training(run, folder), run.folder(folder))
            for run in plan.runs
        }
        with place.playing(len(pairs), "pairs") as progress:
            played = play_all(plan, pairs, folder, workers, progress)
        rivals = self._average_hmis(plan, played)
        with place.playing(len(rivals), "pairs") as progress:
            played |= play_all(plan, list(rivals.values()), folder, workers, progress)
        with place.playing(len(crossed) * self.snapshots, "snapshots") as progress:
            curves = play_curves(plan, crossed, folder, workers, progress)
        return TaskResults(plan, played, training, curves, rivals, folder)

    @staticmethod
    def _average_hmis(plan: TaskPlan, played: Mapping[Pair, Any]) -> dict[str, Pair]:
        """Pair two-stage drivers with the Bayes filter for the average driver.

        The filter assumes the share of revealing steps that this driver was seen to have.
        """
        if not plan.task.hidden or TWO_STAGE not in plan.protocols:
            return {}
        rivals = {}
        for run in plan.runs_of(TWO_STAGE):
            own = played[own_pair(run)]
            names = plan.settings.driver_names
            share = sum(revealing(own, name) for name in names) / len(names)
            rivals[run.name] = Pair(plan.name, run.name, f"belief:average:{share:.3f}")
        return rivals

    def judge(self, results: Comparison) -> list[Verdict]:
        """See :meth:`Experiment.judge`."""
        return judge(results)

    def numbers(self, results: Comparison) -> dict[str, Any]:
        """JSON content, with every run's numbers."""
        return content_of(results)

    def blocks(self, results: Comparison) -> list[Block]:
        """Show the answer, then the tables and figures of each task."""
        blocks: list[Block] = [answer(results)]
        changes = differences(results)
        if changes:
            blocks.append(tables.difference_table(changes))
        if same := with_same_reward(results):
            blocks.append(tables.same_reward_table(same))
        if rows := at_equal_gradients(results):
            blocks.append(tables.equal_gradients_table(rows))
        for task in results.tasks.values():
            blocks += self._blocks_of(task, results.workers)
        if any(results.tried.values()):
            blocks.append(tables.tuning_table(results))
        return blocks

    @staticmethod
    def _blocks_of(results: TaskResults, workers: int) -> Sequence[Block]:
        plan = results.plan
        name = plan.name
        blocks: list[Block] = [
            Heading(f"Task {name}", name),
            tables.summary_table(results),
            Figure(
                f"{name}-curves",
                f"{name}: returns over environment steps",
                partial(curves_figure, results),
                sources=[results.place("curves")],
            ),
            tables.regret_table(results),
        ]
        if TWO_STAGE in plan.protocols:
            blocks.append(tables.driving_table(results))
        if plan.task.hidden:
            blocks += [tables.signal_table(results), tables.situation_table(results)]
            blocks += signal_clips(results)
        blocks += [
            Figure(
                f"{name}-cross",
                f"{name}: every driver with every HMI",
                partial(cross_figure, results),
                sources=[results.place("cross_play")],
            ),
            tables.cross_table(results),
            tables.dependence_table(results),
        ]
        if sweep(results):
            description = f"{name}: returns against divergence from the natural driver"
            draw, sources = partial(sweep_figure, results), [results.place("sweep")]
            figure = Figure(f"{name}-sweep", description, draw, sources=sources)
            blocks += [figure, tables.sweep_table(results)]
        if results.improvements():
            description = f"{name}: share of runs and drivers above each score"
            scores = "scores_by_run_and_driver"
            sources = [results.place("arms", one, scores) for one in plan.protocols]
            draw = partial(profile_figure, results)
            figure = Figure(f"{name}-profile", description, draw, sources=sources)
            blocks += [figure, tables.improvement_table(results)]
        blocks += [tables.budget_table(results), tables.cost_table(results, workers)]
        if plan.standing_runs:
            blocks.append(tables.gaming_table(results))
        return blocks

    def agents(self, place: Place) -> list[Agent]:
        """Trained pairs of the first seed, of the tasks in which attention is hidden."""
        return [
            Agent(one.name, find_policy(one.run.folder(place.folder), one.seat), one.what)
            for one in shippable(self.plans())
        ]
