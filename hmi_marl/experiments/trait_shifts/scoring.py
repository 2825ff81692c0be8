"""Record strangers under a shift, and estimate their traits from z and by exact posteriors."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

import hmi_marl
from hmi_marl.agents.catalogue import learned_file, make_driver_policy
from hmi_marl.agents.learned.trait_model import find_traits, load_traits
from hmi_marl.demonstrations.dataset import Demonstrations, disjoint_pools
from hmi_marl.demonstrations.recording import CollectSettings, collect
from hmi_marl.envs.config import DRIVER, TeamConfig
from hmi_marl.envs.drivers import TRAIT_NAMES
from hmi_marl.exact.identify import check_stochastic
from hmi_marl.exact.importance import Sampling
from hmi_marl.exact.trait_posterior import trait_posterior
from hmi_marl.experiments.latent_traits.probes import predict_traits
from hmi_marl.experiments.trait_shifts.shifts import Belief
from hmi_marl.extras import needing
from hmi_marl.files import json_value, sha256_of, with_checksum, without_checksum, write_json
from hmi_marl.reading import read_json

Array = NDArray[np.float64]
LINEAR, NETWORK = "linear", "network"
"""Probes that read traits from z."""
UNAWARE, KNOWING = "unaware", "knowing"
"""Exact posteriors: one believes that nothing has shifted, the other knows the shift."""
PENALTIES = (1e-3, 1e-2, 1e-1, 1.0, 10.0)
"""Penalties of ridge regression, chosen by leaving out one stranger after the other."""


@dataclass(frozen=True)
class Estimates:
    """Traits of P strangers as one reader estimates them."""

    true: Array
    """True traits, means over windows, shape (P, 4)."""
    read: Array
    """Estimates, shape (P, 4)."""
    ranks: Array | None = None
    """Posterior probability below the truth, shape (P, 4); None from z."""
    enough: float | None = None
    """Share of strangers whose posterior has a large enough effective sample size."""

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> Estimates:
        """Read what ``json_value`` wrote.

        Raises:
            ValueError: it is something else.
        """
        try:
            arrays = {name: _table(content[name]) for name in ("true", "read")}
            ranks, enough = content["ranks"], content["enough"]
            return cls(
                **arrays,
                ranks=None if ranks is None else _table(ranks),
                enough=None if enough is None else float(enough),
            )
        except (KeyError, TypeError) as error:
            raise ValueError(f"no estimates of traits: {error}") from None


def _table(rows: ArrayLike) -> Array:
    table = np.asarray(rows, np.float64)
    if table.ndim != 2 or table.shape[1] != len(TRAIT_NAMES):
        raise ValueError(f"traits have shape (P, 4), not {table.shape}")
    return table


@dataclass(frozen=True)
class Probing:
    """Reading of traits from z by probes that were fitted on strangers without shift."""

    model: str
    """Place of the trait model."""
    fitted: CollectSettings
    """Recording that the probes are fitted on."""
    judged: CollectSettings
    """Recording of the strangers whose traits are read."""
    seed: int
    """Seed of the network."""

    def run(self) -> dict[str, Estimates]:
        """Record, encode, fit and read, by probe."""
        z, traits = _pooled_once(self.model, self.fitted)
        vectors, true = pooled(self.model, self.judged)
        return {
            LINEAR: Estimates(true, read_linearly(z, traits, vectors)),
            NETWORK: Estimates(true, predict_traits(z, traits, vectors, self.seed)),
        }

    def depends_on(self) -> dict[str, Any]:
        """Checksums of what it reads, by place."""
        card = find_traits(self.model)
        checksums = {self.model: sha256_of(card.with_suffix(".safetensors"))}
        for recording in (self.fitted, self.judged):
            checksums |= _checksums(recording.driver_policy)
        return checksums


@dataclass(frozen=True)
class Inference:
    """Exact posteriors of strangers by a belief about how their windows came about."""

    judged: CollectSettings
    """Recording of the strangers."""
    belief: Belief
    """Assumptions."""
    reader: str
    """``UNAWARE`` or ``KNOWING``."""
    sampling: Sampling
    """Numbers of points and rounds."""
    seed: int
    """Seed of the points."""

    def run(self) -> dict[str, Estimates]:
        """Record, and compute the posteriors."""
        data, belief, name = recorded(self.judged), self.belief, self.belief.driver_policy
        observed, truth = data.observed, data.truth
        assert truth is not None
        policy = None
        if name is not None:
            policy = check_stochastic(make_driver_policy(name, belief.config))
            policy.greedy = self.judged.greedy  # type: ignore[attr-defined]
        posteriors = trait_posterior(
            belief.config,
            policy,
            observed.seeds,
            observed.actions,
            observed.alerts,
            observed.length,
            person=observed.driver,
            prior=belief.prior,
            sampling=self.sampling,
            seed=self.seed,
        )
        true = truth.traits_of(disjoint_pools(observed.driver, self.judged.windows))
        means = np.array([each.mean() for each in posteriors])
        ranks = np.array([each.rank(own) for each, own in zip(posteriors, true, strict=True)])
        enough = float(np.mean([each.is_enough for each in posteriors]))
        return {self.reader: Estimates(true, means, ranks, enough)}

    def depends_on(self) -> dict[str, Any]:
        """Checksums of what it reads, by place."""
        known = self.belief.driver_policy
        return _checksums(self.judged.driver_policy) | ({} if known is None else _checksums(known))


Part = Probing | Inference


def score(part: Part, path: Path) -> dict[str, Estimates]:
    """Run one part, or read from ``path`` what it found before, and return it by reader."""
    about = {"version": hmi_marl.__version__, "part": json_value(part)}
    about["sha256"] = part.depends_on()
    with suppress(FileNotFoundError, ValueError):  # a damaged file is made again
        content = without_checksum(read_json(path))
        if content.get("about") == about:
            return {name: Estimates.from_json(each) for name, each in content["found"].items()}
    found = part.run()
    write_json(path, with_checksum({"about": about, "found": json_value(found)}))
    return found


def recorded(settings: CollectSettings) -> Demonstrations:
    """Record a population in one part."""
    (data,) = collect(settings)
    return data


def pooled(model: str, settings: CollectSettings) -> tuple[Array, Array]:
    """Record strangers; return z of all windows of each, (P, Z), and their traits, (P, 4)."""
    traits, data = load_traits(model), recorded(settings)
    pools = disjoint_pools(data.observed.driver, settings.windows)
    assert data.truth is not None
    z = traits.latents(traits.encode(data.observed), pools).mean
    return z, data.truth.traits_of(pools)


_pooled_once = lru_cache(maxsize=1)(pooled)
"""The same for the probes, which are fitted on the same strangers under all shifts."""


def read_linearly(z: Array, traits: Array, vectors: Array) -> Array:
    """Read traits from z (P, Z) by ridge regression on strangers z (F, Z) and their traits (F, 4).

    Returns:
        Shape (P, 4).

    Raises:
        ModuleNotFoundError: scikit-learn is not installed.
    """
    with needing("judging latent vectors"):
        from sklearn.linear_model import RidgeCV
        from sklearn.pipeline import make_pipeline
        from sklearn.preprocessing import StandardScaler

    columns = []
    for trait in traits.T:
        probe = make_pipeline(StandardScaler(), RidgeCV(PENALTIES))
        columns.append(probe.fit(z, trait).predict(vectors))
    return np.stack(columns, axis=1)


def has_probabilities(driver_policy: str) -> bool:
    """Whether a driver policy gives the probabilities of its actions."""
    try:
        check_stochastic(make_driver_policy(driver_policy, TeamConfig()))
    except TypeError:
        return False
    return True


def _checksums(driver_policy: str) -> dict[str, str]:
    weights = learned_file(driver_policy, DRIVER)
    return {} if weights is None else {driver_policy: sha256_of(weights)}
