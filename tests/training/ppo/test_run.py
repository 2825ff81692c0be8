import json
import os
import signal
import subprocess
import sys
from dataclasses import replace

import numba
import numpy as np
import pytest
import torch
from trait_models import save_driver
from unchecked import unchecked

import hmi_marl
from hmi_marl.agents.catalogue import make_driver_policy
from hmi_marl.agents.learned import cards as weight_files
from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.agents.learned.policy import load_policy, read_policy
from hmi_marl.agents.partners import make_vec
from hmi_marl.envs.config import TeamConfig, as_fatigue
from hmi_marl.envs.scene import Scene
from hmi_marl.files import sha256_of
from hmi_marl.training.ppo import learner
from hmi_marl.training.ppo.run import train
from hmi_marl.training.protocols.alternating import Alternating
from hmi_marl.training.protocols.fine_tune import FineTune
from hmi_marl.training.protocols.joint import Joint, Simultaneous
from hmi_marl.training.protocols.settings import PPOSettings
from hmi_marl.training.protocols.two_stage import TwoStage
from hmi_marl.training.runs.checkpoint import Checkpoint

TINY = {
    "num_teams": 8,  # 40 steps a batch
    "duration": 1.0,
    "vehicles": (1, 3),
    "network": NetworkConfig((8,)),
    "ppo": PPOSettings(num_learning_epochs=1, num_mini_batches=2),
    "device": "cpu",
    "threads": 1,
    "checkpoint_every": 0.0,
}
TWO_STAGE = TwoStage(driver_steps=80, hmi_steps=80, **TINY)
ALTERNATING = Alternating(rounds=2, driver_steps=160, hmi_steps=160, **TINY)
JOINT_WITH_MEMORY = Joint(steps=80, rnn_hidden_dim=4, ai_sees_attention=False, **TINY)
FINE_TUNE = FineTune(
    driver_steps=80,
    hmi_steps=80,
    together_steps=80,
    anchor="first-stage",
    anchor_kl=0.1,
    **TINY,
)
PROTOCOLS = {
    "two-stage": TWO_STAGE,
    "joint": Joint(steps=80, **TINY),
    "simultaneous": Simultaneous(steps=80, **TINY),
    "at once": Simultaneous(steps=80, sequential=False, critic="own", **TINY),
    "alternating": ALTERNATING,
    "fine-tune": FINE_TUNE,
    "human-regularised": Joint(steps=80, anchor="trained:driver", anchor_kl=0.1, **TINY),
    "two stages, at once": replace(TWO_STAGE, sequential=False),
    "rounds, at once": replace(ALTERNATING, sequential=False),
    "hidden attention": replace(
        TWO_STAGE, ai_sees_attention=False, rnn_hidden_dim=4, condition="hidden"
    ),
    "hidden attention, joint": JOINT_WITH_MEMORY,
    "graded alerts": replace(TWO_STAGE, alert_strengths=(0.3, 0.6, 1.0), fatigue=(8, 3, 0.5)),
    "graded alerts, joint": Joint(steps=80, alert_strengths=(0.3, 0.6, 1.0), **TINY),
    "two memories at once": Simultaneous(
        steps=80, rnn_hidden_dim=4, ai_sees_attention=False, **TINY
    ),
}
SEATS = ("driver", "vehicle_ai")
WEIGHTS = tuple(f"{seat}.safetensors" for seat in SEATS)
TEAM = TeamConfig(duration=1.0, scene=Scene(vehicles=(1, 3)))


class TwoTraits:
    """z is β and the inflation as they are."""

    size = 2
    digest = "β and the inflation"

    def __call__(self, traits):
        return traits[:, [0, 3]]


def learned(folder, settings, **choices):
    train(settings, folder, quiet=True, **choices)
    return files(folder)


def files(folder):
    """What the run has learned: the policies' files, byte by byte."""
    names = [f"{seat}.{suffix}" for seat in SEATS for suffix in ("safetensors", "json")]
    return {name: (folder / name).read_bytes() for name in names}


def weights(content):
    return [content[name] for name in WEIGHTS]


def rows(folder):
    """The curve but for times."""
    timed = ("seconds", "steps_per_second", "share_of_time_learning", "share_of_time_waiting")
    curve = json.loads((folder / "curve.json").read_text())
    return [{name: v for name, v in row.items() if name not in timed} for row in curve]


