"""Checks of the paper's claims about latent traits, from the numbers of the experiment "traits".

What is said of a way of learning is judged over training seeds, paired where settings share them;
with one seed it is undetermined. What is said of the scenario is judged by the exact classifier,
which learns nothing and needs no labels.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hmi_marl.envs.config import TeamConfig
from hmi_marl.exact.hidden_attention import rule_return, solve_belief
from hmi_marl.experiments import criteria
from hmi_marl.experiments.adaptation.evaluation import AdaptSettings
from hmi_marl.experiments.latent_traits.divergence import (
    kl_matrix,
    kl_ratio_of,
    log_error,
)
from hmi_marl.reporting import statistics
from hmi_marl.reporting.statistics import UNKNOWN, Estimate
from hmi_marl.reporting.verdicts import SEEDS, Part, Verdict
from hmi_marl.reproduction.findings import Check, Results

SETTINGS = {"none": "unsupervised", "id": "by driver", "preference": "by preference"}
Means = NDArray[np.float64]
_MODELS = ("lisa", "marge", "bart", "homer", "average")


def _seeds(results: Results, setting: str) -> list[Mapping[str, Any]]:
    return list(results["traits"]["supervisions"][setting]["seeds"])


def _pool(results: Results, setting: str = "") -> list[Mapping[str, Any]]:
    """Accuracies with pools of the models' size, by seed; of the first setting by default."""
    size, name = results["traits"]["pool"], setting or next(iter(results["traits"]["supervisions"]))
    return [
        next(row for row in seed["identified"] if row["windows"] == size)
        for seed in _seeds(results, name)
    ]


def _accuracies(results: Results, setting: str) -> list[Estimate]:
    rows = _pool(results, setting)
    return [Estimate.from_json(row["types"]["linear_probe"]) for row in rows]


def _over_seeds(
    what: str, estimate: Estimate, make: Callable[..., Part] = Part.mean_share, **more: Any
) -> Part:
    about = {"seeds": estimate.count, "form": "z.1%"} | more
    return make(what, estimate, SEEDS, **about)


def _accurate(results: Results, setting: str, least: float) -> Part:
    found = statistics.mean_share(_accuracies(results, setting))
    return _over_seeds(f"{SETTINGS[setting]}, drivers named right:", found, above=least)


def _found(*parts: Part, reason: str = "") -> Verdict:
    return Verdict("", parts, reason)


def _embedding(seed: Mapping[str, Any]) -> tuple[Means, list[str]]:
    found = seed["embedding"]
    return np.asarray(found["means"], np.float64), list(found["drivers"])


def nearest(means: Means, drivers: Sequence[str], names: Sequence[str]) -> list[str]:
    """Name the driver to whose centre each pool is nearest, by the means (P, Z) of z.

    A pool does not count in its own driver's centre, which it would pull towards itself.
    """
    own = np.asarray(drivers)[:, None] == np.asarray(names)
    counts, sums = own.sum(axis=0), own.T @ means
    centres = np.broadcast_to((sums / counts[:, None])[None], (len(means), *sums.shape)).copy()
    pool, name = np.nonzero(own & (counts > 1))
    centres[pool, name] = (sums[name] - means[pool]) / (counts[name] - 1)[:, None]
    distances = np.linalg.norm(centres - means[:, None], axis=2)
    return [names[k] for k in distances.argmin(axis=1)]


def share_apart(
    means: Means, drivers: Sequence[str], one: Sequence[str], other: Sequence[str]
) -> Estimate:
    """Share of pools, means (P, Z), nearest to a centre of their kind; either kind counts half."""
    names = [*one, *other]
    own = np.isin(drivers, names)
    listed = [driver for driver in drivers if driver in names]
    named = nearest(means[own], listed, names)
    kinds = np.isin(listed, one)
    right = np.isin(named, one) == kinds
    share = float(np.mean([right[kinds].mean(), right[~kinds].mean()]))
    return Estimate(share, np.nan, np.nan, count=len(right))


def kinds_apart(setting: str, one: Sequence[str], other: Sequence[str], title: str) -> Check:
    """Make the check that two kinds of drivers are apart in one setting's embeddings."""

    def check(results: Results) -> Verdict:
        seeds = _seeds(results, setting)
        shares = [share_apart(*_embedding(seed), one, other) for seed in seeds]
        what = f"{title}, pools next to their own kind:"
        part = _over_seeds(what, statistics.mean_share(shares), above=criteria.APART)
        return _found(part, reason="by chance 50 %")

    return check


