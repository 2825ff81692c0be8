"""Experiment "identify": who drives, with a driver policy that reads the traits and with a control.

Drivers differ in how their attention lapses, which is the model of people, and in how the policy
reacts to the traits that it reads, which is a property of the network. The control is learned alike
but reads only its inflation of its traits: it cannot react to β, α and η. What the exact classifier
finds with the trained driver and not with the control is the network's reaction to these.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from hmi_marl.agents.learned.policy import find_policy
from hmi_marl.checks import Count, Steps, Whole
from hmi_marl.demonstrations.recording import CollectSettings
from hmi_marl.envs.config import DRIVER, TeamConfig
from hmi_marl.envs.streams import Seed, part_seed
from hmi_marl.experiments.experiment import Agent, Place
from hmi_marl.experiments.identification.report import (
    CONTROL,
    TRAINED,
    IdentificationReport,
    IdentificationResults,
)
from hmi_marl.experiments.identification.scoring import (
    POOL,
    compare_driving,
    compare_naming,
    score_driving,
    score_naming,
    score_traits,
)
from hmi_marl.experiments.metrics_table.experiment import MetricsTable
from hmi_marl.training.jobs import Job
from hmi_marl.workers import calls

CONTROL_RUN = "driver-inflation"
"""Folder of the run of the control, and its name among the shipped agents."""
_STRANGERS_PART, _TIES_PART = 2**32 + 2, 2**32 + 3
"""Parts of the experiment's seed."""


@dataclass(frozen=True)
class DriverIdentification(IdentificationReport):
    """Compare who drives, by exact Bayes, with a control driver who reads inflation alone.

    Raises:
        ValueError: no steps, or too few windows, episodes or strangers.
    """

    driver_steps: Steps = 12_000_000
    """Environment steps in which the control learns, and the driver unless one is given."""
    windows: Annotated[int, Whole(POOL, 1_000_000)] = 1000
    """Windows of 20 s of each of the four drivers, with either policy."""
    strangers: Annotated[int, Whole(3, 1_000_000)] = 100
    """Drivers of a continuous population whose traits are estimated, from eight windows each."""
    episodes: Count = 1000
    """Episodes of each driver in which both policies' driving is compared."""
    num_teams: Count = 512
    """Teams that train side by side."""
    seed: Seed = 0
    """Seed of all training and of the windows."""

    uses_driver = True

    @classmethod
    def quick(cls) -> DriverIdentification:
        """See :meth:`Experiment.quick`."""
        return cls(driver_steps=1_000_000, windows=160, strangers=10, episodes=200)

    def driver_job(self, folder: Path) -> Job:
        """See :meth:`Experiment.driver_job`; the same as of the paper's table."""
        alike = MetricsTable(
            driver_steps=self.driver_steps, num_teams=self.num_teams, seed=self.seed
        )
        return alike.driver_job(folder)

    def control_job(self, folder: Path) -> Job:
        """Training of the control: the same but for what the policy reads."""
        settings = replace(self.driver_job(folder).settings, condition="inflation")
        return Job(settings, folder / CONTROL_RUN)

    def run(self, place: Place) -> IdentificationResults:
        """See :meth:`Experiment.run`."""
        place.train([self.control_job(place.folder)])
        runs = str(place.driver_run), str(place.folder / CONTROL_RUN)
        ties = int(part_seed(self.seed, _TIES_PART))
        tasks: list[tuple[Callable[..., Any], Any, int]] = [
            *((score_traits, self.people(run), self.seed) for run in runs),  # the longest first
            *((score_naming, self.recording(run), ties) for run in runs),
            *((score_driving, run, self.episodes) for run in runs),
        ]
        scores = []
        with place.playing(len(tasks), "parts") as progress:
            for score in calls(_score, tasks, place.workers):
                scores.append(score)
                progress(1)
        return IdentificationResults(
            compare_naming(*scores[2:4]),
            compare_driving(*scores[4:]),
            dict(zip((TRAINED, CONTROL), scores[:2], strict=True)),
        )

    def recording(self, run: str) -> CollectSettings:
        """Settings of the windows of the four drivers, with a policy."""
        steps = self.windows * TeamConfig().horizon
        return CollectSettings(driver_policy=run, steps=steps, seed=self.seed)

    def people(self, run: str) -> CollectSettings:
        """Settings of the windows of strangers, with a policy."""
        return replace(
            self.recording(run),
            drivers=(),
            population=self.strangers,
            windows=POOL,
            num_teams=self.strangers * POOL,
            seed=int(part_seed(self.seed, _STRANGERS_PART)),
        )

    def agents(self, place: Place) -> list[Agent]:
        """See :meth:`Experiment.agents`."""
        what = "drives as any driver, given their inflation alone: a control"
        return [Agent(CONTROL_RUN, find_policy(place.folder / CONTROL_RUN, DRIVER), what)]


def _score(function: Callable[..., Any], what: Any, number: int) -> Any:
    return function(what, number)
