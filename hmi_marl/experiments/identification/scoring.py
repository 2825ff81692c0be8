"""Score who drives, the traits of strangers and driving, with one driver policy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hmi_marl.demonstrations.dataset import disjoint_pools
from hmi_marl.demonstrations.recording import CollectSettings, collect
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import PAPER_DRIVERS
from hmi_marl.exact.evidence_by_source import SOURCES, evidence_by_source
from hmi_marl.exact.identify import check_stochastic
from hmi_marl.experiments.episodes import Episodes, play_named
from hmi_marl.experiments.latent_traits.posterior import PosteriorRow, evaluate_posteriors
from hmi_marl.reporting import statistics
from hmi_marl.reporting.statistics import Estimate

SECONDS = (0.2, 1.0, 2.0, 5.0, 10.0, 20.0)
"""Lengths of driving that are read of a window [s]."""
POOL = 8
"""Windows of a pool, as trait models pool."""
_EQUAL = 1e-6
"""Difference in log evidence of candidates that are equal but for rounding."""


class Read(NamedTuple):
    """What is read of a driver."""

    source: str
    """One of :data:`SOURCES`."""
    seconds: float
    """Length that is read of each window [s]."""
    windows: int
    """Windows together."""


Rights = dict[Read, NDArray[np.bool_]]
"""Whether the driver of each window, or pool of windows, is named."""


@dataclass(frozen=True)
class NamedRow:
    """Share of windows, or of pools, whose driver the exact classifier names."""

    read: Read
    trained: Estimate
    """With the driver policy that reads all traits."""
    control: Estimate
    """With the control."""
    difference: Estimate
    """Share with the first less that with the control, paired by windows of the same seeds."""


@dataclass(frozen=True)
class DrivingRow:
    """Driving of one driver, without alerts, with either policy in the same episodes."""

    driver: str
    speed_return: Estimate
    """With the policy that reads all traits."""
    control_speed_return: Estimate
    speed_difference: Estimate
    """The first less the second, paired by episode."""
    crash_rate: Estimate
    control_crash_rate: Estimate


def score_naming(recording: CollectSettings, seed: int) -> Rights:
    """Record windows of the four drivers, and name their drivers by the exact classifier.

    Windows of one driver are read together only over their whole length.

    Args:
        recording: settings of the windows; its driver policy is a learned one.
        seed: of draws among candidates that are equal.
    """
    team = recording.team(PAPER_DRIVERS)
    policy = check_stochastic(recording.make_driver(team))
    steps = [round(seconds * team.scene.policy_frequency) for seconds in SECONDS]
    found: dict[tuple[str, float], list[NDArray[np.float64]]] = {}
    who: list[NDArray[np.int64]] = []
    for chunk in collect(recording):
        seen = chunk.observed
        assert seen.seeds is not None
        assert chunk.truth is not None
        data = seen.seeds, seen.actions, seen.alerts, seen.length, chunk.truth.intended
        by_source = evidence_by_source(team, policy, PAPER_DRIVERS, *data, steps)
        for source, several in by_source.items():
            for seconds, after in zip(SECONDS, several, strict=True):
                found.setdefault((source, seconds), []).append(after.log_evidence)
        who.append(seen.driver)
    driver, rng = np.concatenate(who), np.random.default_rng(seed)
    pools = {1: np.arange(len(driver))[:, None], POOL: disjoint_pools(driver, POOL)}
    rights = {}
    for size, groups in pools.items():
        for source in SOURCES:
            for seconds in SECONDS if size == 1 else SECONDS[-1:]:
                evidence = np.concatenate(found[source, seconds])[groups].sum(axis=1)
                right = is_named(evidence, driver[groups[:, 0]], rng)
                rights[Read(source, seconds, size)] = right
    return rights


def is_named(
    log_evidence: NDArray[np.float64], true: NDArray[np.int64], rng: np.random.Generator
) -> NDArray[np.bool_]:
    """Whether the likeliest candidate is the true one; among equals one is drawn.

    Args:
        log_evidence: shape (E, K).
        true: number of the true candidate, shape (E,).
        rng: draws.
    """
    best = log_evidence >= log_evidence.max(axis=1, keepdims=True) - _EQUAL
    guess = np.where(best, rng.random(best.shape), -1.0).argmax(axis=1)
    return guess == true


def score_traits(recording: CollectSettings, seed: int) -> PosteriorRow:
    """Record strangers, and judge the exact posterior over their traits, a^H hidden.

    Args:
        recording: settings of a population with ``POOL`` windows each, in one part.
        seed: of the posterior's points.
    """
    (strangers,) = collect(recording)
    return evaluate_posteriors(
        strangers, windows=POOL, driver_policy=recording.driver_policy, seed=seed
    )


def score_driving(driver_policy: str, episodes: int) -> dict[str, Episodes]:
    """Play episodes of the four drivers without alerts, by driver."""
    return {
        driver: play_named(TeamConfig(driver=driver), driver_policy, "never", episodes)
        for driver in PAPER_DRIVERS
    }


def compare_naming(trained: Rights, control: Rights) -> list[NamedRow]:
    """Compare both policies' drivers, named in windows of the same seeds."""
    rows = []
    for read, right in trained.items():
        shares = [statistics.share(int(r.sum()), len(r)) for r in (right, control[read])]
        difference = statistics.mean(right.astype(float) - control[read])
        rows.append(NamedRow(read, shares[0], shares[1], difference))
    return rows


def compare_driving(trained: dict[str, Episodes], control: dict[str, Episodes]) -> list[DrivingRow]:
    """Compare both policies' driving in the same episodes."""
    rows = []
    for driver, played in trained.items():
        both = played, control[driver]
        speeds = [each.returns["speed_reward"] for each in both]
        crashes = [statistics.share(int(e.crashed.sum()), len(e.seeds)) for e in both]
        means = (statistics.mean(each) for each in (*speeds, speeds[0] - speeds[1]))
        rows.append(DrivingRow(driver, *means, *crashes))
    return rows
