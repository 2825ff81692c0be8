"""A stage for the tests, which takes its time in small steps."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hmi_marl.experiments.stages import Agent, Outcome, Place, learned_in
from hmi_marl.files import make_folder, write_bytes
from hmi_marl.reporting.blocks import Table


@dataclass(frozen=True)
class Counting:
    """It learns to count, goes on where it was cut off, and then plays for a while."""

    name: str
    steps: int = 3
    pause: float = 0.0
    title = "Counting <to some number>"
    paper = "The paper does not count."

    def settings(self) -> dict[str, Any]:
        return {"steps": self.steps}

    def inputs(self, place: Place) -> list[Path]:
        return learned_in(place.folder)

    def agents(self, place: Place) -> list[Agent]:
        return []

    def run(self, place: Place) -> Outcome:
        make_folder(place.folder)
        learned = place.folder / "count.safetensors"
        began = time.monotonic()
        while (count := len(learned.read_bytes()) if learned.is_file() else 0) < self.steps:
            write_bytes(learned, bytes(count + 1))
            time.sleep(self.pause)
        time.sleep(self.pause)
        numbers = {"count": count, "pair": (1, 2)}
        table = Table("Counted", ("name", "count"), ((self.name, str(count)),))
        return Outcome(numbers, (table,), {"counting": time.monotonic() - began}, "counted")
