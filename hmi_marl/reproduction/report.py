"""Report of a whole reproduction: summary, claims with verdicts, a page for each experiment.

Nothing in it but its page of durations depends on durations or on interruptions: the same settings
give the same bytes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from hmi_marl.files import json_value
from hmi_marl.paper.audit import audit
from hmi_marl.reporting.blocks import Block, Heading, Text, Verdicts
from hmi_marl.reporting.cards import Cards, Tally
from hmi_marl.reporting.pages import Page, PagedReport
from hmi_marl.reporting.report import PAGE
from hmi_marl.reporting.sources import Citation, pointer
from hmi_marl.reporting.verdicts import Outcome, Verdict
from hmi_marl.reproduction.claims import Judged, claims_json, judge
from hmi_marl.reproduction.exact_page import audit_blocks, exact_blocks, exact_values
from hmi_marl.reproduction.exhibits import card, exhibits
from hmi_marl.reproduction.made_page import (
    MADE,
    Timings,
    command_of,
    made_blocks,
    made_with,
    time_blocks,
)
from hmi_marl.reproduction.paper_items import paper_items
from hmi_marl.reproduction.suite import TIMINGS, Record

NAME = "reproduce"
NUMBERS = f"{NAME}.json"
REPORT = "report"
"""Folder of the report, in that of the reproduction."""
_INTRODUCTION = (
    "“Learning Latent Traits for Simulated Cooperative Driving Tasks” (DeCastro et al.) claims "
    "that the traits of drivers can be learned from how they drive, and that an HMI made for the "
    "driver at the wheel does better than one for the average driver. Here everything is learned "
    "anew, what can be known exactly stands next to it, and each claim has a verdict that is "
    "computed from the numbers of this run."
)
_ABOUT_CLAIMS = (
    "Claims are in short or quoted. Every verdict is computed from the numbers of this run, by one "
    "rule: a part is supported if its whole interval lies on the claimed side of the threshold, "
    "not supported if it lies on the other side (or is too small to matter), else undetermined; a "
    "claim is supported if all its parts are, not supported if one is not, else undetermined. "
    "Intervals allow for the number of parts in the whole report, so that the chance of any false "
    "verdict is at most 5 %. HMIs are compared in the same episodes. What was trained once is "
    "judged as the agents that were learned here; ways of learning are judged over training seeds."
)
_ABOUT_ITEMS = (
    "The paper's source comes without its pictures: ours are compared to what it prints, in "
    "numbers and in words."
)
_CLAIMS = "/claims"

__all__ = ["NUMBERS", "PAGE", "REPORT", "full_report"]


def full_report(
    records: Sequence[Record], command_line: str, timings: Timings | None = None
) -> PagedReport:
    """Make the report of a reproduction.

    Args:
        records: finished experiments.
        command_line: command that ran them.
        timings: durations, which are shown on a page of their own.
    """
    results = {record.experiment.name: record.numbers for record in records}
    judged, audited, exact, made = judge(results), audit(), exact_values(), made_with()
    items, shown = paper_items(results), exhibits(results)
    numbers = {
        MADE: made,
        "claims": claims_json(judged.claims),
        "exhibits": [exhibit.as_json() for exhibit in shown],
        "items": items.rows,
        "exact": exact,
        "audit": audited,
        "stages": _stages(results, judged),
    }
    whole = Citation(command_line, NUMBERS, about="made.html#command")
    outcomes = Counter(verdict.outcome for verdict in judged.claims)
    tally = {outcome: outcomes[outcome] for outcome in Outcome}
    cards = [
        card(exhibit, place, _citation(exhibit.stage, command_line, within=""))
        for place, exhibit in enumerate(shown)
    ]
    summary: list[Block] = [
        Text(_INTRODUCTION),
        Tally(tally, "claims of the paper", "claims.html", [_CLAIMS]),
        *([Cards(cards)] if cards else []),
    ]
    claims: list[Block] = [
        Heading("The paper's claims", "claims"),
        Verdicts(judged.claims, f"{len(judged.claims)} claims", _ABOUT_CLAIMS, [_CLAIMS]),
        Heading("The paper's tables and figures", "items"),
        Text(_ABOUT_ITEMS),
        items,
    ]
    known: list[Block] = [
        Text("`hmi-marl oracle` prints the exact values of any driver, and the audit."),
        Heading("Exact optimum and ceilings", "exact"),
        *exact_blocks(exact, results),
        Heading("What the paper's table cannot be", "audit"),
        *audit_blocks(audited),
    ]
    how = made_blocks(records, command_line, made)
    times = Citation(command_line, TIMINGS, about=whole.about)
    pages = [
        Page("index", "Summary", "The paper, made again", summary, whole),
        Page("claims", "Claims", "The paper's claims, with verdicts", claims, whole),
        *(_stage_page(record, judged, command_line) for record in records),
        Page("exact", "Exact values", "What is known exactly", known, whole),
        Page("made", "Method", "How it was made", how, whole),
        Page("times", "Times", "Durations", time_blocks(timings or {}), times, False),
    ]
    settings = {record.experiment.name: record.experiment.settings() for record in records}
    return PagedReport(NAME, pages, numbers, command_line, settings, {TIMINGS: timings or {}})


def _stages(
    results: Mapping[str, Mapping[str, Any]], judged: Judged
) -> dict[str, Mapping[str, Any]]:
    """Numbers of the experiments, with verdicts that are corrected together with the claims'."""
    own = judged.experiments
    return {
        name: {**numbers, "verdicts": [each.as_json() for each in own[name]]}
        if own[name]
        else numbers
        for name, numbers in json_value(results).items()
    }


def _citation(stage: str, command_line: str, within: str | None = None) -> Citation:
    """Cite the command of an experiment, and its numbers."""
    place = pointer("stages", stage) if within is None else within
    return Citation(command_of(stage, command_line), NUMBERS, place, f"made.html#{stage}")


def _stage_page(record: Record, judged: Judged, command_line: str) -> Page:
    """Make the page of an experiment."""
    experiment = record.experiment
    own: list[Verdict] = judged.experiments[experiment.name]
    blocks = [
        replace(block, verdicts=own) if isinstance(block, Verdicts) else block
        for block in record.blocks
    ]
    cited = _citation(experiment.name, command_line)
    short, paper = experiment.short or experiment.title, Text(experiment.paper)
    return Page(experiment.name, short, experiment.title, [paper, *blocks], cited)
