"""``hmi-marl table``."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import tyro

from hmi_marl.commands.watch import CLIP_FRAMES_PER_STEP
from hmi_marl.evaluation.table import TableConfig, TableSettings, make_table
from hmi_marl.files import make_folder
from hmi_marl.workers import check_workers


@dataclass(frozen=True)
class Table:
    """Compare HMIs (rows) for drivers (columns) over seeded episodes.

    On highway-env by default. Writes text, CSV, JSON and an HTML page with a figure and a clip.

    Example: hmi-marl table --hmis NoHMI AvgHMI own --drivers bart homer --episodes 20
    """

    table: tyro.conf.OmitArgPrefixes[TableSettings] = field(default_factory=TableSettings)
    """What is in the table."""
    workers: int | None = None
    """Processes to share the episodes among; all cores by default. Does not change results."""
    clip: bool = True
    """Record a clip for the page, of the last driver with the last HMI."""
    out: Path = Path("runs/table")
    """Folder for everything that is written."""

    def run(self, typed: str) -> None:
        """Play, sum up, write and print; the page says what was ``typed``."""
        from tqdm import tqdm

        from hmi_marl.evaluation import report

        config, workers = TableConfig(**vars(self.table)), check_workers(self.workers)
        make_folder(self.out)
        total = config.episodes * len(config.drivers) * len(config.hmis)
        with tqdm(total=total, unit=" episodes", desc="table") as bar:
            cells = make_table(config, workers, bar.update)
        record = partial(_record, config) if self.clip else None
        page = report.write_report(self.out, config, cells, record, typed)
        print(report.as_text(config, cells))
        print(f"\n{report.NOTE}\n\nthe page: {page.resolve().as_uri()}")


def _record(config: TableConfig, path: Path) -> None:
    from hmi_marl.evaluation import clip

    team = config.team(config.drivers[-1])
    # On highway-env itself, whatever world the table was played on.
    moments = clip.episode(team, config.hmis[-1], config.driver_policy, config.seed, "highway")
    clip.record(path, team, moments, CLIP_FRAMES_PER_STEP)
