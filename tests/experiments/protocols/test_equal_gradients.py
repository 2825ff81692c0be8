"""Protocols minus two-stage at equal gradient steps."""

from dataclasses import replace
from pathlib import Path

import pytest
from comparisons import SMALL, comparison

from hmi_marl.experiments.protocols.equal_gradients import at_equal_gradients
from hmi_marl.experiments.protocols.results import Comparison, Training, gradient_steps
from hmi_marl.experiments.protocols.tables import equal_gradients_table


def test_smaller_budgets_are_compared_at_equal_gradient_steps():
    settings = replace(SMALL, budgets=(4_000_000,), seeds=3, few_seeds=2)
    results = comparison(settings).tasks["hidden"]
    training = {
        run.name: Training(
            results.plan.budget(results.plan.arms[run.arm]).steps,
            gradient_steps(results.plan.training(run, Path())),
            1.0,
        )
        for run in results.plan.runs
    }
    (row,) = at_equal_gradients(
        Comparison(settings, {"hidden": replace(results, training=training)})
    )
    assert row.protocol == "simultaneous"
    assert row.steps == pytest.approx(4_000_000, rel=0.05)
    assert row.two_stage_steps == pytest.approx(8_000_000, rel=0.05)
    assert row.gradient_steps == pytest.approx(row.two_stage_gradient_steps, rel=0.1)
    assert row.difference.pairs == 2
    assert equal_gradients_table([row]).rows[0][:2] == ["hidden", "simultaneous"]


def test_equal_budgets_have_no_second_account():
    assert at_equal_gradients(comparison(SMALL)) == []
