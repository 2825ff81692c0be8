"""Counterbalancing: conditions, places, neighbours and clips come equally often."""

from collections import Counter
from itertools import pairwise

import numpy as np
import pytest

from hmi_marl.people.study.order import CHECK, order, williams


@pytest.mark.parametrize("conditions", range(1, 9))
def test_every_condition_in_every_place_and_after_every_other(conditions):
    design = williams(conditions).tolist()
    assert len(design) == (conditions if conditions % 2 == 0 or conditions == 1 else 2 * conditions)
    places = Counter(place for row in design for place in enumerate(row))
    neighbours = Counter(pair for row in design for pair in pairwise(row))
    assert len(places) == conditions**2
    assert len(set(places.values())) == 1
    assert len(neighbours) == conditions * (conditions - 1)
    assert len(set(neighbours.values())) <= 1


@pytest.mark.parametrize(("conditions", "clips", "shown"), [(6, 10, 2), (5, 7, 3), (2, 2, 1)])
def test_over_a_full_cycle_every_clip_comes_equally_often_in_every_place(conditions, clips, shown):
    raters = len(williams(conditions)) * clips
    orders = [order(number, conditions, clips, shown, seed=3) for number in range(raters)]
    places = Counter()
    for own in orders:
        seen = [place for place in own if place != CHECK]
        assert len(set(seen)) == len(seen) == conditions * shown, "no clip twice"
        for block in range(shown):
            part = seen[block * conditions : (block + 1) * conditions]
            assert {place.condition for place in part} == set(range(conditions))
        places.update(enumerate(seen))
    assert len(places) == (conditions * shown) * (conditions * clips)
    assert set(places.values()) == {len(williams(conditions)) // conditions}


def test_the_attention_check_comes_once_in_the_second_half_in_various_places():
    places = Counter(order(number, 6, 10, 2).index(CHECK) for number in range(200))
    assert set(places) == set(range(6, 12))
    assert min(places.values()) > 15
    assert all(order(number, 6, 10, 2).count(CHECK) == 1 for number in range(50))


def test_orders_are_the_same_again_and_others_with_another_seed():
    assert order(7, 6, 10, 2, seed=1) == order(7, 6, 10, 2, seed=1)
    assert order(7, 6, 10, 2, seed=1) != order(7, 6, 10, 2, seed=2)
    for odd in (-1, 1.5, True):
        with pytest.raises((TypeError, ValueError), match="number"):
            order(odd, 6, 10, 2)
    with pytest.raises(ValueError, match="seed"):
        order(0, 6, 10, 2, seed=-1)


def test_first_row_by_hand():
    assert williams(4)[0].tolist() == [0, 1, 3, 2]
    assert np.array_equal(williams(3)[3], williams(3)[0][::-1])
