"""The report of a whole reproduction from numbers that are made up, for tests of its pages."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from simulated_reports import report

from hmi_marl.experiments.hidden_attention import BAYES_AVERAGE, BAYES_OWN, LEARNED_OWN
from hmi_marl.reporting.blocks import Block, Figure, Table, Text, Verdicts
from hmi_marl.reporting.drawing import COLOURS, canvas, png
from hmi_marl.reporting.pages import PagedReport
from hmi_marl.reporting.verdicts import Part, Verdict
from hmi_marl.reproduction.report import full_report
from hmi_marl.reproduction.suite import Record, full_suite

COMMAND = "hmi-marl reproduce --seed 3"
EXTRA = [1, 7]
"""Numbers that every experiment has besides."""


def numbers() -> dict[str, dict[str, Any]]:
    """Numbers of all experiments, with what pages show beyond the claims."""
    stages = report({"id apart": 1.0}, spread=1.0)
    for row in stages["hidden"]["rows"]:
        row |= {"exact_own": 900.0, "exact_average": 890.0}
        played = (BAYES_OWN, BAYES_AVERAGE, LEARNED_OWN)
        row["attention_return"] |= {hmi: {"mean": 895.0} for hmi in played}
        row["exact_same_steps"] = dict.fromkeys(played, 880.0)
    for setting in stages["traits"]["supervisions"].values():
        setting["average_kl"] = {"mean": 10.0}
        rows = [row for seed in setting["seeds"] for row in seed["identified"]]
        for row in rows:
            row["ceilings"]["preference"] = row["ceilings"]["identity"]
        setting["accuracy"] = rows[-1]["types"]["linear_probe"]
        setting["by_windows"] = [
            {"windows": row["windows"], "accuracy": row["types"]["linear_probe"]}
            for row in setting["seeds"][0]["identified"]
        ]
    return stages


def records(shown: Sequence[Block] = ()) -> list[Record]:
    """Finished experiments that all show the same blocks, whose source may be ``/extra``."""
    stages = numbers()
    suite = [one for one in full_suite() if one.name in stages]
    return [Record(one, {**stages[one.name], "extra": EXTRA}, tuple(shown)) for one in suite]


def whole_report() -> PagedReport:
    """A report with wide tables, figures and verdicts on the page of every experiment."""
    row = ["HMI for the driver at the wheel", *["7 [1, 7]\nexact 7\nreachable 1 to 7"] * 12]
    head = ["HMI for", *(f"driver {k}" for k in range(12))]
    part = Part.exact("something", 1.0, above=0.5)
    sources = ["/extra"]
    blocks: list[Block] = [
        Text("As `hmi-marl reproduce --quick` prints it."),
        Figure("bars", "some bars", _bars, sources=sources),
        Table("A wide table", head, [row] * 3, "A note.", sources),
        Verdicts([Verdict("a criterion", (part, part))], sources=sources),
    ]
    timings = {"table": {"this time": 61.4, "playing": 12.0}}
    return full_report(records(blocks), COMMAND, timings)


def _bars() -> bytes:
    drawing = canvas(11, 4)
    for place, axes in enumerate(drawing.subplots(1, 3)):
        axes.bar([0, 1, 2], [1, 3, 2], 0.3, color=COLOURS[1 + place], label="bars")
        axes.legend()
        axes.set_title("a panel")
    return png(drawing)
