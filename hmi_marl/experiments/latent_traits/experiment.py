"""Learn latent driver traits in the paper's three settings and self-supervised, and judge them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

from hmi_marl.agents.learned.trait_model import NAME
from hmi_marl.checks import Count, Steps
from hmi_marl.demonstrations.dataset import Split
from hmi_marl.demonstrations.recording import CollectSettings
from hmi_marl.envs.drivers import PAPER_DRIVERS
from hmi_marl.envs.streams import Seed, part_seed
from hmi_marl.experiments.experiment import Agent, Place, driver_job, traits_run
from hmi_marl.experiments.latent_traits import assessment
from hmi_marl.experiments.latent_traits.assessment import AssessSettings
from hmi_marl.experiments.latent_traits.evaluation import SUPERVISIONS, TraitEvaluation
from hmi_marl.experiments.latent_traits.report import TraitReport
from hmi_marl.experiments.latent_traits.results import TraitResults
from hmi_marl.experiments.latent_traits.strangers import MIN_STRANGERS, strangers_pools
from hmi_marl.experiments.recordings import record
from hmi_marl.training.jobs import Job, need_training, own_line, side_by_side
from hmi_marl.training.run_tasks import RunTask
from hmi_marl.training.runs.start import check_machine
from hmi_marl.training.traits.settings import TraitSettings

DEMONSTRATIONS, POPULATION, STRANGERS = "demonstrations", "population", "strangers"
_POPULATION_PART, _STRANGERS_PART = 2**32, 2**32 + 1
"""Parts of the experiment that their episodes are; the first parts are its runs."""


@dataclass(frozen=True)
class LatentTraits(TraitReport):
    """Learn latent traits in the paper's three settings and self-supervised, and judge them.

    Every setting is learned from several seeds; accuracies, R² and KL get intervals over them.

    Raises:
        ValueError: a size below its least, or a setting that the experiment sets itself.
    """

    driver_steps: Steps = 4_000_000
    """Environment steps in which the driver learns, unless one is given."""
    demonstrated: Steps = 300_000
    """Steps demonstrated by each driver."""
    strangers: Count = 2000
    """Drivers of a continuous population that the self-supervised setting learns from."""
    population: Count = 1000
    """Drivers of the population that nothing has learned from: one half fits the probes of traits,
    the other half is judged."""
    learn: TraitSettings = field(default_factory=TraitSettings)
    """Settings of each learning; supervision and seed are set for each."""
    seed: Seed = 0
    """Seed of the driver, the demonstrations and the first learning of each setting."""
    seeds: Count = 5
    """Times that each setting is learned."""
    evaluation: AssessSettings = field(default_factory=AssessSettings)
    """Size of the evaluation of each model."""

    uses_driver = True
    results_format = 2
    paper = (
        "The paper's figure of latent embeddings (Sec. VIII-B) has three panels: unsupervised, "
        "supervised by driver, supervised by preference, each the embeddings of the four drivers. "
        "Its source comes without the pictures; what it prints is the KL divergence averaged over "
        "pairs of driver types, 435, 4940 and 2872 nats. Below is the same figure of ours, and "
        "with every accuracy what the exact Bayes classifier of the same windows reaches."
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        default = TraitSettings()
        if (self.learn.supervision, self.learn.seed) != (default.supervision, default.seed):
            raise ValueError(
                "every supervision is learned, from --seed on: leave out "
                "--learn.supervision and --learn.seed"
            )
        if self.population < MIN_STRANGERS:
            raise ValueError(
                f"traits are regressed over {MIN_STRANGERS} drivers or more, but got "
                f"population = {self.population}"
            )
        if self.strangers < 2:
            raise ValueError("the self-supervised setting learns from two strangers or more")

    @classmethod
    def quick(cls) -> LatentTraits:
        """See :meth:`Experiment.quick`."""
        return cls(
            seeds=1,
            demonstrated=100_000,
            strangers=200,
            population=60,
            learn=TraitSettings(steps=150_000, imitation_updates=200, encoder_updates=60),
            evaluation=AssessSettings(windows=200, episodes=60, ranked=40),
        )

    def check_machine(self) -> None:
        """See :meth:`Experiment.check_machine`."""
        check_machine(self.learn.device, self.learn.threads)

    def driver_job(self, folder: Path) -> Job:
        """See :meth:`Experiment.driver_job`."""
        return driver_job(PAPER_DRIVERS, self.driver_steps, 512, self.seed, folder)

    def datasets(self, driver_run: Path) -> dict[str, CollectSettings]:
        """Return what to collect, by folder."""
        common = CollectSettings(driver_policy=str(driver_run), seed=self.seed)
        people = replace(
            common, drivers=(), windows=max(common.windows, 2 * self.learn.pool), population=1
        )

        def drawn(count: int, part: int) -> CollectSettings:
            return replace(people, population=count, seed=int(part_seed(self.seed, part)))

        return {
            DEMONSTRATIONS: replace(common, steps=self.demonstrated),
            POPULATION: drawn(self.population, _POPULATION_PART),
            STRANGERS: drawn(self.strangers, _STRANGERS_PART),
        }

    def trainings(self, folder: Path) -> dict[Path, TraitSettings]:
        """Return what to learn, by folder; the first seed of each setting comes first."""
        return {
            folder / traits_run(supervision, number): replace(
                self.learn, supervision=supervision, seed=int(part_seed(self.seed, number))
            )
            for number in range(self.seeds)
            for supervision in SUPERVISIONS
        }

    def run(self, place: Place) -> TraitResults:
        """See :meth:`Experiment.run`."""
        need_training()
        out, watch = place.folder, place.watch
        runs, data = self.trainings(out), out / DEMONSTRATIONS
        with watch.timing("collecting"):
            self.collect(place.driver_run, out)
        with watch.timing("all training of this call, in parallel"):
            tasks = [
                RunTask(learn_in, (job, place.command_line), folder, (_data(out, job).absolute(),))
                for folder, job in runs.items()
            ]
            side_by_side(tasks, place.workers, place.cluster)
        place.note_training(runs)
        with watch.timing("judging"):
            return TraitEvaluation(
                tuple(runs), data, out / POPULATION, str(place.driver_run), self.evaluation
            ).run(place)

    def collect(self, driver_run: Path, folder: Path) -> None:
        """Record what is not recorded yet, and check that it is enough to judge by.

        Raises:
            FileNotFoundError: there is no such driver policy.
            ValueError: a dataset that is there was recorded otherwise, or there is too little.
        """
        from hmi_marl.demonstrations.parquet import read_demonstrations  # needs the data extra
        from hmi_marl.demonstrations.stored import ObservedFile

        record(self.datasets(driver_run), driver_run, folder)
        learn, demonstrations = self.learn, read_demonstrations(folder / DEMONSTRATIONS)
        share = replace(learn, supervision="none").held_out_share
        split = Split.of(demonstrations, share, self.evaluation.windows)
        latent = max(settings.latent_size for settings in self.trainings(folder).values())
        assessment.pool_sizes(split, learn.pool, latent)
        strangers_pools(ObservedFile(folder / POPULATION).driver, learn.pool)

    def agents(self, place: Place) -> list[Agent]:
        """See :meth:`Experiment.agents`."""
        labels = (
            "no labels",
            "a fifth labelled by driver",
            "a fifth labelled by preference",
            "no labels, from who belongs together among strangers",
        )
        return [
            Agent(
                traits_run(supervision),
                place.folder / traits_run(supervision) / NAME,
                f"encodes driving into latent traits, learned with {given}",
            )
            for supervision, given in zip(SUPERVISIONS, labels, strict=True)
        ]


def _data(folder: Path, job: TraitSettings) -> Path:
    """Folder of the dataset that a run learns from."""
    return folder / (STRANGERS if job.supervision == "self" else DEMONSTRATIONS)


def learn_in(
    settings: TraitSettings, command_line: str, folder: Path, demonstrations: Path
) -> None:
    """Learn a trait model in ``folder``; to be called in a process of its own."""
    from hmi_marl.training.traits.run import learn_traits  # torch, with the threads just set

    settings = replace(settings, threads=1)
    learn_traits(settings, demonstrations, folder, command_line=command_line, line=own_line())
