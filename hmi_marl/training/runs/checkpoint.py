"""State of a run in a file, to resume it from."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save as save_tensors

from hmi_marl.files import write_bytes

FORMAT = "hmi-marl checkpoint 1"


@dataclass
class Checkpoint:
    """State of a run: one safetensors file with JSON in its header, written atomically."""

    phase: int = 0
    """Index of the current phase; the number of phases if the run is finished."""
    iteration: int = 0
    """Batches learned from in that phase."""
    steps: int = 0
    """Environment steps taken in the whole run, over all processes."""
    seconds: float = 0.0
    """Time spent in the whole run [s]."""
    tensors: dict[str, dict[str, torch.Tensor]] = field(default_factory=dict)
    """Weights and optimizer's state of each learner, by its name."""
    curve: list[dict[str, Any]] = field(default_factory=list)
    """A row for each batch."""

    def save(self, path: Path) -> None:
        """Write the state, atomically."""
        flat = {
            f"{learner}/{name}": tensor.detach().cpu().contiguous()
            for learner, tensors in self.tensors.items()
            for name, tensor in tensors.items()
        }
        header = {
            "format": FORMAT,
            "phase": self.phase,
            "iteration": self.iteration,
            "steps": self.steps,
            "seconds": self.seconds,
            "curve": self.curve,
        }
        write_bytes(path, save_tensors(flat, {"hmi_marl": json.dumps(header)}))

    @classmethod
    def load(cls, path: Path) -> Checkpoint:
        """Read a state.

        Raises:
            ValueError: the file is damaged, or not such a checkpoint.
        """
        try:
            with safe_open(path, "pt") as file:
                header = json.loads((file.metadata() or {}).get("hmi_marl", "{}"))
                flat = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        except (SafetensorError, json.JSONDecodeError) as error:
            raise ValueError(f"{path} is a damaged checkpoint: {error}") from None
        if not isinstance(header, dict) or header.pop("format", None) != FORMAT:
            raise ValueError(f"{path} is not a checkpoint that can be read here")
        tensors: dict[str, dict[str, torch.Tensor]] = {}
        for full_name, tensor in flat.items():
            learner, name = full_name.split("/", 1)
            tensors.setdefault(learner, {})[name] = tensor
        try:
            return cls(tensors=tensors, **header)
        except TypeError as error:
            raise ValueError(f"{path} is a damaged checkpoint: {error}") from None
