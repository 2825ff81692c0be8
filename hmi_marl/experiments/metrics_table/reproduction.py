r"""The paper's metrics table made again, with learned drivers and HMIs.

Six HMIs (trained for Lisa, Marge, Bart, Homer, for the average driver, and none) with each of the
four drivers, the cells that the paper leaves as ``*`` included. Twice: with the printed η, and
with η = 1 for all four, since the printed η = 0.01 puts the paper's own-HMI cells of Lisa and
Bart out of reach of every alert policy, while η = 1 gives about what it prints. AvgHMI is the same
in both, trained for the average driver with η = 0.505.

One driver policy drives in all cells, conditioned on the traits of who is at the wheel.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from hmi_marl.checks import check_count
from hmi_marl.envs.drivers import DRIVERS, PAPER_DRIVERS, Driver
from hmi_marl.experiments.metrics_table.table import Cell, TableConfig, make_table
from hmi_marl.training.protocols.two_stage import TwoStage
from hmi_marl.training.runs.jobs import Job

DRIVER_RUN, AVERAGE, NONE = "driver", "AvgHMI", "NoHMI"
EVALUATION_SEED = 10**9
TOLERANCE = 0.02
"""A learned cell agrees with the exact value within this share of it, or within its interval."""


def spec(driver: Driver) -> str:
    """A driver as the command line takes one."""
    return f"{driver.name}:{driver.beta:g},{driver.alpha:g},{driver.eta:g},{driver.inflation:g}"


@dataclass(frozen=True)
class Variant:
    """One of the two tables."""

    name: str
    title: str
    drivers: tuple[Driver, ...]
    """Columns, named as in the paper."""

    def hmi_run(self, driver: Driver) -> str:
        """Folder of the HMI trained for one of its drivers. Equal drivers share it."""
        return f"hmi-{driver.name}" + ("" if driver == DRIVERS[driver.name] else f"-{self.name}")


PRINTED = Variant("printed", "η as printed", tuple(DRIVERS[name] for name in PAPER_DRIVERS))
ETA_1 = Variant("eta-1", "η = 1", tuple(replace(driver, eta=1.0) for driver in PRINTED.drivers))
VARIANTS = (PRINTED, ETA_1)


def driver_job(
    drivers: tuple[str, ...], steps: int, num_teams: int, seed: int, folder: Path
) -> Job:
    """One driver policy over these drivers, which later trainings in ``folder`` take."""
    settings = TwoStage(
        drivers=drivers, driver_steps=steps, hmi_steps=0, num_teams=num_teams, seed=seed
    )
    return Job(settings, folder / DRIVER_RUN)


@dataclass(frozen=True)
class ReproductionSettings:
    """How large a reproduction is.

    Raises:
        ValueError: no steps or no episodes.
    """

    driver_steps: int = 12_000_000
    """Environment steps in which the driver learns."""
    hmi_steps: int = 1_500_000
    """Environment steps in which each HMI learns."""
    episodes: int = 2000
    """Episodes in each cell."""
    num_teams: int = 512
    """Teams that train side by side."""
    seed: int = 0
    """Of all training."""

    def __post_init__(self) -> None:
        for name in ("driver_steps", "hmi_steps", "episodes"):
            check_count(name, getattr(self, name))

    def driver_job(self, folder: Path) -> Job:
        """Stage 1: one driver policy over everybody who drives in either table."""
        drivers = {spec(driver) for variant in VARIANTS for driver in variant.drivers}
        everybody = (*sorted(drivers), spec(DRIVERS["average"]))
        return driver_job(everybody, self.driver_steps, self.num_teams, self.seed, folder)

    def hmi_jobs(self, folder: Path) -> list[Job]:
        """Stage 2: an HMI for each driver of the tables, and for the average one."""
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


@dataclass(frozen=True)
class ReproducedTable:
    """One variant's cells, by label of the HMI and name of the driver."""

    variant: Variant
    cells: dict[tuple[str, str], Cell]
    average: Cell | None = None
    """AvgHMI with the average driver, for whom it was trained; not in the paper's table."""

    @property
    def rows(self) -> tuple[str, ...]:
        """Labels of the HMIs."""
        return tuple(dict.fromkeys(hmi for hmi, _ in self.cells))

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the drivers."""
        return tuple(driver.name for driver in self.variant.drivers)

    def own(self, driver: str) -> Cell:
        """A driver with the HMI that was trained for them."""
        return self.cells[driver, driver]

    def with_own_hmi(self) -> dict[str, Cell]:
        """Every driver with the HMI that was trained for them, the average one included."""
        own = {driver: self.own(driver) for driver in self.columns}
        return own if self.average is None else own | {"average": self.average}

    def paper_row(self, hmi: str, driver: str) -> str | None:
        """The row of :mod:`hmi_marl.paper.printed` that this cell is in, if it is printed."""
        if hmi in (AVERAGE, NONE):
            return hmi
        return "own" if hmi == driver else None


def play_table(
    variant: Variant,
    settings: ReproductionSettings,
    folder: Path,
    workers: int,
    progress: Callable[[int], object],
) -> ReproducedTable:
    """Play every cell of a variant with the policies that were learned in ``folder``."""
    average = PRINTED.hmi_run(DRIVERS["average"])
    hmis = {driver.name: variant.hmi_run(driver) for driver in variant.drivers}
    paths = {label: str(folder / run) for label, run in (hmis | {AVERAGE: average}).items()}
    paths[NONE] = "never"
    config = TableConfig(
        drivers=tuple(spec(driver) for driver in variant.drivers),
        hmis=tuple(paths.values()),
        driver_policy=str(folder / DRIVER_RUN),
        episodes=settings.episodes,
        seed=EVALUATION_SEED,
        world="batched",
    )
    label_of = {path: label for label, path in paths.items()}
    cells = make_table(config, workers, progress)
    average_cell = None
    if variant == PRINTED:
        alone = replace(config, drivers=(spec(DRIVERS["average"]),), hmis=(paths[AVERAGE],))
        average_cell = make_table(alone, workers, progress)[0]
    return ReproducedTable(
        variant,
        {(label_of[cell.hmi], cell.driver.partition(":")[0]): cell for cell in cells},
        average_cell,
    )


def cells_in_all() -> int:
    """How many cells both variants have."""
    without = len((AVERAGE, NONE))
    return 1 + sum((len(v.drivers) + without) * len(v.drivers) for v in VARIANTS)


def agrees_with_exact(cell: Cell) -> bool:
    """Whether a cell's distraction return is the exact one, within 2 % or its interval."""
    exact = cell.exact_distraction_return_same_steps
    assert exact is not None
    return cell.distraction_return.agrees(exact, TOLERANCE)


def shortfall(cell: Cell) -> float:
    """How much of the exact optimum's attention return is missing, as a share of its size."""
    best = cell.optimal_attention_return_same_steps
    return (best - cell.attention_return.mean) / abs(best)
