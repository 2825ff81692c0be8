"""Progress for people: a bar on the terminal and curves for TensorBoard."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import TracebackType

from tqdm import tqdm

_LOSSES = ("L1", "L2", "L3", "L4")
_ON_THE_BAR = ("return", "crash_rate", "alerts", "imitation")
_LEARNING = ("value", "surrogate", "entropy", "learning_rate", "imitation", *_LOSSES)
_SPEED = ("steps_per_second", "share_of_time_learning", "seconds")


class Telling:
    """Tells how a run goes.

    Args:
        folder: for TensorBoard's files.
        name: of the run.
        total: environment steps of the whole run.
        done: steps taken before; what TensorBoard's files say of later ones is dropped.
        quiet: tell nothing.
        line: of the terminal, counted from this one, for the bar.
    """

    def __init__(
        self, folder: Path, name: str, total: int, done: int, quiet: bool, line: int = 0
    ) -> None:
        self._writer = None
        self._bar = tqdm(
            total=total,
            initial=done,
            desc=name,
            unit=" steps",
            unit_scale=True,
            disable=quiet,
            position=line,
            smoothing=0.05,
        )
        if not quiet:
            from torch.utils.tensorboard.writer import SummaryWriter  # takes a second

            self._writer = SummaryWriter(str(folder), purge_step=done + 1)

    def __enter__(self) -> Telling:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._bar.close()
        if self._writer is not None:
            self._writer.close()

    def phase(self, name: str) -> None:
        """A phase begins."""
        self._bar.set_description(name)

    def batch(self, row: Mapping[str, float], steps: int, taken: int) -> None:
        """A batch of ``taken`` steps has been learned from, ``steps`` in all."""
        self._bar.update(taken)
        self._bar.set_postfix({name: f"{row[name]:.4g}" for name in _ON_THE_BAR if name in row})
        if self._writer is None:
            return
        for name, value in row.items():
            group = "learning" if name.endswith(_LEARNING) else "episode"
            group = "speed" if name in _SPEED else group
            self._writer.add_scalar(f"{group}/{name}", value, steps)