@pytest.mark.parametrize("name", PROTOCOLS)
def test_every_protocol_leaves_two_policies_that_act(name, tmp_path):
    settings = PROTOCOLS[name]
    train(settings, tmp_path, quiet=True, command_line="hmi-marl train it")
    steps = sum(phase.steps for phase in settings.phases())
    curve = json.loads((tmp_path / "curve.json").read_text())
    assert [row["steps"] for row in curve] == list(range(40, steps + 1, 40))
    assert all(
        np.isfinite([v for v in row.values() if not isinstance(v, str)]).all() for row in curve
    )
    about = json.loads((tmp_path / "run.json").read_text())
    assert about["protocol"] == type(settings).__name__
    assert about["settings"]["num_teams"] == 8
    config = replace(
        TEAM,
        ai_sees_attention=settings.ai_sees_attention,
        alert_strengths=settings.alert_strengths,
        fatigue=as_fatigue(settings.fatigue),
    )
    env = make_vec(8, "team", threads=1, **vars(config))
    for seat in SEATS:
        policy = load_policy(tmp_path, seat, config)
        assert policy.card.training["command"] == "hmi-marl train it"
        assert policy.card.training["settings"] == about["settings"]
        assert policy.card.sequential == settings.sequential
        assert policy.card.training["team"]["duration"] == 1.0
        policy.reset(np.arange(8, dtype=np.uint64))
        actions = policy.act(env.get_observations()[seat].numpy())
        choices = 5 if seat == "driver" else config.alerts.choices
        assert ((actions >= 0) & (actions < choices)).all()
        assert policy.probabilities(env.get_observations()[seat].numpy()).shape == (8, choices)
    assert {path.name for path in tmp_path.iterdir()} == {
        "run.json",
        "curve.json",
        "checkpoint.safetensors",
        *(f"{seat}.{suffix}" for seat in SEATS for suffix in ("json", "safetensors")),
    }


@pytest.mark.parametrize("settings", [TWO_STAGE, PROTOCOLS["simultaneous"]], ids=["turns", "both"])
def test_the_same_seed_gives_the_same_weights_and_another_does_not(settings, tmp_path):
    one = learned(tmp_path / "one", settings)
    torch.manual_seed(99)  # nobody else's draws come in
    assert learned(tmp_path / "again", settings) == one
    assert rows(tmp_path / "again") == rows(tmp_path / "one")
    other = learned(tmp_path / "other", replace(settings, seed=1))
    assert all(a != b for a, b in zip(weights(one), weights(other), strict=True))


def test_the_draws_of_others_are_left_alone(tmp_path):
    torch.manual_seed(7)
    expected = torch.rand(3)
    torch.manual_seed(7)
    train(TWO_STAGE, tmp_path, quiet=True)
    assert torch.equal(torch.rand(3), expected)


def test_threads_and_checkpoints_do_not_change_results(tmp_path):
    one = learned(tmp_path / "one", TWO_STAGE)
    others = replace(TWO_STAGE, threads=int(numba.config.NUMBA_NUM_THREADS), checkpoint_every=1e9)
    assert weights(learned(tmp_path / "two", others)) == weights(one)


class Killed(BaseException):
    """As if the machine had been switched off: nothing may catch it."""


@pytest.mark.parametrize(
    "settings",
    [
        pytest.param(TWO_STAGE, id="two stages"),
        pytest.param(JOINT_WITH_MEMORY, id="both seats, recurrent"),
        pytest.param(FINE_TUNE, id="fine-tune", marks=pytest.mark.slow),
        pytest.param(ALTERNATING, id="rounds", marks=pytest.mark.slow),
    ],
)
def test_a_run_cut_off_at_any_checkpoint_ends_as_if_it_had_not_been(
    settings, tmp_path, monkeypatch
):
    whole = learned(tmp_path / "whole", settings)
    save, saves = Checkpoint.save, 0

    def counted(self, path):
        nonlocal saves
        saves += 1
        save(self, path)
        if saves == last:
            raise Killed

    monkeypatch.setattr(Checkpoint, "save", counted)
    # After each of 2 batches of every phase, and after the phase's policies were written.
    total = 3 * len(settings.phases())
    for last in range(1, total + 1):
        folder, saves = tmp_path / f"cut {last}", 0
        with pytest.raises(Killed):
            train(settings, folder, quiet=True)
        saves = total
        assert learned(folder, settings) == whole
        assert rows(folder) == rows(tmp_path / "whole")


