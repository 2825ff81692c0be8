import json
from functools import partial

import numpy as np
import pytest
from cited import missing

from hmi_marl.cli import main
from hmi_marl.envs.config import TeamConfig
from hmi_marl.experiments import experiment
from hmi_marl.experiments import hidden_attention as module
from hmi_marl.experiments.hidden_attention import (
    BAYES_OWN,
    HiddenAttention,
    HiddenRow,
)
from hmi_marl.experiments.signalling import revealing_share
from hmi_marl.reporting.blocks import as_text
from hmi_marl.reporting.statistics import Estimate
from hmi_marl.reporting.verdicts import Outcome


def row(difference, bayes=-200.0):
    """Of an HMI that is ``difference`` better than a Bayes filter that comes to ``bayes``."""
    found = Estimate(difference, difference - 0.2, difference + 0.2, 0.1, 10_000)
    returns = {BAYES_OWN: Estimate(bayes, bayes, bayes)}
    return HiddenRow("bart", 0.3, returns, found, found, found, found, -225.0, -400.0)


def test_a_learned_hmi_is_as_good_within_a_hundredth_of_the_filter():
    supported, not_supported, undetermined = Outcome
    for found, outcome in (
        (row(1.0), supported),
        (row(-1.7), supported),
        (row(-2.0), undetermined),
        (row(-2.3), not_supported),
        (row(-2.3, bayes=1000.0), supported),
    ):
        (verdict,) = HiddenAttention(seeds=1).judge_of([found])
        assert verdict.outcome is outcome


def test_the_exact_worth_of_knowing_the_driver_comes_before_the_learned_one():
    text = as_text(HiddenAttention(seeds=1).blocks_of([row(-1.7)]))
    assert text.index("exact worth of knowing") < text.index("own - AvgHMI, learned")
    assert "+175.0" in text
    numbers = HiddenAttention(seeds=1).numbers_of([row(-1.7)])
    assert numbers["rows"][0]["exact_worth"] == 175.0
    assert not missing(HiddenAttention(seeds=1).blocks_of([row(-1.7)]), numbers)


def test_a_random_driver_reveals_in_four_of_five_steps(tmp_path):
    # a^H is any of five actions; one of them is the last applied one.
    team = TeamConfig(driver="lisa", duration=10.0, ai_sees_attention=False)
    share = revealing_share(team, "random", np.arange(64, dtype=np.uint64))
    assert share == pytest.approx(0.8, abs=4 * np.sqrt(0.16 / (64 * 30)))


@pytest.mark.usefixtures("trained_here")
@pytest.mark.parametrize("given", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_the_command_compares_learned_hmis_with_bayes_filters(given, tmp_path, capsys, monkeypatch):
    for owner, name in ((experiment, "TwoStage"), (module, "TwoStage"), (module, "TeamConfig")):
        monkeypatch.setattr(owner, name, partial(getattr(owner, name), duration=2.0))
    size = ["--hmi-steps", "1", "--driver-steps", "1", "--rnn-hidden-dim", "4", "--episodes", "4"]
    size += ["--num-teams", "16", "--seeds", "1"]
    command = ["reproduce", "hidden", *size, "--workers", "1"]
    if given:
        made = [
            "train",
            "two-stage",
            "--num-teams",
            "16",
            "--duration",
            "2",
            "--driver-steps",
            "1",
            "--hmi-steps",
            "1",
        ]
        assert main([*made, "--out", str(tmp_path / "driver-run")]) == 0
        command += ["--driver-run", str(tmp_path / "driver-run")]
    assert main([*command, "--out", str(tmp_path)]) == 0
    content = json.loads((tmp_path / "hidden.json").read_text())
    drivers = [row["driver"] for row in content["rows"]]
    assert drivers == ["lisa", "marge", "bart", "homer", "average"]
    assert "Paired differences" in capsys.readouterr().out
