"""Experiments of one shape: settings, run, judge, blocks.

An experiment is a frozen dataclass whose fields are its settings. It learns and plays what is not
done yet (:meth:`Experiment.run`), gives its numbers as JSON content, judges them by the criteria of
:mod:`hmi_marl.experiments.criteria`, and describes a report in blocks. It is registered once, in
:mod:`hmi_marl.experiments.registry`, which the command line and the reproduction read.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

from tqdm import tqdm

from hmi_marl.agents.learned.policy import find_policy
from hmi_marl.checks import Checked
from hmi_marl.envs.config import DRIVER
from hmi_marl.envs.drivers import PAPER_DRIVERS, Driver
from hmi_marl.envs.streams import check_seed
from hmi_marl.files import json_value
from hmi_marl.ownership import owned
from hmi_marl.reporting.blocks import Block, Verdicts
from hmi_marl.reporting.report import Report, Stopwatch
from hmi_marl.reporting.verdicts import Verdict, judged_together
from hmi_marl.training.cluster.cluster import Cluster
from hmi_marl.training.jobs import Job, own_line, train_all
from hmi_marl.training.protocols.two_stage import TwoStage
from hmi_marl.training.runs.folder import CHECKPOINT, seconds_of

T = TypeVar("T")
R = TypeVar("R")
"""Results of an experiment."""
DRIVER_RUN = "driver"
"""Folder of a run that learns a driver policy."""
MODELS = (*PAPER_DRIVERS, "average")
"""Drivers that HMIs without sight of attention are learned for."""
HIDDEN_RUN = "hmi-{}"
"""Folder of the run of each of these HMIs, {} for the driver model."""
HIDDEN_EXPERIMENT = "hidden"
"""Experiment that learns them, and its folder in a reproduction."""
TRAITS_EXPERIMENT = "traits"
"""Experiment that learns latent traits, and its folder in a reproduction."""


def traits_run(supervision: str, number: int = 0) -> str:
    """Folder of a trait model in its experiment's; ``number`` counts training seeds from 0."""
    return f"traits-{supervision}{f'-{number}' if number else ''}"


_DEPENDED_ON = (".safetensors", ".parquet")


@dataclass(frozen=True)
class Place:
    """Where and how an experiment runs."""

    folder: Path
    """Folder of its own."""
    driver_run: Path
    """Training run of the driver policy that all experiments of a reproduction share."""
    workers: int = 1
    """Processes at a time. Does not change results."""
    command_line: str = ""
    """Command that runs it."""
    watch: Stopwatch = field(default_factory=Stopwatch)
    """Durations of its parts."""
    cluster: Cluster | None = None
    """Cluster that trains in place of processes here."""

    def train(self, jobs: Sequence[Job]) -> None:
        """Train what is not trained yet, several runs at a time, and note the durations.

        Jobs must not need each other's results.
        """
        train_all(jobs, self.workers, self.command_line, cluster=self.cluster)
        self.note_training(job.folder for job in jobs)

    def note_training(self, runs: Iterable[Path]) -> None:
        """Note how long each training took in all, however often it was cut off."""
        trained = seconds_of(runs, self.folder)
        self.watch.seconds |= {f"training {name}": spent for name, spent in trained.items()}

    @contextmanager
    def playing(
        self, total: int, unit: str, what: str = "playing"
    ) -> Iterator[Callable[[int], object]]:
        """Time the playing within and show its progress; yields what counts it on, in ``unit``."""
        name = f"{what} {self.folder.name}"
        with (
            self.watch.timing(what),
            tqdm(total=total, unit=f" {unit}", desc=name, position=own_line() or None) as bar,
        ):
            yield bar.update

    def each(self, items: Sequence[T], unit: str) -> Iterator[T]:
        """Iterate over what is played one after the other; see :meth:`playing`."""
        with self.playing(len(items), unit) as progress:
            for item in items:
                yield item
                progress(1)


@dataclass(frozen=True)
class Agent:
    """Something learned that ships with the package."""

    name: str
    card: Path
    what: str
    """Description in one line."""


