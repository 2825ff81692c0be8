"""Judge trait models, and show them in tables and figures.

Settings come in the paper's order: unsupervised, supervised by driver, by preference; after them
comes the self-supervised one. Each may have been learned several times, from different seeds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from hmi_marl.experiments import criteria
from hmi_marl.experiments.experiment import Experiment
from hmi_marl.experiments.latent_traits.assessment import WINDOWS, Assessment, Identified
from hmi_marl.experiments.latent_traits.ceiling import Ceilings
from hmi_marl.experiments.latent_traits.figures import TITLES, draw_accuracy, embeddings_figure
from hmi_marl.experiments.latent_traits.imitation import ActionLikelihood, Driving, DrivingRow
from hmi_marl.experiments.latent_traits.posterior import PosteriorRow
from hmi_marl.experiments.latent_traits.reward import RewardRanking
from hmi_marl.experiments.latent_traits.strangers import Naming
from hmi_marl.experiments.latent_traits.trait_figures import reading_figure
from hmi_marl.files import json_value
from hmi_marl.paper.printed import AVERAGE_KL
from hmi_marl.reporting import statistics
from hmi_marl.reporting.blocks import Block, Figure, Table, Text
from hmi_marl.reporting.drawing import png
from hmi_marl.reporting.statistics import Estimate, number
from hmi_marl.reporting.verdicts import SEEDS, Part, Verdict

T = TypeVar("T")
PROBES = ("linear", "smooth", "network")
"""What reads traits from z; see :class:`TraitR2`."""


@dataclass(frozen=True)
class TraitResults:
    """Assessments of trait models."""

    assessments: Mapping[str, Sequence[Assessment]]
    """By supervision, one for each seed."""
    pool: int
    """Windows that the models pool."""
    one_step: Ceilings | None = None
    """Accuracies of the exact classifier that sees a single observation; None if not known."""
    posterior: PosteriorRow | None = None
    """The exact posterior of judged strangers from as many windows; None if it was not computed."""

    @property
    def first(self) -> Mapping[str, Assessment]:
        """Assessment of the first seed of each setting."""
        return {name: several[0] for name, several in self.assessments.items()}

    @property
    def identified(self) -> list[Identified]:
        """Accuracies of the first model, by windows seen."""
        return next(iter(self.first.values())).identified

    def accuracy(self, setting: str, size: int, of: str = "types") -> Estimate:
        """Average the probe's accuracy on "types" or "preferences"; 1 seed: interval over pools."""
        probes = [getattr(o.at_pool(size), of).linear_probe for o in self.assessments[setting]]
        if len(probes) == 1:
            return probes[0]
        found = statistics.mean([probe.mean for probe in probes])
        return replace(found, low=max(found.low, 0.0), high=min(found.high, 1.0))

    def by_seed(self, setting: str, size: int, of: str = "types") -> Estimate:
        """Average the same over training seeds; without an interval for a single one."""
        return statistics.mean_share(
            [getattr(one.at_pool(size), of).linear_probe for one in self.assessments[setting]]
        )

    def kl_ratio(self, setting: str, other: str, size: int) -> Estimate:
        """Ratio of the average KL of two settings, paired by seed, geometric mean."""
        kl = [
            [max(one.at_pool(size).types.average_kl, criteria.SMALLEST_KL) for one in several]
            for several in (self.assessments[setting], self.assessments[other])
        ]
        seeds = min(map(len, kl))
        return statistics.geometric_ratio(kl[0][:seeds], kl[1][:seeds])

    def average_kl(self, setting: str, size: int) -> Estimate:
        """Average the KL between driver types over seeds."""
        return statistics.mean(
            [o.at_pool(size).types.average_kl for o in self.assessments[setting]]
        )

    def trait_r2(self, setting: str, trait: str, probe: str) -> Estimate | None:
        """Average R² of a probe over seeds; 1 seed: interval over strangers; None if not judged."""
        found = self._r2(setting, trait, probe)
        if len(found) < 2:
            return found[0] if found else None
        return statistics.mean([each.mean for each in found])

    def trait_r2_by_seed(self, setting: str, trait: str, probe: str) -> Estimate:
        """Average the same over training seeds; without an interval for a single one."""
        return statistics.mean_of_same(self._r2(setting, trait, probe))

    def _r2(self, setting: str, trait: str, probe: str) -> list[Estimate]:
        readings = [one.reading for one in self.assessments[setting] if one.reading is not None]
        return [getattr(reading.r2[trait], probe) for reading in readings]

    def named(self, setting: str, place: int) -> Estimate:
        """Average the share of types named from one labelled pool over seeds, by rows of naming."""
        found = [one.naming[place].named for one in self.assessments[setting]]
        return found[0] if len(found) == 1 else statistics.mean([each.mean for each in found])


