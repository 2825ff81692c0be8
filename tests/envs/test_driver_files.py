"""Drivers in files, and where their paths are taken."""

import json
from dataclasses import replace

import pytest

from hmi_marl.agents.catalogue import is_learned, make_hmi
from hmi_marl.cli import main
from hmi_marl.demonstrations.recording import CollectSettings
from hmi_marl.envs.config import VEHICLE_AI, TeamConfig
from hmi_marl.envs.driver_files import FORMAT, write_driver
from hmi_marl.envs.drivers import Driver, get_driver, spelled_out
from hmi_marl.exact.oracle import solve_alerts

PERSON = Driver("visitor-17", 0.04, 0.1 + 0.2, 0.15, 5.25)


@pytest.fixture
def path(tmp_path):
    write_driver(tmp_path / "measured" / "Visitor-17.json", PERSON, {"trips": 15})
    return tmp_path / "measured" / "Visitor-17.json"


def test_a_file_stands_for_its_driver(path):
    assert get_driver(str(path)) == PERSON
    assert TeamConfig(driver=str(path)).only_driver == PERSON
    assert solve_alerts(str(path)).driver == PERSON


def test_a_driver_is_spelled_out_exactly():
    assert get_driver(spelled_out(PERSON)) == PERSON


def test_settings_keep_the_traits_and_not_the_path(path):
    settings = CollectSettings(drivers=("lisa", str(path)))
    path.unlink()
    assert settings.drivers == ("lisa", spelled_out(PERSON))
    assert settings.cast()[1][0] == PERSON


def test_hmis_take_the_path(path):
    assert not is_learned(f"optimal:{path}", VEHICLE_AI)
    for kind in ("optimal", "belief"):
        assert make_hmi(f"{kind}:{path}", TeamConfig()).model == PERSON
    assert make_hmi(f"belief:{path}:0.5", TeamConfig()).model == PERSON


def test_a_file_written_by_hand_needs_no_checksum(tmp_path):
    path = tmp_path / "mona.json"
    traits = {"name": "mona", "beta": 0.1, "alpha": 0.5, "eta": 0, "inflation": 2}
    path.write_text(json.dumps({"format": FORMAT, "driver": traits}))
    assert get_driver(str(path)) == Driver("mona", 0.1, 0.5, 0.0, 2.0)


def test_a_command_takes_the_path(path, tmp_path, capsys):
    assert main(["oracle", "--driver", str(path), "--horizon", "5", "--out", str(tmp_path)]) == 0
    assert "visitor-17: β = 0.04, α = 0.3" in capsys.readouterr().out


def altered(**changes):
    traits = {"name": "mona", "beta": 0.1, "alpha": 0.5, "eta": 0.0, "inflation": 2.0}
    return json.dumps({"format": FORMAT, "driver": traits | changes})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "is no JSON file"),
        ("[]", "a mapping whose format is 'hmi-marl driver 1'"),
        ('{"format": "hmi-marl driver 2"}', "a mapping whose format is"),
        (json.dumps({"format": FORMAT}), "a mapping, not None"),
        (altered(beta=2), "driver 'mona': beta lies in"),
        (altered(beta="much"), "beta is a finite number"),
        (altered(gamma=1), "unknown fields: .'gamma'"),
        (altered(name="../mona"), "name in a file has up to 64 of"),
        (altered()[:-1] + ', "sha256": "0"}', "its checksum differs"),
        (altered()[:-1] + ', "more": 1}', "unknown fields: .'more'"),
    ],
)
def test_a_bad_file_is_refused_in_one_line(text, message, tmp_path):
    path = tmp_path / "mona.json"
    path.write_text(text)
    with pytest.raises(ValueError, match=message) as caught:
        get_driver(str(path))
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_files_and_folders_are_named(tmp_path):
    with pytest.raises(ValueError, match=r"there is no driver file .*nobody\.json"):
        get_driver(str(tmp_path / "nobody.json"))
    (tmp_path / "folder.json").mkdir()
    with pytest.raises(ValueError, match=r"folder\.json"):
        get_driver(str(tmp_path / "folder.json"))


def test_only_what_can_be_read_is_written(tmp_path):
    with pytest.raises(ValueError, match=r"ends in \.json"):
        write_driver(tmp_path / "mona.txt", PERSON)
    with pytest.raises(ValueError, match="up to 64 of"):
        write_driver(tmp_path / "mona.json", replace(PERSON, name="a b"))
