"""Report of the ablation: figure and tables."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from hmi_marl.envs.drivers import TRAIT_NAMES
from hmi_marl.experiments.training_seeds import SeededExperiment
from hmi_marl.experiments.trait_ablations.figure import ablation_figure
from hmi_marl.experiments.trait_ablations.rows import AblationResults, Row
from hmi_marl.experiments.trait_ablations.variants import AXES
from hmi_marl.files import json_value
from hmi_marl.reporting.blocks import Block, Figure, Table, Text
from hmi_marl.reporting.statistics import Estimate
from hmi_marl.reporting.verdicts import Verdict

_SOURCES = ("/rows",)
"""Place of the numbers in the JSON file."""
_NAMED = "types named [%]"
_NOTE = (
    "Loss: InfoNCE by the likelihood of both posteriors, by the distance or the cosine of their "
    "means with a learned temperature, or the paper's contrastive loss with each stranger as a "
    "label, as a mean over pairs (margin) or with equal and other pairs weighted alike (balanced). "
    "Pooling is within a window; a pool is the mean of its windows. Without the state the average "
    "driver still reads it; with actions and alerts there is no average driver either; without the "
    "time of alerts neither reads it."
)


class AblationReport(SeededExperiment[AblationResults]):
    """Report of the experiment."""

    name = "ablations"
    title = "Parts of the self-supervised encoder, changed one at a time"
    paper = (
        "The paper learns latent traits by one encoder and one set of losses (Sec. VIII-B). Below, "
        "the self-supervised encoder of ours is learned again with one part changed."
    )

    def numbers_of(self, results: AblationResults) -> Mapping[str, Any]:
        """See :meth:`SeededExperiment.numbers_of`."""
        return dict(json_value(results))

    def judge_of(self, results: AblationResults) -> Sequence[Verdict]:
        """Judge nothing: there is no claim, but a table."""
        return ()

    def blocks_of(self, results: AblationResults) -> list[Block]:
        """Show the figure, and tables of R² and of differences from the default."""
        rows, exact = results.rows, results.exact
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
                "dimensions; the default and the exact posterior are marked",
                lambda: ablation_figure(rows, exact),
                lambda: ablation_figure(rows, exact, 2),
                sources=("/rows", "/exact"),
            ),
            r2_table(
                "R² of traits, by a small network",
                rows,
                lambda row: row.network,
                named=True,
                note=_NOTE,
            ),
            *([] if exact is None else [exact_table(exact)]),
            r2_table("R² of traits, by a linear probe", rows, lambda row: row.linear),
            r2_table(
                "R² less that of the default, by a small network, paired by stranger",
                [row for row in rows if not row.default],
                lambda row: row.more,
                form="+.2f",
            ),
        ]


def exact_table(exact: Mapping[str, Estimate]) -> Table:
    """Show R² of the exact posterior."""

    def column(trait: str) -> Callable[[Mapping[str, Estimate]], str]:
        return lambda found: found[trait].shown("z.2f")

    columns: dict[str, Callable[[Mapping[str, Estimate]], str]] = {
        "reader": lambda found: "exact posterior",
        **{trait: column(trait) for trait in TRAIT_NAMES},
        "strangers": lambda found: str(found[TRAIT_NAMES[0]].count),
    }
    note = (
        "Its mean, from as many windows as the default reads; it knows the driver policy. No "
        "estimate from the same driving has a smaller squared error."
    )
    return Table.of("R² of the exact posterior", [exact], columns, note, ("/exact",))


def r2_table(
    title: str,
    rows: Sequence[Row],
    of: Callable[[Row], Mapping[str, Estimate]],
    named: bool = False,
    form: str = "z.2f",
    note: str = "",
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
    return Table.of(title, rows, columns, note, _SOURCES)