def _average_kl(results: Results, setting: str) -> list[Estimate]:
    """Average KL with pools of the models' size, by seed."""
    return [Estimate.from_json(row["types"]["average_kl"]) for row in _pool(results, setting)]


def _labelled(seed: Mapping[str, Any]) -> tuple[Means, NDArray[np.int64], list[str]]:
    """Means of z (P, Z), the index of each pool's driver (P,), and the drivers' names."""
    means, drivers = _embedding(seed)
    names = list(dict.fromkeys(drivers))
    return means, np.array([names.index(name) for name in drivers]), names


def supervision_counts(results: Results) -> Verdict:
    """Check that labels at least double the KL, and that drivers are named better with them."""
    parts, kl = [], {name: _average_kl(results, name) for name in SETTINGS}
    for name in ("id", "preference"):
        ratio = kl_ratio_of(kl[name], kl["none"])
        what, least = f"{SETTINGS[name]}, KL over the unsupervised one's:", criteria.KL_INFLUENCE
        parts.append(_over_seeds(what, ratio, Part.ratio, above=least, form=".2f"))
        both = _accuracies(results, name), _accuracies(results, "none")
        more = statistics.difference_of_shares(*both)
        what = f"{SETTINGS[name]}, accuracy less the unsupervised one's:"
        margin = criteria.NO_MORE_ACCURATE
        about = {"paired": True, "above": 0.0, "margin": margin, "form": "+z.1%"}
        parts.append(_over_seeds(what, more, Part.mean, **about))
    means = (np.mean([each.mean for each in several]) for several in kl.values())
    numbers = ", ".join(f"{value:.4g}" for value in means)
    return _found(
        *parts,
        reason=f"average KL {numbers} nats (the paper: 435, 4940, 2872); supervised settings also "
        "have a loss and updates that the unsupervised one has not",
    )


def supervision_suffices(results: Results) -> Verdict:
    """Check that drivers are named right in nine of ten pools, with either kind of labels."""
    return _found(*(_accurate(results, name, criteria.APART) for name in ("id", "preference")))


def structure_uncovered(results: Results) -> Verdict:
    """Check that drivers are named without labels clearly better than by chance."""
    chance = _pool(results, "none")[0]["types"]["chance"]
    part = _accurate(results, "none", chance + criteria.ABOVE_CHANCE)
    return _found(part, reason=f"by chance {100 * chance:.0f} %")


def distraction_separates(results: Results) -> Verdict:
    """Compare KL of Bart and Homer with that of Lisa and Marge, learned from preferences."""
    ratios = []
    for seed in _seeds(results, "preference"):
        means, types, names = _labelled(seed)
        among = [names.index(name) for name in ("bart", "homer", "lisa", "marge")]
        try:
            ratios.append(_ratio_of_pairs(means, types, *among))
        except ValueError as error:
            return _found(reason=f"too few pools: {error}")
    ratio = statistics.geometric_mean_of_same(ratios)
    what = "KL of Bart and Homer over that of Lisa and Marge:"
    return _found(_over_seeds(what, ratio, Part.ratio, above=1.0, form=".2f"))


def _ratio_of_pairs(
    means: Means, types: NDArray[np.int64], a: int, b: int, c: int, d: int
) -> Estimate:
    """KL of two types, both ways, over that of two others, with the error of its logarithm."""

    def ratio(kl: NDArray[np.float64]) -> NDArray[np.float64]:
        high, low = kl[:, a, b] + kl[:, b, a], kl[:, c, d] + kl[:, d, c]
        return np.maximum(high, criteria.SMALLEST_KL) / np.maximum(low, criteria.SMALLEST_KL)

    found = float(ratio(kl_matrix(means, types)[None])[0])
    return statistics.by_logarithm(found, log_error(means, types, ratio), len(means))


# What the exact classifier can tell.


def _exact(what: str, content: Mapping[str, Any] | None, unit: str, **more: Any) -> Part:
    estimate = UNKNOWN if content is None else Estimate.from_json(content["identity"])
    return Part.share(what, estimate, unit, seeds=1, form="z.1%", **more)


