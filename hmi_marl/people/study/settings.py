"""Settings of a rating study: drivers and controls, clips, ratings and intended differences.

The paper had 500 people rate roll-outs by how safe, distracted, risky, or similar to their own
driving they were. Here a *condition* is a driver with a driver policy, of which several clips are
shown. A *contrast* says that one condition is to be rated higher than another; contrasts are fixed
when the study is made, before there is an answer.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Literal
from urllib.parse import urlsplit

from hmi_marl.checks import Check, Checked, Real, Whole, check_choice
from hmi_marl.envs.config import Duration, TeamConfig, VehicleRange
from hmi_marl.envs.drivers import PAPER_DRIVERS, Driver, DriverName, get_driver, spelled_out
from hmi_marl.envs.scene import Scene
from hmi_marl.envs.streams import Seed

RATINGS = ("safe", "distracted", "risky", "own")
"""The paper's four ratings; the last is similarity to one's own driving."""
_MORE = {
    "safe": "safer",
    "distracted": "more distracted",
    "risky": "riskier",
    "own": "more similar to their own driving",
}
POINTS = 7
"""Points of each rating's scale, 1 to 7."""
_APART = 0.25
"""Least difference of shares of distracted steps by which raters are to see a difference."""
_FACTOR = 1.5
"""Least ratio of inflations by which raters are to see a difference."""
_CONTRAST = re.compile(r"(\w+):([\w@-]+)>([\w@-]+)")


@dataclass(frozen=True)
class Condition:
    """Driver, driver policy and HMI of some clips."""

    name: str
    """The driver's name; for another policy than the study's DRIVER@POLICY, as far as letters."""
    driver: str
    """Name or name:β,α,η,inflation."""
    policy: str
    hmi: str
    control: bool = False


@dataclass(frozen=True)
class Contrast:
    """An intended difference: raters see more of something in one condition than in another."""

    rating: str
    more: str
    less: str

    @property
    def name(self) -> str:
        """Write it as settings take it."""
        return f"{self.rating}:{self.more}>{self.less}"

    @property
    def claim(self) -> str:
        """Write it as a sentence."""
        return f"raters see {self.more} as {_MORE[self.rating]} than {self.less}"


def check_web_address(name: str, value: str) -> str:
    """Return an address on the web, or an empty text.

    Raises:
        ValueError: it does not begin with https:// and a host.
    """
    text = str(value)
    try:
        parts = urlsplit(text)
    except ValueError:
        parts = urlsplit("")
    if text and not (parts.scheme == "https" and parts.hostname and text.isprintable()):
        raise ValueError(f"{name} begins with https:// and a host, or is empty, not {text[:60]!r}")
    return text


def _check_code(name: str, value: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9_-]{0,40}", str(value)):
        raise ValueError(f"{name} has up to 40 letters, digits, - and _, not {str(value)[:60]!r}")
    return str(value)