class TraitReport(Experiment[TraitResults]):
    """Report of judged trait models."""

    name = "traits"
    files = "traits-report"
    title = "Latent traits"

    def judge(self, results: TraitResults) -> list[Verdict]:
        """Judge the means of the settings that were learned, with pools of the models' size."""
        size, found = results.pool, results.assessments
        first = next(iter(results.first.values())).at_pool(size)
        seeds = {name: len(several) for name, several in found.items()}
        verdicts = []

        def accuracy(claim: str, name: str, least: float, of: str = "types") -> None:
            share = results.by_seed(name, size, of)
            what = f"{TITLES[name]}, accuracy"
            part = Part.mean(what, share, SEEDS, above=least, seeds=seeds[name], form="z.1%")
            verdicts.append(Verdict(claim, (part,)))

        if "id" in found and first.ceilings is not None:
            margin = criteria.IDENTITY_MARGIN
            claim = f"by driver: accuracy within {100 * margin:.0f} points of the ceiling"
            accuracy(claim, "id", first.ceilings.identity.mean - margin)
        if "preference" in found and first.preferences and first.ceilings:
            margin = criteria.PREFERENCE_MARGIN
            claim = f"by preference: of preferences within {100 * margin:.0f} points of the ceiling"
            least = first.ceilings.preference.mean - margin
            accuracy(claim, "preference", least, "preferences")
        if "none" in found:
            claim = f"unsupervised: {100 * criteria.ABOVE_CHANCE:.0f} points above chance"
            accuracy(claim, "none", first.types.chance + criteria.ABOVE_CHANCE)
            least = criteria.KL_FACTOR
            for name in (name for name in ("id", "preference") if name in found):
                both = min(seeds[name], seeds["none"])
                ratio = results.kl_ratio(name, "none", size)
                part = Part.ratio("KL ratio", ratio, SEEDS, above=least, seeds=both, form=".2f")
                claim = f"{TITLES[name]}: KL {least:.0f} times the unsupervised one"
                verdicts.append(Verdict(claim, (part,)))
        if "self" in found:
            verdicts += judge_self(results)
        return verdicts

    def numbers(self, results: TraitResults) -> dict[str, Any]:
        """JSON content."""
        return {
            "pool": results.pool,
            "one_step": json_value(results.one_step),
            "posterior": json_value(results.posterior),
            "supervisions": {
                name: {
                    "accuracy": results.accuracy(name, results.pool).as_json(),
                    "average_kl": results.average_kl(name, results.pool).as_json(),
                    "paper_kl": AVERAGE_KL.get(name),
                    "seeds": [one.as_json() for one in several],
                }
                for name, several in results.assessments.items()
            },
        }

    def blocks(self, results: TraitResults) -> list[Block]:
        """Show the figures and all tables."""
        seeds = max(len(several) for several in results.assessments.values())
        note = (
            f"On held-out windows; pools of {results.pool}; {seeds} seed(s). Bayes is the exact "
            "classifier of the same windows, which no encoder can beat. Accuracies and KL are "
            "means over seeds, the rest is of the first."
        )
        tables = (
            identity_table(results),
            trait_table(results),
            naming_table(results),
            likelihood_table(results),
            driving_table(results),
            ranking_table(results),
        )
        return [
            Text(" ".join([note, *left_out(results)])),
            embeddings_figure({name: one.embedding for name, one in results.first.items()}),
            accuracy_figure(results),
            *(
                reading_figure(name, one.reading)
                for name, one in results.first.items()
                if name == "self" and one.reading is not None
            ),
            *(table for table in tables if table.rows),
        ]


