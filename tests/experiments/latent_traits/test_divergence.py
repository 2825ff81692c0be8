"""KL between types, and the standard error of its logarithm."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hmi_marl.experiments.latent_traits.divergence import (
    SMALLEST_SPREAD,
    average_kl,
    estimated_kl,
    gaussian_kl,
    kl_matrix,
    kl_ratio_of,
    kl_without_one,
    log_error,
)
from hmi_marl.reporting import statistics

TYPES = np.repeat(np.arange(4), 25)


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
    means = np.random.default_rng(0).normal(size=(100, 2)) + TYPES[:, None]
    padded = np.concatenate([means, np.full((100, 1), 0.1)], axis=1)
    assert average_kl(padded, TYPES) == pytest.approx(average_kl(means, TYPES))


def test_a_gaussian_takes_two_vectors_more_than_dimensions():
    rng = np.random.default_rng(0)
    types = np.array([0] * 10 + [1] * 3)
    with pytest.raises(ValueError, match="takes 4 vectors of each type or more, but type 1 has 3"):
        average_kl(rng.normal(size=(13, 2)), types)
    assert average_kl(rng.normal(size=(13, 1)), types) > 0.0


# The standard error of the logarithm, by leaving out one vector at a time.


def left_out(means, types):
    """The KL without each vector, one after the other, sorted by type."""
    order = np.argsort(types, kind="stable")
    return [kl_matrix(np.delete(means, k, axis=0), np.delete(types, k)) for k in order]


def test_the_error_worked_by_hand():
    # Types -1, 0, 1, 2 and 3, 4, 5, 6: variances 5/3, means 0.5 and 4.5. Without an outer vector of
    # one type: variance 1 and a mean 0.5 further off or nearer, without an inner one: variance 7/3
    # and 1/6 further off or nearer.
    means = np.array([[-1.0], [0.0], [1.0], [2.0], [3.0], [4.0], [5.0], [6.0]])
    types = np.repeat([0, 1], 4)

    def both(variance, apart):
        """Average KL of N(0, variance) and N(apart, 5/3), both ways."""
        whole = 5 / 3
        one = (variance + apart**2) / whole - 1 + math.log(whole / variance)
        other = (whole + apart**2) / variance - 1 + math.log(variance / whole)
        return (one + other) / 4

    assert average_kl(means, types) == pytest.approx(both(5 / 3, 4.0)) == 4.8
    cases = ((1.0, 3.5), (7 / 3, 4 - 1 / 6), (7 / 3, 4 + 1 / 6), (1.0, 4.5))
    logs = [math.log(both(variance, apart)) for variance, apart in cases]
    squares = sum((each - sum(logs) / 4) ** 2 for each in logs)
    wanted = math.sqrt(2 * 3 / 4 * squares)  # of both types, which mirror each other
    found = estimated_kl(means, types)
    assert (found.mean, found.error) == pytest.approx((4.8, wanted))
    assert found.count == 8
    half = 2.364624 * wanted  # Student's t of 7 degrees of freedom
    assert np.log([found.low, found.high]) == pytest.approx(
        [math.log(4.8) - half, math.log(4.8) + half], abs=1e-5
    )


@settings(deadline=None, database=None, max_examples=20)
@given(st.integers(0, 2**32 - 1), st.integers(1, 4))
def test_leaving_out_is_as_if_a_vector_were_not_there(seed, size):
    rng = np.random.default_rng(seed)
    types = rng.permutation(np.repeat([0, 1, 2], [size + 3, size + 5, 12]))
    means = rng.normal(size=(len(types), size)) * rng.uniform(0.1, 10.0, size) + types[:, None]
    found = np.concatenate(kl_without_one(means, types))
    assert found == pytest.approx(np.array(left_out(means, types)), rel=1e-6, abs=1e-9)


def test_the_error_does_not_depend_on_axes_and_units():
    rng = np.random.default_rng(1)
    means = rng.normal(size=(100, 3)) + 2.0 * TYPES[:, None]
    moved = means @ np.linalg.qr(rng.normal(size=(3, 3)))[0] * [1.0, 1e3, 1e-3] + 5.0
    plain, turned = estimated_kl(means, TYPES), estimated_kl(moved, TYPES)
    assert turned.error == pytest.approx(plain.error, rel=1e-6)
    assert turned.mean == pytest.approx(plain.mean, rel=1e-6)


def test_a_type_on_a_line_has_an_error_and_an_interval():
    rng = np.random.default_rng(0)
    means, types = rng.normal(size=(40, 2)), np.repeat([0, 1], 20)
    means[:20, 1] = 2.0 * means[:20, 0]
    found = estimated_kl(means, types)
    assert 0.0 < found.error < math.inf
    assert found.low < found.mean < found.high < math.inf
    means[0] = [50.0, 0.0]  # without this one the type is on a line
    assert math.isfinite(estimated_kl(means, types).error)


def simulated(rng, count, size):
    """Vectors of three Gaussians that differ in means and in spread."""
    spreads, shifts = np.array([1.0, 1.5, 0.7]), np.array([0.0, 2.0, 4.0])
    types = np.repeat([0, 1, 2], count)
    return rng.normal(size=(3 * count, size)) * spreads[types, None] + shifts[types, None], types


def true_kl(size, blur=0.0):
    gaussians = [(m, s * s + blur**2) for m, s in ((0.0, 1.0), (2.0, 1.5), (4.0, 0.7))]
    eye, ones = np.eye(size), np.ones(size)
    pairs = itertools.permutations(gaussians, 2)
    return np.mean([gaussian_kl(m * ones, s * eye, n * ones, t * eye) for (m, s), (n, t) in pairs])


@pytest.mark.parametrize(("count", "size"), [(75, 2), pytest.param(300, 4, marks=pytest.mark.slow)])
def test_the_error_is_the_spread_over_samples_and_intervals_hold_the_true_kl(count, size):
    """Of 300 samples of Gaussians with a known KL."""
    rng, logs, errors, missed = np.random.default_rng(count), [], [], 0
    for _ in range(300):
        found = estimated_kl(*simulated(rng, count, size))
        logs.append(math.log(found.mean))
        errors.append(found.error)
        missed += not found.low <= true_kl(size) <= found.high
    spread = float(np.std(logs, ddof=1))
    # The spread of 300 normal values is known to 4 %.
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(spread, rel=0.16)
    assert missed <= 15 + 4 * math.sqrt(15)  # few vectors take the KL a little too high


def test_the_error_of_a_ratio_within_one_training_is_that_of_its_logarithm():
    def ratio(kl):
        return kl[:, 0, 1] / kl[:, 2, 1]

    rng, logs, errors = np.random.default_rng(3), [], []
    for _ in range(200):
        vectors, types = simulated(rng, 75, 2)
        logs.append(math.log(ratio(kl_matrix(vectors, types)[None])[0]))
        errors.append(log_error(vectors, types, ratio))
    assert np.mean(errors) == pytest.approx(np.std(logs, ddof=1), rel=0.2)


def test_ratios_over_seeds_keep_the_luck_of_the_vectors_of_both():
    ones = [statistics.by_logarithm(20.0, 0.3, 300)] * 5  # no spread over seeds
    others = [statistics.by_logarithm(10.0, 0.4, 200)] * 6
    found = kl_ratio_of(ones, others)
    assert (found.mean, found.count) == (pytest.approx(2.0), 5)
    assert (found.error, found.luck) == pytest.approx((0.5, 0.5))
    assert found.luck_count == 200
    half = math.log(found.high / found.mean)
    assert half == pytest.approx(1.972 * 0.5, abs=1e-3)
    nothing = [statistics.by_logarithm(0.0, 0.0, 300)] * 2  # all vectors agree
    assert kl_ratio_of(nothing, nothing).mean == pytest.approx(1.0)


def test_intervals_over_trainings_that_share_vectors_hold_the_true_kl():
    """Of 100 experiments of two settings and five seeds, each of which blurs the same vectors."""
    rng, missed, too_narrow = np.random.default_rng(5), 0, 0
    true = math.log(true_kl(2, 0.1))
    for _ in range(100):
        vectors, types = simulated(rng, 60, 2)
        blurred = vectors + 0.1 * rng.normal(size=(10, *vectors.shape))
        found = [estimated_kl(each, types) for each in blurred]
        over = statistics.geometric_mean_of_same(found[:5])
        missed += not math.log(over.low) <= true <= math.log(over.high)
        ratio = kl_ratio_of(found[:5], found[5:])
        missed += not ratio.low <= 1.0 <= ratio.high
        alone = statistics.mean([math.log(each.mean) for each in found[:5]])
        too_narrow += not alone.low <= true <= alone.high
    assert missed <= 10 + 4 * math.sqrt(10)
    assert too_narrow > 30, "without the luck of the vectors"
