from dataclasses import dataclass
from typing import Literal

import pytest

from hmi_marl.checks import Checked, Count, CountOrZero, Positive, PositiveOrZero, Share
from hmi_marl.envs.streams import Seed


@dataclass(frozen=True)
class Base(Checked):
    count: Count = 1
    rest: CountOrZero = 0
    free: float = -1.0


@dataclass(frozen=True)
class Settings(Base):
    rate: Positive = 0.1
    weight: PositiveOrZero = 0.0
    share: Share = 1.0
    seed: Seed = 0
    kind: Literal["none", "id"] = "none"


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"count": 0}, "count is at least 1, but got 0"),
        ({"rest": -1}, "rest is at least 0, but got -1"),
        ({"rate": 0.0}, "rate is a positive number, but got 0.0"),
        ({"rate": float("inf")}, "rate is a positive number, but got inf"),
        ({"weight": -0.5}, "weight is a number of at least 0, but got -0.5"),
        ({"share": 1.5}, r"share lies in \[0, 1\], but got 1.5"),
        ({"share": float("nan")}, r"share lies in \[0, 1\], but got nan"),
        ({"seed": -1}, r"a seed lies in \[0, 2\^64\), but got -1"),
        ({"kind": "name"}, "kind is one of none, id, not 'name'"),
    ],
    ids=str,
)
def test_fields_are_checked_by_their_annotations_inherited_ones_too(changed, message):
    with pytest.raises(ValueError, match=message):
        Settings(**changed)


@pytest.mark.parametrize("value", [True, 2.0, float("nan"), "3", None], ids=str)
def test_a_count_is_a_whole_number(value):
    with pytest.raises(TypeError, match="count is a whole number, not"):
        Settings(count=value)


def test_values_within_their_ranges_are_kept():
    assert Settings(3, 2, -5.0, 1.0, 0.5, 0.0, 7, "id").count == 3
