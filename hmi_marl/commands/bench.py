"""``hmi-marl bench``."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import tyro

from hmi_marl.experiments.speed import BenchConfig, bench, make_report, measurements
from hmi_marl.ownership import owned
from hmi_marl.reporting.blocks import as_text


@dataclass(frozen=True)
class Bench:
    """Measure the speed of the worlds in one run, as ratios to highway-env's own step.

    Example: hmi-marl bench --teams 1024 --threads 1 2
    """

    bench: tyro.conf.OmitArgPrefixes[BenchConfig] = field(default_factory=BenchConfig)
    """Settings of the bench."""
    out: Path = Path("runs/bench")
    """Folder for the report."""

    def run(self, command_line: str) -> None:
        """Measure, write and print."""
        from tqdm import tqdm

        with owned(self.out):
            with tqdm(total=measurements(self.bench), unit=" turns", desc="bench") as bar:
                rows = bench(self.bench, bar.update)
            report = make_report(self.bench, rows, command_line)
            report.write_results(self.out)
            print(as_text(report.blocks))
            report.write(self.out)
        print(f"\nwritten: {self.out / 'bench.json'}")
