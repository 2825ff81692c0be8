"""The exact posterior over traits, judged over a population of drivers.

No estimate of β, α, η and inflation from the same driving has a smaller mean squared error than the
mean of this posterior (:mod:`hmi_marl.exact.trait_posterior`), over drivers drawn evenly from the
whole population: the R² here are the ceilings of every learned representation of drivers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.catalogue import make_driver_policy
from hmi_marl.checks import Check, Real, Whole, check_choice
from hmi_marl.demonstrations.dataset import MISSING, Demonstrations, numbers
from hmi_marl.demonstrations.env import team_of
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import TRAIT_NAMES
from hmi_marl.envs.streams import Seed
from hmi_marl.exact.importance import Sampling
from hmi_marl.exact.trait_posterior import TraitPosterior, trait_posterior
from hmi_marl.experiments.experiment import Experiment, Place
from hmi_marl.experiments.latent_traits.ceiling import check_at_random, driver_policy_of
from hmi_marl.files import json_value
from hmi_marl.reporting import statistics
from hmi_marl.reporting.blocks import Block, Table, Text
from hmi_marl.reporting.sources import pointer
from hmi_marl.reporting.statistics import Estimate

LEVELS = (0.5, 0.8, 0.95)
"""Probabilities of the intervals whose coverage is counted."""
_BINS = 10
_NO_TRUTH = "posteriors are judged by the true traits, which these data do not hold"
_LEAST = 3
"""Least number of drivers that an R² is computed over."""


class Known(NamedTuple):
    """Whether a^H is seen, and whether the driver policy is known."""

    intent: bool
    policy: bool


CASES: Mapping[str, Known] = MappingProxyType(
    {
        "hidden-known": Known(intent=False, policy=True),
        "seen-known": Known(intent=True, policy=True),
        "hidden-unknown": Known(intent=False, policy=False),
        "seen-unknown": Known(intent=True, policy=False),
    }
)
"""Cases by name: a^H, then the driver policy."""
_Case = Annotated[
    str, Check(lambda name, value: check_choice(name, value, CASES), ", ".join(CASES))
]
_Windows = Annotated[int, Whole(1, 10_000)]
_Length = Annotated[float, Real(0.0, 1e6, "s", above=True)]


@dataclass(frozen=True)
class TraitScore:
    """Posteriors of one trait against the truth."""

    r2: Estimate
    """1 - squared error of the mean over the variance of the truth."""
    coverage: tuple[Estimate, ...]
    """Share of drivers whose trait lies in the interval of each of ``LEVELS``."""
    ranks: tuple[int, ...]
    """Drivers by the posterior probability below their trait, in ten equal bins: even if the
    posterior is calibrated."""


@dataclass(frozen=True)
class PosteriorRow:
    """Posteriors from so much driving of each driver."""

    case: str
    """Name of ``CASES``."""
    windows: int
    """Windows of each driver."""
    seconds: float
    """Length of each window [s]."""
    drivers: int
    """Drivers judged."""
    traits: Mapping[str, TraitScore]
    """By trait."""
    effective_size: float
    """Median effective sample size."""
    enough: float
    """Share of drivers whose effective sample size is large enough."""


def judge_posteriors(
    posteriors: Sequence[TraitPosterior], true: NDArray[np.float64]
) -> dict[str, TraitScore]:
    """Compare the posteriors of P drivers with their traits, shape (P, 4).

    Raises:
        ValueError: other numbers of posteriors and drivers, or fewer than three.
    """
    if len(posteriors) != len(true) or len(true) < _LEAST:
        raise ValueError(
            f"R² takes posteriors of the same {_LEAST} or more drivers, not {len(posteriors)} "
            f"posteriors of {len(true)} drivers"
        )
    means = np.array([each.mean() for each in posteriors])
    ranks = np.array([each.rank(own) for each, own in zip(posteriors, true, strict=True)])
    scores = {}
    for k, name in enumerate(TRAIT_NAMES):
        missed = statistics.ratio(
            (means[:, k] - true[:, k]) ** 2, (true[:, k] - true[:, k].mean()) ** 2
        )
        covered = [np.abs(ranks[:, k] - 0.5) <= level / 2 for level in LEVELS]
        scores[name] = TraitScore(
            Estimate(1 - missed.mean, 1 - missed.high, 1 - missed.low),
            tuple(statistics.share(int(each.sum()), len(true)) for each in covered),
            tuple(np.histogram(ranks[:, k], _BINS, (0.0, 1.0))[0].tolist()),
        )
    return scores


def evaluate_posteriors(
    data: Demonstrations,
    case: str = "hidden-known",
    windows: int = 8,
    seconds: float | None = None,
    driver_policy: str | None = None,
    sampling: Sampling | None = None,
    seed: int = 0,
    progress: Callable[[int], Any] = id,
) -> PosteriorRow:
    """Judge the posteriors of the drivers of demonstrations from their first windows.

    Drivers with fewer windows are left out. Drivers are taken to be drawn evenly from the whole
    population (``hmi-marl collect --population``).

    Args:
        data: with truth.
        case: name of ``CASES``.
        windows: of each driver.
        seconds: read no more of each window; all of it by default.
        driver_policy: where the driver policy is; by default where it was when it drove.
        sampling, seed, progress: as of :func:`trait_posterior`.

    Raises:
        ValueError: no truth, alerts that were not at random, too few drivers or windows, another
            driver policy than the one that drove, or none whose probabilities are known.
        FileNotFoundError: the driver policy is not there.
    """
    check_choice("case", case, CASES)
    observed, truth, known = data.observed, data.truth, CASES[case]
    if truth is None:
        raise ValueError(_NO_TRUTH)
    check_at_random(observed)
    config = team_of(observed)
    policy = driver_policy_of(observed, driver_policy, config) if known.policy else None
    rows, person = _first_windows(observed.driver, windows)
    length = observed.length[rows]
    frequency = config.scene.policy_frequency
    steps = int(length.max()) if seconds is None else max(1, round(seconds * frequency))
    posteriors = trait_posterior(
        config,
        policy,
        None if observed.seeds is None else observed.seeds[rows],
        observed.actions[rows],
        observed.alerts[rows],
        np.minimum(length, steps),
        intended=truth.intended[rows] if known.intent else None,
        person=person,
        sampling=sampling,
        seed=seed,
        progress=progress,
    )
    true = truth.traits_of(rows[np.argsort(person, kind="stable")].reshape(-1, windows))
    return PosteriorRow(
        case,
        windows,
        min(steps, int(length.max())) / frequency,
        len(true),
        judge_posteriors(posteriors, true),
        float(np.median([each.effective_size for each in posteriors])),
        float(np.mean([each.is_enough for each in posteriors])),
    )


def _first_windows(
    driver: NDArray[np.int64], windows: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first windows of the drivers who have so many, and whose each is.

    Raises:
        ValueError: too few drivers have.
    """
    known, count = np.unique(driver[driver != MISSING], return_counts=True)
    able = known[count >= windows]
    if len(able) < _LEAST:
        raise ValueError(
            f"only {len(able)} drivers have {windows} windows; collect more, for example with "
            f"--population 300 --windows {windows}, or lower --windows"
        )
    rows = np.flatnonzero(np.isin(driver, able) & (numbers(driver) < windows))
    return rows, np.searchsorted(able, driver[rows])


