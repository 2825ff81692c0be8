"""Map of when the driver matters: where the best alert rule depends on the traits, and its worth.

Nothing is played or learned: all returns are exact expectations of episodes that run their whole
time. What is averaged over a population is integrated by the midpoint rule.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import hmi_marl
from hmi_marl.checks import Share, Whole
from hmi_marl.envs.attention import WINDOW
from hmi_marl.envs.drivers import PAPER_DRIVERS
from hmi_marl.exact.driver_worth import Problem
from hmi_marl.exact.oracle import DEFAULT_HORIZON, DEFAULT_WINDOW
from hmi_marl.experiments.criteria import LEAST_WORTH, SAME_RULE
from hmi_marl.experiments.driver_map.cases import (
    AVERAGE,
    PAPER,
    WEIGHTS,
    WHEN_DISTRACTED,
    Case,
    CaseResult,
    Grid,
    Integral,
    Loss,
    solve_case,
)
from hmi_marl.experiments.driver_map.figures import MapFigures
from hmi_marl.experiments.experiment import MODELS, Experiment, Place
from hmi_marl.files import json_value, with_checksum, without_checksum, write_json
from hmi_marl.reading import read_json
from hmi_marl.reporting.blocks import Block, Figure, Table, Text
from hmi_marl.reporting.verdicts import Part, Verdict
from hmi_marl.typed_json import read_as

CASES = "cases"
"""Folder of the cases that are solved, below that of the experiment."""
_SOURCES = ("/cases",)
"""Place of the numbers in the JSON file."""
Cells = Annotated[int, Whole(1, 50)]
Points = Annotated[int, Whole(2, 201)]


@dataclass(frozen=True)
class DriverMap(Experiment[list[CaseResult]]):
    """Map exactly when the best alert rule depends on the driver, and what knowing them is worth.

    Raises:
        ValueError: a size out of its range, or nothing to map.
    """

    windows: tuple[Annotated[int, WINDOW], ...] = (1, 3, 7, 14, 28)
    """Alert windows N [steps]."""
    window: Annotated[int, WINDOW] = DEFAULT_WINDOW
    """Alert window where something else varies with attention hidden [steps]."""
    shares: tuple[Share, ...] = (0.0, 0.1, 0.2, 0.35, 0.5, 0.7, 1.0)
    """Shares of revealing steps, with attention hidden."""
    revealing: Share = 0.35
    """Share of revealing steps where something else varies; about that of the trained driver."""
    etas: tuple[Share, ...] = (0.01, 0.05, 0.1, 0.2, 0.505, 1.0)
    """η of the slices that are drawn."""
    horizon: Annotated[int, Whole(1, 1000, "steps")] = DEFAULT_HORIZON
    """Steps of an episode."""
    seen_cells: Cells = 9
    """Cells of β and of α in the coarse quadrature, attention seen, and of η less one; the fine one
    has three times as many of each."""
    hidden_cells: Cells = 5
    """The same, attention hidden."""
    points: Points = 21
    """Points of β and of α in a slice."""

    name = "map"
    title = "When the driver matters"
    paper = (
        "The paper's claim is that an HMI for the driver at the wheel does better than one for the "
        "average driver. Where that can be so is a question about numbers that are exact."
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("windows", "shares", "etas"):
            values = getattr(self, name)
            if not values or len(set(values)) < len(values):
                raise ValueError(f"{name} are one or more different numbers, not {values}")
        for window in (*self.windows, self.window):
            Problem(window, self.horizon)

    @classmethod
    def quick(cls) -> DriverMap:
        """Make a coarse version of a minute."""
        coarse = {"seen_cells": 3, "hidden_cells": 2, "points": 11}
        return cls(windows=(1, 7), shares=(0.0, 0.35, 1.0), **coarse)  # type: ignore[arg-type]

    @property
    def seen(self) -> list[Case]:
        """Cases with attention seen: every window with all weights."""
        return [Case(n, name, self.horizon) for name in WEIGHTS for n in self.windows]

    @property
    def hidden(self) -> list[Case]:
        """Cases with attention hidden: one thing varies at a time."""
        shares = [(self.window, PAPER, share) for share in self.shares]
        windows = [(n, PAPER, self.revealing) for n in self.windows]
        weights = [(self.window, name, self.revealing) for name in WEIGHTS]
        each = dict.fromkeys([*shares, *windows, *weights])
        return [Case(n, name, self.horizon, share) for n, name, share in each]

    def settings(self) -> dict[str, Any]:
        """JSON content of the settings and the weights."""
        return super().settings() | {"weights": json_value(WEIGHTS)}

    def run(self, place: Place) -> list[CaseResult]:
        """Solve the cases that are not solved yet."""
        cases = self.seen + self.hidden
        return [self._solve(case, place) for case in place.each(cases, "alert problems")]

    def _solve(self, case: Case, place: Place) -> CaseResult:
        cells = self.seen_cells if case.revealing is None else self.hidden_cells
        grid = Grid(cells, self.points, self.etas)
        path = place.folder / CASES / f"{case.name}.json"
        about = {"version": hmi_marl.__version__, "weights": json_value(WEIGHTS[case.weights])}
        with suppress(FileNotFoundError, ValueError):  # a damaged file is solved again
            kept_about, kept = read_result(path)
            if (kept_about, kept.case, kept.grid) == (about, case, grid):
                return kept
        result = solve_case(case, grid, place.workers)
        write_json(path, with_checksum({"about": about, "result": json_value(result)}))
        return result

    def numbers(self, results: list[CaseResult]) -> Mapping[str, Any]:
        """JSON content of everything but the slices, which are in the files of the cases."""
        return {"cases": [_summary(result) for result in results]}

    def judge(self, results: list[CaseResult]) -> Sequence[Verdict]:
        """Judge by the named drivers, and by all."""
        seen = _paper_weights(results, hidden=False)
        named = [max(r.losses[WHEN_DISTRACTED].named[d] for d in MODELS) for r in seen]
        most = max(seen, key=lambda r: r.losses[WHEN_DISTRACTED].other_rule.value)
        loss = most.losses[WHEN_DISTRACTED]
        rule = 'attention seen: "alert exactly when distracted" is optimal'
        lost = "largest loss per trip"
        verdicts = [
            Verdict(
                f"{rule} for the paper's drivers and the average one, whatever the window",
                (Part.exact(lost, max(named), below=SAME_RULE),),
            ),
            Verdict(
                f"{rule} for every driver",
                (Part.exact(lost, loss.most, below=SAME_RULE),),
                f"N = {most.case.window}: not for {_percent(loss.other_rule)} of a uniform "
                f"population",
            ),
        ]
        for result in self._at(results, self.window, self.revealing):
            worth = result.losses[AVERAGE].named
            verdicts.append(
                Verdict(
                    f"attention hidden, {100 * self.revealing:g} % revealing: knowing the driver "
                    f"is worth at least {LEAST_WORTH:g} a trip for each driver of the paper",
                    tuple(
                        Part.exact(d, worth[d], above=LEAST_WORTH, form=".1f")
                        for d in PAPER_DRIVERS
                    ),
                )
            )
        return verdicts

    @staticmethod
    def _at(results: list[CaseResult], window: int, share: float) -> list[CaseResult]:
        wanted = (window, PAPER, share)
        return [r for r in results if (r.case.window, r.case.weights, r.case.revealing) == wanted]

    def blocks(self, results: list[CaseResult]) -> Sequence[Block]:
        """Figures and tables."""
        figures = MapFigures(results, self.window, self.revealing)
        return [
            Text(
                f"Returns per trip, an episode of {self.horizon} steps that runs its whole time. "
                "Exact but for rounding; means and shares over drivers uniform in β, α and η by "
                "the midpoint rule, ± the difference from the rule with a third as many points of "
                "each trait."
            ),
            Figure("map-seen", SEEN_FIGURE, figures.seen, sources=_SOURCES),
            seen_table(results),
            Figure("map-hidden", HIDDEN_FIGURE, figures.hidden, sources=_SOURCES),
            hidden_table(results),
            Figure("map-curves", CURVES_FIGURE, figures.curves, sources=_SOURCES),
        ]


SEEN_FIGURE = (
    "loss of an alert exactly when distracted against the best rule for the driver, by β and α, "
    "for some η and reward weights, attention seen"
)
HIDDEN_FIGURE = (
    "what it is worth to know the driver, by β and α, for some η and shares of revealing steps, "
    "attention hidden"
)
CURVES_FIGURE = (
    "share of drivers for whom an alert exactly when distracted is not optimal, by window; worth "
    "of knowing the driver by the share of revealing steps, by window and by weights"
)


def read_result(path: Path) -> tuple[Any, CaseResult]:
    """Read what the result of a case depends on beyond its settings, and the result.

    Raises:
        FileNotFoundError: there is none.
        ValueError: the file is damaged.
    """
    content = without_checksum(read_json(path))
    return content.get("about"), read_as(CaseResult, content.get("result"))


def _paper_weights(results: list[CaseResult], hidden: bool) -> list[CaseResult]:
    return [
        r for r in results if r.case.weights == PAPER and (r.case.revealing is not None) == hidden
    ]


def _summary(result: CaseResult) -> dict[str, Any]:
    content = json_value(result)
    for loss in content["losses"].values():
        del loss["slices"]
    return dict(content)


def _percent(share: Integral) -> str:
    return f"{100 * share.value:.1f} ± {100 * share.error:.1f} %"


def _mean(mean: Integral) -> str:
    return f"{mean.value:.2f} ± {mean.error:.2f}"


def _most(loss: Loss) -> str:
    if loss.most <= SAME_RULE:
        return "0"
    digits = 0 if loss.most >= 10 else 1
    return f"{loss.most:.{digits}f} ({', '.join(f'{trait:.3g}' for trait in loss.most_at)})"


Column = Callable[[CaseResult], str]


def _losses(rule: str) -> dict[str, Column]:
    return {
        "another rule is best": lambda r: _percent(r.losses[rule].other_rule),
        f"worth {LEAST_WORTH:g} or more": lambda r: _percent(r.losses[rule].worth_it),
        "mean": lambda r: _mean(r.losses[rule].mean),
        "most (β, α, η)": lambda r: _most(r.losses[rule]),
    }


def seen_table(results: list[CaseResult]) -> Table:
    """Table of the cases with attention seen."""
    columns: dict[str, Column] = {
        "weights": lambda r: r.case.weights,
        "N": lambda r: str(r.case.window),
        **_losses(WHEN_DISTRACTED),
        "mean, rule for the average driver": lambda r: _mean(r.losses[AVERAGE].mean),
    }
    return Table.of(
        "Attention seen: what an alert exactly when distracted loses against the best rule for the "
        "driver",
        [r for r in results if r.case.revealing is None],
        columns,
        sources=_SOURCES,
    )


def hidden_table(results: list[CaseResult]) -> Table:
    """Table of the cases with attention hidden."""

    def named(driver: str) -> Column:
        return lambda r: f"{r.losses[AVERAGE].named[driver]:.1f}"

    columns: dict[str, Column] = {
        "weights": lambda r: r.case.weights,
        "N": lambda r: str(r.case.window),
        "revealing": lambda r: f"{100 * (r.case.revealing or 0.0):g} %",
        **_losses(AVERAGE),
        **{driver: named(driver) for driver in PAPER_DRIVERS},
    }
    return Table.of(
        "Attention hidden: what the filter that knows the driver earns more than the one for the "
        "average driver",
        [r for r in results if r.case.revealing is not None],
        columns,
        sources=_SOURCES,
    )
