"""Rows of the ablation: what each variant reads of traits, against the default."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from hmi_marl.envs.drivers import TRAIT_NAMES
from hmi_marl.experiments.trait_ablations.judging import Array, Judged
from hmi_marl.experiments.trait_ablations.variants import (
    AXES,
    BASELINE,
    DEFAULTS,
    POOL,
    Variant,
)
from hmi_marl.experiments.trait_shifts.errors import share_explained
from hmi_marl.reporting import statistics
from hmi_marl.reporting.statistics import Estimate


@dataclass(frozen=True)
class Row:
    """One place on one axis."""

    axis: str
    """A key of ``AXES``."""
    what: str
    """Description of the place, or its number."""
    default: bool
    """Whether the default is there."""
    linear: Mapping[str, Estimate]
    """R² by trait, by the linear probe."""
    network: Mapping[str, Estimate]
    """R² by trait, by the small network."""
    more: Mapping[str, Estimate]
    """The latter less that of the default, by trait, paired by stranger."""
    named: Estimate
    """Share of pools of the four types that is named right."""

    @property
    def number(self) -> float:
        """Number of the place, on an axis with numbers."""
        return float(self.what)


@dataclass(frozen=True)
class AblationResults:
    """Results of all variants."""

    rows: Sequence[Row]
    exact: Mapping[str, Estimate] | None
    """R² of the exact posterior by trait, from as many windows; None if it was not computed."""


def rows_of(
    found: Mapping[str, Judged], variants: Sequence[Variant], places: Mapping[str, int], pool: int
) -> list[Row]:
    """Make the rows, axis by axis; the default has one on each axis that has others.

    Args:
        found: results by the name of the variant, the default's among them.
        variants: variants that are shown.
        places: numbers of the default, by axis with numbers.
        pool: windows that all but the rows of ``POOL`` read at once.
    """
    default = found[BASELINE.name]

    def row(axis: str, what: str, judged: Judged, size: int, is_default: bool) -> Row:
        errors, base = judged.errors[size], default.errors[pool]
        more = {}
        for k, trait in enumerate(TRAIT_NAMES):
            own, deviations = _explained(errors.network, errors.spread, k)
            before, others = _explained(base.network, base.spread, k)
            more[trait] = statistics.mean(own.mean + deviations - before.mean - others)
        linear, network = (
            {t: _explained(read, errors.spread, k)[0] for k, t in enumerate(TRAIT_NAMES)}
            for read in (errors.linear, errors.network)
        )
        return Row(axis, what, is_default, linear, network, more, judged.named[size])

    rows = []
    for axis in AXES:
        if axis == POOL:
            rows += [row(axis, f"{n}", default, n, n == pool) for n in sorted(default.errors)]
            continue
        others = [each for each in variants if each.axis == axis]
        if not others:
            continue
        own = [row(axis, DEFAULTS.get(axis) or f"{places[axis]}", default, pool, True)]
        own += [row(axis, each.what, found[each.name], pool, False) for each in others]
        rows += own if axis in DEFAULTS else sorted(own, key=lambda each: each.number)
    return rows


def _explained(squares: Array, spread: Array, column: int) -> tuple[Estimate, Array]:
    return share_explained(squares[:, column], spread[:, column])
