"""Progress of a run: a bar on the terminal, curves for TensorBoard, and reports; no torch."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Any, Self

from tqdm import tqdm

from hmi_marl.training.runs.reports import listener

_LOSSES = ("L1", "L2", "L3", "L4")
_ON_THE_BAR = ("return", "crash_rate", "alerts", "imitation", "loss", "held_out_loss")
_LEARNING = ("value", "surrogate", "entropy", "learning_rate", "anchor_kl", "imitation", *_LOSSES)
_SPEED = ("steps_per_second", "share_of_time_learning", "seconds")
_NOTHING: Mapping[str, float] = MappingProxyType({})


class Bar:
    """Progress bar on a line of the terminal.

    Args:
        total: steps of the whole run.
        done: steps taken before.
        line: line of the terminal, counted from the current one.
    """

    def __init__(
        self, name: str, total: int, done: int, unit: str, quiet: bool = False, line: int = 0
    ) -> None:
        self._bar = tqdm(
            total=total,
            initial=done,
            desc=name,
            unit=f" {unit}",
            unit_scale=unit == "steps",  # there are millions
            disable=quiet,
            position=line,
            smoothing=0.05,
        )

    def close(self) -> None:
        """Leave the bar as it is."""
        self._bar.close()

    def phase(self, name: str) -> None:
        """Show the name of what is done now."""
        self._bar.set_description(name)

    def advance(self, count: int, row: Mapping[str, float]) -> None:
        """Show ``count`` more steps, and some of a row of the curve."""
        self._bar.update(count)
        if row:
            self._bar.set_postfix({name: f"{row[name]:.4g}" for name in _ON_THE_BAR if name in row})


class Progress:
    """Show the progress of a run, here or to its listener.

    Args:
        total: steps of the whole run.
        done: steps taken before; TensorBoard's points beyond them are dropped.
        line: line of the terminal for the bar, counted from the current one.
        board: folder for TensorBoard's files; None for none.
    """

    def __init__(
        self,
        name: str,
        total: int,
        done: int = 0,
        unit: str = "steps",
        quiet: bool = False,
        line: int = 0,
        board: Path | None = None,
    ) -> None:
        self._writer: Any = None
        self._done, self._listener = done, listener()
        self._bar = Bar(name, total, done, unit, quiet or self._listener is not None, line)
        if self._listener is not None:
            self._listener.begin(name, total, done, unit)
        if board is not None and not quiet:
            from torch.utils.tensorboard.writer import SummaryWriter  # takes a second

            self._writer = SummaryWriter(str(board), purge_step=done + 1)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self._bar.close()
        if self._writer is not None:
            self._writer.close()

    def phase(self, name: str) -> None:
        """Show the name of what is done now."""
        self._bar.phase(name)
        if self._listener is not None:
            self._listener.phase(name)

    def advance(self, count: int = 1, row: Mapping[str, float] = _NOTHING) -> None:
        """Show ``count`` more steps, and a row of the curve if there is one."""
        self._done += count
        self._bar.advance(count, row)
        if self._listener is not None:
            self._listener.advance(count, dict(row))
        if self._writer is None:
            return
        for name, value in row.items():
            group = "learning" if name.endswith(_LEARNING) else "episode"
            group = "speed" if name in _SPEED else group
            self._writer.add_scalar(f"{group}/{name}", value, self._done)
