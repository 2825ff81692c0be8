"""An HMI that is conditioned on z learns from trips that it drives itself."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from evidence_models import SMALL, evidence_weights, trait_model, untrained_evidence
from trait_models import untrained
from unchecked import unchecked

from hmi_marl.agents.adaptive.advantages import Advantages
from hmi_marl.agents.adaptive.evidence_model import (
    EvidenceCard,
    LearnedEvidence,
    save_evidence,
)
from hmi_marl.agents.adaptive.hmis import TYPES, ConditionedHMI, Trained, make_adaptive
from hmi_marl.agents.adaptive.trait_estimator import TraitEstimator
from hmi_marl.agents.catalogue import make_driver_policy
from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.agents.learned.policy import LearnedPolicy, load_policy
from hmi_marl.agents.learned.trait_model import save_traits
from hmi_marl.demonstrations.dataset import observed_layout
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import Traits
from hmi_marl.envs.observations import vehicle_ai_layout
from hmi_marl.envs.scene import Scene
from hmi_marl.training.conditioned.run import learn_conditioned
from hmi_marl.training.conditioned.settings import ConditionedSettings
from hmi_marl.training.conditioned.student import Student
from hmi_marl.training.conditioned.trips import DrivenTrips, drive
from hmi_marl.training.runs.checkpoint import Checkpoint

TEAM = TeamConfig(ai_sees_attention=False)
TINY = ConditionedSettings(
    driver_policy="random",
    strangers=3,
    types=1,
    candidates=2,
    inflations=2,
    rounds=2,
    updates=2,
    batch=6,
    network=NetworkConfig((5,), rnn_hidden_dim=4),
    checkpoint_every=0.0,
)
FILES = ("vehicle_ai.safetensors", "vehicle_ai.json")


@pytest.fixture
def evidence(tmp_path):
    model = untrained_evidence(TEAM)
    save_evidence(tmp_path / "evidence", model.card, model.weights)
    return tmp_path / "evidence"


def learned(folder, evidence, settings=TINY, **choices):
    learn_conditioned(settings, evidence, folder, quiet=True, **choices)
    return {name: (folder / name).read_bytes() for name in FILES}


def test_a_run_leaves_an_hmi_that_adapts(tmp_path, evidence):
    learned(tmp_path / "run", evidence, command_line="hmi-marl reproduce adapt")
    policy = load_policy(tmp_path / "run", "vehicle_ai", TEAM)
    model = untrained_evidence(TEAM)
    assert policy.card.context == 2 * model.card.context
    assert policy.card.training["context_of"] == model.card.encoder
    assert policy.card.training["evidence"] == model.digest
    assert policy.card.training["command"] == "hmi-marl reproduce adapt"
    assert 0 < policy.card.training["steps"] <= TINY.steps
    rows = json.loads((tmp_path / "run" / "curve.json").read_text())
    assert [row["rounds"] for row in rows] == [1, 2]
    assert all(np.isfinite([row["loss"], row["regret"], row["regret_types"]]).all() for row in rows)
    trained = Trained(str(evidence), str(tmp_path / "run"))
    assert isinstance(make_adaptive("conditioned", TEAM, trained=trained), ConditionedHMI)


def test_the_same_seed_gives_the_same_weights_and_another_does_not(tmp_path, evidence):
    one = learned(tmp_path / "one", evidence)
    assert learned(tmp_path / "two", evidence) == one
    other = learned(tmp_path / "other", evidence, replace(TINY, seed=1))
    assert other[FILES[0]] != one[FILES[0]]


@pytest.mark.parametrize("cut", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_run_that_is_cut_off_goes_on_as_if_nothing_had_happened(
    cut, tmp_path, evidence, monkeypatch
):
    whole = learned(tmp_path / "whole", evidence)
    saves, save = [], Checkpoint.save

    def fail_after(self, path):
        save(self, path)
        saves.append(path)
        if len(saves) == cut:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Checkpoint, "save", fail_after)
        with pytest.raises(KeyboardInterrupt):
            learned(tmp_path / "cut", evidence)
    assert learned(tmp_path / "cut", evidence) == whole


def test_a_policy_that_was_lost_is_written_again(tmp_path, evidence):
    before = learned(tmp_path / "run", evidence)
    for name in FILES:
        (tmp_path / "run" / name).unlink()
    assert learned(tmp_path / "run", evidence) == before


def test_another_evidence_model_or_run_is_refused(tmp_path, evidence):
    learned(tmp_path / "run", evidence)
    with pytest.raises(ValueError, match=r"holds another run \(.*rounds = 2, now 3"):
        learned(tmp_path / "run", evidence, replace(TINY, rounds=3))
    card = untrained_evidence(TEAM).card
    save_evidence(tmp_path / "other", card, evidence_weights(card, seed=9))
    with pytest.raises(ValueError, match="holds another run"):
        learned(tmp_path / "run", tmp_path / "other")
    with pytest.raises(ValueError, match="reads the encoder of another trait model"):
        learned(tmp_path / "new", evidence, replace(TINY, traits="trained:traits-id"))
    assert not (tmp_path / "new").exists()


def test_a_trait_model_of_another_scene_is_refused_before_there_is_a_folder(tmp_path):
    other = untrained(observed_layout(TeamConfig(scene=Scene(lidar_cells=8))))
    save_traits(tmp_path / "traits", other.card, other.weights)
    card = EvidenceCard.for_team(TEAM, other, **SMALL)
    save_evidence(tmp_path / "evidence", card, evidence_weights(card))
    settings = replace(TINY, traits=str(tmp_path / "traits"))
    with pytest.raises(ValueError, match=r"reads 16 columns of 'lidar', .* use the scene"):
        learned(tmp_path / "run", tmp_path / "evidence", settings)
    assert not (tmp_path / "run").exists()


def test_learning_that_diverges_is_reported(tmp_path, evidence):
    wild = unchecked(replace(TINY, updates=20), learning_rate=1e30)
    with pytest.raises(FloatingPointError, match=r"diverged in batch \d+ of phase 1"):
        learned(tmp_path / "run", evidence, wild)


# Trips, and what is learned from them.


class Watched(LearnedPolicy):
    """A policy that keeps what it reads, what follows from it, and what it does."""

    def __init__(self, *arguments, **choices):
        super().__init__(*arguments, **choices)
        self.read, self.odds, self.acts = [], [], []

    def probabilities(self, observations):
        found = super().probabilities(observations)
        self.read.append(np.concatenate([observations[:, self._columns], self.context], axis=1))
        self.odds.append(np.log(found[:, 1]) - np.log(found[:, 0]))
        return found

    def act(self, observations):
        self.acts.append(super().act(observations))
        return self.acts[-1]


class Watching(ConditionedHMI):
    """An HMI that keeps its beliefs."""

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.beliefs = []

    def act(self, observations):
        alerts = super().act(observations)
        self.beliefs.append(self.estimator.belief.probabilities)
        return alerts


class WatchedAdvantages(Advantages):
    """Advantages that are kept."""

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.found = []

    def observe(self, observations):
        self.found.append(super().observe(observations))
        return self.found[-1]


def driven(drivers, seed=0, team=TEAM):
    """Trips of ``drivers`` with an untrained HMI, the HMI, and what it learns from."""
    model = untrained_evidence(TEAM)
    evidence = LearnedEvidence(model, trait_model(), TYPES, team)
    card = TINY.card(model.card.context)
    torch.manual_seed(seed)
    policy = Watched(card, Student(card).weights(), team, greedy=False)
    hmi = Watching(TraitEstimator(evidence, team), policy, model.expected(Traits.of(TYPES)))
    advantages = WatchedAdvantages(TYPES, team, 0.35)
    trips = np.arange(2 * len(drivers), dtype=np.uint64).reshape(-1, 2)
    policy_of_driver = make_driver_policy("random", team)
    found = drive(team, policy_of_driver, hmi, drivers, advantages, 0.35, trips, 1)
    return found, hmi, advantages


@pytest.fixture(scope="module")
def one():
    return driven([TYPES[2], TYPES[0]])


def by_trip(values):
    """Values (N, ...) of each turn of two trips of N = 2 drivers as (2 N, T, ...)."""
    turns = np.array(values)
    return np.concatenate([np.moveaxis(part, 0, 1) for part in np.split(turns, 2)])


def test_what_is_learned_from_is_what_the_driving_hmi_read(one):
    trips, hmi, _ = one
    policy = hmi.policy
    assert trips.inputs.shape == (4, 100, policy.card.inputs)
    assert trips.driving[:, 0].all()
    np.testing.assert_array_equal(trips.inputs, by_trip(policy.read).astype(np.float32))
    student = Student(policy.card)
    torch.manual_seed(0)
    student = Student(policy.card)
    with torch.no_grad():
        odds = student(torch.from_numpy(trips.inputs)).numpy()
    np.testing.assert_allclose(odds, by_trip(policy.odds), atol=1e-4)


def test_every_second_driver_has_an_hmi_that_does_not_depend_on_what_is_learned(one):
    trips, hmi, _ = one
    policy = hmi.policy
    own, there = by_trip(policy.acts), trips.driving
    np.testing.assert_array_equal(trips.alerts[::2][there[::2]], own[::2][there[::2]] > 0)
    assert (trips.alerts[1::2] != own[1::2])[there[1::2]].any()
    other, _, _ = driven([TYPES[2], TYPES[0]], seed=1)
    np.testing.assert_array_equal(other.alerts[1::2], trips.alerts[1::2])
    np.testing.assert_array_equal(other.inputs[1::2], trips.inputs[1::2])
    assert (other.alerts[::2] != trips.alerts[::2]).any()


def test_attention_and_traits_that_are_shown_change_no_trip(one):
    trips, _, _ = one
    shown = TeamConfig(ai_sees_attention=True, observe_traits=True)
    assert {"traits", "distracted"} <= set(vehicle_ai_layout(shown).slices)
    seeing, _, _ = driven([TYPES[2], TYPES[0]], team=shown)
    for name, values in vars(trips).items():
        np.testing.assert_array_equal(getattr(seeing, name), values)


def test_what_is_learned_from_is_the_advantage_that_the_belief_expects(one):
    trips, hmi, advantages = one
    expected = by_trip((np.array(hmi.beliefs) * np.array(advantages.found)).sum(axis=2))
    np.testing.assert_allclose(trips.advantage, expected, rtol=1e-5, atol=1e-5)
    of_each = by_trip(np.array(advantages.found))[trips.driving]
    assert (np.sign(of_each.min(axis=1)) != np.sign(of_each.max(axis=1))).any()


def test_what_is_known_of_a_driver_is_kept_for_the_next_trip(one):
    trips, hmi, _ = one
    policy = hmi.policy
    z = trips.inputs[:, 0, -policy.card.context :]  # of the first trips of both, then the second
    np.testing.assert_allclose(z[0], z[1], atol=1e-6)
    assert np.abs(z[2:] - z[:2]).max(axis=1).min() > 1e-3


def test_regret_by_hand():
    advantage = np.array([[2.0, -3.0, 0.5, 7.0], [1.0, 1.0, -1.0, -1.0]], np.float32)
    alerts = np.array([[1, 1, 0, 0], [0, 1, 1, 0]], np.bool_)
    driving = np.array([[1, 1, 1, 0], [1, 1, 1, 1]], np.bool_)
    trips = DrivenTrips(np.zeros((2, 4, 1), np.float32), advantage, alerts, driving)
    assert trips.regret == pytest.approx([3.0 + 0.5, 1.0 + 1.0])


def test_the_loss_by_hand():
    torch.manual_seed(1)
    student = Student(TINY.card(2))
    inputs = torch.randn(2, 6, TINY.card(2).inputs)
    advantage = torch.tensor([[2.0, -3.0, 0.5, 7.0, -1.0, 0.0]] * 2)
    driving = torch.arange(6) < torch.tensor([[6], [4]])
    with torch.no_grad():
        odds = student(inputs).numpy().astype(np.float64)
        loss = student.loss(inputs, advantage, driving).item()
    each = np.abs(advantage.numpy()) * np.log1p(np.exp(-np.sign(advantage.numpy()) * odds))
    assert loss == pytest.approx(each[driving.numpy()].mean(), rel=1e-5)


@pytest.mark.slow
def test_it_learns_to_lose_less(tmp_path, evidence):
    settings = ConditionedSettings(
        driver_policy="random", strangers=24, types=4, candidates=4, rounds=8, updates=40, batch=40
    )
    learned(tmp_path / "run", evidence, settings)
    rows = json.loads((tmp_path / "run" / "curve.json").read_text())
    assert rows[-1]["regret"] < 0.6 * rows[0]["regret"]


def test_the_hmi_reads_no_column_that_shows_traits_or_attention():
    shown = TeamConfig(ai_sees_attention=True, observe_traits=True)
    layout = vehicle_ai_layout(shown)
    model = untrained_evidence(shown)
    card = TINY.card(model.card.context)
    hmi = ConditionedHMI(
        TraitEstimator(LearnedEvidence(model, trait_model(), TYPES, shown), shown),
        LearnedPolicy(card, Student(card).weights(), shown),
        model.expected(Traits.of(TYPES)),
    )
    seen = np.random.default_rng(0).random((2, layout.size), np.float32)
    seen[1] = seen[0]
    seen[:, layout["time"]] = 0.1
    for name in ("distracted", "accepted", "counter", "traits"):
        seen[1, layout[name]] = 0.123
    hmi.reset(np.arange(2, dtype=np.uint64))
    for step in range(1, 5):
        seen[:, layout["time"]] = step / shown.horizon
        alerts = hmi.act(seen)
        np.testing.assert_array_equal(hmi.policy.context[0], hmi.policy.context[1])
        assert alerts[0] == alerts[1]
