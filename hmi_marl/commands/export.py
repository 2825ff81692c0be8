"""``hmi-marl export``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from hmi_marl.agents.learned.cards import is_shipped
from hmi_marl.agents.learned.policy import find_policy, read_policy


@dataclass(frozen=True)
class Export:
    """Write a learned policy as ONNX, for use outside of Python.

    Its metadata name the columns that it reads.

    Example: hmi-marl export --policy runs/homer --seat vehicle_ai --out hmi.onnx
    """

    policy: Path
    """Folder of a trained run, a policy's .json, or trained:NAME."""
    seat: Literal["driver", "vehicle_ai"] = "vehicle_ai"
    """Seat of the policy."""
    out: Path | None = None
    """File to write; by default next to the policy, for one from the package in this folder."""

    def run(self, command_line: str) -> None:
        """Read the policy, write the file and print its path."""
        from hmi_marl.agents.learned.onnx_export import export_onnx

        source = find_policy(self.policy, self.seat)
        beside = source.with_suffix(".onnx")
        if is_shipped(self.policy):
            beside = Path(f"{source.parent.name}.onnx")
        out = beside if self.out is None else self.out
        export_onnx(read_policy(source), out)
        print(f"written: {out}")
