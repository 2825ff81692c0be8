"""Registry of the experiments, in the order in which a whole reproduction runs them.

``hmi-marl reproduce NAME``, its ``--quick``, the pages, the claims and what ships with the package
follow from these entries. The modules are imported only when an experiment is asked for.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import Any

from hmi_marl.experiments.experiment import Experiment
from hmi_marl.extras import TRAINING
from hmi_marl.registry import Registry


@dataclass(frozen=True)
class Where:
    """Where an experiment is defined, and what it needs."""

    path: str
    """Module and class: "package.module:Class"."""
    needs: tuple[str, ...] = TRAINING
    """Modules of extras, without which it does not begin."""
    in_suite: bool = True
    """Whether a whole reproduction of the paper runs it."""

    def load(self) -> type[Experiment[Any]]:
        """Import the class."""
        module, _, name = self.path.partition(":")
        kind: type[Experiment[Any]] = getattr(importlib.import_module(module), name)
        return kind


EXPERIMENTS: Registry[Where] = Registry("experiment", "hmi-marl reproduce --help")
