import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hmi_marl.experiments.latent_traits.probes import (
    SMALLEST_SPREAD,
    average_kl,
    gaussian_kl,
    kl_matrix,
    separability,
)
from hmi_marl.files import json_value
from hmi_marl.reporting.statistics import share

CORNERS = np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 10.0], [10.0, 10.0]])
TYPES = np.repeat(np.arange(4), 25)


def clusters(seed, spread=0.1):
    """Four clusters of 25, far apart."""
    return CORNERS[TYPES] + spread * np.random.default_rng(seed).normal(size=(100, 2))


def test_kl_in_one_dimension_worked_by_hand():
    # variances 1 and 4, a unit apart: ln 2 + (1 + 1) / 8 - 1/2, and -ln 2 + (4 + 1) / 2 - 1/2
    assert gaussian_kl([0.0], [[1.0]], [1.0], [[4.0]]) == pytest.approx(math.log(2) - 0.25)
    assert gaussian_kl([1.0], [[4.0]], [0.0], [[1.0]]) == pytest.approx(2.0 - math.log(2))


def test_kl_in_two_dimensions_worked_by_hand():
    # trace 1/2 + 1/4, shift 1/2 + 4/4, determinant 8
    kl = gaussian_kl([0.0, 0.0], np.eye(2), [1.0, 2.0], np.diag([2.0, 4.0]))
    assert kl == pytest.approx(0.5 * (0.75 + 1.5 - 2.0 + math.log(8)))
    # the inverse is [[2, -1], [-1, 2]] / 3: trace 4/3, shift 2/3, determinant 3
    kl = gaussian_kl([0.0, 0.0], np.eye(2), [1.0, 1.0], [[2.0, 1.0], [1.0, 2.0]])
    assert kl == pytest.approx(0.5 * math.log(3))


def test_a_gaussian_is_at_no_distance_from_itself():
    cov = [[2.0, 0.5], [0.5, 1.0]]
    assert gaussian_kl([1.0, 2.0], cov, [1.0, 2.0], cov) == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize(
    "cov", [[[1.0, 2.0], [2.0, 1.0]], [[1.0, 0.5], [0.0, 1.0]], [[1.0, 1.0], [1.0, 1.0]]]
)
def test_what_is_no_covariance_is_refused(cov):
    with pytest.raises(ValueError, match="symmetric positive definite"):
        gaussian_kl([0.0, 0.0], np.eye(2), [0.0, 0.0], cov)


def test_gaussians_of_different_shapes_are_refused():
    with pytest.raises(ValueError, match=r"one shape \(Z,\), not \(1,\) and \(2,\)"):
        gaussian_kl([0.0], [[1.0]], [0.0, 0.0], np.eye(2))
    with pytest.raises(ValueError, match=r"has shape \(1, 1\), not \(2, 2\)"):
        gaussian_kl([0.0], [[1.0]], [0.0], np.eye(2))


def test_average_kl_worked_by_hand():
    # means 0 and 1, unbiased variances 1 and 4: the two numbers of the first test
    means, types = [[-1.0], [0.0], [1.0], [-1.0], [1.0], [3.0]], [7, 7, 7, 9, 9, 9]
    matrix = kl_matrix(means, types)
    assert matrix == pytest.approx(
        np.array([[0.0, math.log(2) - 0.25], [2.0 - math.log(2), 0.0]]), abs=1e-12
    )
    assert average_kl(means, types) == pytest.approx(0.875)


@settings(deadline=None, database=None, max_examples=50)
@given(
    st.integers(0, 2**32 - 1), st.integers(1, 4), st.floats(-100, 100), st.sampled_from([1e-3, 1e3])
)
def test_kl_does_not_depend_on_axes_and_units(seed, size, shift, unit):
    rng = np.random.default_rng(seed)
    types = np.repeat([0, 1, 2], 12)
    means = rng.normal(size=(36, size)) + 3.0 * types[:, None]
    turned = np.linalg.qr(rng.normal(size=(size, size)))[0] * rng.uniform(0.5, 2.0, size)
    moved = (means @ turned.T + shift) * unit
    assert kl_matrix(moved, types) == pytest.approx(kl_matrix(means, types), rel=1e-6, abs=1e-9)
    assert (kl_matrix(means, types) >= 0.0).all()


