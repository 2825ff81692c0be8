"""Report of the ablation: figure and tables."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from hmi_marl.envs.drivers import TRAIT_NAMES
from hmi_marl.experiments.training_seeds import SeededExperiment
from hmi_marl.experiments.trait_ablations.figure import ablation_figure
from hmi_marl.experiments.trait_ablations.rows import Row
from hmi_marl.experiments.trait_ablations.variants import AXES
from hmi_marl.files import json_value
from hmi_marl.reporting.blocks import Block, Figure, Table, Text
from hmi_marl.reporting.statistics import Estimate
from hmi_marl.reporting.verdicts import Verdict

_SOURCES = ("/rows",)
"""Place of the numbers in the JSON file."""
_NAMED = "types named [%]"


class AblationReport(SeededExperiment[list[Row]]):
    """Report of the experiment."""

    name = "ablations"
    title = "Parts of the self-supervised encoder, changed one at a time"
    paper = (
        "The paper learns latent traits by one encoder and one set of losses (Sec. VIII-B). Below, "
        "the self-supervised encoder of ours is learned again with one part changed."
    )

    def numbers_of(self, results: list[Row]) -> Mapping[str, Any]:
        """See :meth:`SeededExperiment.numbers_of`."""
        return {"rows": json_value(results)}

    def judge_of(self, results: list[Row]) -> Sequence[Verdict]:
        """Judge nothing: there is no claim, but a table."""
        return ()

    def blocks_of(self, results: list[Row]) -> list[Block]:
        """Show the figure, and tables of R² and of differences from the default."""
        return [
            Text(
                "Every encoder learns from strangers, by which windows are of one person, with the "
                "same number of updates. Probes fitted on one half of other strangers read the "
                "traits of the other half from z; R² is 1 less their squared error over the "
                "variance of the trait. Types are named from one labelled pool of each. Intervals: "
                "95 %, over strangers or pools, and over training seeds where there are several."
            ),
            Figure(
                "ablations",
                "R² of traits of strangers by loss, pooling, inputs, population, windows and "
                "dimensions; the default is marked",
                lambda: ablation_figure(results),
                lambda: ablation_figure(results, 2),
                sources=_SOURCES,
            ),
            r2_table("R² of traits, by a small network", results, lambda row: row.network, True),
            r2_table("R² of traits, by a linear probe", results, lambda row: row.linear),
            r2_table(
                "R² less that of the default, by a small network, paired by stranger",
                [row for row in results if not row.default],
                lambda row: row.more,
                form="+.2f",
            ),
        ]


def r2_table(
    title: str,
    rows: Sequence[Row],
    of: Callable[[Row], Mapping[str, Estimate]],
    named: bool = False,
    form: str = "z.2f",
) -> Table:
    """Show one measure of all rows, by trait."""

    def column(trait: str) -> Callable[[Row], str]:
        return lambda row: of(row)[trait].shown(form)

    columns: dict[str, Callable[[Row], str]] = {
        "changed": lambda row: AXES[row.axis],
        "to": lambda row: f"{row.what} (default)" if row.default else row.what,
        **{trait: column(trait) for trait in TRAIT_NAMES},
    }
    if named:
        columns[_NAMED] = lambda row: row.named.percent()
    return Table.of(title, rows, columns, sources=_SOURCES)
