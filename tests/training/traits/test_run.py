import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest
import torch
from people.trips import a_trip
from trait_models import SMALL
from unchecked import unchecked

from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.agents.learned.trait_model import TraitModel, load_traits
from hmi_marl.demonstrations.dataset import Demonstrations, Truth
from hmi_marl.demonstrations.parquet import (
    OBSERVED,
    TRUTH,
    read_demonstrations,
    write_demonstrations,
)
from hmi_marl.demonstrations.recording import CollectSettings, collect
from hmi_marl.envs.drivers import PAPER_DRIVERS, TRAIT_NAMES
from hmi_marl.people.export import demonstrations_of
from hmi_marl.training.protocols.settings import PPOSettings
from hmi_marl.training.runs.checkpoint import Checkpoint
from hmi_marl.training.traits import run
from hmi_marl.training.traits.run import learn_traits
from hmi_marl.training.traits.settings import LABELLED, TraitSettings

TINY = TraitSettings(
    supervision="none",
    steps=40,  # two rounds of 4 cars for 5 steps
    imitation_updates=2,
    num_teams=4,
    pool=2,
    expert_pools=2,
    labelled_pools=3,
    average_updates=2,
    encoder_updates=2,
    drivers_per_update=3,
    encoder=SMALL,
    reward=NetworkConfig((4,)),
    potential=NetworkConfig((4,)),
    policy=NetworkConfig((4,)),
    ppo=PPOSettings(num_learning_epochs=1, num_mini_batches=2),
    labelled=0.5,
    settling=0.0,
    device="cpu",
    checkpoint_every=0.0,
)
SUPERVISIONS = ["self", "none", "id", "preference"]
FILES = ("traits.safetensors", "traits.json")


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """Ten windows of five steps of each driver, most of which share a scene with few others."""
    settings = CollectSettings(duration=1.0, steps=50, vehicles=(1, 2), num_teams=16)
    folder = tmp_path_factory.mktemp("demonstrations")
    write_demonstrations(folder, collect(settings))
    return folder


def learned(folder, dataset, settings=TINY, **choices):
    learn_traits(settings, dataset, folder, quiet=True, **choices)
    return {name: (folder / name).read_bytes() for name in FILES}


def rows(folder):
    timed = ("seconds", "steps_per_second")
    curve = json.loads((folder / "curve.json").read_text())
    return [{name: v for name, v in row.items() if name not in timed} for row in curve]


@pytest.mark.parametrize("supervision", SUPERVISIONS)
def test_every_setting_leaves_a_model_and_tells_its_losses(supervision, dataset, tmp_path):
    settings = replace(TINY, supervision=supervision)
    learn_traits(settings, dataset, tmp_path, quiet=True, command_line="hmi-marl traits train it")
    model = load_traits(tmp_path)
    assert model.card.training["settings"]["supervision"] == supervision
    assert model.card.training["command"] == "hmi-marl traits train it"
    assert model.card.training["drivers"] == list(PAPER_DRIVERS)
    assert model.card.training["steps"] == 40
    updates = [0] * (6 if supervision == "self" else 4)
    assert [row["steps"] for row in rows(tmp_path)] == [*updates, 20, 40]
    for row in rows(tmp_path):
        assert np.isfinite(list(row.values())).all()
        assert ("L3" in row) == (supervision in LABELLED and "average" not in row)
        assert ("L1" in row) == (row["steps"] > 0)
    observed = read_demonstrations(dataset).observed
    sums = model.encoder.encode(observed.states, observed.actions, observed.alerts, observed.length)
    latent = model.encoder.latent(sums)
    assert latent.mean.shape == (40, 8 if supervision == "self" else 2)
    assert np.isfinite(latent.mean).all()
    assert (latent.variance > 0).all()


def test_the_same_seed_gives_the_same_weights_and_another_does_not(dataset, tmp_path):
    one = learned(tmp_path / "one", dataset)
    assert learned(tmp_path / "two", dataset) == one
    assert learned(tmp_path / "other", dataset, replace(TINY, seed=1))[FILES[0]] != one[FILES[0]]