def judge_self(results: TraitResults) -> list[Verdict]:
    """Judge the self-supervised setting by strangers, and by types that it has never seen."""
    seeds, verdicts = len(results.assessments["self"]), []
    for probe, title, bars in (
        ("linear", "a linear probe", criteria.LINEAR_R2),
        ("network", "a small network", criteria.NETWORK_R2),
    ):
        found = {trait: results.trait_r2_by_seed("self", trait, probe) for trait in bars}
        if any(each.count == 0 for each in found.values()):
            continue
        asked = ", ".join(f"{trait} {bar:.2f}" for trait, bar in bars.items())
        parts = [
            Part.mean(f"R² of {trait}", found[trait], SEEDS, above=bar, seeds=seeds, form="z.3f")
            for trait, bar in bars.items()
        ]
        claim = f"self-supervised: R² of strangers by {title} at least {asked}"
        verdicts.append(Verdict(claim, tuple(parts)))
    for place, row in enumerate(results.first["self"].naming):
        bar = criteria.NAMED_WINDOWS if row.windows == 1 else criteria.NAMED_POOLS
        shares = [one.naming[place].named for one in results.assessments["self"]]
        what = "window" if row.windows == 1 else f"pool of {row.windows}"
        claim = f"self-supervised: {100 * bar:.0f} % of types named from one {what}"
        share = statistics.mean_share(shares)
        part = Part.mean("named", share, SEEDS, above=bar, seeds=seeds, form="z.1%")
        verdicts.append(Verdict(claim, (part,)))
    return verdicts


def left_out(results: TraitResults) -> list[str]:
    """List what could not be judged, in a sentence each."""
    rows, first = results.identified, next(iter(results.first.values()))
    seen = [row.windows for row in rows]
    sizes = ", ".join(str(size) for size in WINDOWS if size not in seen)
    return [
        sentence
        for sentence, holds in (
            (f"Too few windows were held out to identify drivers from pools of {sizes}.", sizes),
            ("There is no exact ceiling.", rows[0].ceilings is None),
            ("Recorded drives cannot be replayed, to compare driving.", not first.driving),
        )
        if holds
    ]


def accuracy_figure(results: TraitResults) -> Figure:
    """Draw accuracy by windows seen, with the ceiling and chance."""
    rows = results.identified
    windows = [row.windows for row in rows]
    curves = {
        TITLES[name]: [results.accuracy(name, size) for size in windows]
        for name in results.assessments
    }
    exact = [row.ceilings.identity.mean for row in rows if row.ceilings is not None]
    chance = rows[0].types.chance

    def draw() -> bytes:
        return png(draw_accuracy(windows, curves, exact or None, chance))

    return Figure("accuracy", "accuracy by windows seen", draw)


def identity_table(results: TraitResults) -> Table:
    """Show accuracies by windows seen; all but accuracies and KL are of the first seed."""
    head = ["setting", "windows", "probe [%]", "Bayes [%]", "centroid [%]", "preference [%]"]
    head += ["Bayes [%]", "silhouette", "Rand", "KL", "paper"]
    rows = []
    for name, one in results.first.items():
        for row in one.identified:
            size, preferences, exact = row.windows, row.preferences, row.ceilings
            rows.append(
                [
                    TITLES[name],
                    str(size),
                    results.accuracy(name, size).percent(),
                    "-" if exact is None else exact.identity.percent(),
                    f"{100 * row.types.nearest_centroid.mean:.1f}",
                    results.accuracy(name, size, "preferences").percent() if preferences else "-",
                    exact.preference.percent() if preferences and exact else "-",
                    f"{row.types.silhouette:.2f}",
                    f"{row.types.adjusted_rand:.2f}",
                    f"{results.average_kl(name, size).mean:.4g}",
                    f"{AVERAGE_KL[name]:.0f}"
                    if size == results.pool and name in AVERAGE_KL
                    else "",
                ]
            )
    return Table("Drivers identified, by number of windows", head, rows)


def _table(
    results: TraitResults,
    title: str,
    items: Callable[[Assessment], Iterable[T]],
    columns: Mapping[str, Callable[[T], str]],
) -> Table:
    """Show items of the first seed of each setting, a row each."""
    listed = [(TITLES[name], item) for name, one in results.first.items() for item in items(one)]
    rows = [[setting, *(shown(item) for shown in columns.values())] for setting, item in listed]
    return Table(title, ["setting", *columns], rows)


