"""Figures of latent vectors: embeddings by driver, and accuracy by windows seen."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.envs.drivers import PAPER_DRIVERS
from hmi_marl.experiments.latent_traits.assessment import Embedding
from hmi_marl.experiments.latent_traits.divergence import average_kl
from hmi_marl.experiments.latent_traits.vectors import checked_vectors
from hmi_marl.reporting.blocks import Figure
from hmi_marl.reporting.drawing import COLOURS, canvas, faint, ink, png
from hmi_marl.reporting.statistics import Estimate
from hmi_marl.text import in_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Drawing
    from matplotlib.lines import Line2D
    from matplotlib.patches import Ellipse

Array = NDArray[np.float64]

# Colours that are distinct for the colour-blind as well; shapes help where colours do not.
DRIVER_COLOURS = (*COLOURS[1:5], *COLOURS[5:], COLOURS[0])
SETTING_COLOURS = (COLOURS[0], *COLOURS[5:], *COLOURS[1:5])
"""Different colours first, so that a setting is not mistaken for a driver."""
TITLES = {
    "none": "unsupervised",
    "id": "by driver",
    "preference": "by preference",
    "self": "self-supervised",
}
"""Titles of the settings by supervision."""
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
SIGMAS = 2.0
"""Standard deviations from an ellipse's centre to its edge."""
_GREY = "#808080"


@dataclass(frozen=True)
class EmbeddingPanel:
    """Content of one panel."""

    title: str
    """Setting: unsupervised, by identity, by preference."""
    means: Array
    """Posterior means, shape (P, Z). For Z > 2 the principal axes are drawn, for Z = 1 a line."""
    types: NDArray[np.int64]
    """Index of each vector's name, shape (P,)."""
    names: Sequence[str]
    """Names of the drivers."""
    average_kl: float
    """See :func:`hmi_marl.experiments.latent_traits.divergence.average_kl` [nats]."""

    def __post_init__(self) -> None:
        _, labels = checked_vectors(self.means, self.types, f"vectors of {self.title!r}")
        if labels.min() < 0 or labels.max() >= len(self.names):
            raise ValueError(
                f"types of {self.title!r} are 0 to {len(self.names) - 1} for "
                f"{', '.join(self.names)}, not {labels.min()} to {labels.max()}"
            )


def draw_embeddings(panels: Sequence[EmbeddingPanel]) -> Drawing:
    """Draw a panel for each setting: vectors coloured by driver, 2σ ellipses, the average KL.

    Raises:
        ValueError: no panels.
    """
    if not panels:
        raise ValueError("there are no embeddings to draw")
    names = _ordered(name for panel in panels for name in panel.names)
    figure = canvas(3.9 * len(panels) + 0.4, 4.6)
    for axes, panel in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
        _embedding(axes, panel, names)
    figure.legend(
        handles=[_legend_entry(name, place) for place, name in enumerate(names)],
        loc="outside lower center",
        ncols=len(names),
        frameon=False,
        handletextpad=0.2,
    )
    return figure


def embeddings_figure(embeddings: Mapping[str, Embedding], sources: Sequence[str] = ()) -> Figure:
    """Draw the paper's figure: a panel for each setting, with the average KL of its vectors."""
    panels = [
        EmbeddingPanel(
            TITLES[name], one.means, one.types, one.names, average_kl(one.means, one.types)
        )
        for name, one in embeddings.items()
    ]
    return Figure(
        "embeddings", "embeddings by driver", lambda: png(draw_embeddings(panels)), sources=sources
    )


def draw_accuracy(
    windows: Sequence[int],
    curves: Mapping[str, Sequence[Estimate]],
    ceiling: ArrayLike | None,
    chance: float,
) -> Drawing:
    """Draw the accuracy of naming the driver by the number of windows seen, with 95 % intervals.

    Args:
        windows: numbers of windows, rising, shape (W,).
        curves: W accuracies for each setting.
        ceiling: exact Bayes accuracies, W of them or one for all; None if they are not known.
        chance: accuracy of a guess.

    Raises:
        ValueError: windows that do not rise from 1 or more, or curves of another length.
    """
    seen = np.asarray(windows, np.float64)
    if seen.ndim != 1 or len(seen) == 0 or seen[0] < 1 or (np.diff(seen) <= 0).any():
        raise ValueError(f"numbers of windows rise from 1 or more, not {list(windows)}")
    for name, curve in curves.items():
        if len(curve) != len(seen):
            raise ValueError(f"{len(seen)} numbers of windows, but {name} has {len(curve)} points")
    best = np.asarray(np.nan if ceiling is None else ceiling, np.float64)
    if best.shape not in ((), seen.shape):
        raise ValueError(f"{len(seen)} numbers of windows, but the ceiling has shape {best.shape}")
    from matplotlib.ticker import PercentFormatter

    figure = canvas(6.4, 4.6)
    axes = figure.subplots()
    for place, (name, curve) in enumerate(curves.items()):
        # A little apart, so that the intervals do not overlap.
        at = seen * 2.0 ** (0.07 * (place - (len(curves) - 1) / 2))
        _accuracy_line(axes, at, curve, name, place)
    if ceiling is not None:
        bayes = np.broadcast_to(best, seen.shape)
        axes.plot(seen, bayes, "--", color=ink(), linewidth=1.3, label="exact Bayes")
    axes.axhline(chance, color=_GREY, linestyle=":", linewidth=1.3, label="chance")
    axes.set_xscale("log", base=2)
    axes.set_xticks(seen, [str(number) for number in windows])
    axes.minorticks_off()
    axes.set_xlim(seen[0] * 2.0**-0.3, seen[-1] * 2.0**0.3)
    axes.set_ylim(0.0, 1.03)
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    axes.set_xlabel("windows seen")
    axes.set_ylabel("drivers recognised")
    axes.grid(axis="y", color=faint(), linewidth=0.7)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    drawn = dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    order = [name for name in (*curves, "exact Bayes", "chance") if name in drawn]
    figure.legend(
        [drawn[name] for name in order], order, loc="outside lower center", ncols=3, frameon=False
    )
    return figure


