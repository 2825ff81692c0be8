"""Page of the report on exact values: optimum, ceilings, and the audit of the paper's table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from hmi_marl.envs.drivers import DRIVERS
from hmi_marl.exact import oracle
from hmi_marl.experiments.alert_problem import audit_table
from hmi_marl.experiments.criteria import ETA_1_TOLERANCE
from hmi_marl.experiments.hidden_attention import (
    BAYES_AVERAGE,
    BAYES_OWN,
    EXACT_NOTE,
    LEARNED_OWN,
)
from hmi_marl.paper.audit import AuditedCell
from hmi_marl.reporting.blocks import Block, Table, Text
from hmi_marl.reporting.sources import pointer
from hmi_marl.reporting.statistics import Estimate

HORIZON = 100
EXACT = "/exact"
"""Places of the exact values and of the audit in the report's JSON file."""


def exact_values() -> list[dict[str, Any]]:
    """Exact values of every driver, over whole episodes."""
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


def exact_blocks(
    values: Sequence[Mapping[str, Any]], results: Mapping[str, Mapping[str, Any]]
) -> list[Block]:
    """Optimum of the alert problem; ceilings of hidden attention and of naming drivers.

    Args:
        values: see :func:`exact_values`.
        results: numbers of the experiments.
    """
    rows = []
    for row in values:
        reach = row["reachable_distraction_return"]
        numbers = [row["attention_return"], row["distraction_return"], row["alerts"]]
        shown = [f"{value:.1f}" for value in numbers]
        rows.append([row["driver"], *shown, f"{reach['least']:.0f} to {reach['most']:.0f}"])
    head = ["driver", "attention return", "distraction return", "alerts", "distraction reachable"]
    blocks: list[Block] = [
        Table(f"The optimum over {HORIZON} steps, attention seen", head, rows, sources=[EXACT]),
        Text(
            "No HMI can do better than the optimum. With attention seen it is the same rule for "
            "these five named drivers, to alert exactly when distracted. It is not for every "
            "driver: with low α, β and η other alerts are better."
        ),
    ]
    if "hidden" in results:
        blocks.append(_hidden_table(results["hidden"]["rows"]))
    if "traits" in results:
        first, setting = next(iter(results["traits"]["supervisions"].items()))
        seeds = setting["seeds"]
        bayes = [
            [str(row["windows"])]
            + [f"{100 * row['ceilings'][kind]['mean']:.1f}" for kind in ("identity", "preference")]
            for row in seeds[0]["identified"]
            if row["ceilings"] is not None
        ]
        head = ["windows", "driver named [%]", "preference named [%]"]
        source = pointer("stages", "traits", "supervisions", first, "seeds", 0, "identified")
        title = "The Bayes classifier of held-out windows"
        blocks.append(Table(title, head, bayes, sources=[source]))
    return blocks


def _hidden_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Show exact values and what was played over as many steps, attention hidden."""
    shown = []
    for row in rows:
        entries = [row["driver"]]
        for hmi in (BAYES_OWN, BAYES_AVERAGE, LEARNED_OWN):
            exact = f"exact {row['exact_same_steps'][hmi]:.1f}"
            entries.append(f"{row['attention_return'][hmi]['mean']:.1f}\n{exact}")
        played = Estimate.from_json(row["bayes_own_minus_average"]).shown("z.1f")
        entries.append(f"{played}\nexact {row['exact_worth_same_steps']:z.1f}")
        entries += [f"{row[name]:z.1f}" for name in ("exact_own", "exact_average", "exact_worth")]
        shown.append(entries)
    head = ["driver", "Bayes filter, own", "Bayes filter, AvgHMI", "learned, own"]
    head += ["worth of knowing", *(f"{name}, whole trips" for name in ("own", "AvgHMI", "worth"))]
    title = "The Bayes filter, attention hidden: attention returns, played and exact"
    return Table(title, head, shown, EXACT_NOTE, sources=[pointer("stages", "hidden", "rows")])


def audit_blocks(cells: Sequence[AuditedCell]) -> list[Block]:
    """Distraction returns that the paper prints, and what can be reached."""
    out = [cell for cell in cells if not cell.reachable]
    like_1 = [cell for cell in out if _near(cell.paper, cell.optimum_if_eta_1)]
    text = (
        f"{len(out)} of {len(cells)} are out of reach of every alert policy; {len(like_1)} of "
        f"these are what η = 1 would give, within {100 * ETA_1_TOLERANCE:.0f} %."
    )
    return [Text(text), audit_table(cells, oracle.DEFAULT_WINDOW)]


def _near(paper: float, ends: tuple[float, float]) -> bool:
    low, high = ends
    return low - ETA_1_TOLERANCE * abs(low) <= paper <= high + ETA_1_TOLERANCE * abs(high)
