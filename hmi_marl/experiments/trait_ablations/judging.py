"""Learn one variant, and judge its z by strangers and named types whom it has not learned from."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

import hmi_marl
from hmi_marl.agents.learned.trait_encoder import Latent
from hmi_marl.envs.drivers import TRAIT_NAMES
from hmi_marl.experiments.latent_traits.probes import predict_traits
from hmi_marl.experiments.latent_traits.strangers import name_by, strangers_pools
from hmi_marl.experiments.trait_shifts.scoring import read_linearly
from hmi_marl.files import json_value, with_checksum, without_checksum, write_json
from hmi_marl.reading import read_json
from hmi_marl.reporting.statistics import Estimate
from hmi_marl.training.ablations.design import EncoderDesign
from hmi_marl.training.traits.settings import TraitSettings

Array = NDArray[np.float64]
STRANGERS, MANY, JUDGED, NAMED = "strangers", "many", "judged", "named"
"""Recordings: strangers to learn from, many more of them, others by whom an encoder is judged, and
types to be named."""
_SEED = 0
"""Seed of the probes, and of the choice of labelled pools, the same for all encoders."""


@dataclass(frozen=True)
class Errors:
    """Errors of traits of P judged strangers as they are read from z, sums over their pools."""

    spread: Array
    """Squared distances of the truth from its mean over all strangers, shape (P, 4)."""
    linear: Array
    """Squared errors of ridge regression, shape (P, 4)."""
    network: Array
    """Squared errors of a small network, shape (P, 4)."""

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> Errors:
        """Read what ``json_value`` wrote, or raise ValueError."""
        arrays = [np.asarray(content[name], np.float64) for name in ("spread", "linear", "network")]
        for array in arrays:
            if array.ndim != 2 or array.shape != (len(arrays[0]), len(TRAIT_NAMES)):
                raise ValueError(f"errors of traits have shape (P, 4), not {array.shape}")
        return cls(*arrays)


@dataclass(frozen=True)
class Judged:
    """Results of one variant."""

    errors: Mapping[int, Errors]
    """By the number of windows that are read at once."""
    named: Mapping[int, Estimate]
    """Share of the types' pools of so many windows that is named right."""

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> Judged:
        """Read what ``json_value`` wrote, or raise ValueError."""
        try:
            errors, named = content["errors"], content["named"]
            return cls(
                {int(size): Errors.from_json(each) for size, each in errors.items()},
                {int(size): Estimate.from_json(each) for size, each in named.items()},
            )
        except (KeyError, TypeError, AttributeError) as error:
            raise ValueError(f"no results of an encoder: {error}") from None


@dataclass(frozen=True)
class Trial:
    """One variant to learn and to judge."""

    design: EncoderDesign
    settings: TraitSettings
    dataset: str
    """Recording to learn from."""
    strangers: int
    """Strangers to learn from."""
    windows: int
    """Windows of each of them."""
    pools: tuple[int, ...]
    """Numbers of windows that are read at once."""

    def run(self, recordings: Path) -> Judged:
        """Learn from the recordings below this folder, and judge by them."""
        from hmi_marl.demonstrations.stored import ObservedFile, TruthFile
        from hmi_marl.training.ablations.learning import learn_encoder

        learned = recordings / self.dataset
        encoder = learn_encoder(self.design, self.settings, learned, self.strangers, self.windows)
        judged, named = ObservedFile(recordings / JUDGED), ObservedFile(recordings / NAMED)
        truth = TruthFile(recordings / JUDGED, judged).read()
        sums = encoder.encode(recordings / JUDGED)
        errors = {}
        for size in self.pools:
            pools, fits = strangers_pools(judged.driver, size)
            z, traits = encoder.latents(sums, pools).mean, truth.traits_of(pools)
            who = judged.driver[pools[:, 0]]
            errors[size] = read_errors(z, traits, who, fits, _SEED)
        sums_named = encoder.encode(recordings / NAMED)
        naming = name_by(
            lambda pools: encoder.latents(sums_named, pools),
            named.driver,
            self.settings.pool,
            self.pools,
            _SEED,
            SCORES.get(self.design.loss),
        )
        return Judged(errors, {each.windows: each.named for each in naming})


def read_errors(
    z: Array, traits: Array, who: NDArray[np.int64], fits: NDArray[np.bool_], seed: int
) -> Errors:
    """Read traits from z (P, Z) by probes, and sum up the errors of each judged stranger.

    Args:
        z: posterior means of pools.
        traits: their drivers' traits, shape (P, 4).
        who: their drivers, shape (P,).
        fits: whether each pool fits the probes, shape (P,); the others are judged.
        seed: seed of the network.
    """
    sides = z[fits], traits[fits], z[~fits]
    true = traits[~fits]
    squares = (
        (true - true.mean(axis=0)) ** 2,
        (read_linearly(*sides) - true) ** 2,
        (predict_traits(*sides, seed) - true) ** 2,
    )
    number = np.unique(who[~fits], return_inverse=True)[1]
    sums = np.zeros((len(squares), number.max() + 1, true.shape[1]))
    for each, values in zip(sums, squares, strict=True):
        np.add.at(each, number, values)
    return Errors(*sums)


def _distance_scores(of: Latent, prototypes: Latent) -> Array:
    return -((of.mean[:, None] - prototypes.mean[None]) ** 2).sum(axis=2)


def _cosine_scores(of: Latent, prototypes: Latent) -> Array:
    one, other = (z / np.linalg.norm(z, axis=1, keepdims=True) for z in (of.mean, prototypes.mean))
    return one @ other.T


SCORES: Mapping[str, Callable[[Latent, Latent], Array]] = MappingProxyType(
    {
        "distance": _distance_scores,
        "cosine": _cosine_scores,
        "margin": _distance_scores,
        "balanced-margin": _distance_scores,
    }
)
"""Scores by which an encoder of a loss names types; by default the posteriors' likelihood."""


def score(trial: Trial, recordings: Path, path: Path) -> Judged:
    """Run one trial, or read from ``path`` what it found before."""
    about = {"version": hmi_marl.__version__, "part": json_value(trial)}
    about["recordings"] = {
        name: checksum(recordings / name) for name in (trial.dataset, JUDGED, NAMED)
    }
    with suppress(FileNotFoundError, ValueError):  # a damaged file is made again
        content = without_checksum(read_json(path))
        if content.get("about") == about:
            return Judged.from_json(content["found"])
    found = trial.run(recordings)
    write_json(path, with_checksum({"about": about, "found": json_value(found)}))
    return found


def checksum(dataset: Path) -> str:
    """Return the checksum of the observed data of a recording, as its truth has it."""
    from hmi_marl.demonstrations.step_file import TRUTH_SCHEMA, StepFile
    from hmi_marl.demonstrations.stored import TRUTH

    return str(StepFile(dataset / TRUTH, TRUTH_SCHEMA).belongs_to)
