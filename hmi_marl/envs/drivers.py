"""Driver traits: the four drivers of the paper, the average one, and populations to draw from.

Four numbers describe a driver (the paper's driver table): how easily they become distracted
(``beta``), how easily they recover (``alpha``), how much an accepted alert helps (``eta``) and
how many times too large they perceive other vehicles (``inflation``).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Annotated, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.checks import SHARE, Check, Checked, Real, Share, Whole, shown
from hmi_marl.envs.driver_files import is_driver_file, read_driver
from hmi_marl.envs.streams import Stream, uniform

TRAIT_NAMES = ("beta", "alpha", "eta", "inflation")
MAX_INFLATION = 20.0
INFLATION = Real(1.0, MAX_INFLATION)
TRAIT_RANGES: Mapping[str, Real] = MappingProxyType(
    {"beta": SHARE, "alpha": SHARE, "eta": SHARE, "inflation": INFLATION}
)
_DRAWN = Real(0.0, MAX_INFLATION)
DrawnNumber = Annotated[float, _DRAWN]
"""A number that a trait may have."""
_VALUES = Whole(1, 10_000)
MOST_DRIVERS = 100_000


@dataclass(frozen=True)
class Driver(Checked):
    """One driver's traits.

    Raises:
        ValueError: a trait is NaN, infinite or out of its range.
        TypeError: a trait is not a number.
    """

    name: str
    beta: Share
    """Probability per step of becoming distracted, p(d_t = 1 | d_{t-1} = 0), without help."""
    alpha: Share
    """Probability per step of becoming attentive again, p(d_t = 0 | d_{t-1} = 1), without help."""
    eta: Share
    """Intervention effectiveness, 0 to 1: how much an accepted alert moves both probabilities."""
    inflation: Annotated[float, INFLATION]
    """Factor on the length and width of every other object in the driver's perception, 1 to 20."""

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name:
            raise TypeError(f"a driver's name is a non-empty string, not {shown(self.name)}")
        super().__post_init__()

    def _named(self, field: str) -> str:
        return f"driver {self.name!r}: {field}"

    def __str__(self) -> str:
        return f"β {self.beta:g}, α {self.alpha:g}, η {self.eta:g}, inflation {self.inflation:g}"

    @property
    def traits(self) -> tuple[float, float, float, float]:
        """(beta, alpha, eta, inflation)."""
        return self.beta, self.alpha, self.eta, self.inflation


DRIVERS: Mapping[str, Driver] = MappingProxyType(
    {
        driver.name: driver
        for driver in (
            Driver("lisa", beta=0.2, alpha=0.8, eta=0.01, inflation=3.0),
            Driver("marge", beta=0.2, alpha=0.8, eta=1.0, inflation=9.0),
            Driver("bart", beta=0.8, alpha=0.2, eta=0.01, inflation=3.0),
            Driver("homer", beta=0.8, alpha=0.2, eta=1.0, inflation=9.0),
            Driver("average", beta=0.5, alpha=0.5, eta=0.505, inflation=6.0),
        )
    }
)
"""The paper's four drivers, and the average one that AvgHMI is tuned to."""


def known_name(beta: float, alpha: float, eta: float, inflation: float) -> str | None:
    """Return the name of the known driver with exactly these traits, or None."""
    traits = beta, alpha, eta, inflation
    return next((name for name, driver in DRIVERS.items() if driver.traits == traits), None)


PAPER_DRIVERS = ("lisa", "marge", "bart", "homer")


def get_driver(driver: str | Driver) -> Driver:
    """Look a driver up by name (case does not matter), or pass a :class:`Driver` through.

    A name with traits, ``"mona:0.4,0.3,0.5,2"``, is a custom driver: β, α, η, inflation. A name
    that ends in ``.json`` is the path of a driver file; see :mod:`hmi_marl.envs.driver_files`.
    """
    if isinstance(driver, Driver):
        return driver
    if not isinstance(driver, str):
        raise TypeError(f"expected a driver's name or a Driver, not {driver!r}")
    if is_driver_file(driver):
        return read_driver(driver, Driver)
    name, colon, traits = driver.partition(":")
    if colon:
        return _driver_from_text(name, traits)
    if driver.lower() not in DRIVERS:
        from hmi_marl.registry import unknown  # needed for this error alone

        own = "a custom one is name:beta,alpha,eta,inflation, or a driver file, FILE.json"
        raise ValueError(f"{unknown('driver', driver, DRIVERS)}; {own}")
    return DRIVERS[driver.lower()]


