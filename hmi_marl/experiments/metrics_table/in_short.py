"""Summary of a table: what was learned, why rows are alike or differ, what to try next.

Every sentence is made from the table's cells. One that the cells do not support is left out.
"""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

from hmi_marl.envs.config import TeamSettings
from hmi_marl.envs.drivers import PAPER_DRIVERS
from hmi_marl.experiments.criteria import OPTIMAL_SHARE, SAME_GAIN
from hmi_marl.experiments.metrics_table.table import Cell, TableConfig
from hmi_marl.reporting.blocks import Text

LEARNED, ALIKE = "What was learned", "Why rows are alike"
DIFFER, NEXT = "How the rows differ", "What to try next"
_ROUNDING = 1e-6
"""Shortfall of a rule, in attention return, that is due to rounding."""
_MANY = 6
"""Number of drivers from which on a range is given instead of a number for each."""


def in_short(config: TableConfig, cells: Sequence[Cell]) -> list[Text]:
    """Summarise a table in at most three sentences."""
    rows = _rows(config, cells)
    said = [what_was_learned(config, rows), why_alike(config, rows), what_next(config, rows)]
    return [remark for remark in said if remark is not None]


@dataclass(frozen=True)
class Row:
    """One HMI with every driver."""

    name: str
    cells: tuple[Cell, ...]

    @property
    def learned(self) -> bool:
        """Whether it is a learned policy."""
        return any(cell.learned for cell in self.cells)

    @property
    def judged(self) -> bool:
        """Whether its alerts were judged with every driver."""
        return all(cell.share_following_rule is not None for cell in self.cells)

    @property
    def gains(self) -> dict[str, float]:
        """Share of what the best alerts gain, by driver, where there is something to gain."""
        return {c.driver: c.share_of_gain for c in self.cells if c.share_of_gain is not None}

    @property
    def following(self) -> dict[str, float]:
        """Share of steps in which it alerted exactly when distracted, by driver."""
        known = ((cell.driver, cell.share_following_rule) for cell in self.cells)
        return {driver: share for driver, share in known if share is not None}

    @property
    def mean_gain(self) -> float:
        """Mean share of gain over drivers; NaN where no driver leaves anything to gain."""
        gains = self.gains.values()
        return sum(gains) / len(gains) if gains else math.nan

    @property
    def missed(self) -> list[str]:
        """Drivers for whom it is not optimal."""
        # Where nothing can be gained, no needless alerts are asked for.
        return [cell.driver for cell in self.cells if _share(cell) < OPTIMAL_SHARE]

    @property
    def follows(self) -> bool:
        """Whether it alerts exactly when distracted, with every driver."""
        return all(share >= OPTIMAL_SHARE for share in self.following.values())


def what_was_learned(config: TableConfig, rows: Sequence[Row]) -> Text | None:
    """Say what the learned HMIs of the table do; None if there are none."""
    learned = [row for row in rows if row.learned and row.judged]
    if not learned:
        return None
    if len(learned) > 2:
        return Text(lead=LEARNED, text=_of_many(config, learned))
    say = _found_or_not if config.ai_sees_attention else _without_seeing
    return Text(lead=LEARNED, text="; ".join(say(config, row) for row in learned) + ".")


def _found_or_not(config: TableConfig, row: Row) -> str:
    rule, steps = _rule(config), _by_driver(row.following, "the steps")
    if row.missed:
        earned = _by_driver(row.gains, "what those gain over no alerts")
        return (
            f"{row.name} has not found the best possible alerts for {_listed(row.missed)}: it "
            f'{f"earns {earned}, and " if earned else ""}agrees with "{rule}" in {steps}'
        )
    earned = _by_driver(row.gains, "what the best possible alerts gain over none")
    if row.follows:
        return (
            f"{row.name} has learned to {_rule(config, 'the driver is ')}: it does so in {steps}"
            f"{f', and earns {earned}' if earned else ''}"
        )
    return (
        f"{row.name} has learned alerts as good as the best possible: they earn {earned}, though "
        f'they agree with "{rule}" in only {steps}'
    )