def _embedding(axes: Axes, panel: EmbeddingPanel, names: Sequence[str]) -> None:
    flat, labels = two_axes(panel.means)
    for name in names:
        own = flat[[panel.names[each] == name for each in panel.types]]
        place = names.index(name)
        axes.scatter(
            own[:, 0], own[:, 1], s=13, alpha=0.55, linewidths=0, zorder=2, **_style(place)
        )
        if len(own) > 2:
            axes.add_patch(_ellipse(own, _colour(DRIVER_COLOURS, place)))
    axes.set_title(in_figure(panel.title), fontsize=12, fontweight="bold", pad=22)
    kl = f"average KL {_short(panel.average_kl)}"
    axes.text(0.5, 1.025, kl, transform=axes.transAxes, ha="center", va="bottom", color=_GREY)
    axes.set_xlabel(labels[0])
    axes.set_ylabel(labels[1])
    axes.margins(0.08)
    axes.set_aspect("equal", adjustable="datalim")  # so that ellipses keep their shape
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=9)
    axes.locator_params(nbins=6)


def two_axes(means: Array) -> tuple[Array, tuple[str, str]]:
    """Return vectors of shape (P, 2) and the labels of their axes: z, or its principal axes."""
    if means.shape[1] == 1:
        return np.column_stack([means, np.zeros(len(means))]), ("$z_1$", "")
    if means.shape[1] == 2:
        return means, ("$z_1$", "$z_2$")
    centred = means - means.mean(axis=0)
    _, sizes, directions = np.linalg.svd(centred, full_matrices=False)
    # The sign of an axis is arbitrary; fixing it makes the picture reproducible.
    signs = np.sign(directions[[0, 1], np.abs(directions[:2]).argmax(axis=1)])
    shares = sizes[:2] ** 2 / max(float((sizes**2).sum()), np.finfo(np.float64).tiny)
    of = f"of {means.shape[1]} principal axes of z"
    labels = f"first {of} ({shares[0]:.0%})", f"second {of} ({shares[1]:.0%})"
    return centred @ (directions[:2] * signs[:, None]).T, labels


def _ellipse(points: Array, colour: str) -> Ellipse:
    """Make the ellipse SIGMAS standard deviations from the mean of the points (P, 2)."""
    from matplotlib.patches import Ellipse

    variances, directions = np.linalg.eigh(np.cov(points, rowvar=False))
    height, width = 2.0 * SIGMAS * np.sqrt(np.clip(variances, 0.0, None))
    angle = float(np.degrees(np.arctan2(directions[1, 1], directions[0, 1])))
    centre = float(points[:, 0].mean()), float(points[:, 1].mean())
    return Ellipse(
        centre, width, height, angle=angle, fill=False, edgecolor=colour, linewidth=1.6, zorder=3
    )


def _accuracy_line(axes: Axes, at: Array, curve: Sequence[Estimate], name: str, place: int) -> None:
    means = np.array([estimate.mean for estimate in curve])
    ends = np.array([[estimate.low, estimate.high] for estimate in curve]).T
    colour = _colour(SETTING_COLOURS, place)
    axes.errorbar(
        at,
        means,
        yerr=np.nan_to_num(np.abs(ends - means)),
        color=colour,
        marker=MARKERS[place % len(MARKERS)],
        markersize=5,
        linewidth=1.6,
        elinewidth=1.1,
        capsize=2.5,
        label=name,
    )


def _legend_entry(name: str, place: int) -> Line2D:
    from matplotlib.lines import Line2D

    return Line2D([], [], linestyle="", markersize=7, label=in_figure(name), **_style(place))


def _style(place: int) -> dict[str, Any]:
    return {"color": _colour(DRIVER_COLOURS, place), "marker": MARKERS[place % len(MARKERS)]}


def _colour(colours: Sequence[str], place: int) -> str:
    return colours[place % len(colours)]


def _ordered(names: Iterable[str]) -> list[str]:
    """List each name once: the paper's drivers in the paper's order, then the others."""
    once = dict.fromkeys(names)
    others = [name for name in once if name not in PAPER_DRIVERS]
    return [name for name in PAPER_DRIVERS if name in once] + others


def _short(kl: float) -> str:
    """Write whole numbers from 10 on, two digits below."""
    return f"{kl:,.0f}" if kl >= 9.95 else f"{kl:.2g}"