@dataclass(frozen=True)
class PosteriorEvaluation(Experiment[list[PosteriorRow]]):
    """Evaluation of exact posteriors, as ``hmi-marl traits posterior`` runs it."""

    name = "trait-posterior"
    title = "The exact posterior over traits"

    demonstrations: Path
    """Demonstrations of a population."""
    cases: tuple[_Case, ...] = ("hidden-known",)
    """Names of ``CASES``."""
    windows: tuple[_Windows, ...] = (1, 2, 4, 8, 16)
    """Numbers of windows of each driver."""
    seconds: tuple[_Length, ...] = (5.0, 10.0, 20.0)
    """Parts of one window."""
    driver_policy: str | None = None
    """Run of the driver policy of the demonstrations; by default as recorded in them."""
    sampling: Sampling = field(default_factory=Sampling)
    """Numbers of points and rounds."""
    seed: Seed = 0
    """Seed of the points."""

    @classmethod
    def quick(cls) -> PosteriorEvaluation:
        """Raise ``ValueError``: there are no default demonstrations."""
        raise ValueError("an evaluation of posteriors names its demonstrations")

    def check(self, place: Place) -> None:
        """See :meth:`Experiment.check`."""
        if not self.cases or not (self.windows or self.seconds):
            raise ValueError("name at least one of the cases, and one of windows or seconds")
        if self.driver_policy is not None:
            make_driver_policy(self.driver_policy, TeamConfig())
        from hmi_marl.demonstrations.stored import TRUTH, ObservedFile  # needs the data extra

        stored = ObservedFile(self.demonstrations)
        if not (self.demonstrations / TRUTH).is_file():
            raise ValueError(_NO_TRUTH)
        _first_windows(stored.driver, max(self.windows, default=1))
        some = stored.read(0, 1)
        check_at_random(some)
        if any(CASES[case].policy for case in self.cases):
            driver_policy_of(some, self.driver_policy, team_of(some))

    def run(self, place: Place) -> list[PosteriorRow]:
        """Compute the posteriors from more and more driving."""
        from hmi_marl.demonstrations.parquet import read_demonstrations

        data = read_demonstrations(self.demonstrations)
        sizes: list[tuple[int, float | None]] = [(1, each) for each in sorted(self.seconds)]
        sizes += [(each, None) for each in sorted(self.windows)]
        found = []
        total = len(self.cases) * len(sizes) * len(data.observed.names)
        with place.playing(total, "posteriors") as progress:
            for case in self.cases:
                for windows, seconds in sizes:
                    found.append(
                        evaluate_posteriors(
                            data,
                            case,
                            windows,
                            seconds,
                            self.driver_policy,
                            self.sampling,
                            self.seed,
                            progress,
                        )
                    )
        return found

    def numbers(self, results: list[PosteriorRow]) -> dict[str, Any]:
        """JSON content."""
        return {"levels": list(LEVELS), "rows": json_value(results)}

    def blocks(self, results: list[PosteriorRow]) -> list[Block]:
        """Tables of R² and of calibration."""
        blocks: list[Block] = [
            Text(
                "The mean of the exact posterior is the estimate with the smallest squared error "
                "from the same driving, over drivers drawn evenly from the whole population. "
                "Intervals: 95 %, over drivers. Where the policy is known, its reaction to the "
                "traits that it reads counts: collect with `trained:driver-inflation` for a driver "
                "who reads inflation alone."
            )
        ]
        for case in self.cases:
            rows = [row for row in results if row.case == case]
            sources = [pointer("rows", k) for k, row in enumerate(results) if row.case == case]
            intent, policy = case.split("-")
            of = f"a^H {intent}, driver policy {policy}"
            blocks += [
                Table.of(f"R² of the posterior mean: {of}", rows, _columns(_r2), sources=sources),
                Table.of(
                    f"Coverage of the intervals of 50, 80 and 95 % [%]: {of}",
                    rows,
                    _columns(_coverage),
                    sources=sources,
                ),
                Table.of(
                    f"Drivers by the rank of the truth, in tenths: {of}",
                    rows[-1:],
                    _columns(_ranks),
                    "Even, but for chance, if the posterior is calibrated.",
                    sources,
                ),
            ]
        return blocks


def _r2(score: TraitScore) -> str:
    return score.r2.shown("z.3f")


def _coverage(score: TraitScore) -> str:
    return " ".join(f"{100 * each.mean:.0f}" for each in score.coverage)


def _ranks(score: TraitScore) -> str:
    return " ".join(map(str, score.ranks))


def _columns(
    show: Callable[[TraitScore], str],
) -> dict[str, Callable[[PosteriorRow], str]]:
    """Columns of a table with one entry for each trait."""

    def of(trait: str) -> Callable[[PosteriorRow], str]:
        return lambda row: show(row.traits[trait])

    return {
        "windows": lambda row: str(row.windows),
        "of [s]": lambda row: f"{row.seconds:g}",
        "drivers": lambda row: str(row.drivers),
        **{trait: of(trait) for trait in TRAIT_NAMES},
        "effective size": lambda row: f"{row.effective_size:.0f}",
        "enough": lambda row: f"{100 * row.enough:.0f} %",
    }
