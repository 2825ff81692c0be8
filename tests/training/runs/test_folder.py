import json
from dataclasses import replace
from pathlib import Path

import pytest
from trait_models import save_driver, untrained

from hmi_marl.agents.learned.trait_model import load_traits, save_traits
from hmi_marl.demonstrations.dataset import observed_layout
from hmi_marl.envs.config import TeamConfig
from hmi_marl.files import sha256_of
from hmi_marl.training.evidence.settings import EvidenceSettings
from hmi_marl.training.protocols.two_stage import TwoStage
from hmi_marl.training.runs.folder import (
    CHECKPOINT,
    check_same,
    partners_of,
    read_curve,
    read_settings,
    run_settings,
    seconds_of,
    settings_digest,
)


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


def test_a_trait_model_is_noted_in_the_same_way(tmp_path: Path) -> None:
    mine, moved, other = (tmp_path / name for name in ("mine", "moved", "other"))
    for folder, seed in ((mine, 0), (moved, 0), (other, 1)):
        model = untrained(observed_layout(TeamConfig()), seed)
        save_traits(folder, model.card, model.weights)
    settings = EvidenceSettings(traits=str(mine))
    content = run_settings(settings)["traits"]
    assert content == {"name": "mine", "sha256": load_traits(mine).digest}  # of the encoder
    assert run_settings(EvidenceSettings())["traits"]["name"] == "trained:traits-self"
    before = about(settings)
    check_same(before, about(replace(settings, traits=str(moved))), tmp_path)
    with pytest.raises(ValueError, match=r"holds another run .*traits"):
        check_same(before, about(replace(settings, traits=str(other))), tmp_path)
    with pytest.raises(FileNotFoundError, match="no trait model at"):
        run_settings(replace(settings, traits=str(tmp_path / "nowhere")))


def test_a_mixture_is_told_by_what_is_in_it_in_its_order(tmp_path: Path) -> None:
    mine, moved = (save_driver(tmp_path / name) for name in ("mine", "moved"))
    other = save_driver(tmp_path / "other", 7)
    settings = TwoStage(driver_policy=f"mixture:{mine},rule")
    content = run_settings(settings)["driver_policy"]
    digest = sha256_of(mine / "driver.safetensors")
    assert content == {"mixture": [{"name": "mine", "sha256": digest}, "rule"]}
    before = json.loads(json.dumps(about(settings)))
    same = about(replace(settings, driver_policy=f"Mixture:{moved},rule"))
    check_same(before, same, tmp_path)
    assert settings_digest(before) == settings_digest(same)
    for another in (f"mixture:{other},rule", f"mixture:rule,{mine}", str(mine), "rule"):
        changed = about(replace(settings, driver_policy=another))
        assert settings_digest(changed) != settings_digest(before)
        with pytest.raises(ValueError, match=r"holds another run .*driver_policy"):
            check_same(before, changed, tmp_path)
    with pytest.raises(FileNotFoundError, match="no policy for the seat of driver"):
        run_settings(replace(settings, driver_policy=f"mixture:rule,{tmp_path / 'nowhere'}"))


def test_the_digest_is_that_of_what_binds_a_run(tmp_path: Path) -> None:
    one = about(TwoStage())
    assert settings_digest(one) == settings_digest(json.loads(json.dumps(one)) | {"command": "x"})
    assert settings_digest(one) == settings_digest(about(TwoStage(checkpoint_every=7.0)))
    assert settings_digest(one) != settings_digest(about(TwoStage(seed=1)))
    assert settings_digest(one) != settings_digest(one | {"version": "2"})


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{}", "curve is a list"),
        ("[]", "it has no rows"),
        ("[3]", r"curve\[0\] is a mapping"),
        ('[{"loss": [1]}]', r"curve\[0\].loss is a whole number or"),
        ('[{"loss": NaN}]', "NaN is no number in JSON"),
        ("[", "no JSON file"),
    ],
)
def test_a_curve_is_rows_of_numbers(tmp_path: Path, content: str, message: str) -> None:
    (tmp_path / "curve.json").write_text(content)
    with pytest.raises(ValueError, match=rf"curve\.json .*{message}"):
        read_curve(tmp_path)


def test_a_curve_without_durations_is_refused(tmp_path: Path) -> None:
    (tmp_path / "curve.json").write_text('[{"seconds": 1.5}]')
    assert seconds_of([tmp_path], tmp_path) == {tmp_path.name: 1.5}
    assert seconds_of([tmp_path], tmp_path / "elsewhere") == {tmp_path.name: 1.5}
    inside = f"{tmp_path.parent.name}/{tmp_path.name}"
    assert seconds_of([tmp_path], tmp_path.parent.parent) == {inside: 1.5}
    (tmp_path / "curve.json").write_text('[{"seconds": "long"}]')
    with pytest.raises(ValueError, match=r"curve\.json .* its last row has no seconds"):
        seconds_of([tmp_path], tmp_path)


@pytest.mark.parametrize("content", ["[]", "{}", '{"settings": 3}'])
def test_settings_are_those_of_a_run(tmp_path: Path, content: str) -> None:
    (tmp_path / "run.json").write_text(content)
    with pytest.raises(ValueError, match=r"run\.json does not contain the settings of a run"):
        read_settings(tmp_path / "run.json")


@pytest.mark.parametrize(
    ("policy", "names"),
    [
        (None, None),
        ("rule", None),
        ({"name": "a", "sha256": "0"}, None),
        ({"mixture": [{"name": "a", "sha256": "0"}, "rule"]}, ("a", "rule")),
        ({"mixture": [{}, {"name": 3}, 3]}, ("None", "3", "3")),  # damaged: other than any
    ],
)
def test_partners_are_those_of_the_mixture(tmp_path: Path, policy: object, names: object) -> None:
    (tmp_path / "run.json").write_text(json.dumps({"settings": {"driver_policy": policy}}))
    assert partners_of(tmp_path) is None, "nothing was learned yet"
    (tmp_path / CHECKPOINT).touch()
    assert partners_of(tmp_path) == names
