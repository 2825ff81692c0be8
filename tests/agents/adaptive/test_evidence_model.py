from dataclasses import replace

import numpy as np
import pytest
from evidence_models import (
    HIDDEN,
    SMALL,
    any_alerts,
    any_intents,
    evidence_weights,
    seeds,
    trait_model,
    turns,
    untrained_evidence,
)
from standing_world import standing_teams

from hmi_marl.agents.adaptive.evidence_model import (
    DERIVED,
    READS,
    EvidenceCard,
    EvidenceModel,
    LearnedEvidence,
    Turns,
)
from hmi_marl.agents.adaptive.trip_encoder import TripEncoder
from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.agents.learned.situations import LONG_AGO
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import DRIVERS, PAPER_DRIVERS, Driver, Traits
from hmi_marl.envs.observations import vehicle_ai_layout
from hmi_marl.envs.scene import Scene
from hmi_marl.envs.teaming import Teaming

FOUR = [DRIVERS[name] for name in PAPER_DRIVERS]
LAYOUT = vehicle_ai_layout(HIDDEN)


# Cards.


def test_a_card_knows_what_is_read_and_how_large_the_weights_are():
    traits = trait_model()
    features = traits.card.encoder.features
    card = EvidenceCard.for_team(HIDDEN, traits, ("speed", "lane"), **SMALL)
    assert card.reads == (("speed", 1), ("lane", 4))
    assert (card.encoder, card.features) == (traits.digest, features)
    assert (card.context, card.read_size) == (traits.card.latent, 5)
    shapes = card.shapes
    assert shapes["read.centre"] == shapes["read.scale"] == (features + 5,)
    assert shapes["reader.layer0.weight"] == (6, features + 5 + DERIVED)
    assert shapes["reader.layer1.weight"] == (3, 6)
    assert shapes["place.layer0.weight"] == (5, 4)
    assert shapes["place.layer1.weight"] == (3, 5)
    assert shapes["expected.layer1.weight"] == (traits.card.latent, 4)


def test_by_default_it_reads_what_everybody_may_see():
    blind = TeamConfig(ai_sees_attention=False, observe_traits=False)
    card = EvidenceCard.for_team(blind, trait_model())
    assert tuple(name for name, _ in card.reads) == READS
    assert card == EvidenceCard.for_team(TeamConfig(), trait_model())


@pytest.mark.parametrize(
    ("changes", "found"),
    [
        ({"reads": ()}, "reads parts of at least one column"),
        ({"reads": (("speed", 0),)}, "reads parts of at least one column"),
        ({"latent": 0}, "latent lies in 1 to .*, but got 0"),
        ({"features": 0}, "features lies in 1 to .*, but got 0"),
        ({"place": NetworkConfig((4,), rnn_hidden_dim=2)}, "no recurrent layer: set place"),
        ({"reader": NetworkConfig((4,), rnn_hidden_dim=2)}, "no recurrent layer: set reader"),
    ],
    ids=str,
)
def test_impossible_cards_are_refused(changes, found):
    given = {"reads": (("speed", 1),), "encoder": "", "features": 2, "context": 2}
    with pytest.raises(ValueError, match=found):
        EvidenceCard(**(given | changes))


def test_a_part_that_is_not_shown_is_refused():
    with pytest.raises(ValueError, match="no part 'distracted' to read; there are lidar, speed"):
        EvidenceCard.for_team(HIDDEN, trait_model(), ("speed", "distracted"))


def test_weights_that_do_not_fit_are_refused():
    card = EvidenceCard.for_team(HIDDEN, trait_model(), **SMALL)
    weights = evidence_weights(card)
    del weights["place.layer1.bias"]
    with pytest.raises(ValueError, match=r"evidence model's card: place\.layer1\.bias"):
        EvidenceModel(card, weights)
    wrong = evidence_weights(card) | {"read.scale": np.full(card.standardised, np.nan)}
    with pytest.raises(ValueError, match=r"read\.scale is not finite everywhere"):
        EvidenceModel(card, wrong)


# Turns.


