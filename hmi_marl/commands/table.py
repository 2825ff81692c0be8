"""``hmi-marl table``."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from hmi_marl.commands.watch import CLIP_FRAMES_PER_STEP
from hmi_marl.experiments.metrics_table.table import TableConfig, TableSettings, make_table
from hmi_marl.ownership import owned
from hmi_marl.reporting.blocks import Clip, Text, as_text
from hmi_marl.reporting.report import print_page
from hmi_marl.workers import check_workers

if TYPE_CHECKING:
    from hmi_marl.reporting.clip import Pictures


@dataclass(frozen=True)
class TableCommand:
    """Compare HMIs (rows) for drivers (columns) over seeded episodes.

    On highway-env by default. Writes text, CSV, JSON and an HTML page with a figure and a clip.

    Example: hmi-marl table --hmis NoHMI AvgHMI own --drivers bart homer --episodes 20
    """

    table: tyro.conf.OmitArgPrefixes[TableSettings] = field(default_factory=TableSettings)
    """Settings of the table."""
    workers: int | None = None
    """Processes to share the episodes among; all cores by default. Does not change results."""
    clip: bool = True
    """Record a clip for the page, of the last driver with the last HMI: the best part of the
    episodes."""
    out: Path = Path("runs/table")
    """Folder for everything that is written."""

    def run(self, command_line: str) -> None:
        """Play, sum up, write and print."""
        from tqdm import tqdm

        from hmi_marl.experiments.metrics_table.in_short import in_short
        from hmi_marl.experiments.metrics_table.report import (
            NOTE,
            metric_tables,
            write_report,
            write_results,
        )

        config, workers = TableConfig(**vars(self.table)), check_workers(self.workers)
        total = config.episodes * len(config.drivers) * len(config.hmis)
        with owned(self.out):
            with tqdm(total=total, unit=" episodes", desc="table") as bar:
                cells = make_table(config, workers, bar.update)
            write_results(self.out, config, cells, command_line)  # before anything is drawn
            remarks = in_short(config, cells)
            print(as_text([*metric_tables(config, cells), Text(NOTE), *remarks]))
            clip = _record(config, self.out) if self.clip else None
            page = write_report(self.out, config, cells, command_line, clip)
        print_page(page)
        if clip:
            print(f"the clip: {self.out / 'clip.gif'}\n  {clip.caption}")


def _record(config: TableConfig, folder: Path) -> Clip:
    """Record the best part of the last driver's episodes with the last HMI."""
    from tqdm import tqdm

    from hmi_marl.experiments.metrics_table.report import CLIP
    from hmi_marl.reporting import highlight

    path = folder / f"{CLIP}.gif"

    def progress(pictures: Pictures, count: int) -> Pictures:
        return iter(tqdm(pictures, total=count, unit=" frames", desc=path.name))

    seeds = config.seeds(range(config.episodes)).tolist()
    team, hmi, policy = config.team(config.drivers[-1]), config.hmis[-1], config.driver_policy
    caption = highlight.record(path, team, hmi, policy, seeds, CLIP_FRAMES_PER_STEP, progress)
    return Clip(CLIP, caption, path.read_bytes(), sources=["/clip"])
