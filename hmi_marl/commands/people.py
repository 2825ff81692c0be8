"""``hmi-marl people``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from hmi_marl.checks import Count
from hmi_marl.commands.choice import Choice
from hmi_marl.commands.people_traits import PeopleTraits
from hmi_marl.ownership import owned
from hmi_marl.people.export import Format
from hmi_marl.people.store import Store, visitor_name


@dataclass(frozen=True)
class ExportPeople:
    """Write trips and answers of people into files.

    csv: trips.csv, steps.csv and answers.csv; json: each trip, to replay; parquet and minari: the
    driving, in the formats of hmi-marl collect, to learn from.

    Example: hmi-marl people export people.db --formats csv parquet --out runs/people
    """

    database: tyro.conf.Positional[Path]
    """Database that hmi-marl play or hmi-marl study serve wrote; either may go on meanwhile."""
    formats: tuple[Format, ...] = ("csv", "json")
    """Formats to write: csv, json, parquet, minari."""
    visitor: Count | None = None
    """Number of the only visitor to export; all by default."""
    out: Path = Path("runs/people")
    """Folder for the files; those of the same names are replaced."""

    def run(self, command_line: str) -> None:
        """Read, write and print."""
        from hmi_marl.people.export import export

        if not self.formats:
            raise ValueError("name at least one format: csv, json, parquet or minari")
        with Store(self.database, make=False) as store, owned(self.out):
            written = export(store, self.out, self.formats, self.visitor)
        print("written: " + ", ".join(map(str, written)))


@dataclass(frozen=True)
class DeletePeople:
    """Delete all data of one person from a database, by the code that they were given.

    Files that were exported before stay as they are; remove the person's rows there too.

    Example: hmi-marl people delete people.db K7QF2M9PXW4ZH8TD
    """

    database: tyro.conf.Positional[Path]
    """Database that hmi-marl play or hmi-marl study serve wrote."""
    code: tyro.conf.Positional[str]
    """Code of the person; case, spaces and dashes do not matter."""

    def run(self, command_line: str) -> None:
        """Delete and print how much."""
        with Store(self.database, make=False) as store:
            number = store.find_visitor(self.code)
            counts = store.delete_visitor(self.code)
        rows = ", ".join(f"{count} {name}" for name, count in counts.items())
        print(f"deleted {visitor_name(number or 0)}: rows of {rows}")


@dataclass(frozen=True)
class PeopleCommand(Choice):
    """Export, delete and measure what people left at the wheel."""

    what: Annotated[
        Annotated[ExportPeople, tyro.conf.subcommand("export")]
        | Annotated[DeletePeople, tyro.conf.subcommand("delete")]
        | Annotated[PeopleTraits, tyro.conf.subcommand("traits")],
        tyro.conf.arg(prefix_name=False),
    ]
