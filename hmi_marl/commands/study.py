"""``hmi-marl study``."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from hmi_marl.checks import COUNT, Count, Real
from hmi_marl.commands.choice import Choice
from hmi_marl.people.study.settings import PowerSettings, StudySettings
from hmi_marl.people.web.settings import Limits, ServerSettings

Margin = Annotated[float, Real(0.0, 3.0, "points")]


@dataclass(frozen=True)
class MakeStudy:
    """Render clips of drivers and controls into a study folder.

    The clips show the road alone, in which raters rate the green car. The folder holds a manifest
    with all seeds, the intended differences and checksums, and consent.txt, which you replace by
    your own text; then run the command again with the same options, which keeps the clips. A
    command that was cut off goes on where it was.

    Example: hmi-marl study make --out runs/study, or for a first look in a minute
    hmi-marl study make --quick --out runs/look
    """

    settings: Annotated[StudySettings, tyro.conf.arg(name="")] = field(
        default_factory=StudySettings
    )
    consent: Path | None = None
    """File with the text that raters consent to, a paragraph after each empty line."""
    quick: bool = False
    """Render a tiny study: two clips of 4 s of each driver and control, of which each rater sees
    one."""
    out: Path = Path("runs/study")
    """Folder of the study."""

    def run(self, command_line: str) -> None:
        """Render and print."""
        from tqdm import tqdm

        from hmi_marl.people.study.make import make_study, quick

        settings = quick(self.settings) if self.quick else self.settings
        study = make_study(
            settings, self.out, self.consent, lambda jobs: iter(tqdm(jobs, unit=" clips"))
        )
        print(f"the study {study.id}: {len(study.clips)} clips, and an attention check")
        for contrast in study.contrasts:
            print(f"  {contrast.name}: {contrast.claim}")
        print(f"written: {self.out}; edit {self.out / 'consent.txt'} and make it again")


@dataclass(frozen=True)
class ServeStudy:
    """Let people rate the clips of a study folder in their browsers.

    Raters consent, read the instructions, rate clips in counterbalanced order with an attention
    check among them, and get a completion code. They can come back, and withdraw at any time; their
    code deletes their answers. Each answer is on the disk before the next page appears. For others
    than this machine, put it behind a reverse proxy with TLS, or give --host.

    Example: hmi-marl study serve runs/study study.db
    """

    study: tyro.conf.Positional[Path]
    """Study folder that hmi-marl study make wrote."""
    database: tyro.conf.Positional[Path]
    """Database for the answers, which is made if there is none."""
    server: Annotated[ServerSettings, tyro.conf.arg(name="")] = field(
        default_factory=ServerSettings
    )
    limits: Annotated[Limits, tyro.conf.arg(name="")] = field(default_factory=Limits)
    most_raters: Count = 100_000
    """Raters after whom no more are admitted."""

    def run(self, command_line: str) -> None:
        """Serve until Ctrl-C."""
        from hmi_marl.people.store import Store
        from hmi_marl.people.study.app import StudyService
        from hmi_marl.people.study.folder import read_study
        from hmi_marl.people.study.visits import Visits
        from hmi_marl.people.web.cookies import check_signing_key, signing_key
        from hmi_marl.people.web.pages import Site
        from hmi_marl.people.web.server import listening, serve
        from hmi_marl.people.web.texts import Texts

        COUNT("most_raters", self.most_raters)
        study = read_study(self.study)
        check_signing_key(self.database)
        listening(self.server).close()  # so that an address in use leaves no database behind
        site = Site(self.server, Texts("study"))
        with Store(self.database) as store:
            key = signing_key(self.database)
            service = StudyService(Visits(study, store), site, key, self.limits, self.most_raters)
            serve(
                service.app(),
                self.server,
                lambda address: print(
                    f"the study {study.id} is at {address} (Ctrl-C ends it)", flush=True
                ),
            )


@dataclass(frozen=True)
class AnalyseStudy:
    """Say what raters see: a verdict on each intended difference, and ratings by driver.

    Linear mixed models with random effects of raters and clips give the verdicts; an ordinal model
    checks them. Raters who failed the attention check are left out, and counted.

    Example: hmi-marl study analyse runs/study study.db, or the same of an export,
    hmi-marl study analyse runs/study runs/people/answers.csv
    """

    study: tyro.conf.Positional[Path]
    """Study folder, as it was served."""
    answers: tyro.conf.Positional[Path]
    """Database of hmi-marl study serve, or answers.csv of hmi-marl people export."""
    margin: Margin = 0.0
    """Differences up to this size count as none [points]."""
    out: Path = Path("runs/study-results")
    """Folder for the page, the figure and the JSON file."""

    def run(self, command_line: str) -> None:
        """Read, analyse, write and print."""
        from hmi_marl.ownership import owned
        from hmi_marl.people.study.analyse import analyse
        from hmi_marl.people.study.folder import read_study
        from hmi_marl.people.study.ratings import read_ratings
        from hmi_marl.people.study.report import analysis_blocks, marked
        from hmi_marl.reporting.report import Report, print_page

        study = read_study(self.study)
        ratings = read_ratings(self.answers, study)
        with owned(self.out):
            analysis = analyse(study, ratings, self.margin)
            report = Report(
                "study-simulated" if analysis.simulated else "study",
                marked(f"Rating study {study.id}", analysis.simulated),
                analysis_blocks(analysis),
                {"study": study.id, **analysis.as_json()},
                command_line,
                {"study": str(self.study), "answers": str(self.answers), "margin": self.margin},
            )
            report.write_results(self.out)
            print(report.text)
            print_page(report.write(self.out))


@dataclass(frozen=True)
class StudyPower:
    """Say how many raters a study needs, by simulated raters.

    Simulates whole studies with planted differences for several numbers of raters, and judges each
    as analyse does. Everything it writes is marked as simulated. One simulated study's answers
    are written too, to try analyse on.

    Example: hmi-marl study power runs/study --raters 50 100 200 500 --plan.effect 0.5
    """

    study: tyro.conf.Positional[Path]
    """Study folder that hmi-marl study make wrote."""
    settings: Annotated[PowerSettings, tyro.conf.arg(name="")] = field(
        default_factory=PowerSettings
    )
    out: Path = Path("runs/study-power")
    """Folder for the page, the figure and the JSON file."""

    def run(self, command_line: str) -> None:
        """Simulate, write and print."""
        from tqdm import tqdm

        from hmi_marl.files import json_value
        from hmi_marl.ownership import owned
        from hmi_marl.people.study.folder import read_study
        from hmi_marl.people.study.power import find_power
        from hmi_marl.people.study.ratings import write_answers
        from hmi_marl.people.study.report import marked, power_blocks
        from hmi_marl.people.study.simulated import planted_means, simulated_answers
        from hmi_marl.reporting.report import Report, print_page

        study, settings = read_study(self.study), self.settings
        planted_means(study.settings, settings.plan)
        with owned(self.out):
            power = find_power(
                study.settings,
                settings,
                lambda raters, studies: iter(tqdm(studies, f"{raters} raters", unit=" studies")),
            )
            report = Report(
                "power-simulated",
                marked(f"Power of the rating study {study.id}", True),
                power_blocks(power),
                {"study": study.id, **power.as_json()},
                command_line,
                {"study": str(self.study), **json_value(settings)},
            )
            report.write_results(self.out)
            answers = simulated_answers(study, settings.raters[-1], settings.plan, settings.seed)
            write_answers(self.out / "answers-simulated.csv", answers)
            print(report.text)
            print_page(report.write(self.out))


@dataclass(frozen=True)
class StudyCommand(Choice):
    """Have people rate clips of drivers, and say what they see."""

    what: Annotated[
        Annotated[MakeStudy, tyro.conf.subcommand("make")]
        | Annotated[ServeStudy, tyro.conf.subcommand("serve")]
        | Annotated[AnalyseStudy, tyro.conf.subcommand("analyse")]
        | Annotated[StudyPower, tyro.conf.subcommand("power")],
        tyro.conf.arg(prefix_name=False),
    ]
