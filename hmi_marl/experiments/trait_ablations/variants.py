"""Variants of the self-supervised encoder: each differs from the default in one respect."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

from hmi_marl.training.ablations.design import EncoderDesign


@dataclass(frozen=True)
class Variant:
    """One change of the encoder or of what it learns from."""

    name: str
    """Name in files."""
    axis: str
    """Respect in which it differs, a key of ``AXES``; empty of the default."""
    what: str
    """Description for a reader."""
    design: EncoderDesign = field(default_factory=EncoderDesign)
    strangers: int | None = None
    """Strangers learned from; by default those of the experiment, as below."""
    windows: int | None = None
    """Windows of each of them."""
    latent: int | None = None
    """Size of z."""


BASELINE = Variant("baseline", "", "default")
POOL = "pool"
"""Axis along which nothing else is learned: the default reads other numbers of windows."""
AXES: Mapping[str, str] = MappingProxyType(
    {
        "loss": "loss",
        "pooling": "pooling over time",
        "inputs": "inputs of a step",
        "strangers": "strangers learned from",
        "windows": "windows of each learned from",
        "latent": "dimensions of z",
        POOL: "windows read at once",
    }
)
"""Axes in the order of figure and tables, and what a reader calls them."""
DEFAULTS: Mapping[str, str] = MappingProxyType(
    {"loss": "posteriors", "pooling": "mean", "inputs": "all"}
)
"""Descriptions of the default on axes without numbers."""
NUMERIC: Sequence[str] = tuple(axis for axis in AXES if axis not in DEFAULTS)
POOLS = (1, 2, 4, 8, 16)
"""Windows that the default reads at once; the others read what trait models pool."""
LEARNED_WINDOWS, DIMENSIONS = (2, 4, 8), (1, 2, 4, 16)
POPULATIONS = (100, 300, 1000, 5000, 10_000)

VARIANTS: tuple[Variant, ...] = (
    BASELINE,
    Variant("loss-distance", "loss", "distance", EncoderDesign(loss="distance")),
    Variant("loss-cosine", "loss", "cosine", EncoderDesign(loss="cosine")),
    Variant("loss-margin", "loss", "margin", EncoderDesign(loss="margin")),
    Variant("loss-balanced", "loss", "margin, balanced", EncoderDesign(loss="balanced-margin")),
    Variant("pooling-maximum", "pooling", "maximum", EncoderDesign(pooling="maximum")),
    Variant("pooling-last", "pooling", "last GRU state", EncoderDesign(pooling="last-state")),
    Variant("inputs-no-average", "inputs", "no average driver", EncoderDesign(inputs="no-average")),
    Variant("inputs-no-state", "inputs", "no state", EncoderDesign(inputs="no-state")),
    Variant(
        "inputs-no-alert-time", "inputs", "no time of alerts", EncoderDesign(inputs="no-alert-time")
    ),
    Variant(
        "inputs-actions",
        "inputs",
        "actions and alerts",
        EncoderDesign(inputs="actions-and-alerts"),
    ),
    Variant("inputs-state", "inputs", "state alone", EncoderDesign(inputs="state-alone")),
    *(Variant(f"latent-{n}", "latent", f"{n}", latent=n) for n in DIMENSIONS),
    *(Variant(f"windows-{n}", "windows", f"{n}", windows=n) for n in LEARNED_WINDOWS),
    *(Variant(f"strangers-{n}", "strangers", f"{n}", strangers=n) for n in POPULATIONS),
)
"""Variants in the order in which they learn; the default comes first."""
BY_NAME: Mapping[str, Variant] = MappingProxyType({each.name: each for each in VARIANTS})
