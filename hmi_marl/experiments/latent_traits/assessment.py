"""Judge one trait model on windows and drivers that it has not learned from.

The probe and the centroids are fitted on windows that the model did learn from, with the true
names, in every setting alike.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.learned.trait_model import TraitModel
from hmi_marl.checks import Checked, Count, CountOrZero
from hmi_marl.demonstrations.dataset import MISSING, Demonstrations, Split, disjoint_pools
from hmi_marl.demonstrations.env import team_of
from hmi_marl.envs.streams import Seed
from hmi_marl.exact.identify import Identification
from hmi_marl.experiments.latent_traits.ceiling import Ceilings, ceilings, likes_help
from hmi_marl.experiments.latent_traits.imitation import (
    ActionLikelihood,
    DrivingRow,
    action_likelihood,
    by_driver,
    compare_driving,
    driver_latents,
    imitate,
    replay,
)
from hmi_marl.experiments.latent_traits.prediction import ActionPrediction, ActionPredictor
from hmi_marl.experiments.latent_traits.probes import Separability, separability
from hmi_marl.experiments.latent_traits.reward import RewardRanking, reward_ranking
from hmi_marl.experiments.latent_traits.strangers import (
    Naming,
    TraitReading,
    name_types,
    read_traits,
)
from hmi_marl.files import json_value

PARTS = 5
"""Calls of ``progress`` in :func:`assess`."""
WINDOWS = (1, 2, 4, 8, 16)
"""Numbers of windows of a driver from which the driver is identified."""


@dataclass(frozen=True)
class AssessSettings(Checked):
    """Size of the evaluation of each model.

    Raises:
        ValueError: a size below its least.
    """

    windows: Count = 800
    """Most windows of each driver, learned from or held out, that are encoded."""
    episodes: Count = 200
    """Episodes that the policy drives with each driver's z."""
    ranked: Count = 100
    """Held-out windows of each driver by which the recovered reward is judged."""
    posteriors: CountOrZero = 0
    """Judged strangers whose exact posterior is computed, to stand beside R² from z."""
    seed: Seed = 1_000_000
    """Seed of those episodes and of all other draws."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.ranked < 2:
            raise ValueError("ranking takes two windows: ranked is at least 2, but got 1")
        if 0 < self.posteriors < 3:
            raise ValueError(
                f"R² takes three strangers: posteriors is 0, or at least 3, not {self.posteriors}"
            )


@dataclass(frozen=True)
class Identified:
    """Accuracy of identifying drivers from a number of windows."""

    windows: int
    pools: int
    """Held-out pools that are judged."""
    types: Separability
    """Separation by driver."""
    preferences: Separability | None
    """Separation by whether the driver likes help; None if that is not known."""
    ceilings: Ceilings | None
    """Accuracies of the exact Bayes classifier on the same pools."""


@dataclass(frozen=True)
class Embedding:
    """Held-out pools in latent space."""

    means: NDArray[np.float64]
    """Posterior means of z, shape (P, Z)."""
    types: NDArray[np.int64]
    """Indices of ``names``, shape (P,)."""
    names: tuple[str, ...]
    sums: NDArray[np.float64] | None = None
    """Encoding of the held-out windows, to be used again."""


@dataclass(frozen=True)
class Assessment:
    """Results of one trait model."""

    supervision: str
    """"none", "id", "preference" or "self"."""
    identified: list[Identified]
    """By the number of windows seen."""
    embedding: Embedding
    """Pools of the model's own size."""
    likelihood: list[ActionLikelihood]
    driving: list[DrivingRow]
    """Empty for recorded drives, which cannot be replayed, as is the ranking."""
    reward_ranking: list[RewardRanking]
    reading: TraitReading | None
    """Traits read over strangers; None if there was no population."""
    naming: list[Naming]
    """Types named from one labelled pool each; empty if there are too few windows."""
    prediction: ActionPrediction | None = None
    """Strangers' actions predicted from z; None if there are no two pools of each stranger."""

    def at_pool(self, size: int) -> Identified:
        """Return the accuracies from ``size`` windows."""
        return next(row for row in self.identified if row.windows == size)

    def as_json(self) -> dict[str, Any]:
        """JSON content."""
        embedding = {
            "means": self.embedding.means.tolist(),
            "drivers": [self.embedding.names[who] for who in self.embedding.types],
        }
        reading = self.reading
        traits = None if reading is None else json_value(reading.r2)
        content = {name: value for name, value in vars(self).items() if name != "reading"}
        return json_value(content) | {"embedding": embedding, "traits": traits}


def pool_sizes(split: Split, pool: int, latent: int) -> tuple[int, ...]:
    """Choose from how many windows drivers are identified: ``WINDOWS``, and a model's own pool.

    Sizes are left out if some driver has too few pools on either side: a Gaussian in Z dimensions
    (``latent``) takes Z + 2.

    Raises:
        ValueError: too few windows for even the model's own pool, or fewer than two drivers.
    """
    names = split.unseen.observed.names
    if len(names) < 2:
        raise ValueError("identifying drivers takes two or more who are known by name")
    sides = (split.learned.observed.driver, split.unseen.observed.driver)
    counts = np.minimum(*(np.bincount(of[of != MISSING], minlength=len(names)) for of in sides))
    least = (latent + 2) * pool
    if counts.min() < least:
        raise ValueError(
            f"too few windows to judge by: it takes {least} of each driver that were learned from "
            f"and {least} that were held out (pools of {pool}, {latent + 2} of them for z of size "
            f"{latent}), but of {names[counts.argmin()]} there are {counts.min()}; demonstrate "
            "more, raise --windows, learn with a smaller --pool or a larger --held-out, and keep a "
            "population's drivers in a dataset of their own"
        )
    sizes = sorted({*WINDOWS, pool})
    return tuple(size for size in sizes if (latent + 2) * size <= counts.min())