def _without_seeing(config: TableConfig, row: Row) -> str:
    earned = _by_driver(row.gains, "what the best alerts that see it gain over none")
    return (
        f"{row.name} has learned alerts without seeing the driver's attention: they "
        f"{f'earn {earned}, and ' if earned else ''}"
        f'agree with "{_rule(config)}" in {_by_driver(row.following, "the steps")}'
    )


def _of_many(config: TableConfig, rows: Sequence[Row]) -> str:
    found = [row.name for row in rows if not row.missed]
    others = ", ".join(f"{r.name} earns {_percent(r.mean_gain)}" for r in rows if r.missed)
    gain = f"{_best(config)} gain over none"
    parts = []
    if found:
        parts.append(f"{_listed(found)} earn at least {_percent(OPTIMAL_SHARE)} of what {gain}")
    if others:
        parts.append(f"{others} of {'it' if found else f'what {gain}'} on average over the drivers")
    return f"Of {len(rows)} learned HMIs {'; '.join(parts)}."


def why_alike(config: TableConfig, rows: Sequence[Row]) -> Text | None:
    """Say why rows are alike, or how they differ; None if there is nothing to compare."""
    rows = [row for row in rows if row.judged]
    if len(rows) < 2 or not any(row.gains for row in rows):
        return None
    best = [row for row in rows if not row.missed]
    if config.ai_sees_attention and len(best) >= 2:
        return Text(lead=ALIKE, text=_all_optimal(config, best, rows))
    least, most = (pick(rows, key=lambda row: row.mean_gain) for pick in (min, max))
    over = " on average over the drivers" if len(config.drivers) > 1 else ""
    gain = f"of what {_best(config)} gain over none{over}"
    if most.mean_gain - least.mean_gain < SAME_GAIN:
        return Text(lead=ALIKE, text=f"All rows earn about {_percent(most.mean_gain)} {gain}.")
    ends = (f"{_percent(row.mean_gain)} ({row.name})" for row in (least, most))
    return Text(lead=DIFFER, text=f"The rows earn from {' to '.join(ends)} {gain}.")


def _all_optimal(config: TableConfig, best: Sequence[Row], rows: Sequence[Row]) -> str:
    names, rule, drivers = _listed([row.name for row in best]), _rule(config), config.drivers
    short = {c.driver: c.rule_shortfall for c in best[0].cells if c.rule_shortfall > _ROUNDING}
    whom = f"all of {_listed(drivers)}" if len(drivers) > 1 else drivers[0]
    if short or not all(row.follows for row in best):
        shown = ", ".join(f"{driver} by {loss:.3g}" for driver, loss in short.items())
        but = f', which "{rule}" falls short of for {shown}' if short else ""
        return f"{names} come to the exact optimum for {whom}{but}."
    text = f'{names} do the same: "{rule}" is the exact optimum for {whom}'
    if any(row.learned for row in best):
        found = _listed([row.name for row in best if row.learned])
        text += f", and {found} found it"
    missed = [row.name for row in rows if row.learned and row.missed]
    if missed:
        text += f", which {_listed(missed)} did not find"
    if len(drivers) > 1:
        text += "; so knowing who drives gains nothing as long as their attention is seen"
    return text + "."