def with_other_truth(dataset, folder, keep_eta=True):
    """The same observed data beside a truth in which everything hidden is something else."""
    data = read_demonstrations(dataset)
    rng = np.random.default_rng(0)
    truth, shape = data.truth, data.observed.actions.shape
    steps = data.observed.steps_taken
    traits = rng.random((len(data), 4)) * [1, 1, 1, 5] + [0, 0, 0, 1]
    if keep_eta:
        eta = TRAIT_NAMES.index("eta")
        traits[:, eta] = truth.traits[:, eta]
    # One driver has one set of traits.
    traits = traits[[int((data.observed.driver == who).argmax()) for who in data.observed.driver]]
    other = Truth(
        np.where(steps, 1 - truth.distracted, 0),
        np.where(steps, 1 - truth.accepted, 0),
        np.where(steps, (truth.counter + 3) % 7, 0),
        np.where(steps, rng.integers(0, 5, shape), -1),
        traits,
        {},
    )
    write_demonstrations(folder, iter([Demonstrations(data.observed, other)]))
    assert (folder / TRUTH).read_bytes() != (dataset / TRUTH).read_bytes()
    return folder


@pytest.mark.parametrize("supervision", SUPERVISIONS)
def test_nothing_of_the_hidden_truth_is_learned_from(supervision, dataset, tmp_path):
    settings = replace(TINY, supervision=supervision)
    other = with_other_truth(dataset, tmp_path / "other")
    one = learned(tmp_path / "one", dataset, settings)[FILES[0]]
    assert learned(tmp_path / "two", other, settings)[FILES[0]] == one


def test_the_preference_setting_is_told_eta_alone_so_that_the_test_above_could_fail(
    dataset, tmp_path
):
    settings = replace(TINY, supervision="preference")
    other = with_other_truth(dataset, tmp_path / "other", keep_eta=False)
    one = learned(tmp_path / "one", dataset, settings)[FILES[0]]
    assert learned(tmp_path / "two", other, settings)[FILES[0]] != one


@pytest.mark.parametrize("supervision", ["self", "none", "id"])
def test_without_a_truth_the_same_is_learned(supervision, dataset, tmp_path):
    settings = replace(TINY, supervision=supervision)
    alone = tmp_path / "alone"
    alone.mkdir()
    (alone / OBSERVED).write_bytes((dataset / OBSERVED).read_bytes())
    one = learned(tmp_path / "one", dataset, settings)
    assert learned(tmp_path / "two", alone, settings) == one


@pytest.mark.parametrize("supervision", ["self", "none"])
def test_the_policy_can_be_paid_for_driving_that_tells_its_z(supervision, dataset, tmp_path):
    settings, weight = replace(TINY, supervision=supervision), 0.5
    paid = replace(settings, information_reward=weight)
    without = learned(tmp_path / "without", dataset, settings)
    assert learned(tmp_path / "with", dataset, paid) != without
    before, after = rows(tmp_path / "without"), rows(tmp_path / "with")
    first = next(k for k, row in enumerate(before) if row["steps"])  # the first round
    assert "information" not in before[first]
    # Networks are still the same, and each window is paid log q(z | τ) of its pool in all.
    gained = after[first]["return"] - before[first]["return"]
    assert gained == pytest.approx(weight * after[first]["information"], rel=1e-4)


def test_the_reward_that_is_saved_is_the_average_over_the_rounds(dataset, tmp_path):
    learned(tmp_path, dataset)
    tensors = Checkpoint.load(tmp_path / "checkpoint.safetensors").tensors["discriminator"]
    saved = load_traits(tmp_path).weights
    for of, layer in (("reward", "layer0"), ("potential", "layer1")):
        place = f"{of}.{2 * int(layer[-1])}.weight"
        average, present = tensors[f"average.module.{place}"], tensors[f"model.reward.{place}"]
        np.testing.assert_array_equal(saved[f"{of}.{layer}.weight"], average.numpy())
        assert not torch.equal(average, present)
    assert int(tensors["average.n_averaged"]) == 2  # rounds


