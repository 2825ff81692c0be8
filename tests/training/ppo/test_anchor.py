"""Human-regularised PPO: the driver's loss holds it close to a given driver policy."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.agents.learned.policy import LearnedPolicy, load_policy, make_card, save_policy
from hmi_marl.agents.partners import make_vec
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.scene import Scene
from hmi_marl.training.ppo.anchor import Anchor
from hmi_marl.training.ppo.learner import PPOLearner, play_batch
from hmi_marl.training.ppo.models import (
    SeatView,
    make_actor,
    make_critic,
    make_joint_actor,
    weights_of,
)
from hmi_marl.training.ppo.run import train
from hmi_marl.training.protocols.fine_tune import FineTune
from hmi_marl.training.protocols.joint import Joint, Simultaneous
from hmi_marl.training.protocols.settings import PPOSettings
from hmi_marl.training.protocols.two_stage import TwoStage

TEAM = TeamConfig(duration=1.0, scene=Scene(vehicles=(1, 3)))
TINY = {
    "num_teams": 8,  # 40 steps a batch
    "duration": 1.0,
    "vehicles": (1, 3),
    "network": NetworkConfig((8,)),
    "ppo": PPOSettings(num_learning_epochs=1, num_mini_batches=2),
    "device": "cpu",
    "threads": 1,
}
ANCHOR = "trained:driver"
TIMED = {"seconds", "steps_per_second", "share_of_time_learning", "share_of_time_waiting"}
WEIGHTS = ("driver.safetensors", "vehicle_ai.safetensors")


def rows(folder):
    curve = json.loads((folder / "curve.json").read_text())
    return [{name: row[name] for name in row.keys() - TIMED} for row in curve]


def learned(folder, settings):
    train(settings, folder, quiet=True)
    return [(folder / name).read_bytes() for name in WEIGHTS]


def learner_for(env, seats):
    torch.manual_seed(0)
    network = NetworkConfig((8,))
    cards = [make_card("driver", TEAM, network, True)]
    if seats == 2:
        cards.append(make_card("vehicle_ai", TEAM, network, True, by_intent=True))
    view = SeatView(env, tuple(cards), centralised=True)
    actor = make_joint_actor(*cards) if seats == 2 else make_actor(*cards)
    critic = make_critic(view.critic_inputs, network)
    settings = PPOSettings(num_mini_batches=2)
    return PPOLearner(actor, critic, view, env.get_observations(), 5, seats, settings, "cpu")


def env_for(seats):
    seat, partner = ("team", None) if seats == 2 else ("driver", "never")
    return make_vec(8, seat, partner, threads=1, **vars(TEAM))


@pytest.mark.parametrize("seats", [1, 2], ids=["one action", "composite"])
def test_the_gradient_of_the_loss_gets_that_of_the_divergence(seats):
    env = env_for(seats)
    learner = learner_for(env, seats)
    policy = load_policy(ANCHOR, "driver", TEAM)
    learner.anchor_to(Anchor(policy, env, 0.7, "cpu"))
    learner.begin(0.0)
    play_batch(env, learner, 3)
    (shard,) = learner.shards
    shard.evaluate(learner.view(env.get_observations()).critic)
    batch = shard.mini_batches()[1]
    with_anchor, losses = (values.clone() for values in shard.gradient(batch, 0.01))
    shard.anchor_kl = 0.0
    without, measured = (values.clone() for values in shard.gradient(batch, 0.01))
    assert torch.equal(losses, measured)
    logits = learner.actor.mlp(batch.actor)
    ours = torch.log_softmax(logits[:, :5], -1)
    divergence = (ours.exp() * (ours - batch.anchor)).sum(-1).mean()
    weights = list(learner.actor.parameters())
    known = torch.autograd.grad(0.7 * divergence, weights, allow_unused=True)
    flat = torch.cat(
        [
            (torch.zeros_like(weight) if part is None else part).flatten()
            for part, weight in zip(known, weights, strict=True)
        ]
    )
    assert flat.abs().max() > 1e-3
    torch.testing.assert_close((with_anchor - without)[: len(flat)], flat, rtol=1e-4, atol=1e-6)
    assert torch.equal(with_anchor[len(flat) :], without[len(flat) :])  # the critic's
    assert measured[3].item() == pytest.approx(divergence.item(), rel=1e-5)


@pytest.mark.parametrize("reads", [(), ("speed", "lidar")], ids=["all", "some"])
def test_the_anchors_probabilities_are_those_by_which_it_plays(reads):
    env = env_for(1)
    learner = learner_for(env, 1)
    card = make_card("driver", TEAM, NetworkConfig((6, 5), "tanh"), knows_traits=True)
    card = card.reading(reads) if reads else card
    torch.manual_seed(4)
    policy = LearnedPolicy(card, weights_of(make_actor(card)), TEAM)
    learner.anchor_to(Anchor(policy, env, 0.0, "cpu"))
    learner.begin(0.0)
    env.reset(2)
    seen = env.get_observations()
    with torch.inference_mode():
        learner.act(seen)
    policy.reset(np.zeros(8, np.uint64))
    expected = policy.probabilities(seen["driver"].numpy())
    found = learner.rollout.anchor[0, 0].exp().numpy()
    np.testing.assert_allclose(found, expected, rtol=1e-5)


@pytest.mark.parametrize("protocol", [Joint, Simultaneous])
def test_without_weight_an_anchor_changes_no_byte_and_its_divergence_is_recorded(
    protocol, tmp_path
):
    settings = protocol(steps=120, **TINY)
    free = learned(tmp_path / "free", settings)
    assert learned(tmp_path / "zero", replace(settings, anchor=ANCHOR)) == free
    curve = rows(tmp_path / "zero")
    divergences = [row.pop("anchor_kl") for row in curve]
    assert curve == rows(tmp_path / "free")
    assert min(divergences) > 0.1  # new weights are no trained driver
    held = replace(settings, anchor=ANCHOR, anchor_kl=0.3)
    assert all(a != b for a, b in zip(learned(tmp_path / "held", held), free, strict=True))


@pytest.mark.parametrize(
    ("protocol", "batches", "ratio"),
    [
        (Joint, 8, 3),
        pytest.param(Joint, 40, 20, marks=pytest.mark.slow),
        pytest.param(Simultaneous, 40, 20, marks=pytest.mark.slow),
    ],
)
def test_the_more_weight_the_closer_the_driver_stays(protocol, batches, ratio, tmp_path):
    card = make_card("driver", TEAM, NetworkConfig((8,)), knows_traits=True)
    draw = np.random.default_rng(2)
    weights = {name: draw.normal(0, 0.5, shape) for name, shape in card.shapes.items()}
    save_policy(tmp_path, card, weights)
    ppo = PPOSettings(
        num_learning_epochs=6, num_mini_batches=2, learning_rate=2e-2, final_learning_rate=1e-3
    )
    sizes = TINY | {"ppo": ppo, "steps": 40 * batches}
    settings = protocol(anchor=str(tmp_path), **sizes)
    last = []
    for weight in (0.0, 0.1, 1e4):
        folder = tmp_path / str(weight)
        train(replace(settings, anchor_kl=weight), folder, quiet=True)
        last.append(np.mean([row["anchor_kl"] for row in rows(folder)[-3:]]))
    assert last == sorted(last, reverse=True)
    assert last[0] > ratio * last[-1]


def test_a_run_does_not_go_on_with_another_anchor(tmp_path):
    for name, seed in (("one", 1), ("other", 2)):
        anchor = TwoStage(driver_steps=40, hmi_steps=0, seed=seed, **TINY)
        train(anchor, tmp_path / name, quiet=True)
    settings = Simultaneous(steps=40, anchor=str(tmp_path / "one"), anchor_kl=0.1, **TINY)
    before = learned(tmp_path / "run", settings)
    noted = json.loads((tmp_path / "run" / "run.json").read_text())["settings"]["anchor"]
    assert noted["name"] == "one"
    for anchor in (str(tmp_path / "other"), ANCHOR):
        with pytest.raises(
            ValueError, match=r"holds another run \(anchor = '\w+\.\.\., now '\w+\.\.\.\)"
        ):
            train(replace(settings, anchor=anchor), tmp_path / "run", quiet=True)
    with pytest.raises(ValueError, match=r"anchor_kl = 0\.1, now 0\.2"):
        train(replace(settings, anchor_kl=0.2), tmp_path / "run", quiet=True)
    (tmp_path / "one").rename(tmp_path / "moved")  # the same weights elsewhere
    moved = replace(settings, anchor=str(tmp_path / "moved"))
    assert learned(tmp_path / "run", moved) == before


@pytest.mark.parametrize("anchor", ["rule", "trained:homer", "first-stage", "/no/such"])
def test_a_bad_anchor_leaves_no_folder(anchor, tmp_path):
    settings = Simultaneous(steps=40, anchor=anchor, **TINY)
    with pytest.raises((ValueError, FileNotFoundError)):
        train(settings, tmp_path / "run", quiet=True)
    assert not list(tmp_path.iterdir())


TUNED = FineTune(driver_steps=80, hmi_steps=80, together_steps=80, **TINY)


def test_fine_tune_goes_on_from_the_policies_of_two_stages(tmp_path):
    stages = learned(tmp_path / "stages", TwoStage(driver_steps=80, hmi_steps=80, **TINY))
    whole = replace(TINY["ppo"], num_mini_batches=1)  # so that one step is taken after the first
    anchored = replace(TUNED, anchor="first-stage", anchor_kl=0.5, snapshots=1)
    tuned = learned(tmp_path / "tuned", anchored)
    taken = tmp_path / "tuned" / "snapshots"
    assert (taken / "80" / WEIGHTS[0]).read_bytes() == stages[0]
    assert (taken / "160" / WEIGHTS[1]).read_bytes() == stages[1]
    assert all(a != b for a, b in zip(tuned, stages, strict=True))
    # Nothing is new: few steps of 1e-3 from the weights of the stages.
    for seat in ("driver", "vehicle_ai"):
        ends = [load_policy(tmp_path / run, seat, TEAM).weights for run in ("stages", "tuned")]
        apart = max(abs(ends[0][name] - ends[1][name]).max() for name in ends[0])
        assert 0 < apart < 0.01
    learned(tmp_path / "measured", replace(anchored, ppo=whole))
    curve = rows(tmp_path / "measured")
    assert ["anchor_kl" in row for row in curve] == [False] * 4 + [True] * 2
    assert curve[4]["anchor_kl"] == pytest.approx(0, abs=1e-6)  # before the first step
    assert curve[5]["anchor_kl"] > 1e-6


def test_the_driver_of_the_first_stage_stays_the_anchor_when_its_file_is_another(tmp_path):
    # As if a run had been cut off after it wrote its last policies: those are not the anchor.
    anchored = replace(TUNED, anchor="first-stage", anchor_kl=5.0, checkpoint_every=0.0)
    whole = learned(tmp_path / "whole", anchored)

    class Killed(BaseException):
        pass

    from hmi_marl.training.runs.checkpoint import Checkpoint

    save = Checkpoint.save

    def cut_off(self, path):
        save(self, path)
        if (self.phase, self.iteration) == (2, 1):
            raise Killed

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Checkpoint, "save", cut_off)
        with pytest.raises(Killed):
            train(anchored, tmp_path / "cut", quiet=True)
    (tmp_path / "cut" / WEIGHTS[0]).write_bytes(whole[0])
    (tmp_path / "cut" / "driver.json").write_bytes((tmp_path / "whole/driver.json").read_bytes())
    assert learned(tmp_path / "cut", anchored) == whole
