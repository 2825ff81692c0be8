import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from evidence_models import trait_model
from trait_models import untrained
from unchecked import unchecked

from hmi_marl.agents.adaptive.evidence_model import load_evidence
from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.agents.learned.trait_model import save_traits
from hmi_marl.demonstrations.dataset import observed_layout
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import DRIVERS, Traits
from hmi_marl.envs.scene import Scene
from hmi_marl.training.evidence import run
from hmi_marl.training.evidence.run import RecordedDrives, drive_all, learn_evidence
from hmi_marl.training.evidence.settings import EvidenceSettings
from hmi_marl.training.runs.checkpoint import Checkpoint

TINY = EvidenceSettings(
    driver_policy="rule",
    hmis=("never", "random:0.3"),
    drives=20,
    updates=3,
    batch=6,
    held_out=0.2,
    latent=3,
    reader=NetworkConfig((6,)),
    place=NetworkConfig((5,)),
    expected=NetworkConfig((4,)),
    checkpoint_every=0.0,
)
FILES = ("evidence.safetensors", "evidence.json")
REAL = drive_all


@pytest.fixture(scope="module")
def driven():
    return REAL(TINY)


@pytest.fixture(autouse=True)
def driven_once(driven, monkeypatch):
    """The drives of ``TINY`` in every run, whatever its sizes of networks."""
    monkeypatch.setattr(run, "drive_all", lambda settings, progress: driven)


def learned(folder, settings=TINY, **choices):
    learn_evidence(settings, folder, quiet=True, **choices)
    return {name: (folder / name).read_bytes() for name in FILES}


def rows(folder):
    curve = json.loads((folder / "curve.json").read_text())
    return [{name: value for name, value in row.items() if name != "seconds"} for row in curve]


def test_a_run_leaves_a_model_its_settings_and_a_curve(tmp_path):
    learn_evidence(TINY, tmp_path, quiet=True, command_line="hmi-marl reproduce adapt")
    about = json.loads((tmp_path / "run.json").read_text())
    assert about["command"] == "hmi-marl reproduce adapt"
    assert about["settings"]["updates"] == 3
    model = load_evidence(tmp_path)
    assert model.card == replace(TINY.card(TINY.team, trait_model()), training=model.card.training)
    assert model.card.training["settings"] == about["settings"]
    assert model.card.training["command"] == "hmi-marl reproduce adapt"
    (row,) = rows(tmp_path)
    assert row["updates"] == 3
    assert np.isfinite([row["loss"], row["held_out_loss"]]).all()
    assert {path.name for path in tmp_path.iterdir()} == {
        *FILES,
        "run.json",
        "curve.json",
        "checkpoint.safetensors",
    }