@pytest.mark.parametrize("card", [1, 2, 3, 4])
def test_a_run_cut_off_in_the_middle_of_writing_a_policy_mends_it(card, tmp_path, monkeypatch):
    whole = learned(tmp_path / "whole", ALTERNATING)
    write, written = weight_files.write_json, 0

    def cut_off(path, content):
        nonlocal written
        written += 1
        if written == card:
            raise Killed
        write(path, content)

    monkeypatch.setattr(weight_files, "write_json", cut_off)
    with pytest.raises(Killed):
        train(ALTERNATING, tmp_path / "cut", quiet=True)
    assert learned(tmp_path / "cut", ALTERNATING) == whole


KILLED = """
import os, signal, sys
from pathlib import Path
from hmi_marl.training.runs.checkpoint import Checkpoint
from test_run import {name}, train

save = Checkpoint.save

def kill(self, path):
    if len(self.curve) == {batches}:  # this batch was for nothing
        os.kill(os.getpid(), signal.SIGKILL)
    save(self, path)

Checkpoint.save = kill
train({name}, Path(sys.argv[1]), quiet=True)
"""


@pytest.mark.usefixtures("unmeasured")
@pytest.mark.parametrize(
    ("name", "batches", "before"),
    [
        ("TWO_STAGE", 4, (1, 1)),
        pytest.param("ALTERNATING", 6, (2, 1), marks=pytest.mark.slow),
    ],
)
def test_a_run_that_was_killed_goes_on_to_the_same_bytes(name, batches, before, tmp_path):
    settings = globals()[name]
    whole = learned(tmp_path / "whole", settings)
    folder = tmp_path / "killed"
    path = os.pathsep.join([os.path.dirname(__file__), *sys.path])
    command = [sys.executable, "-c", KILLED.format(name=name, batches=batches), str(folder)]
    env = os.environ | {"PYTHONPATH": path, "OMP_NUM_THREADS": "1"}
    killed = subprocess.run(command, env=env, check=False)
    assert killed.returncode == -signal.SIGKILL
    state = Checkpoint.load(folder / "checkpoint.safetensors")
    assert (state.phase, state.iteration) == before
    assert state.steps == 40 * (batches - 1)
    assert learned(folder, settings) == whole
    assert rows(folder) == rows(tmp_path / "whole")


def test_a_finished_run_is_left_alone(tmp_path):
    train(TWO_STAGE, tmp_path, quiet=True)
    before = {path: (path.stat().st_mtime_ns, path.read_bytes()) for path in tmp_path.iterdir()}
    train(TWO_STAGE, tmp_path, quiet=True)
    assert before == {
        path: (path.stat().st_mtime_ns, path.read_bytes()) for path in tmp_path.iterdir()
    }


def test_a_run_goes_on_elsewhere_with_other_threads_and_checkpoints(tmp_path):
    train(TWO_STAGE, tmp_path, quiet=True)
    elsewhere = replace(
        TWO_STAGE, device="auto", threads=int(numba.config.NUMBA_NUM_THREADS), checkpoint_every=5.0
    )
    train(elsewhere, tmp_path, quiet=True)


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        (
            replace(TWO_STAGE, seed=3),
            r"holds another run \(seed = 0, now 3\); choose another --out",
        ),
        (
            replace(TWO_STAGE, hmi_for="homer", driver_steps=81),
            r"\(hmi_for = 'population', now 'homer', driver_steps = 80, now 81\)",
        ),
        (
            replace(TWO_STAGE, ppo=PPOSettings(num_mini_batches=3)),
            r"\(ppo.num_learning_epochs = 1, now 3, ppo.num_mini_batches = 2, now 3\)",
        ),
        (Joint(steps=80, **TINY), "protocol = 'TwoStage', now 'Joint'"),
    ],
    ids=["seed", "two of them", "ppo", "protocol"],
)
def test_a_folder_with_another_run_is_left_alone(settings, told, tmp_path):
    before = learned(tmp_path, TWO_STAGE)
    with pytest.raises(ValueError, match=told):
        train(settings, tmp_path, quiet=True)
    assert files(tmp_path) == before


