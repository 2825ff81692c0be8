"""The one report of a whole reproduction: claims with verdicts, every stage, exact values, audit.

Nothing in it depends on how long anything took or how often it was cut off: the same settings give
the same bytes.
"""

from __future__ import annotations

import json
import platform
from collections import Counter
from collections.abc import Mapping, Sequence
from html import escape
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import hmi_marl
from hmi_marl.envs.drivers import DRIVERS
from hmi_marl.exact import oracle
from hmi_marl.experiments.hidden_attention import BAYES_OWN, LEARNED_OWN
from hmi_marl.experiments.stages import TIMINGS, Record
from hmi_marl.files import write_json, write_text
from hmi_marl.paper import audit
from hmi_marl.reporting.blocks import Exhibit, Table, Told, show
from hmi_marl.reporting.page import page
from hmi_marl.reproduction.claims import Judged, judge
from hmi_marl.reproduction.findings import Verdict
from hmi_marl.reproduction.paper_items import paper_items

PAGE, NUMBERS = "index.html", "reproduce.json"
LIBRARIES = ("numpy", "torch", "rsl-rl-lib", "highway-env", "pettingzoo")
HORIZON = 100
NEAR = 0.1
"""The paper's figure is what η = 1 gives within this share of it."""
_COLOURS = {
    Verdict.SUPPORTED: "good",
    Verdict.PARTLY: "half",
    Verdict.NOT_SUPPORTED: "bad",
    Verdict.UNTESTABLE: "small",
    Verdict.MISSING: "small",
}


def write_full_report(folder: Path, records: Sequence[Record], command: str) -> Path:
    """Write the page and the numbers into ``folder``; returns the page.

    Args:
        folder: of the reproduction.
        records: of its stages.
        command: that makes it again.
    """
    results = {record.stage.name: record.numbers for record in records}
    judged, audited = judge(results), audit.audit()
    content = {
        "command": command,
        "made with": made_with(),
        "settings": {record.stage.name: record.stage.settings() for record in records},
        "claims": [one.as_json() for one in judged],
        "exact": exact_values(),
        "audit": audit.audit_json(audited),
        "stages": results,
    }
    write_json(folder / NUMBERS, content)
    sections = [
        ("claims", "The paper's claims", claims_html(judged)),
        ("items", "The paper's tables and figures", show(paper_items(results))),
        *(
            (one.stage.name, one.stage.title, show([Told(one.stage.paper), *one.exhibits]))
            for one in records
        ),
        ("exact", "Exact optimum and ceilings", show(exact_exhibits(results))),
        ("audit", "What the paper's table cannot be", show(audit_exhibits(audited))),
        ("made", "How it was made", made_html(records, command)),
    ]
    write_text(folder / PAGE, as_html(sections, command))
    return folder / PAGE


def made_with() -> dict[str, str]:
    """Versions of what decides the numbers."""
    found = {"hmi-marl": hmi_marl.__version__, "Python": platform.python_version()}
    for name in LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "none"
    return found


def as_html(sections: Sequence[tuple[str, str, str]], command: str) -> str:
    """The page, from the name, the title and the HTML of each section."""
    contents = "".join(
        f'<li><a href="#{escape(name)}">{escape(title)}</a></li>' for name, title, _ in sections
    )
    body = "\n".join(
        f'<h2 id="{escape(name)}">{escape(title)}</h2>\n{html}' for name, title, html in sections
    )
    introduction = (
        "<p>“Learning Latent Traits for Simulated Cooperative Driving Tasks” (DeCastro et al.), "
        "made again with everything learned anew, the exact values beside it. The paper's source "
        "comes without its pictures: what stands beside ours is what it prints, in numbers and in "
        "words.</p>"
    )
    return page(
        "The paper, made again", f"{introduction}<ul>{contents}</ul>\n{body}", command, made_with()
    )


def claims_html(judged: Sequence[Judged]) -> str:
    """The claims one by one, the verdicts coloured."""
    counts = Counter(one.finding.verdict for one in judged)
    summary = ", ".join(f"{counts[verdict]} {verdict}" for verdict in Verdict if counts[verdict])
    rows = "".join(
        f"<tr><td>{escape(one.claim.text)}<br><span class='small'>{escape(one.claim.where)}</span>"
        f"</td><td>{escape(one.finding.told)}</td>"
        f"<td class='{_COLOURS[one.finding.verdict]}'>{escape(str(one.finding.verdict))}</td></tr>"
        for one in judged
    )
    return (
        f"<p>{len(judged)} claims, in short or quoted: {escape(summary)}. Every verdict is "
        "computed from the numbers of this run. Returns differ where their 95 % intervals do "
        "not overlap, other numbers are held against each other as they are; a claim of several "
        "parts is partly supported if some of them hold.</p>"
        "<div class='wide'><table><tr><th>claim</th><th>what our data say</th><th>verdict</th></tr>"
        f"{rows}</table></div>"
    )


