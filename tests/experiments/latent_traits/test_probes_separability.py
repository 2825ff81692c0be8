import json
import math

import numpy as np
import pytest

from hmi_marl.experiments.latent_traits.divergence import estimated_kl
from hmi_marl.experiments.latent_traits.probes import (
    separability,
)
from hmi_marl.files import json_value
from hmi_marl.reporting.statistics import share

CORNERS = np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 10.0], [10.0, 10.0]])
TYPES = np.repeat(np.arange(4), 25)


def clusters(seed, spread=0.1):
    """Four clusters of 25, far apart."""
    return CORNERS[TYPES] + spread * np.random.default_rng(seed).normal(size=(100, 2))


def test_clusters_far_apart_are_kept_apart_by_every_measure():
    found = separability(clusters(0), TYPES, clusters(1), TYPES)
    assert found.linear_probe == found.nearest_centroid == share(100, 100)
    assert found.chance == 0.25
    assert found.silhouette > 0.97
    assert found.adjusted_rand == 1.0
    # about 100 standard deviations along one axis or both: 100² / 2 × (2 × 1 + 2) / 3
    assert found.average_kl.mean == pytest.approx(100**2 / 2 * 4 / 3, rel=0.4)
    assert found.average_kl == estimated_kl(clusters(1), TYPES)


def test_shuffled_types_are_told_apart_by_chance():
    rng = np.random.default_rng(0)
    types, train_types = rng.permutation(TYPES), rng.permutation(TYPES)
    found = separability(clusters(0), train_types, clusters(1), types)
    for accuracy in (found.linear_probe, found.nearest_centroid):
        assert accuracy.mean == pytest.approx(0.25, abs=4 * math.sqrt(0.25 * 0.75 / 100))
    assert abs(found.adjusted_rand) < 0.1
    assert found.silhouette < 0.0
    assert found.average_kl.mean < 1.0


def test_labels_of_types_can_be_any_integers():
    plain = separability(clusters(0), TYPES, clusters(1, spread=4.0), TYPES)
    other = separability(clusters(0), 7 - 3 * TYPES, clusters(1, spread=4.0), 7 - 3 * TYPES)
    assert plain.nearest_centroid.mean < 1.0
    assert plain.nearest_centroid == other.nearest_centroid
    assert plain.linear_probe == other.linear_probe
    assert plain.average_kl.mean == pytest.approx(other.average_kl.mean)
    assert plain.average_kl.error == pytest.approx(other.average_kl.error)


def test_vectors_that_have_collapsed_tell_nothing():
    found = separability(np.full((100, 2), 0.1), TYPES, np.full((100, 2), 0.1), TYPES)
    assert found.linear_probe.mean == found.nearest_centroid.mean == found.chance == 0.25
    assert found.silhouette == found.adjusted_rand == found.average_kl.mean == 0.0
    assert found.average_kl.error == 0.0


def test_intervals_count_groups_as_trials():
    arguments = clusters(0), TYPES, clusters(1), TYPES
    grouped = separability(*arguments, groups=np.arange(100) // 10)
    assert grouped.linear_probe == share(10, 10)
    alone = separability(*arguments, groups=np.arange(100))
    assert alone == separability(*arguments)


def test_intervals_of_groups_are_rounded_outwards():
    # one of 100 vectors lies with another type: 9.9 of 10 groups are right
    vectors = clusters(1)
    vectors[0] = CORNERS[3]
    found = separability(clusters(0), TYPES, vectors, TYPES, groups=np.arange(100) // 10)
    assert found.nearest_centroid.mean == 0.99
    assert found.nearest_centroid.low == share(9, 10).low
    assert found.nearest_centroid.high == share(10, 10).high


def test_json_holds_every_measure():
    content = json.loads(
        json.dumps(json_value(separability(clusters(0), TYPES, clusters(1), TYPES)))
    )
    assert content["linear_probe"] == share(100, 100).as_json()
    assert set(content) == {
        "linear_probe", "nearest_centroid", "chance", "silhouette", "adjusted_rand", "average_kl"
    }  # fmt: skip


@pytest.mark.parametrize(
    ("means", "types", "message"),
    [
        (np.zeros(100), TYPES, r"shape \(P, Z\), not \(100,\)"),
        (np.zeros((0, 2)), TYPES[:0], r"shape \(P, Z\), not \(0, 2\)"),
        (np.full((100, 2), math.nan), TYPES, "finite, but 200 numbers are not"),
        (np.zeros((100, 2)), TYPES[:99], r"100 vectors have 100 types, not \(99,\)"),
        (np.zeros((100, 2)), TYPES * 1.0, "integers, not float64"),
        (np.zeros((100, 2)), TYPES * 0, "two types or more"),
        (np.zeros((100, 2)), TYPES // 2, r"types \[0, 1, 2, 3\], but held out are \[0, 1\]"),
        (np.zeros((100, 3)), TYPES, "2 dimensions, held-out ones 3"),
        (np.zeros((6, 2)), np.array([0, 1, 2, 2, 3, 3]), "4 vectors of each type or more"),
    ],
)
def test_vectors_that_do_not_fit_are_refused(means, types, message):
    with pytest.raises(ValueError, match=message):
        separability(clusters(0), TYPES, means, types)


def test_groups_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match=r"groups have shape \(100,\) as types have, not \(3,\)"):
        separability(clusters(0), TYPES, clusters(1), TYPES, groups=[1, 2, 3])