def test_held_out_windows_are_not_learned_from(dataset, tmp_path):
    data = read_demonstrations(dataset)
    last = data.observed.number >= 8
    alerts = np.where(last[:, None], 1 - data.observed.alerts, data.observed.alerts)
    changed = replace(data.observed, alerts=alerts)
    write_demonstrations(tmp_path / "data", iter([Demonstrations(changed, data.truth)]))
    one = learned(tmp_path / "one", dataset)[FILES[0]]
    assert learned(tmp_path / "two", tmp_path / "data")[FILES[0]] == one
    settings = replace(TINY, held_out=0.0)
    two = learned(tmp_path / "three", dataset, settings)[FILES[0]]
    assert learned(tmp_path / "four", tmp_path / "data", settings)[FILES[0]] != two


def test_people_answer_for_themselves(dataset, tmp_path):
    settings = replace(TINY, supervision="preference")
    answers = {name: k / 3 for k, name in enumerate(PAPER_DRIVERS)}
    one = learned(tmp_path / "one", dataset, settings, preferences=answers)
    turned = {name: 1.0 - value for name, value in answers.items()}
    other = {**turned, "lisa": 0.1}
    assert learned(tmp_path / "two", dataset, settings, preferences=other) != one
    with pytest.raises(ValueError, match="preferences lack bart, homer"):
        learned(tmp_path / "three", dataset, settings, preferences={"lisa": 0.0, "marge": 1.0})


def test_a_finished_run_is_left_alone(dataset, tmp_path, monkeypatch):
    one = learned(tmp_path, dataset)
    monkeypatch.setattr(run._Run, "_round", None)
    assert learned(tmp_path, dataset) == one


@pytest.mark.parametrize("supervision", ["self", "id"])
@pytest.mark.parametrize("cut", [1, 2, 3, 6, 8])
def test_a_run_that_is_cut_off_goes_on_as_if_nothing_had_happened(
    cut, supervision, dataset, tmp_path, monkeypatch
):
    settings = replace(TINY, supervision=supervision)
    whole = learned(tmp_path / "whole", dataset, settings)
    saves = 0
    save = Checkpoint.save

    def fail_after(self, path):
        nonlocal saves
        save(self, path)
        saves += 1
        if saves == cut:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Checkpoint, "save", fail_after)
        with pytest.raises(KeyboardInterrupt):
            learned(tmp_path / "cut", dataset, settings)
    assert learned(tmp_path / "cut", dataset, settings) == whole
    assert rows(tmp_path / "cut") == rows(tmp_path / "whole")


@pytest.mark.slow
def test_a_killed_run_goes_on(dataset, tmp_path):
    settings = replace(TINY, steps=200)
    whole = learned(tmp_path / "whole", dataset, settings)
    program = (
        "from pathlib import Path; import sys; sys.path.insert(0, sys.argv[1]);"
        "from test_run import TINY; from dataclasses import replace;"
        "from hmi_marl.training.traits.run import learn_traits;"
        "learn_traits(replace(TINY, steps=200), Path(sys.argv[2]), Path(sys.argv[3]), quiet=True)"
    )
    folder = tmp_path / "killed"
    here = os.path.dirname(__file__)
    env = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-c", program, here, str(dataset), str(folder)]
    process = subprocess.Popen(command, env=env)
    deadline = time.monotonic() + 120
    while not (folder / "checkpoint.safetensors").is_file():
        assert time.monotonic() < deadline
        assert process.poll() is None
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert learned(folder, dataset, settings) == whole


def test_another_run_in_the_folder_is_refused(dataset, tmp_path):
    learned(tmp_path / "run", dataset)
    with pytest.raises(ValueError, match=r"holds another run \(margin = 2.0, now 3.0\)"):
        learned(tmp_path / "run", dataset, replace(TINY, margin=3.0))
    other = with_other_truth(dataset, tmp_path / "data")
    data = read_demonstrations(other)
    write_demonstrations(other, iter([data.take(np.arange(len(data))[::-1])]))
    with pytest.raises(ValueError, match="learned from other demonstrations"):
        learned(tmp_path / "run", other)