def test_a_run_whose_settings_lack_some_is_refused(tmp_path):
    before = learned(tmp_path, TWO_STAGE)
    about = json.loads((tmp_path / "run.json").read_text())
    for name in ("alert_strengths", "fatigue"):
        del about["settings"][name]
    (tmp_path / "run.json").write_text(json.dumps(about))
    with pytest.raises(ValueError, match=r"\(alert_strengths = None, now \[1.0\]\)"):
        train(TWO_STAGE, tmp_path, quiet=True)
    with pytest.raises(ValueError, match=r"alert_strengths = None, now \[0.5, 1.0\]"):
        train(replace(TWO_STAGE, alert_strengths=(0.5, 1.0)), tmp_path, quiet=True)
    assert files(tmp_path) == before


def test_a_run_of_another_version_is_told(tmp_path, monkeypatch):
    train(TWO_STAGE, tmp_path, quiet=True)
    monkeypatch.setattr(hmi_marl, "__version__", "99")
    with pytest.raises(ValueError, match=r"version = .*, now '99'"):
        train(TWO_STAGE, tmp_path, quiet=True)


def test_a_damaged_checkpoint_is_told(tmp_path):
    train(TWO_STAGE, tmp_path, quiet=True)
    path = tmp_path / "checkpoint.safetensors"
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(ValueError, match=r"checkpoint\.safetensors is a damaged checkpoint"):
        train(TWO_STAGE, tmp_path, quiet=True)


def test_a_run_that_was_cut_off_before_its_first_checkpoint_begins_anew(tmp_path):
    whole = learned(tmp_path / "whole", TWO_STAGE)
    train(TWO_STAGE, tmp_path / "cut", quiet=True)
    (tmp_path / "cut" / "checkpoint.safetensors").unlink()
    assert learned(tmp_path / "cut", TWO_STAGE) == whole


def test_snapshots_are_the_policies_on_their_way(tmp_path):
    settings = replace(TWO_STAGE, driver_steps=5 * 40, hmi_steps=40, snapshots=2)
    whole = learned(tmp_path, settings)
    taken = {int(path.name): path for path in (tmp_path / "snapshots").iterdir()}
    assert sorted(taken) == [120, 200, 240]  # batches 3 and 5 of the driver's, 1 of the HMI's
    names = {steps: {path.name for path in place.iterdir()} for steps, place in taken.items()}
    assert names[120] == names[200] == {"driver.json", "driver.safetensors"}
    assert names[240] == {"vehicle_ai.json", "vehicle_ai.safetensors"}
    for steps, name in ((200, "driver.safetensors"), (240, "vehicle_ai.safetensors")):
        assert (taken[steps] / name).read_bytes() == whole[name]
    assert (taken[120] / "driver.safetensors").read_bytes() != whole["driver.safetensors"]
    assert read_policy(taken[120] / "driver.json")[0].training["steps"] == 120


def test_a_driver_is_learned_alone(tmp_path):
    train(replace(TWO_STAGE, hmi_steps=0), tmp_path, quiet=True)
    assert (tmp_path / "driver.json").exists()
    assert not (tmp_path / "vehicle_ai.json").exists()


def test_an_hmi_learns_beside_the_driver_of_another_run(tmp_path):
    one = learned(tmp_path / "one", TWO_STAGE)
    settings = replace(TWO_STAGE, driver_policy=str(tmp_path / "one"), seed=5)
    two = learned(tmp_path / "two", settings)
    assert len(rows(tmp_path / "two")) == 2
    for name in ("driver.json", "driver.safetensors"):
        assert two[name] == one[name]  # kept with the run, which is whole without the other
    assert two["vehicle_ai.safetensors"] != one["vehicle_ai.safetensors"]
    ruled = replace(TWO_STAGE, driver_policy="rule")
    train(ruled, tmp_path / "ruled", quiet=True)
    assert not (tmp_path / "ruled" / "driver.json").exists()


def test_an_hmi_learns_with_a_mixture_of_drivers_that_its_card_names(tmp_path):
    first = save_driver(tmp_path / "one")
    settings = replace(TWO_STAGE, driver_policy=f"mixture:{first},rule,random")
    train(settings, tmp_path / "run", quiet=True)
    digest = sha256_of(first / "driver.safetensors")
    mixture = [{"name": "one", "sha256": digest}, "rule", "random"]
    card = read_policy(tmp_path / "run" / "vehicle_ai.json")[0]
    assert card.training["settings"]["driver_policy"] == {"mixture": mixture}
    with pytest.raises(FileNotFoundError, match=r"seat of driver at .*it holds one for vehicle_ai"):
        make_driver_policy(str(tmp_path / "run"), TEAM)
    before = (tmp_path / "run" / "vehicle_ai.safetensors").read_bytes()
    (tmp_path / "run" / "vehicle_ai.json").unlink()
    train(settings, tmp_path / "run", quiet=True)
    assert (tmp_path / "run" / "vehicle_ai.safetensors").read_bytes() == before
    train(replace(settings, driver_policy="rule"), tmp_path / "ruled", quiet=True)
    assert rows(tmp_path / "run") != rows(tmp_path / "ruled")


