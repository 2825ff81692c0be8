"""Judge trait models, and show them in tables and figures.

Settings come in the paper's order: unsupervised, supervised by driver, by preference; after them
comes the self-supervised one. Each may have been learned several times, from different seeds.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

from hmi_marl.experiments import criteria
from hmi_marl.experiments.experiment import Experiment
from hmi_marl.experiments.latent_traits.assessment import WINDOWS
from hmi_marl.experiments.latent_traits.figures import TITLES, embeddings_figure
from hmi_marl.experiments.latent_traits.results import TraitResults, sources_of
from hmi_marl.experiments.latent_traits.tables import accuracy_figure, tables_of
from hmi_marl.experiments.latent_traits.trait_figures import reading_figure
from hmi_marl.experiments.training_seeds import learned_part
from hmi_marl.paper.printed import AVERAGE_KL
from hmi_marl.reporting import statistics
from hmi_marl.reporting.blocks import Block, Text
from hmi_marl.reporting.verdicts import SEEDS, Part, Verdict


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
            part = Part.mean_share(what, share, SEEDS, above=least, seeds=seeds[name], form="z.1%")
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
            verdicts += judge_order(results)
        if "self" in found:
            verdicts += judge_self(results)
        return verdicts + judge_rewards(results)

    def numbers(self, results: TraitResults) -> dict[str, Any]:
        """JSON content."""
        return results.as_json()

    def blocks(self, results: TraitResults) -> list[Block]:
        """Show the figures and all tables."""
        seeds = max(len(several) for several in results.assessments.values())
        note = (
            f"On held-out windows; pools of {results.pool}; {seeds} seed(s). Bayes is the exact "
            "classifier of the same windows, which no encoder can beat. Numbers are means over "
            "seeds; silhouette, Rand and figures of z are of the first. A driver policy that reads "
            "all traits also reacts to them: `hmi-marl reproduce identify` shows how much that "
            "tells."
        )
        return [
            Text(" ".join([note, *left_out(results)])),
            embeddings_figure(
                {name: one.embedding for name, one in results.first.items()},
                sources_of(results, "seeds", 0, "embedding"),
            ),
            accuracy_figure(results),
            *(
                reading_figure(name, one.reading, sources_of(results, "r2"))
                for name, one in results.first.items()
                if name == "self" and one.reading is not None
            ),
            *tables_of(results),
        ]


def judge_order(results: TraitResults) -> list[Verdict]:
    """Judge whether the average KL of the paper's three settings is in the paper's order."""
    order = sorted((k for k in AVERAGE_KL if k in results.assessments), key=AVERAGE_KL.__getitem__)
    parts = []
    for less, more in pairwise(order):
        ratio = results.kl_ratio(more, less, results.pool)
        seeds = min(len(results.assessments[name]) for name in (less, more))
        what = f"KL {TITLES[more]} / {TITLES[less]}"
        parts.append(Part.ratio(what, ratio, SEEDS, above=1.0, seeds=seeds, form=".2f"))
    claim = f"KL in the paper's order: {' < '.join(TITLES[name] for name in order)}"
    return [Verdict(claim, tuple(parts))] if parts else []


def judge_rewards(results: TraitResults) -> list[Verdict]:
    """Judge whether recovered rewards rank good and bad driving of every driver."""
    bar, verdicts = criteria.REWARD_RANKS, []
    for name, several in results.assessments.items():
        rows = results.averaged(name, "reward_ranking")
        parts = tuple(
            Part.mean(
                f"{row.driver}, rank correlation",
                row.mixture.f if len(several) > 1 else statistics.mean([row.mixture.f.mean]),
                SEEDS,
                above=bar,
                seeds=len(several),
                form="z.2f",
            )
            for row in rows
        )
        claim = f"{TITLES[name]}: the reward ranks driving, correlation at least {bar:.1f}"
        verdicts += [Verdict(claim, parts)] if parts else []
    return verdicts


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
        part = Part.mean_share("named", share, SEEDS, above=bar, seeds=seeds, form="z.1%")
        verdicts.append(Verdict(claim, (part,)))
    prediction = results.averaged("self", "prediction")
    if prediction is not None:
        bar, lost = criteria.LOST_BY_Z, prediction.traits_minus_z
        part = learned_part("lost", lost, seeds, "strangers", below=bar, form="z.4f")
        claim = f"self-supervised: z predicts actions within {bar} nats of the true traits"
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
