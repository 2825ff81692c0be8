"""Report of traits under shifts: text, tables and verdicts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

from hmi_marl.envs.drivers import TRAIT_NAMES
from hmi_marl.experiments.criteria import KEPT_R2
from hmi_marl.experiments.experiment import Experiment
from hmi_marl.experiments.trait_shifts.errors import LEVEL, ShiftRow, TraitErrors
from hmi_marl.experiments.trait_shifts.scoring import KNOWING, LINEAR, NETWORK, UNAWARE
from hmi_marl.experiments.trait_shifts.shifts import NONE
from hmi_marl.files import json_value
from hmi_marl.reporting.blocks import Block, Table, Text
from hmi_marl.reporting.verdicts import Part, Verdict
from hmi_marl.text import listed

STRANGERS = "strangers"
"""Unit of replication."""
READERS: Mapping[str, str] = MappingProxyType(
    {
        NETWORK: "z, by the small network",
        LINEAR: "z, by the linear probe",
        UNAWARE: "the exact posterior that believes nothing has shifted",
        KNOWING: "the exact posterior that knows the shift",
    }
)
"""Readers by name."""
_SOURCES = ("/shifts",)
"""Place of the numbers in the JSON file."""


class ShiftsReport(Experiment[list[ShiftRow]]):
    """Report of the experiment."""

    name = "shifts"
    title = "Traits under shifts"
    paper = (
        "The paper learns and judges latent traits with one driver policy, alerts at random and "
        "traits that stay as they are (Sec. VIII-B). Below, a trait model that was learned so "
        "reads strangers for whom one of these has changed."
    )

    def numbers(self, results: list[ShiftRow]) -> dict[str, Any]:
        """JSON content."""
        return {"kept_r2": KEPT_R2, "level": LEVEL, "shifts": json_value(results)}

    def judge(self, results: list[ShiftRow]) -> list[Verdict]:
        """Judge under which shifts z keeps its R², by the small network."""
        verdicts = []
        for row in results:
            traits = row.readers[NETWORK].traits
            same = [trait for trait, each in traits.items() if each.kept is not None]
            if row.name == NONE.name:
                continue
            parts = [
                Part.mean(
                    f"R² of {trait} less {KEPT_R2:g} of that without shift",
                    each.kept,
                    STRANGERS,
                    paired=True,
                    above=0.0,
                    seeds=1,
                    form="+.3f",
                )
                for trait, each in traits.items()
                if each.kept is not None
            ]
            of = "each trait" if len(same) == len(TRAIT_NAMES) else listed(same)
            claim = f"z keeps {100 * KEPT_R2:g} % of its R² of {of}: {row.what}"
            verdicts.append(Verdict(claim, tuple(parts)))
        return verdicts

    def blocks(self, results: list[ShiftRow]) -> Sequence[Block]:
        """Tables of R², and of errors and bias, by reader."""
        return [
            Text(
                "The probes are fitted on strangers without shift. Then other strangers are "
                "recorded under each shift, the same ones with the same seeds, and their traits "
                "are read from pools of their windows. Intervals: 95 %, over strangers. The truth "
                "of traits that drift is their mean over the windows. R² is relative to the "
                "variance of the true trait: where traits come from a narrow range look at the "
                "errors and the bias. β, α and η fill [0, 1] without shift, so that inflation "
                "alone can lie outside the range."
            ),
            short_table(results),
            *(r2_table(results, reader) for reader in READERS),
            *(error_table(results, reader) for reader in (NETWORK, UNAWARE)),
            coverage_table(results),
        ]


def short_table(results: list[ShiftRow]) -> Table:
    """Show R² from z and of both posteriors, without intervals."""

    def entry(row: ShiftRow, trait: str) -> str:
        shown = [
            f"{row.readers[each].traits[trait].r2.mean:z.2f}" if each in row.readers else "-"
            for each in (NETWORK, UNAWARE, KNOWING)
        ]
        return "  ".join(shown)

    return Table.of(
        "R² of traits: from z, of the posterior that believes nothing has shifted, of that which "
        "knows",
        results,
        _columns(entry),
        f"From z by the small network, over {results[0].readers[NETWORK].strangers} strangers; "
        f"the posteriors over the first {results[0].readers[UNAWARE].strangers} of them.",
        _SOURCES,
    )


def r2_table(results: list[ShiftRow], reader: str) -> Table:
    """Show R² by shift and trait."""
    return _table(
        f"R² of traits from {READERS[reader]}",
        results,
        reader,
        lambda each: each.r2.shown("z.2f"),
        _NOTES.get(reader, ""),
    )


def error_table(results: list[ShiftRow], reader: str) -> Table:
    """Show mean absolute errors and biases by shift and trait."""
    return _table(
        f"Mean absolute error, and bias, of {READERS[reader]}",
        results,
        reader,
        lambda each: f"{each.error.mean:.3f}, {each.bias.shown('+.3f')}",
        "Bias: mean of estimate less truth, with its interval.",
    )


def coverage_table(results: list[ShiftRow]) -> Table:
    """Show coverage of the intervals of both posteriors by shift and trait."""

    def entry(row: ShiftRow, trait: str) -> str:
        shown = []
        for reader in (UNAWARE, KNOWING):
            errors = row.readers.get(reader)
            coverage = None if errors is None else errors.traits[trait].coverage
            shown.append("-" if coverage is None else f"{100 * coverage.mean:.0f}")
        return ", ".join(shown)

    columns = _columns(entry)
    columns["enough [%]"] = lambda row: ", ".join(
        "-" if reader not in row.readers else f"{100 * (row.readers[reader].enough or 0.0):.0f}"
        for reader in (UNAWARE, KNOWING)
    )
    return Table.of(
        f"Strangers whose trait lies in the posterior's interval of {100 * LEVEL:g} % [%]",
        results,
        columns,
        "The posterior that believes nothing has shifted, then the one that knows the shift. "
        "Enough: strangers whose posterior has a large enough effective sample size.",
        _SOURCES,
    )


_NOTES = {
    UNAWARE: "It takes the driver policy, alerts that say nothing of the driver, N and the range "
    "of traits to be those without shift; the world in which it replays windows is the recorded "
    "one.",
    KNOWING: "Of the rule-based driver, who has no action probabilities, it knows that nothing is "
    "known of the policy. -: alerts that depend on the driver, and traits that drift, are not in "
    "its model.",
}


def _columns(entry: Callable[[ShiftRow, str], str]) -> dict[str, Callable[[ShiftRow], str]]:
    """Columns of a table with one entry for each trait."""

    def of(trait: str) -> Callable[[ShiftRow], str]:
        return lambda row: entry(row, trait)

    return {"shift": lambda row: row.what, **{trait: of(trait) for trait in TRAIT_NAMES}}


def _table(
    title: str,
    results: list[ShiftRow],
    reader: str,
    show: Callable[[TraitErrors], str],
    note: str,
) -> Table:
    def entry(row: ShiftRow, trait: str) -> str:
        return show(row.readers[reader].traits[trait]) if reader in row.readers else "-"

    columns = _columns(entry)
    columns["strangers"] = lambda row: (
        str(row.readers[reader].strangers) if reader in row.readers else "-"
    )
    return Table.of(title, results, columns, note, _SOURCES)
