"""Figure of what z tells of strangers' traits: z coloured by each, and predicted against true."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hmi_marl.envs.drivers import TRAIT_NAMES
from hmi_marl.experiments.latent_traits.figures import TITLES, two_axes
from hmi_marl.experiments.latent_traits.strangers import TraitReading
from hmi_marl.reporting.blocks import Figure
from hmi_marl.reporting.drawing import COLOURS, canvas, ink, png

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing

_SYMBOLS = {"beta": "β", "alpha": "α", "eta": "η", "inflation": "inflation"}


def reading_figure(setting: str, reading: TraitReading, sources: Sequence[str] = ()) -> Figure:
    """Draw :func:`draw_reading` for a setting."""
    title = f"traits of strangers, {TITLES[setting]}"
    return Figure(
        f"strangers-{setting}", title, lambda: png(draw_reading(reading)), sources=sources
    )


def draw_reading(reading: TraitReading) -> Drawing:
    """Draw two rows with a panel for each trait: z coloured by it, and predicted against true."""
    flat, labels = two_axes(reading.means)
    figure = canvas(3.2 * len(TRAIT_NAMES), 6.2)
    above, below = figure.subplots(2, len(TRAIT_NAMES))
    for column, name in enumerate(TRAIT_NAMES):
        true, predicted = reading.traits[:, column], reading.predicted[:, column]
        axes = above[column]
        dots = axes.scatter(flat[:, 0], flat[:, 1], c=true, s=7, cmap="viridis", linewidths=0)
        figure.colorbar(dots, ax=axes, label=_SYMBOLS[name])
        axes.set_xlabel(labels[0])
        axes.set_ylabel(labels[1] if column == 0 else "")
        axes.tick_params(labelsize=8)
        axes = below[column]
        ends = [float(np.min(true)), float(np.max(true))]
        axes.scatter(true, predicted, s=7, alpha=0.5, color=COLOURS[0], linewidths=0)
        axes.plot(ends, ends, color=ink(), linewidth=1.0)
        axes.set_xlabel(f"true {_SYMBOLS[name]}")
        axes.set_ylabel("read from z" if column == 0 else "")
        axes.set_title(f"R² {reading.r2[name].network.mean:.2f}", fontsize=10)
        axes.tick_params(labelsize=8)
        for each in (above[column], below[column]):
            each.spines[["top", "right"]].set_visible(False)
    return figure
