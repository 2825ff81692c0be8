"""Everything that is asked of one trait model, in the order in which it is told."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from hmi_marl.agents.learned.trait_model import TraitModel
from hmi_marl.demonstrations.dataset import Demonstrations
from hmi_marl.demonstrations.env import team_of
from hmi_marl.envs.drivers import TRAIT_NAMES, Driver
from hmi_marl.exact.identify import Identification
from hmi_marl.experiments.latent_traits.ceiling import NoCeilingError, evidence
from hmi_marl.experiments.latent_traits.driving import (
    DrivingRow,
    compare_driving,
    imitate,
    of_drivers,
    replay,
)
from hmi_marl.experiments.latent_traits.identification import (
    Embedding,
    Identified,
    Split,
    disjoint_pools,
    identify_drivers,
    regress_traits,
)
from hmi_marl.experiments.latent_traits.imitation import (
    ActionLikelihood,
    action_likelihood,
    driver_latents,
)
from hmi_marl.experiments.latent_traits.regression import TraitR2
from hmi_marl.experiments.latent_traits.reward import RewardRanking, reward_ranking
from hmi_marl.experiments.latent_traits.settings import AssessSettings

PARTS = 5
"""Calls of ``progress`` in :func:`assess`."""


@dataclass(frozen=True)
class Assessment:
    """What one trait model came to, on windows and drivers it has not learned from."""

    supervision: str
    """"none", "id" or "preference"."""
    identified: list[Identified]
    """By the number of windows seen."""
    embedding: Embedding
    """Of pools of the model's own size."""
    likelihood: list[ActionLikelihood]
    driving: list[DrivingRow]
    """Empty of recorded drives, which cannot be played again, as is the ranking."""
    ranking: list[RewardRanking]
    traits: dict[str, TraitR2] | None
    """R² over unseen drivers; None if there was no population."""

    def at_pool(self, size: int) -> Identified:
        """How well drivers are told apart from ``size`` windows."""
        return next(row for row in self.identified if row.windows == size)

    def as_json(self) -> dict[str, Any]:
        """JSON content."""
        r2 = self.traits
        return {
            "supervision": self.supervision,
            "identified": [row.as_json() for row in self.identified],
            "embedding": {
                "means": self.embedding.means.tolist(),
                "drivers": [self.embedding.names[who] for who in self.embedding.types],
            },
            "likelihood": [row.as_json() for row in self.likelihood],
            "driving": [row.as_json() for row in self.driving],
            "reward_ranking": [row.as_json() for row in self.ranking],
            "traits": None if r2 is None else {name: one.as_json() for name, one in r2.items()},
        }


def exact_evidence(unseen: Demonstrations, driver_policy: str | None) -> Identification:
    """What the exact classifier makes of these windows, some of each driver.

    Raises:
        NoCeilingError: nobody's traits are known; or see :func:`trait_ceiling.evidence`.
        FileNotFoundError, ValueError: see there.
    """
    observed, truth = unseen.observed, unseen.truth
    if truth is None:
        raise NoCeilingError("the exact ceiling cannot be had: nobody knows these drivers' traits")
    first = [int((observed.driver == who).argmax()) for who in range(len(observed.names))]
    drivers = [
        Driver(name, **dict(zip(TRAIT_NAMES, truth.traits[at].tolist(), strict=True)))
        for name, at in zip(observed.names, first, strict=True)
    ]
    return evidence(observed, driver_policy, drivers)


def supervision_of(model: TraitModel) -> str:
    """How a model was supervised, as its card tells."""
    return str(model.card.training.get("settings", {}).get("supervision", "none"))


def assess(
    model: TraitModel,
    split: Split,
    identification: Identification | None,
    population: Demonstrations | None,
    settings: AssessSettings,
    windows: Sequence[int],
    progress: Callable[[], Any] = tuple,
    whole: bool = True,
) -> Assessment:
    """Judge one model.

    Args:
        model: the trait model.
        split: of the demonstrations it learned from.
        identification: what the exact classifier makes of ``split.unseen``; None if it cannot.
        population: of drivers it has not learned from, with the truth; None to leave that out.
        settings: how much.
        windows: how many are seen, of those that :func:`traits.pool_sizes` tells.
        progress: called ``PARTS`` times.
        whole: if not, only how well drivers are told apart, which is told over seeds.

    Raises:
        ValueError: demonstrations of another layout, too few of them, or of another version of the
            environment.
    """
    unseen = split.unseen.observed
    identified, embedding = identify_drivers(model, split, identification, windows)
    progress()
    supervision = supervision_of(model)
    if not whole:
        for _ in range(PARTS - 1):
            progress()
        return Assessment(supervision, identified, embedding, [], [], [], None)
    pools = disjoint_pools(unseen.driver, model.card.pool)
    likelihood = action_likelihood(model, unseen, pools, identification)
    progress()
    z = driver_latents(model, unseen)
    driving, ranking = [], []
    if unseen.seeds is not None:
        driven = unseen.take(unseen.number < settings.episodes)
        driving = compare_driving(
            of_drivers(replay(driven), driven.labels()),
            imitate(model, unseen, z, settings.episodes, settings.seed),
            team_of(unseen).scene.policy_frequency,
        )
    progress()
    if unseen.seeds is not None:
        ranked = unseen.take(unseen.number < settings.ranked)
        ranking = reward_ranking(model, ranked, z, settings.seed)
    progress()
    traits = None
    if population is not None:
        traits = regress_traits(model, population, model.card.pool, settings.seed)
    progress()
    return Assessment(supervision, identified, embedding, likelihood, driving, ranking, traits)
