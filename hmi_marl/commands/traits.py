"""``hmi-marl traits``."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated

import tyro

from hmi_marl.commands.choice import Choice
from hmi_marl.commands.train import use_quiet_threads
from hmi_marl.exact.importance import Sampling
from hmi_marl.experiments.latent_traits.assessment import AssessSettings
from hmi_marl.experiments.latent_traits.evaluation import TraitEvaluation
from hmi_marl.experiments.latent_traits.posterior import PosteriorEvaluation
from hmi_marl.reporting.report import PAGE, print_page
from hmi_marl.training.traits.settings import TraitSettings


@dataclass(frozen=True)
class TrainTraits(TraitSettings):
    """Learn latent driver traits from demonstrations, by adversarial IRL.

    By default self-supervised, from a population of strangers that hmi-marl collect has recorded.
    Resumes a run that was cut off in the same folder.

    Example: hmi-marl traits train --demonstrations runs/demonstrations --supervision id
    """

    demonstrations: Path = Path("runs/demonstrations")
    """Folder that hmi-marl collect wrote, or one of your own recordings."""
    preferences: Path | None = None
    """JSON file {"name": number in [0, 1]} of people's preferences for help, for --supervision
    preference. A simulated driver's preference is η."""
    out: Path | None = None
    """Folder of the run; by default runs/traits- and the supervision."""

    def run(self, command_line: str) -> None:
        """Learn, and print the commands that use the result."""
        use_quiet_threads()
        from hmi_marl.training.traits.run import learn_traits
        from hmi_marl.training.traits.windows import read_preferences

        out = self.out or Path(f"runs/traits-{self.supervision}")
        answers = None if self.preferences is None else read_preferences(self.preferences)
        settings = TraitSettings(**{f.name: getattr(self, f.name) for f in fields(TraitSettings)})
        learn_traits(settings, self.demonstrations, out, answers, command_line=command_line)
        print(f"learned: {out}; curves: tensorboard --logdir {out}")
        judged = f"--demonstrations {self.demonstrations}"
        if (
            settings.held_out_share == 0.0
        ):  # its own demonstrations hold nothing that it has not read
            judged = "--demonstrations NAMED --population UNSEEN, of drivers that it has not seen"
        print(f"evaluate it: hmi-marl traits evaluate {out} {judged}")


@dataclass(frozen=True)
class EvaluateTraits:
    """Judge trait models on held-out driving: drivers identified, traits, imitation.

    Every accuracy is shown with that of the exact Bayes classifier of the same windows.

    Example: hmi-marl traits evaluate runs/traits-none runs/traits-id
    """

    runs: tyro.conf.Positional[tuple[Path, ...]]
    """Folders of trained runs, one for each supervision, or several that differ in their seed."""
    demonstrations: Path = Path("runs/demonstrations")
    """Demonstrations of drivers known by name that they learned from; the windows that they held
    out are judged. A self-supervised run may have learned from others."""
    population: Path | None = None
    """Demonstrations of drivers they have not learned from, to regress traits over."""
    driver_policy: str | None = None
    """Run of the driver policy of the demonstrations; by default as recorded in them."""
    size: tyro.conf.OmitArgPrefixes[AssessSettings] = field(default_factory=AssessSettings)
    """Size of the evaluation of each model."""
    out: Path = Path("runs/traits")
    """Folder for the page, its figures and the numbers."""

    def run(self, command_line: str) -> None:
        """Judge, write and print."""
        if not self.runs:
            raise ValueError("name the folder of at least one trained run")
        from hmi_marl.experiments.experiment import Place, conduct

        evaluation = TraitEvaluation(
            self.runs, self.demonstrations, self.population, self.driver_policy, self.size
        )
        print(conduct(evaluation, Place(self.out, self.out, command_line=command_line)).text)
        print_page(self.out / PAGE)


@dataclass(frozen=True)
class TraitPosteriors:
    """Evaluate the exact posterior over traits over a population, by windows and seconds.

    R² of its mean is the ceiling of every estimate from the same driving; coverage and ranks show
    that it is calibrated.

    Example: hmi-marl traits posterior --demonstrations runs/unseen --windows 1 8
    """

    demonstrations: Path = Path("runs/demonstrations")
    """Demonstrations of drivers drawn from the population: hmi-marl collect --drivers --population
    300 --driver-policy trained:driver."""
    cases: tuple[str, ...] = ("hidden-known",)
    """Cases to judge: hidden-known, seen-known, hidden-unknown, seen-unknown; whether a^H is
    hidden or seen, and whether the driver policy is known or not."""
    windows: tuple[int, ...] = (1, 2, 4, 8, 16)
    """Numbers of windows of each driver."""
    seconds: tuple[float, ...] = (5.0, 10.0, 20.0)
    """Lengths of a part of one window [s]."""
    driver_policy: str | None = None
    """Run of the driver policy of the demonstrations; by default as recorded in them."""
    sampling: Sampling = field(default_factory=Sampling)
    """Numbers of points and rounds."""
    seed: int = 0
    """Seed of the points."""
    out: Path = Path("runs/trait-posterior")
    """Folder for the page and the numbers."""

    def run(self, command_line: str) -> None:
        """Judge, write and print."""
        from hmi_marl.experiments.experiment import Place, conduct

        evaluation = PosteriorEvaluation(
            self.demonstrations,
            self.cases,
            self.windows,
            self.seconds,
            self.driver_policy,
            self.sampling,
            self.seed,
        )
        print(conduct(evaluation, Place(self.out, self.out, command_line=command_line)).text)
        print_page(self.out / PAGE)


@dataclass(frozen=True)
class TraitsCommand(Choice):
    """Learn latent driver traits from driving alone, and judge them."""

    what: Annotated[
        Annotated[TrainTraits, tyro.conf.subcommand("train")]
        | Annotated[EvaluateTraits, tyro.conf.subcommand("evaluate")]
        | Annotated[TraitPosteriors, tyro.conf.subcommand("posterior")],
        tyro.conf.arg(prefix_name=False),
    ]
