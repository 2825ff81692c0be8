"""Report of a whole reproduction: claims with verdicts, all experiments, exact values, audit.

Nothing in it depends on durations or on interruptions: the same settings give the same bytes.
"""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import hmi_marl
from hmi_marl.envs.drivers import DRIVERS
from hmi_marl.envs.rewards import RewardWeights
from hmi_marl.exact import oracle
from hmi_marl.experiments.alert_problem import audit_table
from hmi_marl.experiments.criteria import ETA_1_TOLERANCE
from hmi_marl.experiments.hidden_attention import BAYES_OWN, LEARNED_OWN
from hmi_marl.files import json_value
from hmi_marl.paper.audit import AuditedCell, audit
from hmi_marl.paper.printed import AVERAGE_KL, DRIVER_TRAITS, REWARDS
from hmi_marl.reporting.blocks import Block, Heading, Table, Text, Verdicts
from hmi_marl.reporting.report import PAGE, Report
from hmi_marl.reproduction.claims import claims_json, judge
from hmi_marl.reproduction.suite import TIMINGS, Record

NAME = "reproduce"
NUMBERS = f"{NAME}.json"
LIBRARIES = ("numpy", "torch", "rsl-rl-lib", "highway-env", "pettingzoo")
HORIZON = 100
_INTRODUCTION = (
    "“Learning Latent Traits for Simulated Cooperative Driving Tasks” (DeCastro et al.), made "
    "again with everything learned anew, and compared to exact values. The paper's source comes "
    "without its pictures: ours are compared to what it prints, in numbers and in words."
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

__all__ = ["NUMBERS", "PAGE", "full_report"]


def full_report(records: Sequence[Record], command_line: str) -> Report:
    """Make the report of a reproduction, from its experiments' records."""
    results = {record.experiment.name: record.numbers for record in records}
    settings = {record.experiment.name: record.experiment.settings() for record in records}
    judged, audited, made = judge(results), audit(), made_with()
    verdicts = judged.claims
    blocks: list[Block] = [
        Text(_INTRODUCTION),
        Heading("The paper's claims", "claims"),
        Verdicts(verdicts, f"{len(verdicts)} claims", _ABOUT_CLAIMS),
        Heading("The paper's tables and figures", "items"),
        paper_items(results),
    ]
    for record in records:
        experiment = record.experiment
        blocks += [Heading(experiment.title, experiment.name), Text(experiment.paper)]
        own = judged.experiments[experiment.name]
        blocks += [
            replace(block, verdicts=own) if isinstance(block, Verdicts) else block
            for block in record.blocks
        ]
    blocks += [
        Heading("Exact optimum and ceilings", "exact"),
        *exact_blocks(results),
        Heading("What the paper's table cannot be", "audit"),
        *audit_blocks(audited),
        Heading("How it was made", "made"),
        Table("Versions", ["library", "version"], [[*each] for each in made.items()]),
        Text(f"Durations are in {TIMINGS} next to this page, all numbers in {NUMBERS}."),
    ]
    numbers = {
        "made with": made,
        "claims": claims_json(verdicts),
        "exact": exact_values(),
        "audit": json_value(audited),
        "stages": {
            name: {**numbers, "verdicts": [each.as_json() for each in own]} if own else numbers
            for (name, numbers), own in zip(
                results.items(), judged.experiments.values(), strict=True
            )
        },
    }
    return Report(NAME, "The paper, made again", blocks, numbers, command_line, settings)


def made_with() -> dict[str, str]:
    """Versions of the libraries that numbers depend on."""
    found = {"hmi-marl": hmi_marl.__version__, "Python": platform.python_version()}
    for name in LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "none"
    return found


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


def exact_blocks(results: Mapping[str, Mapping[str, Any]]) -> list[Block]:
    """Optimum of the alert problem; ceilings of hidden attention and of naming drivers."""
    rows = []
    for row in exact_values():
        reach = row["reachable_distraction_return"]
        numbers = [row["attention_return"], row["distraction_return"], row["alerts"]]
        shown = [f"{value:.1f}" for value in numbers]
        rows.append([row["driver"], *shown, f"{reach['least']:.0f} to {reach['most']:.0f}"])
    head = ["driver", "attention return", "distraction return", "alerts", "distraction reachable"]
    blocks: list[Block] = [
        Table(f"The optimum over {HORIZON} steps, attention seen", head, rows),
        Text(
            "No HMI can do better than the optimum. With attention seen it is the same rule for "
            "these five named drivers, to alert exactly when distracted. It is not for every "
            "driver: with low α, β and η other alerts are better."
        ),
    ]
    if "hidden" in results:
        returns = [
            [row["driver"]]
            + [f"{row[name]:.1f}" for name in ("exact_own", "exact_average", "exact_worth")]
            + [f"{row['attention_return'][hmi]['mean']:.1f}" for hmi in (BAYES_OWN, LEARNED_OWN)]
            for row in results["hidden"]["rows"]
        ]
        head = ["driver", "exact, own rule", "exact, average rule", "worth of knowing"]
        head += ["Bayes filter, played", "learned, played"]
        blocks.append(Table("The Bayes filter, attention hidden: attention returns", head, returns))
    if "traits" in results:
        seeds = next(iter(results["traits"]["supervisions"].values()))["seeds"]
        bayes = [
            [str(row["windows"])]
            + [f"{100 * row['ceilings'][kind]['mean']:.1f}" for kind in ("identity", "preference")]
            for row in seeds[0]["identified"]
            if row["ceilings"] is not None
        ]
        head = ["windows", "driver named [%]", "preference named [%]"]
        blocks.append(Table("The Bayes classifier of held-out windows", head, bayes))
    return blocks


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


HEAD = ("in the paper", "what it shows", "here")


def paper_items(results: Mapping[str, Mapping[str, Any]]) -> Table:
    """List them, with the numbers of the experiments that were run."""
    printed = ", ".join(f"{value:.0f}" for value in AVERAGE_KL.values())
    rows = [
        (
            "Figure 1, schematic of the approach",
            "drivers, embedded by how they drive; no data",
            "no data to make again",
        ),
        (
            "Figure 2, the learning scheme",
            "discriminator, generator and pooling; no data",
            "what the stage of latent traits learns by",
        ),
        (
            "Table of discriminator losses",
            "L1 to L4 and their weights 5, 10 and 1e-4",
            "the losses of the stage of latent traits, with the same weights",
        ),
        (
            "Figure 3, model of distracted driving",
            "the chain of distraction and acceptance; no data",
            "the chain that every number here comes from, and its exact optimum",
        ),
        ("Table of rewards", "eight terms and their coefficients", _rewards()),
        ("Table of driver parameters", "β, α, η and inflation of four drivers", _drivers()),
        (
            "Figure 4, latent embeddings",
            f"three scatter plots; average KL {printed} nats",
            _kl(results),
        ),
        (
            "Table of metrics",
            "speed and distraction returns of four drivers, six HMIs",
            "section on HMIs and drivers, cell by cell" if "table" in results else "not run",
        ),
    ]
    return Table("Item by item", HEAD, rows)


def _rewards() -> str:
    odd = [name for name, value in REWARDS.items() if getattr(RewardWeights(), name) != value]
    return f"others for {', '.join(odd)}" if odd else "all eight, with the same coefficients"


def _drivers() -> str:
    odd = [name for name, traits in DRIVER_TRAITS.items() if DRIVERS[name].traits != traits]
    return f"others for {', '.join(odd)}" if odd else "the same four"


def _kl(results: Mapping[str, Mapping[str, Any]]) -> str:
    if "traits" not in results:
        return "not run"
    settings = results["traits"]["supervisions"]
    found = ", ".join(f"{settings[name]['average_kl']['mean']:.4g}" for name in AVERAGE_KL)
    return f"section on latent traits; average KL {found} nats"