def exact_values() -> list[dict[str, Any]]:
    """What is known exactly of every driver, over whole episodes."""
    found = []
    for driver in DRIVERS.values():
        best = oracle.solve_alerts(driver, horizon=HORIZON)
        found.append(
            {
                "driver": driver.name,
                "attention_return": best.total_return,
                "distraction_return": best.distraction_return,
                "alerts": best.alerts,
                "reachable_distraction_return": oracle.reachable(driver, horizon=HORIZON)._asdict(),
            }
        )
    return found


def exact_exhibits(results: Mapping[str, Mapping[str, Any]]) -> list[Exhibit]:
    """The optimum of the alert problem; the ceilings of hidden attention and of naming drivers."""
    rows = []
    for row in exact_values():
        reach = row["reachable_distraction_return"]
        numbers = [row["attention_return"], row["distraction_return"], row["alerts"]]
        told = [f"{value:.1f}" for value in numbers]
        rows.append([row["driver"], *told, f"{reach['least']:.0f} to {reach['most']:.0f}"])
    head = ["driver", "attention return", "distraction return", "alerts", "distraction reachable"]
    shown: list[Exhibit] = [
        Table(f"The optimum over {HORIZON} steps, attention seen", head, rows),
        Told(
            "Nothing that alerts can do better than the optimum. With attention seen it is the "
            "same rule for every driver here, to alert exactly when distracted."
        ),
    ]
    if "hidden" in results:
        hidden = [
            [
                row["driver"],
                f"{row['exact_own']:.1f}",
                *(f"{_mean(row, hmi):.1f}" for hmi in (BAYES_OWN, LEARNED_OWN)),
            ]
            for row in results["hidden"]["rows"]
        ]
        head = ["driver", "exact, whole episodes", "Bayes filter, played", "learned, played"]
        shown.append(Table("The Bayes filter, attention hidden: attention returns", head, hidden))
    if "traits" in results:
        seeds = next(iter(results["traits"]["supervisions"].values()))["seeds"]
        bayes = [
            [str(row["windows"])]
            + [f"{100 * row['ceilings'][kind]['mean']:.1f}" for kind in ("identity", "preference")]
            for row in seeds[0]["identified"]
            if row["ceilings"] is not None
        ]
        head = ["windows", "driver named [%]", "preference named [%]"]
        shown.append(Table("The Bayes classifier of held-out windows", head, bayes))
    return shown


def _mean(row: Mapping[str, Any], hmi: str) -> float:
    return float(row["attention_return"][hmi]["mean"])


def audit_exhibits(cells: Sequence[audit.AuditedCell]) -> list[Exhibit]:
    """Every distraction return that the paper prints beside what can be reached."""
    steps = f"{audit.HORIZONS[0]} to {audit.HORIZONS[-1]} steps"
    rows = [
        [
            f"{cell.hmi}, {cell.driver}",
            f"{cell.paper:.0f}",
            f"{cell.least:.0f} to {cell.most:.0f}",
            " to ".join(f"{value:.0f}" for value in cell.optimum),
            " to ".join(f"{value:.0f}" for value in cell.optimum_if_eta_1),
            "reachable" if cell.reachable else "OUT OF REACH of every alert policy",
        ]
        for cell in cells
    ]
    head = ["HMI, driver", "paper", "reachable", "optimum", "optimum, η = 1", "verdict"]
    out = [cell for cell in cells if not cell.reachable]
    like_1 = [cell for cell in out if _near(cell.paper, cell.optimum_if_eta_1)]
    return [
        Told(
            f"Distraction returns over {steps}, at N = {oracle.DEFAULT_WINDOW}. {len(out)} of "
            f"{len(cells)} are out of reach of every alert policy; {len(like_1)} of these are what "
            f"η = 1 would give, within {100 * NEAR:.0f} %."
        ),
        Table("The audit, cell by cell", head, rows),
    ]


def _near(paper: float, ends: tuple[float, float]) -> bool:
    low, high = ends
    return low - NEAR * abs(low) <= paper <= high + NEAR * abs(high)


def made_html(records: Sequence[Record], command: str) -> str:
    """The command and every setting."""
    settings = {record.stage.name: record.stage.settings() for record in records}
    told = escape(json.dumps(settings, indent=1))
    return (
        f"<p>By <code>{escape(command)}</code>. How long each part took stands in {TIMINGS} beside "
        f"this page, all numbers in {NUMBERS}.</p>"
        f"<details><summary>All settings</summary><pre class='small'>{told}</pre></details>"
    )