def test_a_driver_that_is_not_there_is_told_before_anything_is_learned(tmp_path):
    settings = replace(TWO_STAGE, driver_policy=str(tmp_path / "nowhere"))
    with pytest.raises(FileNotFoundError, match=r"no policy for the seat of driver at .*nowhere"):
        train(settings, tmp_path / "run", quiet=True)


def test_a_vehicle_ai_is_conditioned_on_a_context(tmp_path):
    train(TWO_STAGE, tmp_path, context=TwoTraits(), quiet=True)
    policy = load_policy(tmp_path, "vehicle_ai", TEAM)
    assert policy.card.context == 2
    assert "traits" not in dict(policy.card.reads)
    assert "traits" in dict(make_driver_policy(str(tmp_path), TEAM).card.reads)
    env = make_vec(4, "team", threads=1, **vars(TEAM))
    policy.context = [0.1, 3.0]
    seen = env.get_observations()["vehicle_ai"].numpy()
    first = policy.probabilities(seen)
    policy.context = [0.8, 9.0]
    assert not np.allclose(policy.probabilities(seen), first)


@pytest.mark.parametrize("name", ["joint", "simultaneous"])
def test_both_seats_learn_beside_each_other_in_a_context(name, tmp_path):
    train(PROTOCOLS[name], tmp_path, context=TwoTraits(), quiet=True)
    assert [read_policy(tmp_path / f"{seat}.json")[0].context for seat in SEATS] == [0, 2]


def test_a_context_is_not_for_rounds_in_which_a_driver_learns_beside_it(tmp_path):
    with pytest.raises(ValueError, match="conditioned on z cannot be a partner in training"):
        train(ALTERNATING, tmp_path, context=TwoTraits(), quiet=True)
    train(replace(ALTERNATING, rounds=1), tmp_path, context=TwoTraits(), quiet=True)


@pytest.mark.filterwarnings("error")
def test_people_are_told_on_the_terminal_and_by_tensorboard(tmp_path, capfd):
    train(TWO_STAGE, tmp_path / "bart")
    told = capfd.readouterr().err
    assert "bart: driver" in told
    assert "bart: hmi" in told
    assert "return=" in told
    events = list((tmp_path / "bart" / "tensorboard").iterdir())
    assert len(events) == 1
    assert events[0].stat().st_size > 1000


def test_a_device_that_is_not_there_is_told(tmp_path):
    with pytest.raises(ValueError, match="device is auto, cpu, cuda or cuda:N, not 'quantum'"):
        train(replace(TWO_STAGE, device="quantum"), tmp_path, quiet=True)
    if not torch.cuda.is_available():
        with pytest.raises(ValueError, match="'cuda' was asked for, but torch sees no GPU; use c"):
            train(replace(TWO_STAGE, device="cuda"), tmp_path, quiet=True)
    assert not (tmp_path / "run.json").exists()


def test_a_folder_that_cannot_be_written_to_is_told(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OSError, match=r"cannot write to .*file"):
        train(TWO_STAGE, tmp_path / "file", quiet=True)


@pytest.mark.parametrize("content", ["{", "[]", None])
def test_damaged_settings_of_a_run_are_told_by_their_file(content, tmp_path):
    train(TWO_STAGE, tmp_path, quiet=True)
    settings = tmp_path / "run.json"
    if content is None:
        settings.unlink()
    else:
        settings.write_text(content)
    with pytest.raises(ValueError, match=r"run\.json"):
        train(TWO_STAGE, tmp_path, quiet=True)


def test_a_start_that_failed_does_not_claim_the_folder(tmp_path):
    lost = replace(TWO_STAGE, driver_policy=str(tmp_path / "nowhere"))
    with pytest.raises(FileNotFoundError):
        train(lost, tmp_path / "run", quiet=True)
    train(TWO_STAGE, tmp_path / "run", quiet=True)
    assert (
        json.loads((tmp_path / "run" / "run.json").read_text())["settings"]["driver_policy"] is None
    )