def trait_table(results: TraitResults) -> Table:
    """Show R² of each trait of strangers, beside that of the exact posterior's mean."""
    rows = []
    for name, one in results.first.items():
        for trait in one.reading.r2 if one.reading is not None else ():
            found = [results.trait_r2(name, trait, probe) for probe in PROBES]
            shown = [each.shown("z.2f") for each in found if each is not None]
            exact = None if results.posterior is None else results.posterior.traits[trait].r2
            network = found[-1]
            ratio = (
                "-"
                if exact is None or network is None
                else number(network.mean / exact.mean, ".2f")
            )
            exact_shown = "-" if exact is None else exact.shown("z.2f")
            rows.append([TITLES[name], trait, *shown, exact_shown, ratio])
    head = [
        "setting",
        "trait",
        "R², linear",
        "R², smooth",
        "R², network",
        "exact",
        "network / exact",
    ]
    readings = [one.reading for one in results.first.values() if one.reading is not None]
    about = f"{readings[0].drivers} strangers in pools of {results.pool}" if readings else ""
    if results.posterior is not None:
        about += f"; exact: the posterior's mean, for {results.posterior.drivers} of them"
    return Table("Traits of strangers, read from z", head, rows, about)


def naming_table(results: TraitResults) -> Table:
    """Show how often types are named from one labelled pool each."""
    columns: dict[str, Callable[[Naming], str]] = {
        "windows": lambda row: str(row.windows),
        "named right [%]": lambda row: row.named.percent(),
        "by chance [%]": lambda row: f"{100 * row.chance:.0f}",
    }
    title = "Types named from one labelled pool of each"
    return _table(results, title, lambda one: one.naming, columns)


def likelihood_table(results: TraitResults) -> Table:
    """Show the log-likelihood of held-out actions."""

    def shown(estimate: Estimate | None) -> str:
        return "-" if estimate is None else estimate.shown("z.3f")

    columns: dict[str, Callable[[ActionLikelihood], str]] = {
        "driver": lambda row: row.driver,
        "own z": lambda row: shown(row.own),
        "another's z": lambda row: shown(row.other),
        "own - another's": lambda row: shown(row.own_minus_other),
        "exact": lambda row: shown(row.exact),
        "exact - own": lambda row: shown(row.exact_minus_own),
    }
    title = "Log-likelihood of held-out actions per step [nats]"
    return _table(results, title, lambda one: one.likelihood, columns)


def driving_table(results: TraitResults) -> Table:
    """Show how the policy and the drivers drive."""

    def both(row: DrivingRow, of: Callable[[Driving], Estimate]) -> str:
        return " / ".join(number(of(each).mean, ".3g") for each in (row.imitated, row.demonstrated))

    columns: dict[str, Callable[[DrivingRow], str]] = {
        "driver": lambda row: row.driver,
        "speed [m/s]": lambda row: both(row, lambda one: one.speed),
        "headway [s]": lambda row: both(row, lambda one: one.headway),
        "lane changes/min": lambda row: both(row, lambda one: one.lane_changes),
        "repeated": lambda row: both(row, lambda one: one.repeated),
        "more with alerts": lambda row: both(row, lambda one: one.alert_effect),
        "crashed": lambda row: both(row, lambda one: one.crash_rate),
    }
    title = "The learned policy / the demonstrations"
    return _table(results, title, lambda one: one.driving, columns)


def ranking_table(results: TraitResults) -> Table:
    """Show rank correlations of recovered and true return."""
    columns: dict[str, Callable[[RewardRanking], str]] = {
        "driver": lambda row: row.driver,
        "f, demonstrated": lambda row: row.demonstrated.f.shown("z.2f"),
        "g, demonstrated": lambda row: row.demonstrated.g.shown("z.2f"),
        "f, mixture": lambda row: row.mixture.f.shown("z.2f"),
        "g, mixture": lambda row: row.mixture.g.shown("z.2f"),
    }
    title = "Rank correlation of recovered and true driving return"
    return _table(results, title, lambda one: one.reward_ranking, columns)