def what_next(config: TableConfig, rows: Sequence[Row]) -> Text:
    """Name one command that goes on from here."""
    driver = config.drivers[-1]
    learned = [row for row in rows if row.learned and row.judged]
    if not config.ai_sees_attention:
        return Text(
            lead=NEXT,
            text="Let HMIs find out who drives, and see how much of the worth of knowing it they "
            "earn: `hmi-marl adapt --quick`.",
        )
    if not learned:
        folder = f"runs/{driver.partition(':')[0].lower()}"
        train = ["train", "two-stage", "--hmi-for", driver, *team_flags(config), "--out", folder]
        return Text(
            lead=NEXT, text=f"Learn an HMI and name {folder} among the --hmis: {_command(*train)}."
        )
    missing = [row.name for row in learned if row.missed]
    if missing:
        longer = ["--driver-policy", config.driver_policy, "--hmi-steps", "2_000_000"]
        train = ["train", "two-stage", *longer, *_drivers(config), *team_flags(config)]
        return Text(
            lead=NEXT,
            text="Learn an HMI for longer and name runs/longer among the --hmis: "
            f"{_command(*train, '--out', 'runs/longer')}.",
        )
    seats = ["--hmi", learned[-1].name, "--policy", config.driver_policy]
    if not config.team(driver).alerts.plain:
        watch = ["watch", "--driver", driver, *seats, *team_flags(config), "--out", "clip.gif"]
        return Text(
            lead=NEXT, text=f"Watch it in another episode: {_command(*watch, '--seed', '1')}."
        )
    hmis = ["NoHMI", "belief:average", "belief"]
    where = ["--driver-policy", config.driver_policy, "--world", "batched", "--episodes", "256"]
    table = ["table", "--no-ai-sees-attention", "--hmis", *hmis, *where]
    table += [*_drivers(config), *team_flags(config), "--out", "runs/hidden"]
    return Text(
        lead=NEXT,
        text="Hide the driver's attention, and see for whom it is then worth knowing who drives "
        "(row belief) instead of assuming the average driver (row belief:average): "
        f"{_command(*table)}.",
    )


def team_flags(config: TeamSettings) -> list[str]:
    """Write the options that set a command's teams like these, where they are not the default."""
    flags: list[str] = []
    for field in fields(TeamSettings):
        value, name = getattr(config, field.name), field.name.replace("_", "-")
        if value == field.default:
            continue
        if isinstance(value, bool):
            flags.append(f"--{name}" if value else f"--no-{name}")
        else:
            several = value if isinstance(value, tuple) else (value,)
            flags += [f"--{name}", *(str(each) for each in several)]
    return flags


def _drivers(config: TableConfig) -> list[str]:
    return [] if config.drivers == PAPER_DRIVERS else ["--drivers", *config.drivers]


def _command(*words: str) -> str:
    return f"`{shlex.join(['hmi-marl', *words])}`"


def _rows(config: TableConfig, cells: Sequence[Cell]) -> list[Row]:
    return [Row(hmi, tuple(cell for cell in cells if cell.hmi == hmi)) for hmi in config.hmis]


def _share(cell: Cell) -> float:
    share = cell.share_of_gain if cell.share_of_gain is not None else cell.share_following_rule
    return 0.0 if share is None else share


def _rule(config: TableConfig, who: str = "") -> str:
    several = len(config.alert_strengths) > 1
    return f"{'give the strongest alert' if several else 'alert'} exactly when {who}distracted"


def _best(config: TableConfig) -> str:
    """Name the alerts that a share of gain is measured by."""
    if config.ai_sees_attention:
        return "the best possible alerts"
    return "the best alerts of an HMI that sees the driver's attention, hidden here,"


def _by_driver(shares: Mapping[str, float], whole: str) -> str:
    """Write a percentage of ``whole`` for each driver, or one if all are the same."""
    shown = {driver: _percent(share) for driver, share in shares.items()}
    if not shown:
        return ""
    if len(set(shown.values())) == 1:
        every = " with every driver" if len(shown) > 1 else ""
        return f"{next(iter(shown.values()))} of {whole}{every}"
    if len(shown) > _MANY:
        return f"{_percent(min(shares.values()))} to {_percent(max(shares.values()))} of {whole}"
    return ", ".join(f"{share} ({driver})" for driver, share in shown.items()) + f" of {whole}"


def _percent(share: float) -> str:
    """Write a share in percent, rounded down, so that 100 % means all."""
    text = f"{math.floor(share * 1000 + 1e-6) / 10:.1f}"
    return f"{text.removesuffix('.0')} %"


def _listed(names: Sequence[str]) -> str:
    *some, last = names
    return f"{', '.join(some)} and {last}" if some else last
