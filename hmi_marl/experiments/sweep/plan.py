"""The runs of a sweep: every combination of values, by protocol and seed, checked as a whole."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

from hmi_marl.envs.streams import part_seed
from hmi_marl.experiments.sweep.options import Swept, make_settings, read_swept, written
from hmi_marl.files import sha256
from hmi_marl.registry import unknown
from hmi_marl.training.protocols.registry import PROTOCOLS
from hmi_marl.training.protocols.settings import TrainSettings

MOST_RUNS = 10_000
_LONGEST = 100
"""Most characters of a folder's name."""


@dataclass(frozen=True)
class Combination:
    """A protocol with a value of each of its swept options."""

    protocol: str
    options: Mapping[str, Any]

    @property
    def label(self) -> str:
        """Protocol and options in one line."""
        values = ", ".join(f"{name} = {written(value)}" for name, value in self.options.items())
        return f"{self.protocol} with {values}" if values else self.protocol

    @property
    def name(self) -> str:
        """Beginning of the names of its runs' folders: the same in a larger sweep."""
        parts = [f"{name}={written(value)}" for name, value in sorted(self.options.items())]
        whole = "_".join([self.protocol, *parts])
        plain = re.sub(r"[^\w.+=-]", "-", whole)
        if plain == whole and len(whole) <= _LONGEST:
            return whole
        return f"{plain[: _LONGEST - 9]}-{sha256(whole.encode())[:8]}"


@dataclass(frozen=True)
class SweptRun:
    """One training."""

    combination: Combination
    number: int
    """Number of the run among those of its combination, 0 for the first."""
    settings: TrainSettings

    @property
    def name(self) -> str:
        """Name of the run and of its folder."""
        return f"{self.combination.name}_run{self.number}"

    @property
    def steps(self) -> int:
        """Environment steps of the whole run, in whole batches."""
        teams = self.settings.num_teams
        return sum(
            phase.iterations(teams) * teams * phase.team.horizon for phase in self.settings.phases()
        )


def varying(combinations: Sequence[Combination]) -> list[str]:
    """Names of the options that do not have one and the same value in all combinations."""
    names = dict.fromkeys(name for each in combinations for name in each.options)
    first = combinations[0].options
    return [
        name
        for name in names
        if not all(
            name in each.options and each.options[name] == first.get(name) for each in combinations
        )
    ]


def plan_runs(
    protocols: Sequence[str], over: Sequence[str], seeds: int, seed: int
) -> tuple[SweptRun, ...]:
    """Make the settings of every run.

    Args:
        protocols: registered names.
        over: options with their values, see :mod:`hmi_marl.experiments.sweep.options`.
        seeds: runs of each combination.
        seed: seed of the first of them; those of the others are mixed from it.

    Raises:
        ValueError: unknown names, or a value that does not fit; the message names the combination.
    """
    if isinstance(protocols, str) or not protocols:
        known = ", ".join(PROTOCOLS)
        raise ValueError(f"protocols is a tuple of at least one of {known}; got {protocols!r}")
    for name in protocols:
        if name not in tuple(PROTOCOLS):
            raise ValueError(unknown("protocol", name, PROTOCOLS, "hmi-marl train --help"))
    if len(set(protocols)) < len(protocols):
        raise ValueError(f"protocols names one twice: {', '.join(protocols)}")
    swept = [read_swept(text, protocols) for text in over]
    chosen = {protocol: _of(protocol, swept) for protocol in protocols}
    sizes = [math.prod(len(option.values) for option in chosen[each]) for each in protocols]
    if sum(sizes) * seeds > MOST_RUNS:
        raise ValueError(
            f"a sweep has at most {MOST_RUNS} runs, but these values and seeds = {seeds} make "
            f"{sum(sizes) * seeds}"
        )
    return tuple(
        SweptRun(combination, number, _settings(combination, int(part_seed(seed, number))))
        for protocol in protocols
        for combination in _combinations(protocol, chosen[protocol])
        for number in range(seeds)
    )


def _of(protocol: str, swept: Sequence[Swept]) -> list[Swept]:
    own = [option for option in swept if option.protocol in (None, protocol)]
    names = [option.name for option in own]
    for number, name in enumerate(names):
        if name in names[:number]:
            raise ValueError(f"{name} is swept twice for {protocol}; give all its values at once")
    return own


def _combinations(protocol: str, swept: Sequence[Swept]) -> list[Combination]:
    names = [option.name for option in swept]
    return [
        Combination(protocol, dict(zip(names, values, strict=True)))
        for values in product(*(option.values for option in swept))
    ]


def _settings(combination: Combination, seed: int) -> TrainSettings:
    try:
        return make_settings(combination.protocol, combination.options, seed)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{combination.label}: {error}") from None