def features(turn):
    """(v_{t-2}, steps since the alert, what was shown) of one turn."""
    ends = 5 + (LONG_AGO + 1) * np.arange(5)
    before, ago, attentive_ago, distracted_ago, *_ = np.split(turn[-DERIVED:], ends)
    assert ago.sum() == 1
    shown = {(0, 0): None, (0, 1): "distracted", (1, 0): "attentive"}[
        int(attentive_ago.sum()), int(distracted_ago.sum())
    ]
    where = ago.argmax()
    assert attentive_ago[where] + distracted_ago[where] == (shown is not None)
    return int(before.argmax()) if before.any() else None, int(where), shown


def shown_before(turn):
    """(steps, whether distracted) of the last step before that showed attention."""
    distracted, attentive = np.split(turn[-2 * (LONG_AGO + 1) :], 2)
    assert distracted.sum() + attentive.sum() == 1
    return int((distracted + attentive).argmax()), bool(distracted.any())


def scripted(config=HIDDEN, reads=("speed",)):
    """A trip by hand: attentive but in step 2, with one alert in step 1."""
    # step   0  1  2  3  4
    # a^H    1  3  4  4  4
    # alert  0  1  0  0  0
    # d      0  0  1  0  0
    # v      1  3  3  4  4
    teams = standing_teams(1, driver="bart", ai_sees_attention=False, duration=4.0)
    teams.reset(seeds(1))
    reader, found = Turns(reads, teams.layouts["vehicle_ai"]), []
    for t, (intended, d, alert) in enumerate([(1, 0, 0), (3, 0, 1), (4, 1, 0), (4, 0, 0)]):
        asleep = Driver("any", float(d), 1.0 - d, 0.0, 1.0)
        teams.traits = Traits.of([asleep])
        teams.intend([intended])
        found.append(reader.read(teams.observe("vehicle_ai"), np.ones(1, np.bool_))[0])
        teams.step([alert])
        assert teams.attention.distracted[0] == d, t
    for _ in range(15):
        teams.intend([4])
        found.append(reader.read(teams.observe("vehicle_ai"), np.ones(1, np.bool_))[0])
        teams.step([0])
    return teams, found


def test_what_turns_show_by_hand():
    teams, found = scripted()
    assert teams.over.all() or teams.steps[0] == 19
    assert [features(turn) for turn in found[:6]] == [
        (None, LONG_AGO, None),  # nothing yet
        (None, LONG_AGO, None),  # v_0 = 1 shows nothing
        (1, 0, "attentive"),  # a^H_1 = 3 after v_0 = 1 was applied, during an alert
        (3, 1, "distracted"),  # a^H_2 = 4 after v_1 = 3 was not
        (3, 2, "attentive"),
        (4, 3, None),  # they wanted the same again
    ]
    assert [shown_before(turn) for turn in found[:6]] == [
        *[(LONG_AGO, False)] * 3,  # nothing has shown attention yet
        (0, False),  # step 1 showed an attentive driver
        (0, True),  # step 2 a distracted one
        (0, False),
    ]
    assert [shown_before(turn)[0] for turn in found[6:9]] == [1, 2, 3]
    since = [features(turn)[1] for turn in found[6:]]
    assert since == [min(steps, LONG_AGO) for steps in range(4, 17)]


def test_the_rest_is_read_as_it_is_shown_in_the_order_asked_for():
    teams, found = scripted(reads=("lane", "intended_action", "speed"))
    teams.intend([4])
    seen = teams.observe("vehicle_ai")[0]
    shown = [seen[LAYOUT[name]] for name in ("lane", "intended_action", "speed")]
    np.testing.assert_array_equal(found[-1][:-DERIVED], np.concatenate(shown))
    assert found[-1].dtype == np.float32
    assert len(found[-1]) == 10 + DERIVED


def test_turns_that_are_not_new_are_read_alike_and_not_remembered():
    teams = standing_teams(2, driver="bart", ai_sees_attention=False, duration=4.0)
    teams.reset(seeds(2))
    reader, once = (Turns(("speed",), LAYOUT) for _ in range(2))
    for each in (reader, once):
        each.reset(2)
    every, none = np.ones(2, np.bool_), np.zeros(2, np.bool_)
    for seen in turns(teams, any_intents(10, 2), any_alerts(10, 2)):
        expected = once.read(seen, every)
        for _ in range(2):
            np.testing.assert_array_equal(reader.read(seen, none), expected)
        np.testing.assert_array_equal(reader.read(seen, every), expected)


