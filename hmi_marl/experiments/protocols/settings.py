"""The protocols at equal environment steps and over several seeds: what is trained, who plays.

Every pair of driver and HMI plays the same seeded episodes on the batched world, with the driver
of each drawn from the population (``compare_play.py``). What that shows is worked out in
``compare_analysis.py``, and drawn and told by ``compare_figures.py`` and ``compare_report.py``.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product
from pathlib import Path
from typing import Any, Literal

from hmi_marl.checks import check_count
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import PAPER_DRIVERS, get_driver
from hmi_marl.envs.scene import Scene
from hmi_marl.envs.streams import check_seed
from hmi_marl.names import unknown
from hmi_marl.training.protocols.registry import compared
from hmi_marl.training.protocols.settings import Budget, TrainSettings
from hmi_marl.training.runs.jobs import Job

Protocol = str
"""Name of a protocol or of a variant, as :func:`compared` lists them."""
PROTOCOLS: tuple[Protocol, ...] = tuple(compared())
TWO_STAGE: Protocol = "two-stage"
EVERYBODY = "all"
"""In place of a driver's name: all of the population."""
QUICK = {"steps": 300_000, "seeds": 2, "episodes": 200, "num_teams": 128}
"""What a coarse comparison changes."""


@dataclass(frozen=True)
class Run:
    """One training run."""

    protocol: Protocol
    seed: int
    standing: bool = False
    """Trained with ``end_at_crash=False``: a crashed car stands until the time is over."""

    @property
    def name(self) -> str:
        """Also its folder's."""
        return f"{self.protocol}-seed{self.seed}" + ("-standing" if self.standing else "")


@dataclass(frozen=True)
class Pair:
    """Who plays."""

    driver: str
    """A run's name, or one of the catalogue."""
    hmi: str
    """The same."""
    end_at_crash: bool = True


