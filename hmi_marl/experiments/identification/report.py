"""Report of who drives with either policy: text, tables and verdicts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hmi_marl.envs.drivers import TRAIT_NAMES
from hmi_marl.experiments import criteria
from hmi_marl.experiments.experiment import Experiment
from hmi_marl.experiments.identification.scoring import (
    POOL,
    SECONDS,
    DrivingRow,
    NamedRow,
    Read,
)
from hmi_marl.experiments.latent_traits.posterior import PosteriorRow
from hmi_marl.files import json_value
from hmi_marl.reporting.blocks import Block, Table, Text
from hmi_marl.reporting.verdicts import Part, Verdict

WINDOWS = "windows"
"""Unit of replication."""
TRAINED, CONTROL = "with the driver", "with the control"
_WHOLE = SECONDS[-1]
_READ = {
    "intended": "a^H alone, by the policy",
    "chain": "a^H and v, by the attention chain",
    "seen": "a^H and v, by both",
    "hidden": "v with a^H hidden, by both",
}


@dataclass(frozen=True)
class IdentificationResults:
    """What tells drivers apart, with either policy."""

    named: Sequence[NamedRow]
    driving: Sequence[DrivingRow]
    posteriors: Mapping[str, PosteriorRow]
    """The exact posterior over strangers' traits, by :data:`TRAINED` and :data:`CONTROL`."""

    def row(self, source: str, seconds: float) -> NamedRow:
        """Row of single windows of which so much is read."""
        wanted = Read(source, seconds, 1)
        (found,) = (row for row in self.named if row.read == wanted)
        return found


class IdentificationReport(Experiment[IdentificationResults]):
    """Report of the experiment."""

    name = "identify"
    title = "Who drives: attention, and the policy's reaction to its traits"
    short = "Who drives"
    paper = (
        "The paper learns latent traits of drivers from how they drive (Sec. VIII-B). Its drivers "
        "are one network that reads their traits, so that part of what tells them apart is how the "
        "network reacts to these inputs, and not how people's attention lapses. Below, the exact "
        "classifier of the same four drivers with that network, and with a control: a driver "
        "policy learned alike, which reads its inflation of its traits, and not β, α and η."
    )

    def numbers(self, results: IdentificationResults) -> dict[str, Any]:
        """JSON content."""
        named = [row.read._asdict() | json_value(row) for row in results.named]
        for row in named:
            del row["read"]
        return dict(json_value(results)) | {"named": named}

    def judge(self, results: IdentificationResults) -> list[Verdict]:
        """Judge what the reaction to traits reveals, and what is left without it."""
        verdicts = []
        for source, seconds in (("intended", _WHOLE), ("hidden", 1.0), ("hidden", _WHOLE)):
            part = Part.mean(
                "named, less with the control",
                results.row(source, seconds).difference,
                WINDOWS,
                paired=True,
                above=0.0,
                seeds=1,
                form="+.1%",
            )
            claim = f"the reaction to β, α and η names more: {_READ[source]}, {seconds:g} s"
            verdicts.append(Verdict(claim, (part,)))
        least, left = criteria.APART, results.row("hidden", _WHOLE).control
        claim = f"without it {100 * least:.0f} % are named: {_READ['hidden']}, {_WHOLE:g} s"
        part = Part.share("named", left, WINDOWS, above=least, seeds=1, form="z.1%")
        return [*verdicts, Verdict(claim, (part,))]

    def blocks(self, results: IdentificationResults) -> Sequence[Block]:
        """Text in short, and tables of drivers named, of traits and of driving."""
        return [
            Text(in_short(results)),
            Table.of(
                "Who drives, by what is read: drivers named [%], four drivers",
                results.named,
                {
                    "read": lambda row: _READ[row.read.source],
                    "seconds": lambda row: f"{row.read.seconds:g}",
                    "windows": lambda row: str(row.read.windows),
                    TRAINED: lambda row: row.trained.percent(),
                    CONTROL: lambda row: row.control.percent(),
                    "difference": lambda row: row.difference.percent("+.1f"),
                },
                "By the exact classifier, which knows the policy and the chain. Intervals: 95 %, "
                f"over windows of separate episodes, or pools of {POOL} of them; differences are "
                "paired by windows of the same seed. Among candidates that are equal one is drawn.",
                sources=["/named"],
            ),
            trait_table(results.posteriors),
            Table.of(
                "Driving without alerts",
                results.driving,
                {
                    "driver": lambda row: row.driver,
                    "speed return": lambda row: row.speed_return.shown(),
                    "of the control": lambda row: row.control_speed_return.shown(),
                    "difference": lambda row: row.speed_difference.shown("+.1f"),
                    "crashes [%]": lambda row: row.crash_rate.percent(),
                    "of the control [%]": lambda row: row.control_crash_rate.percent(),
                },
                "Intervals: 95 %, over episodes, the same ones for both.",
                sources=["/driving"],
            ),
        ]


def trait_table(posteriors: Mapping[str, PosteriorRow]) -> Table:
    """Show R² of the exact posterior's mean over strangers, with either policy."""
    rows = [
        [name, *(row.traits[trait].r2.shown("z.2f") for trait in TRAIT_NAMES)]
        for name, row in posteriors.items()
    ]
    count = next(iter(posteriors.values())).drivers
    return Table(
        f"R² of strangers' traits, by the exact posterior from {POOL} windows, a^H hidden",
        ["", *TRAIT_NAMES],
        rows,
        f"Over {count} drivers of a continuous population, the same ones; intervals: 95 %, over "
        "drivers.",
        sources=["/posteriors"],
    )


def in_short(results: IdentificationResults) -> str:
    """Say which part of who drives is the network's reaction to its trait inputs."""

    def shares(source: str, seconds: float) -> tuple[str, str, str]:
        row = results.row(source, seconds)
        trained, control, difference = (
            f"{100 * each.mean:.1f}" for each in (row.trained, row.control, row.difference)
        )
        return trained, control, difference

    whole, first = shares("hidden", _WHOLE), shares("hidden", 1.0)
    alone, chain = shares("intended", _WHOLE), shares("chain", _WHOLE)
    return (
        f"In a window of {_WHOLE:g} s, a^H hidden, the exact classifier names {whole[0]} % of the "
        f"drivers with the policy that reads all traits, and {whole[1]} % with the control: "
        f"{whole[2]} points are the network's reaction to β, α and η, the rest is how attention "
        f"lapses and what inflation does. After 1 s it is {first[0]} and {first[1]} %, {first[2]} "
        f"points. a^H alone names {alone[0]} and {alone[1]} % after {_WHOLE:g} s: with the control "
        "at most half but for luck, since drivers of the same inflation intend alike. The "
        f"attention chain alone, a^H seen, names {chain[0]} and {chain[1]} %. One training seed of "
        "each policy."
    )
