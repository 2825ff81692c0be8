"""Experiment "table": the paper's metrics table made again, with everything learned anew.

One driver policy drives in all cells, conditioned on the traits of the driver at the wheel.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from hmi_marl.agents.learned.policy import find_policy
from hmi_marl.checks import Count, Steps
from hmi_marl.envs.config import DRIVER, VEHICLE_AI
from hmi_marl.envs.drivers import DRIVERS
from hmi_marl.envs.streams import Seed
from hmi_marl.experiments.criteria import EXACT_TOLERANCE
from hmi_marl.experiments.episodes import EVALUATION_SEED
from hmi_marl.experiments.experiment import DRIVER_RUN, Agent, Place, driver_job, spec
from hmi_marl.experiments.metrics_table.differences import (
    ALL,
    AVERAGE,
    NONE,
    PAIRS,
    Differences,
)
from hmi_marl.experiments.metrics_table.differences import METRICS as COMPARED
from hmi_marl.experiments.metrics_table.paper_table import (
    METRICS,
    PRINTED,
    VARIANTS,
    Average,
    PaperTable,
    Variant,
    averages,
    exact_part,
    numbers,
    optimum_part,
    paper_compared,
    paper_figure,
    shortfall,
)
from hmi_marl.experiments.metrics_table.table import (
    TableConfig,
    make_cell,
    make_table,
    play_table,
)
from hmi_marl.experiments.training_seeds import SeededExperiment
from hmi_marl.paper.audit import HORIZONS
from hmi_marl.reporting.blocks import Block, Figure, Table, Text
from hmi_marl.reporting.sources import pointer
from hmi_marl.reporting.statistics import Estimate, number
from hmi_marl.reporting.verdicts import Verdict
from hmi_marl.training.jobs import Job
from hmi_marl.training.protocols.two_stage import TwoStage

CAPTION = (
    "Each entry: mean with its 95 % interval, over training seeds and the episodes that they share "
    "(over episodes alone where there is one seed); the exact expectation for the "
    "alert rule that is optimal for the driver the HMI was trained for, and the range that any "
    "alert policy can reach, both over as many steps as the episodes had; the paper's figure, "
    "which is out of reach where no alert policy comes to it in "
    f"{HORIZONS[0]} to {HORIZONS[-1]} steps. All cells play the same episodes: differences between "
    "HMIs are paired by episode."
)


@dataclass(frozen=True)
class MetricsTable(SeededExperiment[list[PaperTable]]):
    """Learn every policy of the paper's table of HMIs and drivers, and make the table.

    Raises:
        ValueError: no steps or no episodes.
    """

    driver_steps: Steps = 12_000_000
    """Environment steps in which the driver learns."""
    hmi_steps: Steps = 1_500_000
    """Environment steps in which each HMI learns."""
    episodes: Count = 2000
    """Episodes in each cell."""
    num_teams: Count = 512
    """Teams that train side by side."""
    seed: Seed = 0
    """Seed of the first training, from which the others are mixed."""
    seeds: Count = 5
    """Trainings of driver and HMIs, one after the other."""

    name = "table"
    title = "HMIs and drivers"
    paper = (
        "The paper's table of metrics (Sec. VIII-C): speed and distraction returns of four drivers "
        "with the HMI trained for each, with one trained for the average driver, and with none. "
        "Below, each entry holds ours, the exact value, the range that any alert policy can reach, "
        "and the paper's figure; entries that the paper leaves as * are filled in. Twice: with η "
        "as printed and with η = 1 for all drivers."
    )

    @classmethod
    def quick(cls) -> MetricsTable:
        """Make a coarse version that takes minutes."""
        return cls(driver_steps=1_000_000, hmi_steps=300_000, episodes=400, seeds=1)

    def driver_job(self, folder: Path) -> Job:
        """Training of one driver policy over all drivers of both tables."""
        drivers = {spec(driver) for variant in VARIANTS for driver in variant.drivers}
        every = (*sorted(drivers), spec(DRIVERS["average"]))
        return driver_job(every, self.driver_steps, self.num_teams, self.seed, folder)

    def hmi_jobs(self, folder: Path) -> list[Job]:
        """Training of an HMI for each driver of the tables, and for the average one."""
        wanted = {
            variant.hmi_run(driver): driver for variant in VARIANTS for driver in variant.drivers
        }
        wanted[PRINTED.hmi_run(DRIVERS["average"])] = DRIVERS["average"]
        return [
            Job(
                TwoStage(
                    hmi_for=spec(driver),
                    driver_policy=str(folder / DRIVER_RUN),
                    hmi_steps=self.hmi_steps,
                    num_teams=self.num_teams,
                    seed=self.seed,
                ),
                folder / run,
            )
            for run, driver in wanted.items()
        ]

    def learn(self, each: Sequence[tuple[MetricsTable, Place]], place: Place) -> None:
        """Learn the drivers, and the HMIs that drive with them."""
        place.train([alone.driver_job(where.folder) for alone, where in each])
        place.train([job for alone, where in each for job in alone.hmi_jobs(where.folder)])

    def play(self, place: Place) -> list[PaperTable]:
        """Play every cell of both tables."""
        rows = [len(v.drivers) + len((AVERAGE, NONE)) for v in VARIANTS]
        cells = 1 + sum(n * len(v.drivers) for n, v in zip(rows, VARIANTS, strict=True))
        with place.playing(cells * self.episodes, "episodes") as progress:
            return [self._play(variant, place, progress) for variant in VARIANTS]

    def _play(
        self, variant: Variant, place: Place, progress: Callable[[int], object]
    ) -> PaperTable:
        """Play every cell of a variant with the policies that were learned."""
        average = PRINTED.hmi_run(DRIVERS["average"])
        hmis = {driver.name: variant.hmi_run(driver) for driver in variant.drivers}
        hmis[AVERAGE] = average
        paths = {label: str(place.folder / run) for label, run in hmis.items()} | {NONE: "never"}
        config = TableConfig(
            drivers=tuple(spec(driver) for driver in variant.drivers),
            hmis=tuple(paths.values()),
            driver_policy=str(place.folder / DRIVER_RUN),
            episodes=self.episodes,
            seed=EVALUATION_SEED,
            world="batched",
        )
        label_of = {path: label for label, path in paths.items()}
        played = play_table(config, place.workers, progress)
        labelled = {
            (label_of[hmi], driver.partition(":")[0]): (driver, hmi, episodes)
            for (driver, hmi), episodes in played.items()
        }
        average_cell = None
        if variant == PRINTED:
            alone = replace(config, drivers=(spec(DRIVERS["average"]),), hmis=(paths[AVERAGE],))
            average_cell = make_table(alone, place.workers, progress)[0]
        return PaperTable(
            variant,
            {place: make_cell(config, *cell) for place, cell in labelled.items()},
            average_cell,
            Differences.of(
                {place: episodes for place, (*_, episodes) in labelled.items()},
                [driver.name for driver in variant.drivers],
            ),
        )

    def numbers_of(self, results: list[PaperTable]) -> dict[str, Any]:
        """JSON content."""
        return numbers(results)

    def judge_of(self, results: list[PaperTable]) -> list[Verdict]:
        """Judge the distraction returns and the own HMIs by their exact values."""
        within = f"within {100 * EXACT_TOLERANCE:.0f} %"
        found = []
        for table in results:
            title, own = table.variant.title, table.with_own_hmi()
            cells = tuple(
                exact_part(*place, cell, self.seeds) for place, cell in table.cells.items()
            )
            optima = tuple(optimum_part(driver, cell, self.seeds) for driver, cell in own.items())
            found += [
                Verdict(f"distraction returns are the exact ones {within}, {title}", cells),
                Verdict(f"own HMIs reach the exact optimum {within}, {title}", optima),
            ]
        return found

    def blocks_of(self, results: list[PaperTable]) -> Sequence[Block]:
        """Figure, and tables of each variant."""
        shown: list[Block] = [
            Text(CAPTION),
            Figure(
                "table",
                "bars of both tables",
                partial(paper_figure, results),
                sources=["/tables"],
            ),
        ]
        for table in results:
            shown += [_metric_table(table, *metric) for metric in METRICS]
            shown += [_average_table(table), *_difference_tables(table)]
            shown.append(_optimum_table(table))
        return shown

    def agents(self, place: Place) -> list[Agent]:
        """Driver policy, and the HMIs."""
        driver = find_policy(place.folder / DRIVER_RUN, DRIVER)
        found = [Agent("driver", driver, "drives as any driver, given their traits")]
        for job in self.hmi_jobs(place.folder):
            card = find_policy(job.folder, VEHICLE_AI)
            what = f"alerts {job.settings.hmi_for}, attention seen"  # type: ignore[attr-defined]
            found.append(Agent(job.folder.name.removeprefix("hmi-"), card, what))
        return found


def _metric_table(
    table: PaperTable, metric: str, title: str, printed: Mapping[str, Mapping[str, float]]
) -> Table:
    drivers = {driver.name: driver for driver in table.variant.drivers}

    def entry(hmi: str, driver: str) -> str:
        cell, row = table.cells[hmi, driver], table.paper_row(hmi, driver)
        got: Estimate = getattr(cell, metric)
        lines = [got.shown(".0f")]
        if metric == "distraction_return" and cell.exact_distraction_return_same_steps is not None:
            lines.append(f"exact {cell.exact_distraction_return_same_steps:.0f}")
            reach = cell.reachable_distraction_return_same_steps
            lines.append(f"reachable {reach.least:.0f} to {reach.most:.0f}")
        if row is None:
            return "\n".join([*lines, "paper *"])
        value = printed[row][driver]
        compared = paper_compared(cell, drivers[driver], metric, value)
        return "\n".join([*lines, f"paper {value:.0f}: {compared}"])

    rows = [[hmi, *(entry(hmi, driver) for driver in table.columns)] for hmi in table.rows]
    head, source = ["HMI for", *table.columns], pointer("tables", table.variant.name)
    return Table(f"{title}, {table.variant.title}", head, rows, sources=[source])


def _average_table(table: PaperTable) -> Table:
    titles = {metric: title for metric, title, _ in METRICS}
    columns: dict[str, Callable[[Average], str]] = {
        "mean over the drivers": lambda average: f"{titles[average.metric]}, {average.hmi}",
        "ours": lambda average: average.ours.shown(".0f"),
        "exact": lambda average: number(average.exact, ".0f"),
        "paper": lambda average: f"{average.paper:.0f}",
        "compared": lambda average: average.compared,
    }
    title = f"Averages over the drivers, {table.variant.title}"
    source = pointer("averages", table.variant.name)
    return Table.of(title, averages(table), columns, sources=[source])


def _difference_tables(table: PaperTable) -> list[Table]:
    """Differences between HMIs, paired by episode, in every metric."""
    if table.differences is None:
        return []
    forms = {"steps": "+z.2f", "speed_return_per_step": "+z.4f"}
    found = []
    for metric in COMPARED:
        pairs = [f"{one} - {other}" for one, other in PAIRS]
        by_pair = {pair: table.differences.between_rows[pair][metric] for pair in pairs}
        rows = [
            [driver, *(by_pair[pair][driver].shown(forms.get(metric, "+z.1f")) for pair in pairs)]
            for driver in (*table.columns, ALL)
        ]
        title = f"{metric.replace('_', ' ').capitalize()}: differences per episode, paired"
        title += f", {table.variant.title}"
        between = pointer("differences", table.variant.name, "between_rows")
        sources = [between + pointer(pair, metric) for pair in pairs]
        found.append(Table(title, ["driver", *pairs], rows, sources=sources))
    return found


def _optimum_table(table: PaperTable) -> Table:
    rows = [
        [
            driver,
            cell.attention_return.shown(".1f"),
            f"{cell.optimal_attention_return_same_steps:.1f}",
            cell.attention_minus_optimum.shown("+z.1f"),
            f"{100 * shortfall(cell):+.2f} %",
        ]
        for driver, cell in table.with_own_hmi().items()
    ]
    head = ["driver", "attention return, own HMI", "exact optimum", "less optimum", "missing"]
    name = table.variant.name
    sources = [pointer("tables", name), pointer("attention_shortfall_of_own_hmis", name)]
    if table.average is not None:
        sources.append(pointer("average_driver_with_own_hmi", name))
    title = f"Own HMI and the exact optimum, {table.variant.title}"
    return Table(title, head, rows, sources=sources)
