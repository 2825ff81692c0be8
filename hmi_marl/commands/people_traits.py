"""``hmi-marl people traits``."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import tyro


@dataclass(frozen=True)
class PeopleTraits:
    """Measure the traits of a person from recorded trips, and make a driver of them.

    β, α and η with 95 % intervals from when they looked away and when they were alerted, and
    caution as the inflation whose driver policy fits best. Tests what the model assumes, and says
    how many minutes narrower intervals take. The driver's file is for --driver and --drivers of
    every command.

    Example: hmi-marl people traits recordings/visitor-17 --name visitor-17, then
    hmi-marl table --drivers measured/visitor-17.json --hmis none average own
    """

    recordings: tyro.conf.Positional[tuple[Path, ...]]
    """Trips that hmi-marl play has recorded: its database, or JSON files and folders of them."""
    name: str = "person"
    """Name of the driver, and of what is written."""
    visitor: str | None = None
    """Code of the person, if the recordings are of several."""
    driver_policy: str = "trained:driver"
    """Driver policy by which caution is measured: a trained run, or trained:NAME; none leaves it
    out."""
    widths: tuple[float, ...] = (0.2, 0.1, 0.05)
    """Widths of intervals for which to tell the minutes needed."""
    seed: int = 0
    """Seed of the draws of tests and intervals."""
    out: Path = Path("measured")
    """Folder for the driver's file, NAME.json, and the folder NAME of the page."""

    def run(self, command_line: str) -> None:
        """Measure, write and print."""
        if not re.fullmatch(r"[A-Za-z0-9_-]{1,64}", self.name):
            raise ValueError(f"--name has letters, digits, - and _ alone, not {self.name!r}")
        if not self.recordings:
            raise ValueError("name at least one recording")
        from hmi_marl.agents.catalogue import make_driver_policy
        from hmi_marl.envs.driver_files import write_driver
        from hmi_marl.envs.streams import check_seed
        from hmi_marl.exact.identify import check_stochastic
        from hmi_marl.files import json_value, make_folder
        from hmi_marl.ownership import owned
        from hmi_marl.people.measure.person import measure_person
        from hmi_marl.people.measure.report import blocks, numbers
        from hmi_marl.people.measure.traits import check_width
        from hmi_marl.people.measure.trip_files import measurable, read_trips
        from hmi_marl.reporting.report import Report, print_page

        seed, widths = check_seed(self.seed), [check_width(width) for width in self.widths]
        trips = measurable(read_trips(self.recordings), self.visitor)
        policy = None
        if self.driver_policy != "none":
            policy = check_stochastic(make_driver_policy(self.driver_policy, trips[0].config))
        make_folder(self.out)
        folder = self.out / self.name
        with owned(folder):
            person = measure_person(self.name, trips, policy, widths, seed)
            settings = {
                "recordings": [str(path) for path in self.recordings],
                "visitor": self.visitor,
                "driver_policy": self.driver_policy,
                "seed": self.seed,
            }
            write_driver(self.out / f"{self.name}.json", person.driver, person.as_json())
            title = f"Traits of {self.name}, measured from play"
            report = Report(
                "traits",
                title,
                blocks(person),
                numbers(person),
                command_line,
                json_value(settings),
            )
            report.write_results(folder)
            print(report.text)
            page = report.write(folder)
        print(f"\nthe driver: --driver {self.out / f'{self.name}.json'} ({person.driver})")
        print_page(page)
