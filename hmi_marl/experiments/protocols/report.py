"""A comparison of protocols for people and programs: text, JSON, figures and a page."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import hmi_marl
from hmi_marl.envs.rewards import TERMS
from hmi_marl.experiments.protocols.analysis import (
    MARGIN,
    Comparison,
    Curve,
    Dependence,
    Gaming,
    crash_rate,
    curves_of,
    dependence_of,
    gaming_of,
    over_seeds,
    pooled,
    swap_matrix,
    verdict_of,
)
from hmi_marl.experiments.protocols.figures import curves_figure, swap_figure, terms_figure
from hmi_marl.experiments.protocols.play import Sums
from hmi_marl.experiments.protocols.settings import EVERYBODY, CompareSettings
from hmi_marl.files import json_value, write_bytes, write_json, write_text
from hmi_marl.reporting import statistics
from hmi_marl.reporting.page import html_table, image, page, text_table
from hmi_marl.reporting.statistics import Estimate

Table = tuple[list[str], list[list[str]]]
"""Head and rows."""


def number(value: float, form: str) -> str:
    """A number, or a dash where it is not known."""
    return format(value, form) if math.isfinite(value) else "-"


def entry(estimate: Estimate, form: str = "z.1f") -> str:
    """A number and its interval, as far as they are known."""
    if not math.isfinite(estimate.low):
        return number(estimate.mean, form)
    return f"{estimate.mean:{form}} [{estimate.low:{form}}, {estimate.high:{form}}]"


def percent(estimate: Estimate) -> str:
    """A share and its interval in percent."""
    return entry(Estimate(*(100.0 * value for value in vars(estimate).values())))


def summary_table(comparison: Comparison) -> Table:
    """The protocols, and known policies beside them."""
    head = ["driver and HMI", "team return", "per step", "attention return", "speed return"]
    head += ["crashes [%]", "alerts/min", "steps", "headway [s]"]
    rows = []
    for label, pairs in comparison.groups().items():

        def of(metric: str, form: str = "z.1f", pairs: Any = pairs) -> str:
            return entry(over_seeds(comparison.played, pairs, metric), form)

        rows.append(
            [
                label,
                of("team_return"),
                of("team_return_per_step", "z.2f"),
                of("attention_return"),
                of("speed_reward"),
                percent(crash_rate(pooled(comparison.played, pairs))),
                of("alerts_per_minute"),
                of("length"),
                of("time_headway", ".2f"),
            ]
        )
    return head, rows


def terms_table(comparison: Comparison) -> Table:
    """The eight reward terms per episode."""
    rows = [
        [label, *(entry(over_seeds(comparison.played, pairs, term)) for term in TERMS)]
        for label, pairs in comparison.groups().items()
    ]
    return ["driver and HMI", *TERMS], rows


def swap_table(comparison: Comparison) -> Table:
    """Team return of every driver with every HMI; own pairs in asterisks."""
    protocols, matrix = comparison.settings.protocols, swap_matrix(comparison)
    rows = []
    for i, protocol in enumerate(protocols):
        entries = [entry(statistics.mean(matrix[:, i, j])) for j in range(len(protocols))]
        entries[i] = f"*{entries[i]}*"
        rows.append([protocol, *entries])
    return ["driver of", *(f"HMI of {name}" for name in protocols)], rows


def dependence_table(rows: Sequence[Dependence]) -> Table:
    """How far partners depend on each other."""
    head = ["protocol", "own pair", "driver, others' HMIs", "HMI, others' drivers"]
    head += ["dependence on protocol", "pairs across seeds", "dependence on seed"]
    return head, [
        [
            row.protocol,
            entry(row.own),
            entry(row.driver_with_others),
            entry(row.hmi_with_others),
            entry(row.on_protocol, "+z.1f"),
            entry(row.other_seeds),
            entry(row.on_seed, "+z.1f"),
        ]
        for row in rows
    ]


def gaming_table(rows: Sequence[Gaming]) -> Table:
    """Crash rates with and without an end at the crash, and whether crashing pays."""
    head = ["protocol", "driver", "crashes [%]", "two-stage's [%]", "team return", "per step"]
    head += ["worth of a step", "trained standing [%]", "return, stands", "verdict"]
    return head, [
        [
            row.protocol,
            row.driver,
            percent(row.crash_rate),
            percent(row.two_stage_crash_rate),
            number(row.team_return, "z.1f"),
            number(row.team_return_per_step, "z.2f"),
            number(row.worth_of_a_step, "+z.2f"),
            percent(row.crash_rate_if_trained_standing),
            number(row.team_return_standing, "z.1f"),
            row.verdict,
        ]
        for row in rows
    ]


def verdict_table(comparison: Comparison, rows: Sequence[Gaming]) -> Table:
    """One verdict for each protocol, and with whom it was found unless all is well."""
    told = []
    for protocol in comparison.settings.protocols:
        worst = verdict_of(rows, protocol)
        found = [row.driver for row in rows if row.protocol == protocol and row.verdict == worst]
        told.append([protocol, worst, "" if worst in ("fine", "reference") else ", ".join(found)])
    return ["protocol", "verdict", "drivers"], told


def time_table(comparison: Comparison) -> Table:
    """Wall time of each protocol's runs."""
    rows = []
    for protocol in comparison.settings.protocols:
        seconds = [comparison.seconds(run) for run in comparison.runs(protocol)]
        spent = statistics.mean(seconds, lowest=0.0)
        steps = comparison.curves[comparison.runs(protocol)[0].name][-1]["steps"]
        rows.append([protocol, f"{steps}", entry(spent), f"{steps / spent.mean:.0f}"])
    return ["protocol", "environment steps", "seconds of a run", "steps/s"], rows