def more_is_clearer(results: Results) -> Verdict:
    """Judge by the exact classifier: a single observation hides who drives, many windows do not."""
    last = _seeds(results, next(iter(results["traits"]["supervisions"])))[0]["identified"][-1]
    return _found(
        _exact(
            "a single observation names",
            results["traits"]["one_step"],
            "windows",
            below=criteria.HIDES,
        ),
        _exact(f"{last['windows']} windows name", last["ceilings"], "pools", above=criteria.APART),
        reason="by the exact classifier, which no encoder can beat",
    )


def scenario_hides(results: Results) -> Verdict:
    """Judge by the exact classifier: the scenario hides who drives if it cannot name drivers.

    It shows them if the classifier names all four drivers in 19 of 20 pools. An encoder taught by
    preference labels, which do not tell drivers of one preference apart, says nothing of this.
    """
    row = _pool(results)[0]
    most = criteria.SHOWN_BY_SCENARIO
    part = _exact("the exact classifier names", row["ceilings"], "pools", below=most)
    return _found(part, reason=f"from pools of {row['windows']} windows")


# Use of the representation.


@lru_cache(maxsize=4)
def worth_of_models(revealing: float) -> Mapping[str, Mapping[str, float]]:
    """Exact attention returns with attention hidden, by the driver and the rule's driver."""
    team = TeamConfig()
    game = team.alert_window, team.horizon, team.weights
    rules = {model: solve_belief(model, *game, revealing) for model in _MODELS}
    return {
        driver: {model: rule_return(rule, driver, team.weights) for model, rule in rules.items()}
        for driver in _MODELS[:-1]
    }


def earned_by_naming(means: Means, drivers: Sequence[str]) -> dict[str, Estimate]:
    """Share of the exact worth of knowing the driver that is earned by the driver that z names.

    The HMI is the exact rule for the driver to whose centre z (P, Z) is nearest, with attention
    hidden; 0 is the rule for the average driver, 1 that for the driver at the wheel. The interval
    is over the driver's pools and one more that is named by chance: where all are named right, a
    further one still may not be.
    """
    returns = worth_of_models(AdaptSettings.revealing)
    named = nearest(means, drivers, _MODELS[:-1])
    found = {}
    for driver in criteria.GAP_DRIVERS:
        own, average = returns[driver][driver], returns[driver]["average"]
        worth = {name: (returns[driver][name] - average) / (own - average) for name in _MODELS[:-1]}
        earned = [worth[n] for n, who in zip(named, drivers, strict=True) if who == driver]
        found[driver] = _with_one_by_chance(earned, list(worth.values()))
    return found


def _with_one_by_chance(values: Sequence[float], chance: Sequence[float]) -> Estimate:
    """Mean of values, with the standard error that one more has which is any of ``chance``."""
    count = len(values) + 1
    weights = [1.0 / count] * len(values) + [1.0 / (count * len(chance))] * len(chance)
    every = np.array([*values, *chance])
    error = float(np.sqrt(np.cov(every, aweights=weights, ddof=0) / count))
    middle = float(np.mean(values))
    return Estimate(middle, *statistics.t_interval(middle, error, count), error, count)


def representation_is_useful(results: Results) -> Verdict:
    """Judge the paper's own z: what an HMI earns that is chosen by the driver that z names."""
    if not set(_MODELS[:-1]) <= set(_embedding(_seeds(results, "id")[0])[1]):
        return _found(reason="the embeddings of this run lack one of the four drivers")
    earned = {
        name: [earned_by_naming(*_embedding(seed)) for seed in _seeds(results, name)]
        for name in SETTINGS
    }
    mean: Callable[[str, str], Estimate] = lambda name, who: statistics.mean_of_same(  # noqa: E731
        [seed[who] for seed in earned[name]]
    )
    parts = [
        _over_seeds(
            f"{SETTINGS['id']}, {who}:", mean("id", who), Part.mean_up_to_1, above=criteria.USEFUL
        )
        for who in criteria.GAP_DRIVERS
    ]
    others = "; ".join(
        f"{SETTINGS[name]} {', '.join(f'{w} {100 * mean(name, w).mean:.0f} %' for w in who)}"
        for who in (criteria.GAP_DRIVERS,)
        for name in ("none", "preference")
    )
    return _found(
        *parts,
        reason="of what knowing the driver is worth by exact rules, earned by the rule for the "
        f"driver that the paper's z names from {results['traits']['pool']} windows, "
        f"attention hidden; {others}",
    )
