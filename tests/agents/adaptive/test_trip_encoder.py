"""Trips under way are encoded as whole windows are."""

from dataclasses import replace

import numpy as np
import pytest
from evidence_models import HIDDEN, any_alerts, any_intents, seeds, trait_model, turns
from hypothesis import given, settings
from hypothesis import strategies as st
from standing_world import standing_teams

from hmi_marl.agents import make_driver_policy, make_hmi
from hmi_marl.agents.adaptive.trip_encoder import TripEncoder
from hmi_marl.agents.rollout import Observer, begin, play
from hmi_marl.demonstrations.recording import StepRecorder
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.observations import vehicle_ai_layout
from hmi_marl.envs.scene import Scene

LAYOUT = vehicle_ai_layout(HIDDEN)
COLUMNS = LAYOUT.columns(name for name, _ in trait_model().card.reads)


def observations(count, steps, seed, layout=LAYOUT):
    """Turns (T, N, D) that look like a trip: random states, what was applied and alerted before."""
    rng = np.random.default_rng(seed)
    seen = np.zeros((steps + 1, count, layout.size), np.float32)
    columns = layout.columns(name for name, _ in trait_model().card.reads)
    seen[..., columns] = rng.normal(size=(steps + 1, count, len(columns)))
    actions = rng.integers(0, 5, (steps, count))
    alerts = rng.integers(0, 2, (steps, count))
    seen[1:, :, layout["applied_action"]] = actions[..., None] == np.arange(5)
    seen[1:, :, layout["alerted"]] = alerts[..., None]
    return seen, actions, alerts


def encoded(encoder, seen, length):
    """Read turns; each team's trip has its own number of completed steps."""
    for t, turn in enumerate(seen):
        encoder.observe(turn, t <= length)
    return encoder


@settings(deadline=None, max_examples=20)
@given(seed=st.integers(0, 1000), lengths=st.lists(st.integers(1, 25), min_size=1, max_size=4))
def test_a_trip_under_way_is_encoded_as_a_window_of_its_steps(seed, lengths):
    length = np.array(lengths)
    seen, actions, alerts = observations(len(length), int(length.max()), seed)
    encoder = TripEncoder(trait_model(), HIDDEN)
    encoder.reset(len(length))
    encoded(encoder, seen, length)
    states = seen[:-1][..., COLUMNS].swapaxes(0, 1)
    whole = trait_model().encoder.encode(states, actions.T, alerts.T, length)
    np.testing.assert_allclose(encoder.sums, whole, rtol=1e-9, atol=1e-9)
    expected = trait_model().encoder.latent(whole)
    np.testing.assert_allclose(encoder.latent().mean, expected.mean, rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(encoder.latent().variance, expected.variance, rtol=1e-7)


class Encodes(Observer):
    """Encode trips as the vehicle AI sees them."""

    def __init__(self, encoder):
        self.encoder = encoder

    def seen(self, teaming, observations):
        self.encoder.observe(observations, ~teaming.over)


def test_a_trip_is_encoded_as_its_demonstration_is():
    # What the vehicle AI sees of a trip is what a recording of it holds, but for the last step.
    crowded = Scene(vehicles=(10, 20))
    config = TeamConfig(duration=6.0, ai_sees_attention=False, scene=crowded)
    driver, hmi = make_driver_policy("random", config), make_hmi("random:0.4", config)
    teaming = begin(config, driver, hmi, seeds(12), "batched")
    encoder, recorder = TripEncoder(trait_model(), config), StepRecorder(config, 12)
    encoder.reset(12)
    play(teaming, driver, hmi, [recorder, Encodes(encoder)])
    length = teaming.steps - 1
    assert length.min() < length.max() == 29  # some have crashed
    there = length > 0
    whole = trait_model().encoder.encode(
        recorder.states, recorder.applied, recorder.alerts, np.maximum(length, 1)
    )
    np.testing.assert_allclose(encoder.sums[there], whole[there], rtol=1e-9, atol=1e-9)
    assert not encoder.sums[~there].any()


def test_trips_of_one_driver_are_pooled_and_others_go_on():
    first, second = (observations(2, 12, seed)[0] for seed in (1, 2))
    pooled, *alone = (TripEncoder(trait_model(), HIDDEN) for _ in range(3))
    length = np.array([12, 12])
    for encoder, seen in zip(alone, (first, second), strict=True):
        encoder.reset(2)
        encoded(encoder, seen, length)
    pooled.reset(2)
    encoded(pooled, first, length)
    pooled.begin(np.array([True, False]))
    still = pooled.sums.copy()
    np.testing.assert_allclose(still, alone[0].sums)
    encoded(pooled, second, length)
    np.testing.assert_allclose(pooled.sums[0], alone[0].sums[0] + alone[1].sums[0])
    assert pooled.sums[1, -1] == 12 + 12  # its trip went on; the first turn shows no step
    pooled.reset(2, np.array([False, True]))  # another driver
    np.testing.assert_allclose(pooled.sums[0], alone[0].sums[0] + alone[1].sums[0])
    assert not pooled.sums[1].any()
    pooled.reset(3)
    assert not pooled.sums.any()
    with pytest.raises(ValueError, match="at least one step"):
        pooled.latent()


def test_features_are_what_the_sums_grow_by():
    encoder = TripEncoder(trait_model(), HIDDEN)
    encoder.reset(3)
    teams = standing_teams(3, driver="bart", ai_sees_attention=False, duration=4.0)
    teams.reset(seeds(3))
    every, before = np.ones(3, np.bool_), encoder.sums
    for t, seen in enumerate(turns(teams, any_intents(15, 3), any_alerts(15, 3))):
        features = encoder.observe(seen, every)
        np.testing.assert_allclose(features, (encoder.sums - before)[:, :-1], atol=1e-12)
        assert (encoder.sums[:, -1] == t).all()
        before = encoder.sums
        repeated = encoder.observe(seen, ~every)
        assert not repeated.any()
        np.testing.assert_array_equal(encoder.sums, before)


def test_nothing_but_state_actions_and_alerts_is_read():
    config = TeamConfig(ai_sees_attention=True, observe_traits=True)
    layout = vehicle_ai_layout(config)
    names = [name for name, _ in trait_model().card.reads]
    hidden = np.setdiff1d(
        np.arange(layout.size), layout.columns([*names, "applied_action", "alerted"])
    )
    unseen = "intended_action", "previous_intended_action", "distracted", "accepted", "traits"
    assert set(layout.columns(unseen)) <= set(hidden)
    seen, _, _ = observations(2, 10, 3, layout)
    altered = seen.copy()
    altered[..., hidden] = 0.3
    found = []
    for turns_seen in (seen, altered):
        encoder = TripEncoder(trait_model(), config)
        encoder.reset(2)
        found.append(encoded(encoder, turns_seen, np.array([10, 10])).sums)
    np.testing.assert_array_equal(*found)
    assert found[0].any()


def test_another_scene_is_refused():
    with pytest.raises(ValueError, match=r"reads 32 columns of 'lidar', which these teams do not"):
        TripEncoder(trait_model(), replace(HIDDEN, scene=Scene(lidar_cells=8)))
