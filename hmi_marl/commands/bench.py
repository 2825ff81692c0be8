"""``hmi-marl bench``."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import tyro

from hmi_marl.experiments.speed_config import BenchConfig
from hmi_marl.files import make_folder, write_json


@dataclass(frozen=True)
class Bench:
    """Measure the speed of the worlds in one run, as ratios to highway-env's own step.

    Example: hmi-marl bench --teams 1024 --threads 1 2
    """

    bench: tyro.conf.OmitArgPrefixes[BenchConfig] = field(default_factory=BenchConfig)
    """What to measure."""
    out: Path = Path("runs/bench")
    """Folder for the JSON."""

    def run(self, command_line: str) -> None:
        """Measure, write and print."""
        from tqdm import tqdm

        from hmi_marl.experiments import speed as bench

        self.bench.check()
        make_folder(self.out)
        with tqdm(total=bench.measurements(self.bench), unit=" turns", desc="bench") as bar:
            rows = bench.bench(self.bench, bar.update)
        write_json(
            self.out / "bench.json", bench.as_json(self.bench, rows) | {"command": command_line}
        )
        print(bench.as_text(rows))
        print(f"\nwritten: {self.out / 'bench.json'}")
