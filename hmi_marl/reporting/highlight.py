"""Choose the part of an episode for a clip: traffic, a distraction, and an alert that works.

The episodes are searched on the batched world, where dozens of them take a second. The chosen one
is then played again where the clip is drawn, and its caption comes from there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from hmi_marl.agents.catalogue import make_driver_policy, make_hmi
from hmi_marl.agents.rollout import Observer, begin, play
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.render import TeamStatus, team_status
from hmi_marl.envs.step_result import StepResult
from hmi_marl.envs.teaming import Teaming
from hmi_marl.envs.worlds import Snapshot, make_world
from hmi_marl.reporting import clip

MOST_SEEDS = 64
"""Most episodes that are searched."""
BEHIND, AHEAD = 50.0, 95.0
"""Distances from the driven car within which others are in the picture [m]."""
LEAD_IN, LEAD_OUT = 3.0, 4.0
"""Time that a clip shows before and after the alert [s]."""
HOLD = 1.5
"""Time for which the clip stands still at the distraction and at the alert [s]."""
_ENOUGH = 6
"""Number of other cars in the picture from which on more do not improve a clip."""


@dataclass(frozen=True)
class Beat:
    """State after one step of an episode, as far as the choice of a clip depends on it."""

    distracted: bool
    alert: bool
    overridden: bool
    """The car repeated its last action instead of the intended one."""
    others: int
    """Other cars in the picture."""
    crashed: bool

    @classmethod
    def of(cls, snapshot: Snapshot, status: TeamStatus) -> Beat:
        """Make it from the state that a picture is drawn from."""
        ahead = snapshot.position[1:, 0] - snapshot.position[0, 0]
        return cls(
            distracted=status.distracted,
            alert=status.alert,
            overridden=status.distracted and status.intended != status.applied,
            others=int(((ahead >= -BEHIND) & (ahead <= AHEAD)).sum()),
            crashed=status.crashed,
        )


@dataclass(frozen=True)
class Highlight:
    """Best step of an episode to show, and its quality."""

    beats: tuple[Beat, ...]
    """Whole episode, its start included: beat k is after k steps."""
    step: int
    """Step to show. 0 if the episode has none."""

    @property
    def now(self) -> Beat:
        """State after the step."""
        return self.beats[self.step]

    @property
    def before(self) -> Beat:
        """State before the step."""
        return self.beats[max(0, self.step - 1)]

    @property
    def traffic(self) -> bool:
        """Whether other cars are in the picture."""
        return self.now.others > 0

    @property
    def answers(self) -> bool:
        """Whether the step's alert is given to a driver who was distracted."""
        return self.before.distracted and self.now.alert

    @property
    def works(self) -> bool:
        """Whether that alert brings the driver back."""
        return self.answers and not self.now.distracted

    @property
    def complete(self) -> bool:
        """Whether there are traffic, a distraction and an alert that works."""
        return self.traffic and self.works

    @cached_property
    def attentive(self) -> int:
        """Steps from this one on for which the driver stays attentive."""
        after = [beat.distracted for beat in self.beats[self.step :]]
        return after.index(True) if True in after else len(after)

    @cached_property
    def since(self) -> int:
        """Step in which the distraction began that the step's alert answers."""
        step = self.step
        while step > 0 and self.beats[step - 1].distracted:
            step -= 1
        return step

    @property
    def alerts(self) -> int:
        """Alerts given to this distraction, up to this step."""
        return sum(beat.alert for beat in self.beats[self.since + 1 : self.step + 1])

    def rank(self, window: int) -> tuple[int, ...]:
        """Quality of the step for a clip, higher is better; an alert lasts ``window`` steps."""
        return (
            self.complete,
            self.works,
            self.answers,
            self.before.distracted,
            self.traffic,
            min(self.attentive, window) if self.works else 0,
            self.before.overridden,
            min(self.now.others, _ENOUGH),
            not self.beats[-1].crashed,
        )


def best_step(beats: Sequence[Beat], window: int) -> Highlight:
    """Find the step of an episode that is best to show; the first of equals."""
    whole = tuple(beats)
    steps = range(1, len(whole)) if len(whole) > 1 else range(1)
    return max((Highlight(whole, step) for step in steps), key=lambda found: found.rank(window))


def best_seed(config: TeamConfig, hmi: str, driver_policy: str, seeds: Sequence[int]) -> int:
    """Find the best episode to show among the first ``MOST_SEEDS`` seeds; the first of equals."""
    wanted = np.array(seeds[:MOST_SEEDS], np.uint64)
    driver, ai = make_driver_policy(driver_policy, config), make_hmi(hmi, config)
    # One thread: with so few worlds, more of them slow the policies' matrix products down.
    world = make_world("batched", config.scene, len(wanted), threads=1)
    teaming = begin(config, driver, ai, wanted, world)
    watched = _Beats(teaming)
    play(teaming, driver, ai, [watched])
    found = [best_step(beats, config.alert_window) for beats in watched.episodes]
    ranks = [highlight.rank(config.alert_window) for highlight in found]
    return int(wanted[ranks.index(max(ranks))])


