"""Tables of trait models, and the figure of accuracies."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from hmi_marl.experiments.latent_traits.figures import TITLES, draw_accuracy
from hmi_marl.experiments.latent_traits.imitation import ActionLikelihood, Driving, DrivingRow
from hmi_marl.experiments.latent_traits.prediction import ActionPrediction
from hmi_marl.experiments.latent_traits.results import PROBES, TraitResults, sources_of
from hmi_marl.experiments.latent_traits.reward import RewardRanking
from hmi_marl.experiments.latent_traits.strangers import Naming
from hmi_marl.paper.printed import AVERAGE_KL
from hmi_marl.reporting.blocks import Figure, Table
from hmi_marl.reporting.drawing import png
from hmi_marl.reporting.sources import pointer
from hmi_marl.reporting.statistics import Estimate, number


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

    sources = sources_of(results, "by_windows")
    return Figure("accuracy", "accuracy by windows seen", draw, sources=sources)


def tables_of(results: TraitResults) -> list[Table]:
    """Make the tables of a report; those without rows are left out."""
    tables = (
        identity_table(results),
        trait_table(results),
        naming_table(results),
        prediction_table(results),
        likelihood_table(results),
        driving_table(results),
        ranking_table(results),
    )
    return [table for table in tables if table.rows]


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
    sources = [*sources_of(results, "by_windows"), *sources_of(results, "seeds", 0, "identified")]
    sources += [
        pointer("supervisions", name, "paper_kl") for name in results.first if name in AVERAGE_KL
    ]
    return Table("Drivers identified, by number of windows", head, rows, sources=sources)


def _table(
    results: TraitResults,
    title: str,
    name: str,
    columns: Mapping[str, Callable[[Any], str]],
) -> Table:
    """Show a field of the assessments, averaged over seeds, a row for each of its items."""
    rows = []
    for setting in results.assessments:
        items = results.averaged(setting, name)
        for item in items if isinstance(items, list) else [items] if items is not None else []:
            rows.append([TITLES[setting], *(shown(item) for shown in columns.values())])
    return Table(title, ["setting", *columns], rows, sources=sources_of(results, name))


def trait_table(results: TraitResults) -> Table:
    """Show R² of each trait of strangers, beside that of the exact posterior's mean."""
    rows = []
    for name, one in results.first.items():
        for trait in one.reading.r2 if one.reading is not None else ():
            found = [results.trait_r2(name, trait, probe) for probe in PROBES]
            shown = [each.shown("z.2f") for each in found if each is not None]
            exact = None if results.posterior is None else results.posterior.traits[trait].r2
            ratio = number(results.share_of_exact(name, trait), ".2f")
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
    sources = sources_of(results, "r2")
    if results.posterior is not None:
        sources.append(pointer("posterior", "traits"))
    return Table("Traits of strangers, read from z", head, rows, about, sources)


def naming_table(results: TraitResults) -> Table:
    """Show how often types are named from one labelled pool each."""
    columns: dict[str, Callable[[Naming], str]] = {
        "windows": lambda row: str(row.windows),
        "named right [%]": lambda row: row.named.percent(),
        "by chance [%]": lambda row: f"{100 * row.chance:.0f}",
    }
    title = "Types named from one labelled pool of each"
    return _table(results, title, "naming", columns)


def prediction_table(results: TraitResults) -> Table:
    """Show how well strangers' actions are predicted from z, and from their true traits."""
    columns: dict[str, Callable[[ActionPrediction], str]] = {
        "given z": lambda row: row.z.shown("z.4f"),
        "given the traits": lambda row: row.traits.shown("z.4f"),
        "given neither": lambda row: row.nothing.shown("z.4f"),
        "traits - z": lambda row: row.traits_minus_z.shown("z.4f"),
    }
    title = "Strangers' actions predicted: log-likelihood per step [nats]"
    return _table(results, title, "prediction", columns)


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
    return _table(results, title, "likelihood", columns)


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
    return _table(results, title, "driving", columns)


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
    return _table(results, title, "reward_ranking", columns)