@dataclass(frozen=True)
class StudySettings(Checked):
    """What a study shows and asks.

    Raises:
        ValueError, TypeError: a value out of its range, drivers or contrasts that do not fit.
    """

    drivers: tuple[DriverName, ...] = PAPER_DRIVERS
    """Drivers to rate: names, name:beta,alpha,eta,inflation, or driver files."""
    controls: tuple[str, ...] = ("attentive:0,1,0,3", "lisa@random")
    """Controls: further drivers, or DRIVER@POLICY for one with another driver policy."""
    policy: str = "trained:driver"
    """Driver policy of the drivers: rule, random, the folder of a trained run, or trained:NAME."""
    hmi: str = "never"
    """HMI in the clips, whose alerts are not shown."""
    clips: Annotated[int, Whole(2, 1000)] = 20
    """Clips of each driver and control. Differences between clips of one driver limit how well
    drivers can be told apart, however many raters there are."""
    shown: Annotated[int, Whole(1, 100)] = 2
    """Clips of each driver and control that one rater sees, each of another seed."""
    contrasts: tuple[str, ...] = ()
    """Intended differences RATING:MORE>LESS, such as distracted:bart>lisa; by default those that
    the drivers' traits imply."""
    seed: Seed = 0
    """Seed of all episodes and orders; no two clips share an episode's seed."""
    duration: Duration = 20.0
    """Longest clip [s]; a crash ends one earlier."""
    vehicles: VehicleRange = (1, 20)
    """Least and most other vehicles."""
    format: Literal["mp4", "gif"] = "mp4"
    """Format of the clips; mp4 needs the video extra to be made, and can be paused by raters."""
    width: Annotated[int, Whole(160, 1920, "px")] = 640
    """Width of the clips [px]."""
    frames_per_step: Annotated[int, Whole(1, 12)] = 3
    """Pictures for each policy step of 1/5 s."""
    keep_ids: bool = False
    """Whether the ids in the address that a panel such as Prolific sends raters with
    (PROLIFIC_PID, STUDY_ID, SESSION_ID) are kept. They can identify a person; say so in the consent
    text."""
    completion_code: Annotated[str, Check(_check_code, "letters, digits, - and _")] = ""
    """Code that raters return to their panel as proof; empty for none."""
    return_address: Annotated[str, Check(check_web_address, "an https:// address")] = ""
    """Address that raters are led back to at the end; empty for none."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.drivers:
            raise ValueError("drivers: name at least one")
        names = [each.name for each in self.conditions]
        if len(set(names)) < len(names):
            raise ValueError(f"drivers and controls have different names, not {', '.join(names)}")
        if len(names) < 2:
            raise ValueError("drivers and controls: name at least two to compare")
        if len(names) > 40:
            raise ValueError(f"drivers and controls: at most 40, not {len(names)}")
        if self.shown > self.clips:
            raise ValueError(
                f"shown: a rater cannot see {self.shown} of {self.clips} clips; raise --clips"
            )
        if not self.intended:
            raise ValueError("contrasts: these drivers' traits imply none; name some")
        self.team(self.conditions[0])

    @property
    def conditions(self) -> tuple[Condition, ...]:
        """Drivers, then controls."""
        found = [self._condition(name, False) for name in self.drivers]
        return (*found, *(self._condition(name, True) for name in self.controls))

    @property
    def intended(self) -> tuple[Contrast, ...]:
        """Intended differences, as named or as implied."""
        if not self.contrasts:
            return implied(self.conditions)
        found = tuple(self._contrast(text) for text in self.contrasts)
        if len(set(found)) < len(found):
            raise ValueError("contrasts: one is named twice")
        return found

    def team(self, condition: Condition) -> TeamConfig:
        """Settings of the teams in a condition's clips."""
        return TeamConfig(
            driver=condition.driver, duration=self.duration, scene=Scene(vehicles=self.vehicles)
        )

    def _condition(self, text: str, control: bool) -> Condition:
        name, at, policy = text.partition("@")
        driver = get_driver(name)
        shown = driver.name
        if at:
            if not policy:
                raise ValueError(f"controls are DRIVER or DRIVER@POLICY, not {text!r}")
            shown = f"{driver.name}@{re.sub(r'[^a-zA-Z0-9-]+', '-', policy).strip('-')}"
        return Condition(shown, spelled_out(driver), policy or self.policy, self.hmi, control)

    def _contrast(self, text: str) -> Contrast:
        found = _CONTRAST.fullmatch(text)
        if found is None:
            raise ValueError(f"contrasts are RATING:MORE>LESS, not {text[:60]!r}")
        contrast, names = Contrast(*found.groups()), [each.name for each in self.conditions]
        check_choice("contrasts: the rating", contrast.rating, RATINGS)
        for name in (contrast.more, contrast.less):
            check_choice("contrasts: the driver", name, names)
        if contrast.more == contrast.less:
            raise ValueError(f"contrasts compare two drivers, not {text!r}")
        return contrast