def test_the_drives_are_those_of_the_settings(tmp_path, driven, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(run, "drive_all", REAL)
        one = learned(tmp_path / "one")
    assert learned(tmp_path / "two") == one


def test_units_are_those_of_the_turns_that_there_were(tmp_path, driven):
    learned(tmp_path)
    model = load_evidence(tmp_path)
    read = driven.turns[driven.driving][:, : model.card.standardised].astype(np.float64)
    np.testing.assert_allclose(model.weights["read.centre"], read.mean(axis=0), atol=1e-3)
    spread = read.std(axis=0)
    varied = spread > 1e-2
    assert varied.any()
    np.testing.assert_allclose(model.weights["read.scale"][varied], spread[varied], rtol=1e-3)
    assert (model.weights["read.scale"] > 1e-3).all()


def test_the_same_seed_gives_the_same_weights_and_another_does_not(tmp_path):
    one = learned(tmp_path / "one")
    assert learned(tmp_path / "two") == one
    assert learned(tmp_path / "other", replace(TINY, seed=1))[FILES[0]] != one[FILES[0]]


def test_weights_are_learned(tmp_path):
    few, more = (replace(TINY, updates=n) for n in (1, 3))
    assert learned(tmp_path / "few", few)[FILES[0]] != learned(tmp_path / "more", more)[FILES[0]]


def with_traits(driven, k):
    """The same drives, of which drive k is said to be another driver's."""
    traits = driven.traits.as_array().copy()
    traits[k] = traits[k] * 0.5 + [0.3, 0.1, 0.2, 1]
    return RecordedDrives(driven.turns, driven.driving, driven.z, Traits.from_array(traits))


def test_held_out_drives_are_not_learned_from(tmp_path, driven, monkeypatch):
    settings = replace(TINY, batch=16, updates=1)  # all that there are to learn from
    assert settings.learned == 16
    monkeypatch.setattr(run.EvidenceNetwork, "settle", lambda *_: None)  # which asks as well
    whole, same = learned(tmp_path / "whole", settings)[FILES[0]], []
    for k in range(TINY.drives):
        other = with_traits(driven, k)
        monkeypatch.setattr(run, "drive_all", lambda *_, other=other: other)
        same.append(learned(tmp_path / str(k), settings)[FILES[0]] == whole)
    assert sum(same) == TINY.drives - settings.learned


def test_each_update_learns_from_drives_of_its_own(tmp_path, driven, monkeypatch):
    monkeypatch.setattr(run.EvidenceNetwork, "settle", lambda *_: None)
    whole, changed = learned(tmp_path / "whole")[FILES[0]], []
    for k in range(TINY.drives):
        other = with_traits(driven, k)
        monkeypatch.setattr(run, "drive_all", lambda *_, other=other: other)
        changed.append(learned(tmp_path / str(k))[FILES[0]] != whole)
    assert TINY.batch < sum(changed) <= TINY.learned


def test_evidence_is_toned_down_as_suits_drives_that_were_not_learned_from(
    tmp_path, driven, monkeypatch
):
    settled = learned(tmp_path / "settled")
    asked, loss_at_end = [], run.EvidenceNetwork.loss_at_end

    def told(self, turns, driving, shown, temperatures):
        losses = loss_at_end(self, turns, driving, shown, temperatures)
        asked.append((len(turns), temperatures.numpy(), losses.numpy()))
        return losses

    monkeypatch.setattr(run.EvidenceNetwork, "loss_at_end", told)
    monkeypatch.setattr(run.EvidenceNetwork, "settle", lambda *_: None)
    assert learned(tmp_path / "plain")[FILES[0]] != settled[FILES[0]]
    ((count, tried, losses),) = asked
    assert count == TINY.drives - TINY.learned
    as_it_was, model = load_evidence(tmp_path / "plain"), load_evidence(tmp_path / "settled")
    temperature = model.card.training["temperature"]
    assert temperature == pytest.approx(tried[losses.argmin()])
    assert temperature != 1.0
    gains, drivers = [], Traits.of(DRIVERS.values())
    for each in (as_it_was, model):
        told = each.read(driven.turns[:, 0]) @ each.places(drivers).T
        gains.append(told[:, 1:] - told[:, :1])
    np.testing.assert_allclose(gains[1], temperature * gains[0], rtol=1e-3, atol=1e-6)
    places = model.places(driven.traits)
    np.testing.assert_allclose(places.mean(axis=0), 0.0, atol=1e-4)
    np.testing.assert_allclose(places.std(axis=0, ddof=1), 1.0, atol=1e-3)


@pytest.mark.parametrize("cut", [1, 2, 3])
def test_a_run_that_is_cut_off_goes_on_as_if_nothing_had_happened(cut, tmp_path, monkeypatch):
    whole = learned(tmp_path / "whole")
    saves, save = [], Checkpoint.save

    def fail_after(self, path):
        save(self, path)
        saves.append(path)
        if len(saves) == cut:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Checkpoint, "save", fail_after)
        with pytest.raises(KeyboardInterrupt):
            learned(tmp_path / "cut")
    assert not (tmp_path / "cut" / FILES[0]).exists()
    assert Checkpoint.load(tmp_path / "cut" / "checkpoint.safetensors").iteration == cut
    assert learned(tmp_path / "cut") == whole
    held_out = [row["held_out_loss"] for row in rows(tmp_path / "cut")]
    assert held_out == [row["held_out_loss"] for row in rows(tmp_path / "whole")]


def test_how_often_it_saves_and_on_how_many_threads_changes_nothing(tmp_path):
    one = learned(tmp_path / "one")
    seldom = replace(TINY, checkpoint_every=1e9)
    assert learned(tmp_path / "two", seldom)[FILES[0]] == one[FILES[0]]
    assert learned(tmp_path / "one", replace(TINY, threads=2)) == one


def test_a_finished_run_is_left_alone(tmp_path, monkeypatch):
    one = learned(tmp_path)
    monkeypatch.setattr(run, "drive_all", None)
    assert learned(tmp_path) == one


def test_another_run_in_the_folder_is_refused(tmp_path):
    learned(tmp_path)
    with pytest.raises(ValueError, match=r"holds another run \(latent = 3, now 4\)"):
        learned(tmp_path, replace(TINY, latent=4))