@dataclass(frozen=True)
class CompareSettings:
    """What to compare, and how large.

    Raises:
        ValueError, TypeError: a value out of its range, saying what to use instead.
    """

    protocols: tuple[Protocol, ...] = PROTOCOLS
    """Which protocols. The others are judged beside two-stage."""
    steps: int = 3_000_000
    """Environment steps of each run in all, rounded to batches, alike for every protocol."""
    driver_share: float = 0.8
    """Of the steps of two-stage and alternating: in how many of them the driver learns."""
    rounds: int = 4
    """Of alternating."""
    seeds: int = 3
    """Runs of each protocol."""
    seed: int = 0
    """Of the first run; the others count on from it."""
    episodes: int = 1000
    """Episodes that each pair of driver and HMI plays."""
    drivers: tuple[str, ...] = PAPER_DRIVERS
    """Who drives, drawn for each episode: known names, or name:beta,alpha,eta,inflation."""
    reward: Literal["default", "team", "individual"] = "default"
    """What they learn from: each protocol's own default (the driver learns from driving and the HMI
    from the team's reward where they learn apart, both from the team's where they learn together),
    or one for all but two-stage. (Joint learns from the sum of both agents' rewards.)"""
    crash_check: bool = True
    """Train every protocol also with end_at_crash=False, with the first seed, to see whether
    crashing early pays."""
    num_teams: int = 512
    """Teams side by side in training."""
    duration: float = 20.0
    """Length of an episode [s]."""
    vehicles: tuple[int, int] = (1, 20)
    """Least and most other vehicles."""

    def __post_init__(self) -> None:
        _check_protocols(self.protocols)
        for name in ("steps", "rounds", "seeds", "episodes", "num_teams"):
            check_count(name, getattr(self, name))
        if not 0.0 < self.driver_share < 1.0:
            raise ValueError(
                f"driver_share lies between 0 and 1, both apart, but got {self.driver_share}"
            )
        if self.reward not in ("default", "team", "individual"):
            raise ValueError(f"reward is 'default', 'team' or 'individual', not {self.reward!r}")
        object.__setattr__(self, "seed", check_seed(self.seed))
        check_seed(self.seed + self.seeds - 1)
        if not isinstance(self.drivers, tuple) or not self.drivers:
            raise ValueError(f"drivers is a tuple of at least one name, not {self.drivers!r}")
        names = Counter(get_driver(driver).name for driver in self.drivers)
        if names.total() > len(names):
            raise ValueError(f"drivers names {names.most_common(1)[0][0]!r} twice")
        self.jobs(Path())  # checks the rest

    @property
    def driver_names(self) -> tuple[str, ...]:
        """Of those who drive."""
        return tuple(get_driver(driver).name for driver in self.drivers)

    def team(self, end_at_crash: bool = True) -> TeamConfig:
        """The teams of an evaluation."""
        return TeamConfig(
            driver=self.drivers,
            duration=self.duration,
            end_at_crash=end_at_crash,
            scene=Scene(vehicles=self.vehicles),
        )

    @property
    def _batches(self) -> tuple[int, int]:
        """In each round of alternating: of the driver, of the HMI. At least one each."""
        wanted = self.steps / (self.num_teams * self.team().horizon * self.rounds)
        shares = self.driver_share, 1.0 - self.driver_share
        driver, hmi = (max(1, round(share * wanted)) for share in shares)
        return driver, hmi

    @property
    def steps_apart(self) -> tuple[int, int]:
        """In how many environment steps driver and HMI learn where they learn one by one."""
        driver, hmi = (
            count * self.rounds * self.num_teams * self.team().horizon for count in self._batches
        )
        return driver, hmi

    @property
    def steps_each(self) -> int:
        """Environment steps that every run really takes."""
        return sum(self.steps_apart)

    @property
    def main_runs(self) -> tuple[Run, ...]:
        """Every protocol with every seed."""
        return tuple(
            Run(protocol, self.seed + k) for protocol in self.protocols for k in range(self.seeds)
        )

    @property
    def standing_runs(self) -> tuple[Run, ...]:
        """Those in which a crash does not end the episode."""
        wanted = self.protocols if self.crash_check else ()
        return tuple(Run(protocol, self.seed, standing=True) for protocol in wanted)

    @property
    def runs(self) -> tuple[Run, ...]:
        """All that is trained."""
        return self.main_runs + self.standing_runs

    def jobs(self, folder: Path) -> list[Job]:
        """All training, a folder for each run."""
        return [Job(self._training(run), folder / run.name) for run in self.runs]

    def _training(self, run: Run) -> TrainSettings:
        driver_steps, hmi_steps = self.steps_apart
        reward = None if self.reward == "default" else self.reward
        shared: dict[str, Any] = {
            "drivers": self.drivers,
            "seed": run.seed,
            "end_at_crash": not run.standing,
            "num_teams": self.num_teams,
            "duration": self.duration,
            "vehicles": self.vehicles,
        }
        protocol, variant = compared()[run.protocol]
        budget = Budget(driver_steps, hmi_steps, self.rounds, reward)
        return protocol.for_comparison(budget, **shared, **variant)

    def driver_terms(self, protocol: Protocol) -> tuple[str, ...]:
        """The reward terms that the driver learns from."""
        return self._training(Run(protocol, self.seed)).driver_terms

    def pairs(self) -> list[Pair]:
        """Every pair that plays, each once."""
        by_seed = [
            [run for run in self.main_runs if run.seed == self.seed + k] for k in range(self.seeds)
        ]
        wanted = [
            Pair(a.name, b.name) for same in by_seed for a, b in product(same, same)
        ]  # with the own ones
        for protocol in self.protocols:
            own = [run for run in self.main_runs if run.protocol == protocol]
            wanted += [Pair(a.name, b.name) for a, b in permutations(own, 2)]
        for pairs in self.baselines().values():
            wanted += pairs
        for run in self.standing_runs:
            wanted += [Pair(run.name, run.name, ends) for ends in (True, False)]
        return list(dict.fromkeys(wanted))

    def baselines(self) -> dict[str, list[Pair]]:
        """Pairs of known policies, and the two-stage driver with known HMIs, by what they are.

        "when-distracted" is the exact alert optimum for all of the paper's drivers.
        """
        hmis = "never", "when-distracted"
        known = {f"rule, {hmi}": [Pair("rule", hmi)] for hmi in hmis}
        learned = [run.name for run in self.main_runs if run.protocol == TWO_STAGE]
        if learned:
            known |= {f"{TWO_STAGE}, {hmi}": [Pair(name, hmi) for name in learned] for hmi in hmis}
        return known


def _check_protocols(protocols: Sequence[str]) -> None:
    known = ", ".join(PROTOCOLS)
    if isinstance(protocols, str) or not protocols:
        raise ValueError(f"protocols is a tuple of at least one of {known}; got {protocols!r}")
    for name, times in Counter(protocols).items():
        if name not in PROTOCOLS:
            raise ValueError(unknown("protocol", name, PROTOCOLS, "hmi-marl compare --help"))
        if times > 1:
            raise ValueError(f"protocols names {name!r} twice")


def quick(settings: CompareSettings) -> CompareSettings:
    """The coarse version.

    Raises:
        ValueError: a size was chosen that it would set itself.
    """
    default = CompareSettings()
    chosen = [name for name in QUICK if getattr(settings, name) != getattr(default, name)]
    if chosen:
        raise ValueError(f"--quick sets {', '.join(chosen)} itself; leave out one or the other")
    return replace(settings, **QUICK)  # type: ignore[arg-type]