def test_a_new_trip_has_no_turns_before_it():
    teams = standing_teams(2, driver="bart", ai_sees_attention=False, duration=4.0)
    reader, every = Turns(("speed",), LAYOUT), np.ones(2, np.bool_)
    reader.reset(2)
    teams.reset(seeds(2))
    for seen in turns(teams, any_intents(5, 2), np.ones((5, 2), np.int64)):
        found = reader.read(seen, every)
    assert [features(turn)[1] for turn in found] == [0, 0]
    reader.begin(np.array([False, True]))
    teams.reset(seeds(2), np.array([False, True]))
    teams.intend([1, 1])
    found = reader.read(teams.observe("vehicle_ai"), every)
    assert features(found[0])[0] is not None
    assert features(found[1]) == (None, LONG_AGO, None)


# The model.


def test_places_are_those_of_the_network():
    model = untrained_evidence()
    w = {name: values.astype(np.float64) for name, values in model.weights.items()}
    shown = np.array([[0.8, 0.2, 0.01, 3 / 20], [0.2, 0.8, 1.0, 9 / 20]], np.float32)
    hidden = np.tanh(shown @ w["place.layer0.weight"].T + w["place.layer0.bias"])
    expected = hidden @ w["place.layer1.weight"].T + w["place.layer1.bias"]
    found = model.places(Traits.of([DRIVERS["bart"], DRIVERS["marge"]]))
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_what_is_read_is_put_in_units_and_what_is_derived_is_not():
    model = untrained_evidence()
    size = model.card.standardised
    read = np.random.default_rng(0).random((4, size + DERIVED)).astype(np.float32)
    kept = read.copy()
    found = model.standardise(read)
    np.testing.assert_array_equal(read, kept)
    np.testing.assert_array_equal(found[:, size:], read[:, size:])
    centre, scale = model.weights["read.centre"], model.weights["read.scale"]
    np.testing.assert_allclose(found[:, :size], (read[:, :size] - centre) / scale, rtol=1e-5)


def trip(evidence, teams, steps=20, seed=0):
    """(inputs of the model, evidence), (T, N, ...) each, of a trip that has begun."""
    count = teams.num_teams
    names = [name for name, _ in evidence.model.card.reads]
    reader, every = Turns(names, LAYOUT), np.ones(count, np.bool_)
    encoder = TripEncoder(trait_model(), HIDDEN)
    reader.reset(count)
    encoder.reset(count)
    read, gains = [], []
    for seen in turns(teams, any_intents(steps, count, seed), any_alerts(steps, count, seed=seed)):
        features = encoder.observe(seen, every).astype(np.float32)
        read.append(np.concatenate([features, reader.read(seen, every)], axis=1))
        gains.append(evidence.observe(seen, every))
    return np.array(read), np.array(gains)


def learned(model=None, drivers=FOUR, config=HIDDEN):
    return LearnedEvidence(model or untrained_evidence(), trait_model(), drivers, config)


def begun(count, first=0):
    teams = standing_teams(count, driver=PAPER_DRIVERS, ai_sees_attention=False, duration=4.0)
    teams.reset(seeds(count, first))
    return teams


def test_evidence_is_what_the_reader_says_of_features_and_turns():
    evidence = learned()
    evidence.reset(3)
    read, gains = trip(evidence, begun(3))
    places = evidence.model.places(Traits.of(FOUR))
    for turn, gain in zip(read, gains, strict=True):
        np.testing.assert_allclose(gain, evidence.model.read(turn) @ places.T, rtol=1e-9)
    assert gains.shape == (20, 3, 4)
    features = read[..., : evidence.model.card.features]
    assert not features[0].any()
    assert features[1:].any(axis=2).all()


def test_the_features_of_the_encoder_count():
    model = untrained_evidence()
    weights = dict(model.weights)
    weights["reader.layer0.weight"] = weights["reader.layer0.weight"].copy()
    weights["reader.layer0.weight"][:, : model.card.features] = 0.0
    found = []
    for each in (model, EvidenceModel(model.card, weights)):
        evidence = learned(each)
        evidence.reset(2)
        found.append(trip(evidence, begun(2))[1])
    assert (found[0] != found[1]).any(axis=2).all()


