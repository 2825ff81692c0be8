from dataclasses import dataclass
from fractions import Fraction
from typing import Annotated, Literal

import numpy as np
import pytest

from hmi_marl.checks import Checked, Count, CountOrZero, Names, Real, Share, Weight, Whole, shown
from hmi_marl.envs.streams import Seed


@dataclass(frozen=True)
class Part:
    size: int = 1


@dataclass(frozen=True)
class Base(Checked):
    count: Count = 1
    rest: CountOrZero = 0
    free: float = -1.0


@dataclass(frozen=True)
class Settings(Base):
    rate: Annotated[float, Real(0.0, 10.0, "1/s", above=True)] = 0.1
    width: Annotated[float, Real(1.0, 2.0, below=True, or_zero=True)] = 0.0
    weight: Weight = 0.0
    share: Share = 1.0
    seed: Seed = 0
    kind: Literal["none", "id"] = "none"
    flag: bool = True
    sizes: tuple[Count, ...] = (1,)
    pair: tuple[CountOrZero, Share] | None = None
    part: Part = Part()


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"count": 0}, "count lies in 1 to 1000000, but got 0"),
        ({"count": 10**400}, r"count lies in 1 to 1000000, but got about 10\^400"),
        ({"rest": -1}, "rest lies in 0 to 1000000, but got -1"),
        ({"rate": 0.0}, r"rate lies in \(0, 10\] 1/s, but got 0.0"),
        ({"rate": float("inf")}, r"rate lies in \(0, 10\] 1/s, but got inf"),
        ({"rate": 10**400}, r"rate lies in \(0, 10\] 1/s, but got about 10\^400"),
        ({"rate": Fraction(10**400)}, r"rate lies in \(0, 10\] 1/s, but got Fraction\(1000"),
        ({"width": 2.0}, r"width lies in \[1, 2\) or is 0, but got 2.0"),
        ({"width": 0.5}, r"width lies in \[1, 2\) or is 0, but got 0.5"),
        ({"weight": -0.5}, r"weight lies in \[0, 1e\+06\], but got -0.5"),
        ({"share": 1.5}, r"share lies in \[0, 1\], but got 1.5"),
        ({"share": float("nan")}, r"share lies in \[0, 1\], but got nan"),
        ({"seed": -1}, r"a seed lies in \[0, 2\^64\), but got -1"),
        ({"kind": "name"}, "kind is one of none, id, not 'name'"),
        ({"sizes": (1, 0)}, "each of sizes lies in 1 to 1000000, but got 0"),
        ({"pair": (1, 2)}, r"pair\[1\] lies in \[0, 1\], but got 2"),
        ({"pair": (1, 2, 3)}, r"pair has 2 numbers, but got \(1, 2, 3\)"),
    ],
    ids=str,
)
def test_fields_are_checked_by_their_annotations_inherited_ones_too(changed, message):
    with pytest.raises(ValueError, match=message):
        Settings(**changed)


@pytest.mark.parametrize("value", [True, np.True_, 2.0, np.nan, "3", None, 1j, [1], np.array(1)])
def test_a_count_is_a_whole_number(value):
    with pytest.raises(TypeError, match="count is a whole number, not"):
        Settings(count=value)


@pytest.mark.parametrize("value", [True, np.True_, "1", None, 1j, [1.0], np.array(1.0)])
def test_a_rate_is_a_number(value):
    with pytest.raises(TypeError, match="rate is a number, not"):
        Settings(rate=value)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"flag": 1}, "flag is True or False, not 1"),
        ({"sizes": 3}, "sizes is a tuple of numbers, not 3"),
        ({"part": 3}, "part is a Part, not 3"),
        ({"part": None}, "part is a Part, not None"),
    ],
)
def test_other_fields_are_of_their_types(changed, message):
    with pytest.raises(TypeError, match=message):
        Settings(**changed)


def test_values_within_their_ranges_are_kept():
    assert Settings(3, 2, -5.0, 1.0, 0.0, 0.5, 0.0, 7, "id").count == 3
    assert Settings(pair=[2, 1]).pair == (2, 1.0)


def test_numbers_of_numpy_become_those_of_python():
    settings = Settings(count=np.uint8(3), rate=np.float32(0.5), share=1, flag=np.False_)
    assert [type(v) for v in (settings.count, settings.rate, settings.share)] == [int, float, float]
    assert settings.flag is False
    assert Settings(rate=Fraction(1, 2)).rate == 0.5


def test_ends_are_part_of_a_range_unless_they_are_left_out():
    assert [Whole(1, 3)("x", number) for number in (1, 3)] == [1, 3]
    assert Real(0.0, 1.0)("x", 1) == 1.0
    for end in (0.0, 1.0):
        with pytest.raises(ValueError, match="x lies in"):
            Real(0.0, 1.0, above=True, below=True)("x", end)


def test_names_are_different_known_ones():
    names = Names(("none", "more", "less"), needed="none")
    assert names("shifts", ("none", "less")) == ("none", "less")
    assert str(names) == "none and others by name"
    for wrong, message in (
        (("none", "x"), "shifts: 'x' is none of none, more, less"),
        (("none", "none"), "one or more different ones"),
        ((), "one or more different ones"),
        (("more",), "need 'none' among them"),
    ):
        with pytest.raises(ValueError, match=message):
            names("shifts", wrong)


def test_values_are_shown_in_one_short_line():
    assert shown("a\nb") == r"'a\nb'"
    assert shown(np.zeros((5, 5))) == "array([[0., 0., 0., 0., 0.], [0., 0., 0., 0., 0.], [0., 0..."
    assert shown(-(10**5000)) == "about -10^5000"  # more digits than Python writes
    assert shown([10**5000]) == "a list"
