import json
from dataclasses import replace
from pathlib import Path

import pytest
from trait_models import save_driver

from hmi_marl.demonstrations.parquet import sha256_of
from hmi_marl.training.protocols.two_stage import TwoStage
from hmi_marl.training.runs.folder import check_same, run_settings


def about(settings: TwoStage) -> dict:
    return {"version": "1", "settings": run_settings(settings), "command": "any"}


def test_whose_driver_a_run_takes_is_told_by_checksum_and_not_by_place(tmp_path: Path) -> None:
    settings = TwoStage(driver_policy=str(save_driver(tmp_path / "mine")))
    content = run_settings(settings)
    weights = tmp_path / "mine" / "driver.safetensors"
    assert content["driver_policy"] == {"name": "mine", "sha256": sha256_of(weights)}
    assert str(tmp_path) not in json.dumps(content)
    assert run_settings(TwoStage(driver_policy="rule"))["driver_policy"] == "rule"
    assert run_settings(TwoStage())["driver_policy"] is None
    shipped = run_settings(TwoStage(driver_policy="trained:Driver"))["driver_policy"]
    assert shipped["name"] == "trained:driver"


def test_the_same_driver_elsewhere_goes_on_and_another_is_refused(tmp_path: Path) -> None:
    settings = TwoStage(driver_policy=str(save_driver(tmp_path / "mine")))
    before = about(settings)
    moved = replace(settings, driver_policy=str(save_driver(tmp_path / "moved")))
    check_same(before, about(moved), tmp_path)
    other = replace(settings, driver_policy=str(save_driver(tmp_path / "other", 7)))
    with pytest.raises(ValueError, match=r"holds another run .*driver_policy"):
        check_same(before, about(other), tmp_path)
    with pytest.raises(FileNotFoundError, match="no policy for the seat of driver"):
        run_settings(replace(settings, driver_policy=str(tmp_path / "nowhere")))