def test_a_run_does_not_go_on_with_another_context(tmp_path):
    train(TWO_STAGE, tmp_path, quiet=True)
    with pytest.raises(ValueError, match="context = 0, now 2"):
        train(TWO_STAGE, tmp_path, context=TwoTraits(), quiet=True)


def test_a_run_does_not_go_on_with_a_context_of_the_same_size_that_means_something_else(tmp_path):
    beside = replace(TWO_STAGE, driver_policy="rule")
    train(beside, tmp_path, context=TwoTraits(), quiet=True)
    other = TwoTraits()
    other.digest = "something else"
    with pytest.raises(
        ValueError, match="context_of = 'β and the inflation', now 'something else'"
    ):
        train(beside, tmp_path, context=other, quiet=True)


@pytest.mark.parametrize(
    "name", ["two-stage", "joint", "simultaneous", "fine-tune", "hidden attention"]
)
def test_policies_that_were_lost_are_written_again_from_the_checkpoint(name, tmp_path):
    train(PROTOCOLS[name], tmp_path, quiet=True)
    files = [f"{seat}.{suffix}" for seat in SEATS for suffix in ("json", "safetensors")]
    before = {file: (tmp_path / file).read_bytes() for file in files}
    for lost in (files[:1], files[3:], files):
        for file in lost:
            (tmp_path / file).unlink()
        train(PROTOCOLS[name], tmp_path, quiet=True)
        assert {file: (tmp_path / file).read_bytes() for file in files} == before


def test_another_runs_policy_that_was_lost_is_copied_again(tmp_path):
    first, second = tmp_path / "first", tmp_path / "second"
    train(replace(TWO_STAGE, hmi_steps=0), first, quiet=True)
    settings = replace(TWO_STAGE, driver_policy=str(first))
    train(settings, second, quiet=True)
    before = (second / "driver.json").read_bytes()
    (second / "driver.json").unlink()
    train(settings, second, quiet=True)
    assert (second / "driver.json").read_bytes() == before


def test_the_learned_partner_of_an_interrupted_run_is_written_again(tmp_path, monkeypatch):
    train(ALTERNATING, tmp_path / "whole", quiet=True)
    cut = tmp_path / "cut"
    save = Checkpoint.save

    def stop(self, path):
        save(self, path)
        if self.phase == 2 and self.iteration == 1:
            raise InterruptedError

    with monkeypatch.context() as patch:
        patch.setattr(Checkpoint, "save", stop)
        with pytest.raises(InterruptedError):
            train(ALTERNATING, cut, quiet=True)
    for seat in SEATS:
        (cut / f"{seat}.json").unlink()
    train(ALTERNATING, cut, quiet=True)
    for name in (*WEIGHTS, "driver.json", "vehicle_ai.json"):
        assert (cut / name).read_bytes() == (tmp_path / "whole" / name).read_bytes(), name


@pytest.mark.parametrize("name", ["two-stage", "simultaneous"])
def test_learning_that_diverges_is_told_with_the_batch_and_what_to_change(name, tmp_path):
    sound = PROTOCOLS[name]
    wild = unchecked(sound.ppo, learning_rate=1e30, final_learning_rate=1e30)
    told = (
        r"^learning diverged in batch 1 of phase 1: .* not finite with ppo.learning_rate at "
        r"1e\+30; lower ppo.learning_rate, and choose another --out$"
    )
    with pytest.raises(FloatingPointError, match=told):
        train(replace(sound, ppo=wild), tmp_path, quiet=True)
    assert not (tmp_path / "driver.json").exists()
    assert not (tmp_path / "checkpoint.safetensors").exists()


def test_the_checkpoint_before_a_divergence_stays(tmp_path, monkeypatch):
    learn = learner.PPOLearner.learn

    def spoil_second_batch(self, *arguments):
        rows = learn(self, *arguments)
        if (tmp_path / "checkpoint.safetensors").is_file():
            self.actor.get_parameter("mlp.0.bias").data[0] = torch.nan
        return rows

    monkeypatch.setattr(learner.PPOLearner, "learn", spoil_second_batch)
    with pytest.raises(
        FloatingPointError, match=r"batch 3 of phase 1: weights of driver not finite"
    ):
        train(TWO_STAGE, tmp_path, quiet=True)
    assert Checkpoint.load(tmp_path / "checkpoint.safetensors").iteration == 1