def notes(settings: CompareSettings, workers: int) -> dict[str, str]:
    """What each part shows, by its title's key."""
    return {
        "summary": (
            f"Means over {settings.seeds} seeds of {settings.episodes} episodes each, the same "
            "ones for every pair, likeliest actions; in brackets Student's t interval (95 %) over "
            "the seeds. Crashes: episodes of all seeds together with Wilson's interval, which "
            "does not tell how runs differ. when-distracted is the exact alert optimum for the "
            "paper's drivers. steps: of an episode; a crash ends it. headway: mean of the "
            "episodes' medians while somebody is ahead."
        ),
        "curves": (
            "Means over the seeds, interpolated on common environment steps, with the 95 % band of "
            "Student's t, cut off at what was seen (two seeds: thin lines instead). These are "
            "the episodes that were learned from, so with actions that were drawn (explored), not "
            "the likeliest, by those who learn at the time. In two-stage's first part, and "
            "alternating's, there is no HMI."
        ),
        "terms": "Per episode. In the figure a dot for each seed.",
        "swap": (
            "Team return per episode of the driver of one run with the HMI of another of the same "
            "seed, the same episodes for all; own pairs are marked."
        ),
        "dependence": (
            "Own pairs minus swapped pairs, ½ [M(a,a) + M(b,b)] - ½ [M(a,b) + M(b,a)] with M the "
            "team return of a's driver with b's HMI: 0 if partners could be exchanged freely, "
            "however good each is. On protocol: mean over the other protocols (each number is "
            "shared by both of a pair); on seed: over the other runs of the protocol. Intervals "
            "are over the seeds, whose pairs overlap among the latter."
        ),
        "gaming": (
            "Crashes: a crash ends the episode, in training and now. Trained standing: one run "
            "trained with end_at_crash=False, where a crashed car stands until the time is over "
            "(whether it crashes does not depend on what would follow, so the rate is that of "
            "both settings); return, stands: its team return in that setting. worth of a step: "
            "mean reward of a step to the driver in what they learn from, without the collision "
            "term; where it is negative, ending early pays. GAMED: crashes more often than "
            f"two-stage's (intervals more than {MARGIN:g} apart) and a step is worth less than "
            "nothing; crashes more: only the former; fine: neither. The two-stage driver learns "
            "from driving alone and is the reference, a mild one if it has not learned long enough."
        ),
        "time": f"Training only, side by side (workers: {workers}, a thread each).",
    }


_TITLES = {
    "summary": "Final team return, crashes and alerts",
    "curves": "Learning curves",
    "terms": "The eight reward terms",
    "swap": "Swapped partners",
    "dependence": "How far partners depend on each other",
    "gaming": "Does it pay to crash?",
    "time": "Wall time",
}


def _tables(comparison: Comparison) -> dict[str, list[Table]]:
    gaming = gaming_of(comparison)
    return {
        "summary": [summary_table(comparison)],
        "curves": [],
        "terms": [terms_table(comparison)],
        "swap": [swap_table(comparison)],
        "dependence": [dependence_table(dependence_of(comparison))],
        "gaming": [verdict_table(comparison, gaming), gaming_table(gaming)],
        "time": [time_table(comparison)],
    }