def embed(model: TraitModel, split: Split) -> Embedding:
    """Embed held-out pools of the model's own size."""
    unseen = split.unseen.observed
    sums, pools = model.encode(unseen), disjoint_pools(unseen.driver, model.card.pool)
    return Embedding(
        model.latents(sums, pools).mean, unseen.driver[pools[:, 0]], unseen.names, sums
    )


def identify_drivers(
    model: TraitModel,
    split: Split,
    identification: Identification | None = None,
    windows: Sequence[int] = WINDOWS,
) -> tuple[list[Identified], Embedding]:
    """Measure accuracy by windows seen, and embed held-out pools of the model's own size.

    Args:
        model, split: trait model and demonstrations.
        identification: the exact classifier's evidence of ``split.unseen``, candidates in the
            order of its names.
        windows: numbers of windows; see :func:`pool_sizes`.

    Raises:
        ValueError: too few pools of some driver.
    """
    sides = split.learned, split.unseen
    embedding = embed(model, split)
    assert embedding.sums is not None
    sums = [model.encode(split.learned.observed), embedding.sums]
    drivers = [side.observed.driver for side in sides]
    help_learned, help_unseen = (likes_help(side) for side in sides)

    rows = []
    for size in windows:
        pools = [disjoint_pools(driver, size) for driver in drivers]
        z_fitted, z = (model.latents(*side).mean for side in zip(sums, pools, strict=True))
        fitted, judged = pools
        preferences = None
        if help_learned is not None and help_unseen is not None:
            kinds = help_learned[fitted[:, 0]], help_unseen[judged[:, 0]]
            if len(np.unique(kinds[1])) > 1:
                preferences = separability(z_fitted, kinds[0], z, kinds[1])
        types = drivers[1][judged[:, 0]]
        exact = None if identification is None else ceilings(identification, judged, types)
        separated = separability(z_fitted, drivers[0][fitted[:, 0]], z, types)
        rows.append(Identified(size, len(judged), separated, preferences, exact))
    return rows, embedding


def unseen_drivers(population: Demonstrations, demonstrations: Demonstrations) -> Demonstrations:
    """Select windows of drivers with other traits than all who demonstrated.

    Raises:
        ValueError: there are none.
    """
    if population.truth is None or demonstrations.truth is None:
        return population
    known = {tuple(traits) for traits in demonstrations.truth.traits.tolist()}
    new = np.array([tuple(traits) not in known for traits in population.truth.traits.tolist()])
    if not new.any():
        raise ValueError(
            "all drivers of the population have demonstrated, but traits are regressed over "
            "drivers that a model has not learned from; see hmi-marl collect --population"
        )
    return population.take(new)


def supervision_of(model: TraitModel) -> str:
    """Read from a model's card how it was supervised."""
    return str(model.card.training.get("settings", {}).get("supervision", "none"))


def assess(
    model: TraitModel,
    split: Split,
    identification: Identification | None,
    population: Demonstrations | None,
    settings: AssessSettings,
    windows: Sequence[int],
    progress: Callable[[], Any] = tuple,
    predictor: ActionPredictor | None = None,
) -> Assessment:
    """Judge one model on the demonstrations that it learned from.

    Args:
        model, split: trait model and demonstrations.
        identification: the exact classifier's evidence of ``split.unseen``; None if there is none.
        population: drivers that it has not learned from, with the truth; None to leave that out.
        settings: sizes.
        windows: see :func:`identify_drivers`.
        progress: called ``PARTS`` times.
        predictor: predicts actions of that population; None to leave that out.

    Raises:
        ValueError: demonstrations of another layout, too few of them, or of another version of the
            environment.
    """
    unseen = split.unseen.observed
    identified, embedding = identify_drivers(model, split, identification, windows)
    progress()
    supervision, naming = supervision_of(model), []
    if np.bincount(unseen.driver[unseen.driver != MISSING]).min() >= 2 * model.card.pool:
        assert embedding.sums is not None
        sizes = sorted({1, model.card.pool})
        naming = name_types(model, embedding.sums, unseen.driver, sizes, settings.seed)
    reading = None
    if population is not None:
        reading = read_traits(model, population, model.card.pool, settings.seed)
    prediction = None if predictor is None else predictor.judge(model)
    progress()
    pools = disjoint_pools(unseen.driver, model.card.pool)
    likelihood = action_likelihood(model, unseen, pools, identification)
    progress()
    driving, ranking = [], []
    if unseen.seeds is not None:
        z = driver_latents(model, unseen)
        driven = unseen.take(unseen.number < settings.episodes)
        driving = compare_driving(
            by_driver(replay(driven), driven.labels()),
            imitate(model, unseen, z, settings.episodes, settings.seed),
            team_of(unseen).scene.policy_frequency,
        )
    progress()
    if unseen.seeds is not None:
        ranked = unseen.take(unseen.number < settings.ranked)
        ranking = reward_ranking(model, ranked, z, settings.seed)
    progress()
    return Assessment(
        supervision,
        identified,
        embedding,
        likelihood,
        driving,
        ranking,
        reading,
        naming,
        prediction,
    )
