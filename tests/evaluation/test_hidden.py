import json

import numpy as np
import pytest

from hmi_marl.cli import main
from hmi_marl.envs.config import TeamConfig
from hmi_marl.evaluation.hidden import HiddenRow, as_good, as_text, revealing_share
from hmi_marl.evaluation.statistics import Estimate


def row(low, high):
    difference = Estimate((low + high) / 2, low, high)
    return HiddenRow("bart", 0.3, {"NoHMI": difference}, difference, difference, -225.0)


def test_a_learned_hmi_is_as_good_unless_its_whole_interval_is_below():
    assert as_good(row(-2.0, 0.5))
    assert as_good(row(1.0, 2.0))
    assert not as_good(row(-2.0, -0.5))
    assert "MISSED" in as_text([row(-2.0, -0.5)])


def test_a_random_driver_reveals_in_four_of_five_steps(tmp_path):
    # a^H is any of five actions; one of them is the last applied one.
    team = TeamConfig(driver="lisa", duration=10.0, ai_sees_attention=False)
    share = revealing_share(team, "random", np.arange(64, dtype=np.uint64))
    assert share == pytest.approx(0.8, abs=4 * np.sqrt(0.16 / (64 * 30)))


@pytest.mark.parametrize("given", [True, False])
def test_the_command_compares_learned_hmis_with_bayes_filters(given, tmp_path, capsys):
    size = ["--hmi-steps", "1", "--driver-steps", "1", "--memory", "4", "--episodes", "4"]
    command = ["reproduce", "hidden", *size, "--teams", "16", "--workers", "1"]
    if given:
        made = ["train", "two-stage", "--teams", "16", "--driver-steps", "1", "--hmi-steps", "1"]
        assert main([*made, "--out", str(tmp_path / "driver-run")]) == 0
        command += ["--driver-run", str(tmp_path / "driver-run")]
    assert main([*command, "--out", str(tmp_path)]) == 0
    content = json.loads((tmp_path / "hidden.json").read_text())
    assert [row["driver"] for row in content["rows"]] == ["lisa", "marge", "bart", "homer"]
    assert "Paired differences" in capsys.readouterr().out