def test_a_driver_that_is_not_there_is_told_at_once(tmp_path):
    with pytest.raises(FileNotFoundError, match="no policy for the seat of driver"):
        learned(tmp_path / "run", replace(TINY, driver_policy=str(tmp_path / "nowhere")))


def test_a_trait_model_that_is_not_there_is_reported_at_once(tmp_path):
    with pytest.raises(FileNotFoundError, match="no trait model at"):
        learned(tmp_path / "run", replace(TINY, traits=str(tmp_path / "nowhere")))


@pytest.mark.parametrize(
    ("changes", "found"),
    [
        ({"hmis": ("never", "siren")}, "unknown HMI 'siren'"),
        ({"driver_policy": "autopilot"}, "unknown driver policy 'autopilot'"),
        ({"traits": "other"}, r"reads 16 columns of 'lidar', .* use the scene"),
    ],
    ids=str,
)
def test_what_cannot_drive_or_read_is_refused_before_there_is_a_folder(tmp_path, changes, found):
    other = untrained(observed_layout(TeamConfig(scene=Scene(lidar_cells=8))))
    save_traits(tmp_path / "other", other.card, other.weights)
    if "traits" in changes:
        changes = {"traits": str(tmp_path / "other")}
    with pytest.raises(ValueError, match=found):
        learned(tmp_path / "run", replace(TINY, **changes))
    assert not (tmp_path / "run").exists()


def test_torch_is_left_as_it_was(tmp_path):
    torch.manual_seed(5)
    expected = torch.rand(1).item()
    torch.manual_seed(5)
    threads = torch.get_num_threads()
    learned(tmp_path, replace(TINY, threads=2))
    assert torch.get_num_threads() == threads
    assert torch.rand(1).item() == expected


def test_progress_is_shown_unless_quiet(tmp_path, capsys):
    learn_evidence(TINY, tmp_path / "shown")
    assert "3/3" in capsys.readouterr().err
    learned(tmp_path / "quiet")
    assert capsys.readouterr().err == ""


@pytest.mark.slow
def test_bart_is_told_from_marge(tmp_path, monkeypatch):
    monkeypatch.setattr(run, "drive_all", REAL)
    settings = EvidenceSettings(
        driver_policy="rule",
        hmis=("never", "random:0.2", "random:0.5"),
        drives=1500,
        updates=300,
        batch=128,
    )
    learn_evidence(settings, tmp_path, quiet=True)
    curve = json.loads((tmp_path / "curve.json").read_text())
    assert curve[-1]["held_out_loss"] < 0.9 * np.log(75), "75 drives are held out"
    others = REAL(replace(settings, seed=1, drives=200, known=1.0))
    model = load_evidence(tmp_path)
    drivers = [DRIVERS["bart"], DRIVERS["marge"]]
    places = model.places(Traits.of(drivers))
    odds = np.zeros(len(others.turns))
    for t in range(others.turns.shape[1]):
        told = model.read(others.turns[:, t]) @ (places[0] - places[1])
        odds += np.where(others.driving[:, t], told, 0.0)
    z = model.expected(others.traits)
    error, spread = np.square(z - others.z).mean(axis=0), others.z.var(axis=0)
    assert (error / spread).min() < 0.6, "z follows from the traits as far as it says anything"
    for driver, sign in zip(drivers, (1, -1), strict=True):
        theirs = (others.traits.as_array() == driver.traits).all(axis=1)
        long = theirs & (others.driving.sum(axis=1) > 40)
        assert long.sum() > 10
        assert (sign * odds[long] > 2).mean() > 0.9


def test_a_model_that_was_lost_is_written_again_from_the_checkpoint(tmp_path):
    before = learned(tmp_path)
    for lost in (["evidence.json"], ["evidence.safetensors"], [*FILES, "curve.json"]):
        for name in lost:
            (tmp_path / name).unlink()
        assert learned(tmp_path) == before
    assert rows(tmp_path)[-1]["updates"] == 3


def test_learning_that_diverges_is_told_with_the_batch_and_what_to_change(tmp_path):
    wild = unchecked(replace(TINY, updates=20), learning_rate=1e30)
    told = r"diverged in batch \d+ of phase 1: .*not finite with learning_rate at .*; lower"
    with pytest.raises(FloatingPointError, match=told):
        learned(tmp_path, wild)
    assert not (tmp_path / "evidence.json").exists()
    sound = Checkpoint.load(tmp_path / "checkpoint.safetensors")
    assert all(torch.isfinite(t).all() for part in sound.tensors.values() for t in part.values())
