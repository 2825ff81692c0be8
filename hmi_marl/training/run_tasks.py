"""What is to be learned, in a form that any process can take up, also on another machine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class RunTask:
    """Something to learn in a folder of its own, from where it was cut off."""

    learn: Callable[..., None]
    """Function of a module; it is called as ``learn(*arguments, folder, *reads)``."""
    arguments: tuple[Any, ...]
    """Picklable arguments."""
    folder: Path
    """Folder of the run. On another machine it is another one of the same name."""
    reads: tuple[Path, ...] = ()
    """Other folders, or policies, that it reads; the same holds for them."""
    gpu: bool = False
    """Whether it learns on a GPU."""

    def go(self) -> None:
        """Learn in this process."""
        self.learn(*self.arguments, self.folder, *self.reads)