def implied(conditions: Sequence[Condition]) -> tuple[Contrast, ...]:
    """Return the differences that traits imply between drivers of one policy, and of controls.

    - Drivers whose share of distracted steps β / (β + α) differs by 0.25 or more: the higher one
      is seen as more distracted.
    - Drivers of the same share, one of whom perceives others 1.5 times as large or larger: that
      one is cautious, so is seen as safer, and as less risky.
    - A control that acts at random: it is seen as riskier and as less safe than the same driver
      with the study's policy.
    """
    found: list[Contrast] = []
    drivers = [(each, get_driver(each.driver)) for each in conditions if not each.control]
    for one, other in itertools.permutations(drivers, 2):
        found += _between(one, other)
    for control in conditions:
        for each, _ in drivers:
            if control.policy == "random" != each.policy and control.driver == each.driver:
                found.append(Contrast("risky", control.name, each.name))
                found.append(Contrast("safe", each.name, control.name))
    return tuple(sorted(found, key=lambda contrast: RATINGS.index(contrast.rating)))


def _between(one: tuple[Condition, Driver], other: tuple[Condition, Driver]) -> list[Contrast]:
    (a, first), (b, second) = one, other
    if a.policy != b.policy:
        return []
    apart = distracted_share(first) - distracted_share(second)
    if apart >= _APART - 1e-9:
        return [Contrast("distracted", a.name, b.name)]
    if abs(apart) < 1e-9 and first.inflation >= _FACTOR * second.inflation:
        return [Contrast("safe", a.name, b.name), Contrast("risky", b.name, a.name)]
    return []


def distracted_share(driver: Driver) -> float:
    """Share of steps in which a driver is distracted in the long run, without alerts."""
    total = driver.beta + driver.alpha
    return driver.beta / total if total > 0 else 0.0


@dataclass(frozen=True)
class Plan(Checked):
    """Differences and spreads of simulated raters, on the 7-point scale before rounding.

    Raises:
        ValueError, TypeError: a value out of its range.
    """

    effect: Annotated[float, Real(0.0, 6.0, "points")] = 0.5
    """Difference that raters see where one is intended [points]."""
    rater: Annotated[float, Real(0.0, 6.0, "points")] = 0.7
    """Standard deviation between raters [points]."""
    clip: Annotated[float, Real(0.0, 6.0, "points")] = 0.4
    """Standard deviation between clips of a driver [points]."""
    rater_driver: Annotated[float, Real(0.0, 6.0, "points")] = 0.3
    """Standard deviation between raters in how they see a driver [points]."""
    residual: Annotated[float, Real(0.01, 6.0, "points")] = 1.0
    """Standard deviation of one rater's ratings of one clip [points]."""
    middle: Annotated[float, Real(1.0, 7.0, "points")] = 4.0
    """Mean of drivers without a difference [points]."""
    careless: Annotated[float, Real(0.0, 0.9)] = 0.05
    """Share of raters who fail the attention check, and rate at random."""


@dataclass(frozen=True)
class PowerSettings(Checked):
    """Search for the number of raters.

    Raises:
        ValueError, TypeError: a value out of its range.
    """

    raters: tuple[Annotated[int, Whole(2, 20_000)], ...] = (25, 50, 100, 200, 400)
    """Numbers of raters to try."""
    studies: Annotated[int, Whole(20, 10_000)] = 200
    """Simulated studies for each number of raters."""
    power: Annotated[float, Real(0.5, 0.99)] = 0.8
    """Wanted share of studies in which a planted difference is supported."""
    margin: Annotated[float, Real(0.0, 3.0, "points")] = 0.0
    """As in analyse: differences up to this size count as none [points]."""
    seed: Seed = 0
    """Seed of the simulated raters."""
    plan: Plan = field(default_factory=Plan)
    """What is planted."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.raters:
            raise ValueError("raters: name at least one number")
        if list(self.raters) != sorted(set(self.raters)):
            raise ValueError("raters: the numbers rise")