def test_windows_are_pooled_by_adding_up():
    model = untrained_evidence()
    evidence, other = (learned(model) for _ in range(2))
    for each in (evidence, other):
        each.reset(2)
    first = trip(evidence, begun(2), seed=1)[1]
    evidence.begin(np.ones(2, np.bool_))
    second = trip(evidence, begun(2, 7), seed=2)[1]
    np.testing.assert_array_equal(trip(other, begun(2, 7), seed=2)[1], second)
    # and the pooled vector e, whose product with a place it is, is the sum of the turns'
    places = model.places(Traits.of(FOUR))
    pooled = np.linalg.lstsq(places, (first.sum(0) + second.sum(0)).T, rcond=None)[0]
    each = [np.linalg.lstsq(places, part.sum(0).T, rcond=None)[0] for part in (first, second)]
    np.testing.assert_allclose(pooled, each[0] + each[1], atol=1e-9)


def test_only_new_turns_count_and_are_remembered():
    model = untrained_evidence()
    evidence, once = (learned(model) for _ in range(2))
    for each in (evidence, once):
        each.reset(2)
    for seen in turns(begun(2), any_intents(15, 2), any_alerts(15, 2)):
        expected = once.observe(seen, np.ones(2, np.bool_))
        one, other = np.array([True, False]), np.array([False, True])
        first, second = evidence.observe(seen, one), evidence.observe(seen, other)
        np.testing.assert_allclose(first[0], expected[0], rtol=1e-12)
        np.testing.assert_allclose(second[1], expected[1], rtol=1e-12)
        assert not first[1].any()
        assert not second[0].any()
    assert expected.all()


def test_a_new_trip_begins_anew_where_there_is_one():
    evidence = learned()
    evidence.reset(2)
    teams = begun(2)
    _, first = trip(evidence, teams, steps=10)
    evidence.begin(np.array([True, False]))
    teams.reset(seeds(2), np.array([True, False]))
    every = np.ones(2, np.bool_)
    intents, alerts = any_intents(10, 2), any_alerts(10, 2, seed=0)
    second = np.array([evidence.observe(seen, every) for seen in turns(teams, intents, alerts)])
    np.testing.assert_allclose(second[:, 0], first[:, 0], rtol=1e-9)
    assert (second[:, 1] != first[:, 1]).any(axis=1).all()


def test_teams_of_another_scene_are_refused():
    other = replace(HIDDEN, scene=Scene(lidar_cells=8))
    with pytest.raises(ValueError, match=r"reads 32 columns of 'lidar', .* use the scene that"):
        learned(config=other)
    lanes = replace(HIDDEN, scene=Scene(lanes=4))
    with pytest.raises(ValueError, match=r"reads other columns .* use the scene that"):
        learned(untrained_evidence(names=("lane",)), config=lanes)
    for hidden in ("traits", "eta", "inflation", "distracted"):
        with pytest.raises(ValueError, match=f"may not read '{hidden}': driver inference hides it"):
            EvidenceCard.for_team(TeamConfig(), trait_model(), ("speed", hidden), **SMALL)


def test_the_encoder_of_another_trait_model_is_refused():
    model = untrained_evidence()
    stranger = EvidenceModel(replace(model.card, encoder="0" * 64), model.weights)
    with pytest.raises(ValueError, match="reads the encoder of another trait model"):
        learned(stranger)


def test_it_reads_neither_attention_nor_traits():
    # Two teams that differ in nothing but what is hidden look alike.
    config = TeamConfig(driver=[FOUR[0]])
    evidence = learned(untrained_evidence(config), config=config)
    evidence.reset(2)
    layout = vehicle_ai_layout(config)
    teams = Teaming(config, 2, "highway")
    teams.reset(np.array([3, 3], np.uint64))
    for _ in range(3):
        teams.intend(np.array([3, 3]))
        seen = teams.observe("vehicle_ai")
        for name in ("distracted", "accepted", "counter", "traits"):
            seen[1, layout[name]] = 0.7
        for name in ("applied_action", "previous_intended_action"):
            seen[1, layout[name]] = seen[0, layout[name]]
        found = evidence.observe(seen, np.ones(2, np.bool_))
        np.testing.assert_allclose(found[0], found[1], rtol=1e-12)
        teams.step(np.array([1, 1]))
    latent = evidence.encoder.latent()
    np.testing.assert_allclose(latent.mean[0], latent.mean[1], rtol=1e-12)