def test_average_kl_of_many_vectors_is_that_of_their_gaussians():
    rng = np.random.default_rng(0)
    vectors = rng.normal(size=(40_000, 2))
    vectors[20_000:] = vectors[20_000:] * [1.0, 2.0] + [3.0, 0.0]
    # 3² / 2 either way, and (1/4 - 1 + ln 4) / 2, (4 - 1 - ln 4) / 2
    wanted = 4.5 + (0.25 - 1.0 + 4.0 - 1.0) / 4
    assert average_kl(vectors, np.repeat([0, 1], 20_000)) == pytest.approx(wanted, rel=0.03)


def test_a_type_on_a_line_is_thickened_and_far_from_the_rest():
    rng = np.random.default_rng(0)
    means, types = rng.normal(size=(40, 2)), np.repeat([0, 1], 20)
    means[:20, 1] = 2.0 * means[:20, 0]
    assert 1.0 / SMALLEST_SPREAD < average_kl(means, types) < 1.0 / SMALLEST_SPREAD**2
    means[:20] = 0.5
    assert math.isfinite(average_kl(means, types))


def test_axes_that_tell_nothing_are_left_out():
    means = clusters(0)
    padded = np.concatenate([means, np.full((100, 1), 0.1)], axis=1)
    assert average_kl(padded, TYPES) == pytest.approx(average_kl(means, TYPES))


def test_a_gaussian_takes_two_vectors_more_than_dimensions():
    rng = np.random.default_rng(0)
    types = np.array([0] * 10 + [1] * 3)
    with pytest.raises(ValueError, match="takes 4 vectors of each type or more, but type 1 has 3"):
        average_kl(rng.normal(size=(13, 2)), types)
    assert average_kl(rng.normal(size=(13, 1)), types) > 0.0


def test_clusters_far_apart_are_kept_apart_by_every_measure():
    found = separability(clusters(0), TYPES, clusters(1), TYPES)
    assert found.linear_probe == found.nearest_centroid == share(100, 100)
    assert found.chance == 0.25
    assert found.silhouette > 0.97
    assert found.adjusted_rand == 1.0
    # about 100 standard deviations along one axis or both: 100² / 2 × (2 × 1 + 2) / 3
    assert found.average_kl == pytest.approx(100**2 / 2 * 4 / 3, rel=0.4)


def test_shuffled_types_are_told_apart_by_chance():
    rng = np.random.default_rng(0)
    types, train_types = rng.permutation(TYPES), rng.permutation(TYPES)
    found = separability(clusters(0), train_types, clusters(1), types)
    for accuracy in (found.linear_probe, found.nearest_centroid):
        assert accuracy.mean == pytest.approx(0.25, abs=4 * math.sqrt(0.25 * 0.75 / 100))
    assert abs(found.adjusted_rand) < 0.1
    assert found.silhouette < 0.0
    assert found.average_kl < 1.0


def test_labels_of_types_can_be_any_integers():
    plain = separability(clusters(0), TYPES, clusters(1, spread=4.0), TYPES)
    other = separability(clusters(0), 7 - 3 * TYPES, clusters(1, spread=4.0), 7 - 3 * TYPES)
    assert plain.nearest_centroid.mean < 1.0
    assert plain.nearest_centroid == other.nearest_centroid
    assert plain.linear_probe == other.linear_probe
    assert plain.average_kl == pytest.approx(other.average_kl)


def test_vectors_that_have_collapsed_tell_nothing():
    found = separability(np.full((100, 2), 0.1), TYPES, np.full((100, 2), 0.1), TYPES)
    assert found.linear_probe.mean == found.nearest_centroid.mean == found.chance == 0.25
    assert found.silhouette == found.adjusted_rand == found.average_kl == 0.0


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
