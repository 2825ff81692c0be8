"""``hmi-marl collect``."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import tyro

from hmi_marl.demonstrations.recording import CollectSettings, Summary, collect
from hmi_marl.files import write_json
from hmi_marl.ownership import owned


@dataclass(frozen=True)
class Collect:
    """Record demonstrations of drivers, by default with an HMI that alerts at random.

    What could be observed of a person goes to observed.parquet, the hidden truth apart from it to
    truth.parquet, and what is printed to summary.json.

    Example: hmi-marl collect --driver-policy runs/homer --out runs/demonstrations
    """

    record: tyro.conf.OmitArgPrefixes[CollectSettings] = field(default_factory=CollectSettings)
    """Settings of the recording."""
    minari: bool = False
    """Also write the observed data as a Minari dataset, into MINARI_DATASETS_PATH if that is set,
    else into the folder."""
    out: Path = Path("runs/demonstrations")
    """Folder of the dataset; one that is there is replaced."""

    def run(self, command_line: str) -> None:
        """Play, record, write and print."""
        from tqdm import tqdm

        from hmi_marl.demonstrations.parquet import (
            OBSERVED,
            TRUTH,
            read_observed,
            write_demonstrations,
        )

        if self.minari:
            from hmi_marl.demonstrations.minari import export_minari, minari_place

            minari_place(self.out)  # better known now than after the work
        # No such driver is refused here, before the folder is made.
        chunks = collect(self.record, lambda steps: bar.update(steps), command_line)
        summary, total = Summary(self.record), self.record.total_steps
        with owned(self.out):
            with tqdm(total=total, unit=" steps", unit_scale=True, desc="collect") as bar:
                write_demonstrations(self.out, summary.counting(chunks))
            write_json(
                self.out / "summary.json", {"command": command_line, "drivers": summary.as_json()}
            )
            print(summary.as_text())
            written = [self.out / name for name in (OBSERVED, TRUTH, "summary.json")]
            if self.minari:
                written.append(export_minari(read_observed(self.out), self.out))
        print("written: " + ", ".join(str(path) for path in written))