def _driver_from_text(name: str, traits: str) -> Driver:
    if not name.replace("-", "").replace("_", "").isalnum():
        raise ValueError(f"a driver's name has letters, digits, - and _ alone, not {name!r}")
    try:
        beta, alpha, eta, inflation = (float(number) for number in traits.split(","))
    except ValueError:
        raise ValueError(
            f"a custom driver is name:beta,alpha,eta,inflation, not {name + ':' + traits!r}"
        ) from None
    return Driver(name, beta, alpha, eta, inflation)


def spelled_out(driver: Driver) -> str:
    """Return name:beta,alpha,eta,inflation, of which get_driver makes the same driver."""
    return f"{driver.name}:{','.join(map(repr, driver.traits))}"


def _as_traits(name: str, value: str) -> str:
    """Return a driver's name, or of a driver file name:beta,alpha,eta,inflation."""
    if not (isinstance(value, str) and is_driver_file(value)):
        return value
    return spelled_out(get_driver(value))


DriverName = Annotated[str, Check(_as_traits, "a driver's name, name:β,α,η,inflation or FILE.json")]
"""Driver's name in settings. Of a file the traits are kept, so that stored settings do not change
with it."""


@dataclass(frozen=True)
class Traits:
    """The traits of N drivers. Each field is a float64 array of shape (N,)."""

    beta: NDArray[np.float64]
    alpha: NDArray[np.float64]
    eta: NDArray[np.float64]
    inflation: NDArray[np.float64]

    @classmethod
    def of(cls, drivers: Iterable[Driver]) -> Traits:
        """Stack single drivers."""
        return cls.from_array(np.array([driver.traits for driver in drivers], np.float64))

    @classmethod
    def from_array(cls, traits: ArrayLike) -> Traits:
        """Make traits from an array of shape (N, 4), columns as in ``TRAIT_NAMES``."""
        table = np.asarray(traits, np.float64)
        if table.ndim != 2 or table.shape[1] != len(TRAIT_NAMES):
            raise ValueError(f"traits have shape (N, 4), not {table.shape}")
        return cls(*(np.ascontiguousarray(column) for column in table.T))

    def as_array(self) -> NDArray[np.float64]:
        """Shape (N, 4), columns as in ``TRAIT_NAMES``."""
        return np.stack([getattr(self, trait) for trait in TRAIT_NAMES], axis=1)

    def __len__(self) -> int:
        return len(self.beta)


def check_traits(traits: Traits, count: int) -> Traits:
    """Return ``traits`` if they are of ``count`` possible drivers, as a Population must draw them.

    Raises:
        TypeError: no Traits at all.
        ValueError: a trait of another shape, NaN or out of its range, by name.
    """
    if not isinstance(traits, Traits):
        raise TypeError(f"a Population draws Traits, not {traits!r}")
    for trait, allowed in TRAIT_RANGES.items():
        values = np.asarray(getattr(traits, trait))
        if values.shape != (count,) or values.dtype.kind not in "fiu":
            raise ValueError(
                f"drawn traits: {trait} is an array of numbers of shape ({count},), but got "
                f"{values.dtype} of shape {values.shape}"
            )
        right = (values >= allowed.low) & (values <= allowed.high)  # False for NaN too
        if not right.all():
            raise ValueError(
                f"drawn traits: {trait} lies in {allowed}, but got {values[~right][0]}"
            )
    return traits


@runtime_checkable
class Population(Protocol):
    """Anything that drivers can be drawn from, one for each episode."""

    def draw(self, seeds: NDArray[np.uint64]) -> Traits:
        """The drivers of episodes with these seeds; shape (N,) gives N drivers."""
        ...


@dataclass(frozen=True)
class DriverList:
    """A finite population, drawn from evenly. A single driver is a list of one."""

    drivers: tuple[Driver, ...]

    def __post_init__(self) -> None:
        if not isinstance(self.drivers, (list, tuple)):
            raise TypeError(f"DriverList takes a list or tuple of drivers, not {self.drivers!r}")
        if not self.drivers:
            raise ValueError("a population needs at least one driver")
        if len(self.drivers) > MOST_DRIVERS:
            raise ValueError(f"drivers are at most {MOST_DRIVERS}, but got {len(self.drivers)}")
        object.__setattr__(self, "drivers", tuple(get_driver(driver) for driver in self.drivers))

    def draw(self, seeds: NDArray[np.uint64]) -> Traits:
        """See :meth:`Population.draw`."""
        which = (uniform(seeds, Stream.TRAITS) * len(self.drivers)).astype(np.int64)
        return Traits(*self._columns[:, which])

    @cached_property
    def _columns(self) -> NDArray[np.float64]:
        """Shape (4, number of drivers)."""
        return np.array([driver.traits for driver in self.drivers]).T