class _Beats(Observer):
    """Keep the beats of all teams' episodes, from their start on."""

    def __init__(self, teaming: Teaming) -> None:
        self.episodes = [[self._beat(teaming, team)] for team in range(teaming.num_teams)]

    def before(self, teaming: Teaming) -> None:
        """Note the teams that still drive."""
        self._going = np.flatnonzero(~teaming.over).tolist()

    def after(self, teaming: Teaming, result: StepResult) -> None:
        """Add a beat for each of them."""
        for team in self._going:
            self.episodes[team].append(self._beat(teaming, team))

    @staticmethod
    def _beat(teaming: Teaming, team: int) -> Beat:
        return Beat.of(teaming.world.snapshot(team), team_status(teaming, team))


def cut(found: Highlight, frequency: float) -> range:
    """Choose the moments of the clip: some seconds (``frequency`` in Hz) around the step."""
    length = round((LEAD_IN + LEAD_OUT) * frequency)
    last = len(found.beats) - 1
    first = max(0, min(found.step - round(LEAD_IN * frequency), last - length))
    return range(first, min(last, first + length) + 1)


def held_moments(found: Highlight) -> tuple[int, ...]:
    """Moments at which the clip stands still: the distraction before an alert, and the alert."""
    return (found.step - 1, found.step) if found.answers else ()


def caption(found: Highlight, who: str, seconds: Sequence[float], shown: range) -> str:
    """Describe in one sentence what the clip shows and when, by the clock in the picture.

    The driver's name is ``who``, the time of every moment of the episode ``seconds`` [s], and the
    moments that the clip shows ``shown``.
    """
    others = found.now.others
    cars = f"{others} other car{'' if others == 1 else 's'} in the picture"
    start, end = seconds[shown[0]], seconds[shown[-1]]
    parts = []
    if found.before.distracted:
        part = f"{who} is distracted at {seconds[found.since]:.1f} s (amber)"
        if found.before.overridden:
            part += ", so that the car repeats its last action instead of the intended one"
        parts.append(part)
    if found.answers:
        last = f"{seconds[found.step]:.1f} s"
        times = f" {found.alerts} times, the last at {last}" if found.alerts > 1 else f" at {last}"
        parts.append(f"the HMI alerts (red){times}")
    if found.works:
        end_of_it = found.step + found.attentive
        lasting = end_of_it < len(seconds)
        until = f"until {seconds[end_of_it]:.1f} s" if lasting else "to the end"
        parts[-1] += f", and {who} is attentive again (green) {until}"
    elif found.answers:
        parts[-1] += f", but {who} stays distracted"
    elif not found.before.distracted:
        parts.append(f"{who} is attentive throughout")
    else:
        parts.append("no alert comes")
    text = f"{start:.1f} to {end:.1f} s, {cars if others else 'no traffic'}: {'; '.join(parts)}"
    return f"{text}. The clip stands still at both moments." if found.answers else f"{text}."


def what_is_missing(found: Highlight, searched: int) -> str:
    """Say that no episode that was searched shows all of it; empty if this one does."""
    if found.complete:
        return ""
    return (
        f"None of the {searched} episodes searched shows traffic, a distraction and an alert that "
        "works together; this is the best of them. "
    )


def record(
    path: Path,
    config: TeamConfig,
    hmi: str,
    driver_policy: str,
    seeds: Sequence[int],
    per_step: int,
    progress: Callable[[clip.Pictures, int], clip.Pictures] = lambda pictures, _: pictures,
) -> str:
    """Write the best part of the best of some episodes on highway-env itself, and describe it.

    Args:
        path: a .gif, or an .mp4 with the video extra.
        config: settings of the team.
        hmi, driver_policy: names in the catalogue.
        seeds: seeds of the episodes; the first ``MOST_SEEDS`` of them are searched.
        per_step: pictures for each policy step.
        progress: receives the pictures and their number, and passes them on one by one.
    """
    searched = seeds[:MOST_SEEDS]
    seed = best_seed(config, hmi, driver_policy, searched)
    moments = list(clip.episode(config, hmi, driver_policy, seed, "highway"))
    found = best_step([Beat.of(*moment) for moment in moments], config.alert_window)
    shown = cut(found, config.scene.policy_frequency)
    clip.record(
        path,
        config,
        iter(moments[shown.start : shown.stop]),
        per_step,
        progress=lambda pictures: progress(pictures, per_step * (len(shown) - 1) + 1),
        holds={moment - shown.start: HOLD for moment in held_moments(found)},
    )
    who, seconds = moments[0][1].driver, [status.time for _, status in moments]
    text = what_is_missing(found, len(searched)) + caption(found, who, seconds, shown)
    return f"Episode {seed} with {hmi}. {text}"
