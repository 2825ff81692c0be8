"""The experiment "shifts": verdicts, report, files, and the command on a few strangers."""

import json
from dataclasses import replace

import numpy as np
import pytest
from cited import missing

from hmi_marl.cli import main
from hmi_marl.envs.drivers import TRAIT_NAMES
from hmi_marl.experiments.trait_shifts import experiment as running
from hmi_marl.experiments.trait_shifts.errors import shift_row
from hmi_marl.experiments.trait_shifts.experiment import PARTS, TraitShifts
from hmi_marl.experiments.trait_shifts.report import READERS
from hmi_marl.experiments.trait_shifts.scoring import (
    KNOWING,
    LINEAR,
    NETWORK,
    UNAWARE,
    Estimates,
    read_linearly,
    score,
)
from hmi_marl.experiments.trait_shifts.shifts import SHIFTS
from hmi_marl.reporting.blocks import Verdicts, as_text

BY_NAME = {shift.name: shift for shift in SHIFTS}
SIZE = [
    *("--driver-run", "trained:driver", "--shifts", "none", "rule-driver", "drift-large"),
    *("--fitted", "8", "--strangers", "4", "--posteriors", "3", "--windows", "2"),
    *("--sampling.groups", "8", "--sampling.rounds", "1", "--sampling.most-rounds", "1"),
    *("--workers", "1"),
]


@pytest.fixture
def here(monkeypatch):
    """Work in this process."""
    monkeypatch.setattr(running, "calls", lambda f, tasks, workers: (f(*task) for task in tasks))


def found(errors, strangers=300, ranks=None, seed=0):
    """Estimates with errors of these sizes by trait."""
    rng = np.random.default_rng(seed)
    true = rng.uniform(size=(strangers, 4))
    return Estimates(true, true + np.array(errors) * rng.standard_normal(true.shape), ranks, 1.0)


def row(name, errors, knowing=True):
    shift, ranks = BY_NAME[name], np.full((20, 4), 0.5)
    own = {each: found(errors) for each in (NETWORK, LINEAR)}
    own[UNAWARE] = found(errors, 20, ranks)
    if knowing:
        own[KNOWING] = own[UNAWARE]
    before = {each: found([0.1] * 4) for each in (NETWORK, LINEAR)}
    return shift_row(shift.name, shift.what, own, before, tuple(READERS))


def test_verdicts_follow_what_is_kept():
    rows = [
        row("none", [0.1] * 4),
        row("traffic", [0.11] * 4),
        row("rule-driver", [0.11, 0.3, 0.11, 0.11]),
        row("window-5", [0.11, 0.131, 0.11, 0.11]),
    ]
    verdicts = TraitShifts().judge(rows)
    assert [str(v.outcome) for v in verdicts] == ["supported", "not supported", "undetermined"]
    assert [len(v.parts) for v in verdicts] == [4, 4, 4]
    assert "each trait" in verdicts[0].claim


def test_a_trait_of_another_range_is_not_judged():
    moved = row("high-inflation", [0.1] * 4)
    network = moved.readers[NETWORK]
    traits = dict(network.traits)
    traits["inflation"] = replace(traits["inflation"], kept=None)
    readers = dict(moved.readers) | {NETWORK: replace(network, traits=traits)}
    (verdict,) = TraitShifts().judge([row("none", [0.1] * 4), replace(moved, readers=readers)])
    assert len(verdict.parts) == 3
    assert "beta, alpha, eta" in verdict.claim


def test_every_number_of_the_report_has_its_source():
    experiment = TraitShifts()
    rows = [row("none", [0.1] * 4), row("drift-large", [0.2] * 4, knowing=False)]
    blocks = experiment.blocks(rows)
    assert not missing(blocks, experiment.numbers(rows))
    shown = as_text([*blocks, Verdicts(experiment.judge(rows))])
    assert "R² of traits from the exact posterior that knows the shift" in shown
    assert "100, -" in shown  # coverage where only one can be computed


def test_a_line_is_read_by_ridge_regression():
    z = np.random.default_rng(0).standard_normal((60, 8))
    traits = z @ np.arange(32).reshape(8, 4) + 3.0
    np.testing.assert_allclose(read_linearly(z[:40], traits[:40], z[40:]), traits[40:], atol=0.05)


def test_settings_that_cannot_be_are_refused():
    with pytest.raises(ValueError, match="'nope' is none of none, control-driver"):
        TraitShifts(shifts=("none", "nope"))
    with pytest.raises(ValueError, match="'none' among them"):
        TraitShifts(shifts=("traffic",))
    with pytest.raises(ValueError, match="of the strangers, 5 at most, not 24"):
        TraitShifts(strangers=5)
    TraitShifts.quick()


@pytest.mark.usefixtures("here")
def test_the_command_reads_strangers_and_resumes(tmp_path, capsys, monkeypatch):
    command = ["reproduce", "shifts", *SIZE, "--out", str(tmp_path / "out")]
    assert main(command) == 0
    shown = capsys.readouterr().out
    assert "driver policy: rule" in shown
    content = json.loads((tmp_path / "out" / "shifts.json").read_text())
    none, rule, drift = content["shifts"]
    assert list(none["readers"]) == list(rule["readers"]) == list(READERS)
    assert list(drift["readers"]) == [NETWORK, LINEAR, UNAWARE]
    assert none["readers"][KNOWING] == none["readers"][UNAWARE]
    assert rule["readers"][KNOWING] != rule["readers"][UNAWARE]
    for each in content["shifts"]:
        assert each["readers"][NETWORK]["strangers"] == 4
        assert set(each["readers"][UNAWARE]["traits"]) == set(TRAIT_NAMES)
        assert each["readers"][NETWORK]["traits"]["beta"]["kept"] is not None
    assert [v["claim"].rpartition(": ")[2] for v in content["verdicts"]] == [
        "rule",
        BY_NAME["drift-large"].what,
    ]
    parts = sorted(path.name for path in (tmp_path / "out" / PARTS).iterdir())
    assert len(parts) == 7
    # The second time one part alone is made again: the one whose file is damaged.
    (tmp_path / "out" / PARTS / "rule-driver-knowing.json").write_text("{}")
    made = []

    def watched(part, path):
        before = path.stat().st_mtime_ns
        result = score(part, path)
        made.extend([path.stem] * (path.stat().st_mtime_ns != before))
        return result

    monkeypatch.setattr(running, "score", watched)
    assert main(command) == 0
    assert made == ["rule-driver-knowing"]
    again = json.loads((tmp_path / "out" / "shifts.json").read_text())
    assert again["shifts"] == content["shifts"]