class Experiment(Checked, ABC, Generic[R]):
    """One experiment; see the module.

    Its settings are checked by their annotations, such as :data:`~hmi_marl.checks.Count`.
    """

    name: ClassVar[str]
    """Name in the registry, and of its folder in a reproduction."""
    files: ClassVar[str] = ""
    """Name of its text and its JSON, where it is not the experiment's."""
    indexed: ClassVar[bool] = False
    """Whether its report has an index of checksums, with which it ships by itself."""
    title: ClassVar[str]
    """Heading of its report."""
    short: ClassVar[str] = ""
    """Name of its page in the report of a reproduction; empty for its title."""
    paper: ClassVar[str] = ""
    """Text on what the paper shows of it, and how ours corresponds to it."""
    results_format: ClassVar[int] = 1
    """Raised when its numbers get other names or parts: a reproduction then makes its results again
    from what it has learned, where they are of an earlier format."""
    uses_driver: ClassVar[bool] = False
    """Whether it plays with the driver policy that the experiments of a reproduction share."""

    @classmethod
    @abstractmethod
    def quick(cls) -> Experiment[R]:
        """Make a coarse version that takes minutes."""

    def driver_job(self, folder: Path) -> Job | None:
        """Training of the shared driver policy, below ``folder``; None if it learns none."""
        return None

    def check_machine(self) -> None:
        """Check that this machine has what the settings ask for, such as a GPU.

        Raises:
            ValueError: it has not.
        """

    def check(self, place: Place) -> None:
        """Check that there is what it starts from, before anything is made.

        Raises:
            FileNotFoundError, ValueError: there is not, such as no driver policy.
        """
        if self.uses_driver:
            driver_weights(place)

    @abstractmethod
    def run(self, place: Place) -> R:
        """Learn and play what is not done yet, and return the results."""

    @abstractmethod
    def numbers(self, results: R) -> Mapping[str, Any]:
        """JSON content of the results, without durations and paths; verdicts are added to it."""

    def judge(self, results: R) -> Sequence[Verdict]:
        """Judge the results by the criteria, not yet corrected for the number of parts.

        Nothing by default.
        """
        return ()

    @abstractmethod
    def blocks(self, results: R) -> Sequence[Block]:
        """Blocks of the report; verdicts are added to them."""

    def inputs(self, place: Place) -> list[Path]:
        """Files learned or recorded that the results depend on, once it has run."""
        return learned_in(place.folder) + (driver_weights(place) if self.uses_driver else [])

    def agents(self, place: Place) -> list[Agent]:
        """Policies and models that it has learned for others to use; none by default."""
        return []

    def settings(self) -> dict[str, Any]:
        """JSON content of everything that the results depend on."""
        return dict(json_value(self))


def conduct(experiment: Experiment[Any], place: Place) -> Report:
    """Check an experiment, run and judge it, and write its report into its folder.

    Raises:
        FolderInUseError: another process writes into the folder.
        OSError: the folder cannot be written to.
        FileNotFoundError, ValueError: it lacks what it starts from; see :meth:`Experiment.check`
            and :meth:`Experiment.check_machine`.
    """
    experiment.check_machine()
    with owned(place.folder):  # which removes what it made if the check fails
        experiment.check(place)
        return _conduct(experiment, place)


def _conduct(experiment: Experiment[Any], place: Place) -> Report:
    results = experiment.run(place)
    numbers = experiment.numbers(results)
    verdicts = judged_together(experiment.judge(results))
    judged = [Verdicts(verdicts)] if verdicts else []
    listed = {"verdicts": [verdict.as_json() for verdict in verdicts]} if verdicts else {}
    report = Report(
        experiment.files or experiment.name,
        experiment.title,
        (*experiment.blocks(results), *judged),
        {**numbers, **listed},
        place.command_line,
        experiment.settings(),
        place.watch.seconds,
    )
    report.write(place.folder)
    if experiment.indexed:
        report.write_index(place.folder)
    return report


def with_seed(settings: T, seed: int) -> T:
    """Return the settings with another seed, or raise ``ValueError`` if it is out of range.

    Settings without a field ``seed`` stay as they are.
    """
    seed = check_seed(seed)
    return replace(settings, seed=seed) if hasattr(settings, "seed") else settings  # type: ignore[type-var]


def coarse(chosen: T, quick: T) -> T:
    """Return the coarse settings ``quick`` with the seed of ``chosen``.

    Raises:
        ValueError: more than the seed was chosen.
    """
    seed = getattr(chosen, "seed", 0)
    if chosen != with_seed(type(chosen)(), seed):
        raise ValueError("--quick sets the sizes itself; leave it out to choose them")
    return with_seed(quick, seed)


def learned_in(folder: Path) -> list[Path]:
    """Weights and demonstrations below ``folder``, in order; checkpoints are left out."""
    return sorted(
        path
        for path in folder.rglob("*")
        if path.suffix in _DEPENDED_ON
        and path.name != CHECKPOINT
        and not path.name.startswith(".")  # left behind by a kill
    )


def driver_weights(place: Place) -> list[Path]:
    """Weights of the driver policy that the experiments share."""
    return [find_policy(place.driver_run, DRIVER).with_suffix(".safetensors")]


def spec(driver: Driver) -> str:
    """Write a driver as the command line takes one."""
    return f"{driver.name}:{driver.beta:g},{driver.alpha:g},{driver.eta:g},{driver.inflation:g}"


def driver_job(
    drivers: tuple[str, ...], steps: int, num_teams: int, seed: int, folder: Path
) -> Job:
    """Training of one driver policy over these drivers, in a run below ``folder``."""
    settings = TwoStage(
        drivers=drivers, driver_steps=steps, hmi_steps=0, num_teams=num_teams, seed=seed
    )
    return Job(settings, folder / DRIVER_RUN)
