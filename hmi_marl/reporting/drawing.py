"""Drawing of figures: canvas, colours on light pages and on dark ones, and the PNG.

A figure is drawn once for each: what draws it takes the default colours of matplotlib for text,
axes and background, which :func:`on_dark` changes, :data:`COLOURS` for data, and :func:`ink` for
lines that are to stand out.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing

COLOURS = ("#9aa1ab", "#e0a030", "#5aa9e0", "#32a050", "#b0508c", "#6a5acd", "#c05040")
"""Colours of data in their order, distinct on light and on dark."""
PAPER, DARK_PAPER = "#ffffff", "#16181c"
"""Backgrounds of pages and figures."""
_DARK_INK = "#dddddd"
_FAINT, _DARK_FAINT = "#dddddd", "#3a3d44"
_OF_INK = ("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color")
_OF_FAINT = ("legend.edgecolor", "grid.color")
_OF_PAPER = ("figure.facecolor", "axes.facecolor", "legend.facecolor")


@contextmanager
def on_dark() -> Iterator[None]:
    """Draw figures for dark pages within."""
    from matplotlib import rc_context  # takes a while; no --help waits for it

    dark: dict[Any, str] = dict.fromkeys(_OF_INK, _DARK_INK)
    dark |= dict.fromkeys(_OF_PAPER, DARK_PAPER) | dict.fromkeys(_OF_FAINT, _DARK_FAINT)
    with rc_context(dark):
        yield


def ink() -> str:
    """Colour of text and of lines that stand out, in the figure that is being drawn."""
    from matplotlib import rcParams

    return str(rcParams["text.color"])


def faint() -> str:
    """Colour of lines in the background, in the figure that is being drawn."""
    return _DARK_FAINT if ink() == _DARK_INK else _FAINT


def canvas(width: float, height: float) -> Drawing:
    """Make an empty matplotlib figure of this size [inches]."""
    from matplotlib.figure import Figure as Drawing

    return Drawing(figsize=(width, height), layout="constrained")


def png(drawing: Drawing, dpi: int = 110) -> bytes:
    """Draw a matplotlib figure as a PNG."""
    content = BytesIO()
    with warnings.catch_warnings():  # characters that the font lacks are drawn as boxes
        warnings.filterwarnings("ignore", "Glyph .* missing from", UserWarning)
        drawing.savefig(content, format="png", dpi=dpi)
    return content.getvalue()