@dataclass(frozen=True, eq=False)
class FixedDrivers:
    """A population of fixed drivers: the same in every episode."""

    traits: Traits
    """Traits of the drivers of N teams."""

    def draw(self, seeds: NDArray[np.uint64]) -> Traits:
        """See :meth:`Population.draw`; the seeds change nothing."""
        return self.traits


@dataclass(frozen=True)
class Uniform(Checked):
    """Evenly between ``low`` and ``high``, both in [0, 20]; a constant when they are equal."""

    low: DrawnNumber
    high: DrawnNumber

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.low > self.high:
            raise ValueError(f"Uniform needs low <= high, but got low={self.low}, high={self.high}")

    def _named(self, field: str) -> str:
        return f"Uniform: {field}"

    @property
    def support(self) -> tuple[float, float]:
        """Smallest and largest value that can be drawn."""
        return self.low, self.high

    def quantile(self, u: NDArray[np.float64]) -> NDArray[np.float64]:
        """The inverse distribution function at ``u`` in [0, 1)."""
        return self.low + (self.high - self.low) * u


@dataclass(frozen=True)
class Choice(Checked):
    """One of ``values``, evenly: up to 10,000 numbers in [0, 20]."""

    values: tuple[DrawnNumber, ...]

    def __post_init__(self) -> None:
        super().__post_init__()
        _VALUES("Choice: the number of values", len(self.values))

    def _named(self, field: str) -> str:
        return f"Choice: {field}"

    @property
    def support(self) -> tuple[float, float]:
        """Smallest and largest value that can be drawn."""
        return min(self.values), max(self.values)

    def quantile(self, u: NDArray[np.float64]) -> NDArray[np.float64]:
        """The inverse distribution function at ``u`` in [0, 1)."""
        return np.asarray(self.values, np.float64)[(u * len(self.values)).astype(np.int64)]


@dataclass(frozen=True)
class TraitDistributions(Checked):
    """A continuous population: independent distributions over the four traits."""

    beta: Uniform | Choice = Uniform(0.0, 1.0)
    alpha: Uniform | Choice = Uniform(0.0, 1.0)
    eta: Uniform | Choice = Uniform(0.0, 1.0)
    inflation: Uniform | Choice = Uniform(1.0, 9.0)

    def __post_init__(self) -> None:
        for trait in TRAIT_NAMES:
            distribution = getattr(self, trait)
            if not isinstance(distribution, (Uniform, Choice)):
                raise TypeError(
                    f"TraitDistributions: {trait} is a Uniform or a Choice, not {distribution!r}; "
                    "a constant is a Choice of one value, such as Choice((0.5,))"
                )
            for end in distribution.support:
                TRAIT_RANGES[trait](f"TraitDistributions: {trait}", end)

    def draw(self, seeds: NDArray[np.uint64]) -> Traits:
        """See :meth:`Population.draw`."""
        distributions = [getattr(self, trait) for trait in TRAIT_NAMES]
        return Traits(
            *(d.quantile(uniform(seeds, Stream.TRAITS, k)) for k, d in enumerate(distributions))
        )


def as_population(drivers: str | Driver | Sequence[str | Driver] | Population) -> Population:
    """Return the population of a ``driver=`` keyword's value.

    A name or a :class:`Driver` is a population of one; a list or tuple of them is drawn from
    evenly; a :class:`Population` (such as :class:`TraitDistributions`) is taken as it is.
    """
    if isinstance(drivers, (str, Driver)):
        return DriverList((get_driver(drivers),))
    if isinstance(drivers, Population) and not isinstance(drivers, type):
        return drivers
    if isinstance(drivers, (list, tuple)):
        return DriverList(tuple(get_driver(driver) for driver in drivers))
    raise TypeError(
        "driver= takes a name, a Driver, a list or tuple of them, or a Population (an object with "
        f"draw()), not {drivers!r}"
    )