def test_the_machine_may_be_another_one(dataset, tmp_path):
    one = learned(tmp_path, dataset)
    assert learned(tmp_path, dataset, replace(TINY, checkpoint_every=9.0, threads=2)) == one


def test_curves_go_to_tensorboard(dataset, tmp_path, capsys):
    learn_traits(TINY, dataset, tmp_path)
    assert list((tmp_path / "tensorboard").glob("events*"))
    assert "40.0/40.0" in capsys.readouterr().err


def test_a_larger_z_can_be_learned(dataset, tmp_path):
    learned(tmp_path, dataset, replace(TINY, latent=3))
    assert isinstance(load_traits(tmp_path), TraitModel)
    assert load_traits(tmp_path).card.latent == 3


def test_preferences_are_for_the_preference_setting(dataset, tmp_path):
    settings = replace(TINY, supervision="id")
    with pytest.raises(ValueError, match="preferences are for supervision 'preference', not 'id'"):
        learn_traits(settings, dataset, tmp_path / "run", {"lisa": 1.0}, quiet=True)
    assert not (tmp_path / "run").exists()


def test_a_run_that_cannot_begin_leaves_no_folder(tmp_path):
    with pytest.raises(FileNotFoundError, match="hmi-marl collect"):
        learn_traits(TINY, tmp_path / "nothing", tmp_path / "run", quiet=True)
    assert not (tmp_path / "run").exists()


def test_windows_that_end_at_a_crash_are_refused(tmp_path):
    settings = CollectSettings(
        duration=1.0, steps=10, vehicles=(1, 2), drivers=("lisa", "bart"), end_at_crash=True
    )
    write_demonstrations(tmp_path / "data", collect(settings))
    with pytest.raises(ValueError, match="collect with --no-end-at-crash"):
        learn_traits(TINY, tmp_path / "data", tmp_path / "run", quiet=True)


def test_trips_of_people_that_end_at_a_crash_are_learned_from(tmp_path):
    records = [a_trip(seed=seed, visitor=f"visitor-{seed % 2}").record() for seed in range(12)]
    assert any(record.crashed for record in records)
    assert all(record.config.end_at_crash for record in records)
    write_demonstrations(tmp_path / "data", demonstrations_of(records))
    settings = replace(TINY, supervision="id", steps=120)
    learn_traits(settings, tmp_path / "data", tmp_path / "run", quiet=True)
    assert load_traits(tmp_path / "run").card.training["drivers"] == ["visitor-0", "visitor-1"]


def test_something_has_to_be_left_to_learn_from(dataset, tmp_path):
    with pytest.raises(ValueError, match="held_out leaves no window to learn from"):
        learn_traits(replace(TINY, held_out=0.99), dataset, tmp_path / "run", quiet=True)


def test_a_model_that_was_lost_is_written_again_from_the_checkpoint(dataset, tmp_path):
    before = learned(tmp_path, dataset)
    for lost in FILES:
        (tmp_path / lost).unlink()
        assert learned(tmp_path, dataset) == before


@pytest.mark.parametrize("wild", [{"learning_rate": 1e30}, {"imitation_rate": 1e30}])
def test_learning_that_diverges_is_told_with_the_batch_and_what_to_change(wild, dataset, tmp_path):
    told = r"diverged in batch \d+ of phase [1-4]: .*not finite.*lower"
    with pytest.raises(FloatingPointError, match=told):
        learned(tmp_path, dataset, unchecked(replace(TINY, imitation_updates=20), **wild))
    assert not (tmp_path / "traits.json").exists()
    sound = Checkpoint.load(tmp_path / "checkpoint.safetensors")
    parts = sound.tensors.values()
    assert all(np.isfinite(np.asarray(t)).all() for part in parts for t in part.values())
