"""Errors of estimates under a shift, against values by hand."""

import numpy as np
import pytest

from hmi_marl.experiments.criteria import KEPT_R2
from hmi_marl.experiments.trait_shifts.errors import explained, reader_errors, shift_row
from hmi_marl.experiments.trait_shifts.scoring import Estimates


def estimates(error=0.0, shift=0.0, ranks=None, strangers=40, seed=0):
    """Estimates of drawn traits with errors of this size and bias."""
    rng = np.random.default_rng(seed)
    true = rng.uniform(size=(strangers, 4))
    return Estimates(true, true + shift + error * rng.standard_normal(true.shape), ranks)


def r2(found, trait=0):
    true, read = found.true[:, trait], found.read[:, trait]
    return 1 - ((read - true) ** 2).sum() / ((true - true.mean()) ** 2).sum()


def test_r2_error_and_bias():
    found = estimates(0.1, 0.05)
    errors = reader_errors(found, None).traits["beta"]
    wrong = found.read[:, 0] - found.true[:, 0]
    assert errors.r2.mean == pytest.approx(r2(found))
    assert errors.r2.low < errors.r2.mean < errors.r2.high
    assert errors.error.mean == pytest.approx(np.abs(wrong).mean())
    assert errors.bias.mean == pytest.approx(wrong.mean())
    assert errors.kept is None
    assert errors.coverage is None
    assert errors.error.count == 40


def test_what_is_kept_is_paired_by_stranger():
    before, after = estimates(0.1), estimates(0.2)
    kept = reader_errors(after, before).traits["alpha"].kept
    assert kept.mean == pytest.approx(r2(after, 1) - KEPT_R2 * r2(before, 1))
    same = reader_errors(before, before).traits["alpha"].kept
    _, deviations = explained(before.true[:, 1], (before.read - before.true)[:, 1])
    assert same.error == pytest.approx((1 - KEPT_R2) * deviations.std(ddof=1) / np.sqrt(40))
    assert same.error < kept.error  # since strangers are the same


def test_nothing_is_kept_of_a_trait_that_strangers_have_otherwise():
    before, after = estimates(0.1), estimates(0.1)
    after.true[:, 3] += 8.0
    kept = {name: e.kept for name, e in reader_errors(after, before).traits.items()}
    assert kept["inflation"] is None
    assert kept["eta"].mean == pytest.approx((1 - KEPT_R2) * r2(before, 2))


def test_coverage_counts_the_truths_within_the_interval():
    ranks = np.full((40, 4), 0.5)
    ranks[:10, 2] = 0.98  # the interval of 95 % ends at 0.975
    traits = reader_errors(estimates(0.1, ranks=ranks), None).traits
    assert traits["beta"].coverage.mean == 1.0
    assert traits["eta"].coverage.mean == 0.75


def test_readers_without_estimates_are_left_out():
    row = shift_row("n", "w", {"b": estimates(0.1)}, {"a": estimates(0.1)}, ("a", "b"))
    assert list(row.readers) == ["b"]
    assert row.readers["b"].traits["beta"].kept is None
    assert row.readers["b"].strangers == 40
