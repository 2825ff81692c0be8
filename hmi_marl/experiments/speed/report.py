"""Report of a bench: a table, and figures of how the speed grows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial

from hmi_marl.experiments.speed.bench import (
    SCALING_TEAMS,
    WHOLE_STEP,
    WORLD,
    BenchConfig,
    Measured,
)
from hmi_marl.reporting.blocks import Block, Figure, Table
from hmi_marl.reporting.drawing import COLOURS, canvas, png
from hmi_marl.reporting.report import Report


def make_report(config: BenchConfig, rows: Sequence[Measured], command_line: str) -> Report:
    """Make the report of a bench."""
    columns: dict[str, Callable[[Measured], str]] = {
        "": lambda row: row.name,
        "teams": lambda row: f"{row.teams}",
        "threads": lambda row: f"{row.threads}",
        "vehicles": lambda row: row.vehicles,
        "steps/s": lambda row: f"{row.steps_per_s:,.0f}",
        "ratio": lambda row: f"{row.ratio:,.1f}",
        "of its world": lambda row: "" if row.of_world is None else f"{row.of_world:.2f}",
        "kB/team": lambda row: (
            "" if row.bytes_per_team is None else f"{row.bytes_per_team / 1000:.1f}"
        ),
    }
    numbers = {"rows": [asdict(row) for row in rows]}
    title = "Speed, and its ratio to highway-env's own step"
    table = Table.of(title, rows, columns, sources=["/rows"])
    blocks: list[Block] = [table, growth_figure(rows)]
    return Report("bench", "Speed of the worlds", blocks, numbers, command_line, asdict(config))


def growth_figure(rows: Sequence[Measured]) -> Figure:
    """Show how the speed grows, and the cost."""
    description = "speed by number of teams and threads; cost by number of vehicles"
    return Figure("bench", description, partial(_draw, rows), sources=["/rows"])


def _draw(rows: Sequence[Measured]) -> bytes:
    """Draw how the speed grows with teams and threads, and the cost with vehicles."""
    drawing = canvas(10.0, 3.8)
    by_teams, by_vehicles = drawing.subplots(1, 2)
    for colour, (name, threads) in enumerate(
        dict.fromkeys((r.name, r.threads) for r in rows if r.name in (WORLD, WHOLE_STEP))
    ):
        line = [row for row in rows if (row.name, row.threads) == (name, threads)]
        label = f"{name}, {threads} thread{'s' * (threads > 1)}"
        style = {"marker": "o", "color": COLOURS[colour % len(COLOURS)], "label": label}
        by_teams.plot([r.teams for r in line], [r.ratio for r in line], **style)
    by_teams.set(xscale="log", yscale="log", xlabel="teams", ylabel="ratio to highway-env")
    by_teams.set_title("speed by teams and threads")
    by_teams.legend(fontsize="small")
    for colour, name in enumerate((WORLD, WHOLE_STEP)):
        line = [row for row in rows if row.name == f"{name}, growth"]
        cost = [1e6 / row.steps_per_s for row in line]
        style = {"marker": "o", "color": COLOURS[colour], "label": name}
        by_vehicles.plot([int(r.vehicles) for r in line], cost, **style)
    threads = max(row.threads for row in rows)
    by_vehicles.set(xlabel="other vehicles", ylabel="µs per step of a team", ylim=(0, None))
    by_vehicles.set_title(f"cost by vehicles ({SCALING_TEAMS} teams, {threads} threads)")
    by_vehicles.legend(fontsize="small")
    for axes in (by_teams, by_vehicles):
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(alpha=0.3)
    return png(drawing)