def as_text(comparison: Comparison) -> str:
    """Everything for a terminal."""
    told = notes(comparison.settings, comparison.workers)
    blocks = []
    for key, tables in _tables(comparison).items():
        if tables:
            note = textwrap.fill(told[key], 100, initial_indent="  ", subsequent_indent="  ")
            texts = "\n\n".join(text_table(*table) for table in tables)
            blocks.append(f"{_TITLES[key]}\n{texts}\n{note}")
    return "\n\n".join(blocks)


def as_json(comparison: Comparison) -> dict[str, Any]:
    """Everything for programs, with every seed's numbers."""
    settings, gaming = comparison.settings, gaming_of(comparison)
    return {
        "hmi_marl_version": hmi_marl.__version__,
        "settings": json_value(settings),
        "steps_each": settings.steps_each,
        "workers": comparison.workers,
        "protocols": {
            label: {
                "crash_rate_pooled": crash_rate(pooled(comparison.played, pairs)).as_json(),
                "over_seeds": {
                    metric: over_seeds(comparison.played, pairs, metric).as_json()
                    for metric in comparison.played[pairs[0]][EVERYBODY].metrics()
                },
            }
            for label, pairs in comparison.groups().items()
        },
        "verdicts": {name: verdict_of(gaming, name) for name in settings.protocols},
        "gaming": [_plain(row) for row in gaming],
        "dependence": [_plain(row) for row in dependence_of(comparison)],
        "swap_matrix": {
            "protocols": list(settings.protocols),
            "team_return_by_seed_driver_hmi": swap_matrix(comparison).tolist(),
        },
        "pairs": [
            vars(pair) | {"by_driver": {name: _metrics(sums) for name, sums in drivers.items()}}
            for pair, drivers in comparison.played.items()
        ],
        "seconds": {run.name: comparison.seconds(run) for run in settings.runs},
        "curves": {
            protocol: {name: _plain_curve(c) for name, c in curves_of(comparison, protocol).items()}
            for protocol in settings.protocols
        },
    }


def _plain(row: Dependence | Gaming) -> dict[str, Any]:
    return {
        name: value.as_json()
        if isinstance(value, Estimate)
        else (_known(value) if isinstance(value, float) else value)
        for name, value in vars(row).items()
    }


def _metrics(sums: Sums) -> dict[str, Any]:
    counted = {name: getattr(sums, name) for name in ("episodes", "crashes", "steps", "alerts")}
    return counted | {name: _known(value) for name, value in sums.metrics().items()}


def _plain_curve(curve: Curve) -> dict[str, Any]:
    return {
        "steps": curve.steps.tolist(),
        **{name: [_known(v) for v in getattr(curve, name)] for name in ("mean", "low", "high")},
    }


def _known(value: float) -> float | None:
    """JSON has no NaN."""
    return float(value) if math.isfinite(value) else None


def as_html(comparison: Comparison, figures: Mapping[str, bytes], command: str) -> str:
    """One page that needs nothing besides itself.

    Args:
        comparison: all of it.
        figures: PNGs by the part of the page that they belong to.
        command: that makes the page again.
    """
    settings = comparison.settings
    told = notes(settings, comparison.workers)
    parts = [
        f"<p>Every run: {settings.steps_each:,} environment steps. Two-stage and alternating give "
        f"{settings.steps_apart[0]:,} of them to the driver and {settings.steps_apart[1]:,} to the "
        "HMI; in the others both learn in all.</p>"
    ]
    for key, tables in _tables(comparison).items():
        parts.append(f"<h2>{escape(_TITLES[key])}</h2>")
        parts.append(f"<p>{escape(told[key])}</p>")
        if key in figures:
            parts.append(image("png", figures[key], _TITLES[key]))
        parts += [html_table(*table) for table in tables]
    return page("Protocols compared", "\n".join(parts), command, json_value(settings))


FIGURES: Mapping[str, Callable[[Comparison], bytes]] = {
    "curves": curves_figure,
    "swap": swap_figure,
    "terms": terms_figure,
}


def write_report(out: Path, comparison: Comparison, command: str) -> Path:
    """Write compare.txt, compare.json, curves.png, swap.png, terms.png and index.html into ``out``.

    Returns:
        The page's path.
    """
    figures = {name: draw(comparison) for name, draw in FIGURES.items()}
    write_text(out / "compare.txt", as_text(comparison) + "\n")
    write_json(out / "compare.json", as_json(comparison) | {"command": command})
    for name, content in figures.items():
        write_bytes(out / f"{name}.png", content)
    page = out / "index.html"
    write_text(page, as_html(comparison, figures, command))
    return page
