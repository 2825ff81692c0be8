from dataclasses import replace

import numpy as np
import pytest
from evidence_models import trait_model

from hmi_marl.agents import make_driver_policy, make_hmi
from hmi_marl.agents.adaptive.evidence_model import DERIVED, Turns
from hmi_marl.agents.adaptive.trip_encoder import TripEncoder
from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import DRIVERS, known_name
from hmi_marl.envs.observations import vehicle_ai_layout
from hmi_marl.envs.streams import Stream, mix
from hmi_marl.envs.teaming import Teaming
from hmi_marl.envs.worlds import make_world
from hmi_marl.training.evidence import run as driving
from hmi_marl.training.evidence.run import MixedPopulation, drive_all
from hmi_marl.training.evidence.settings import EvidenceSettings

SETTINGS = EvidenceSettings(
    driver_policy="random",
    hmis=("never", "random:0.5"),
    drives=12,
    batch=4,
    reads=("speed", "intended_action"),
    reader=NetworkConfig((4,)),
)
FEATURES = trait_model().card.encoder.features


@pytest.fixture(scope="module")
def driven():
    return drive_all(SETTINGS)


def names(traits):
    return [known_name(*row) for row in traits.as_array()]


def test_known_drivers_and_strangers_are_mixed_as_asked_for():
    seeds = mix(3, Stream.TRAINING, np.arange(2000, dtype=np.uint64))
    drawn = names(MixedPopulation(0.4).draw(seeds))
    share = np.mean([name is not None for name in drawn])
    assert abs(share - 0.4) < 4 * np.sqrt(0.24 / 2000)
    for name in DRIVERS:
        assert abs(drawn.count(name) / 2000 - 0.08) < 4 * np.sqrt(0.08 * 0.92 / 2000)
    assert set(names(MixedPopulation(1.0).draw(seeds))) == set(DRIVERS)
    others = MixedPopulation(0.0).draw(seeds)
    assert set(names(others)) == {None}
    assert abs(others.beta.mean() - 0.5) < 4 * np.sqrt(1 / 12 / 2000)
    assert others.inflation.max() <= 9


def test_a_strangers_traits_do_not_tell_whether_a_known_driver_would_have_driven():
    # Else the share of the known would depend on β.
    seeds = mix(4, Stream.TRAINING, np.arange(4000, dtype=np.uint64))
    mixed, others = MixedPopulation(0.5).draw(seeds), MixedPopulation(0.0).draw(seeds)
    stranger = mixed.beta == others.beta
    above = others.beta > 0.5
    difference = stranger[above].mean() - stranger[~above].mean()
    assert abs(difference) < 4 * np.sqrt(0.25 * 2 / 2000)


def test_drives_are_those_of_an_ordinary_team(driven):
    count = SETTINGS.drives
    seeds = mix(SETTINGS.seed, Stream.TRAINING, np.arange(count, dtype=np.uint64))
    assert driven.turns.shape == (count, 100, FEATURES + 6 + DERIVED)
    assert driven.z.shape == (count, trait_model().card.latent)
    team = replace(SETTINGS.team, driver=MixedPopulation(SETTINGS.known))
    for k, hmi_name in ((1, "never"), (8, "random:0.5")):
        driver, hmi = make_driver_policy("random", team), make_hmi(hmi_name, team)
        teaming = Teaming(team, 1, make_world("batched", team.scene, 1, 1))
        for each in (teaming, driver, hmi):
            each.reset(seeds[k : k + 1])
        np.testing.assert_array_equal(driven.traits.as_array()[k], teaming.traits.as_array()[0])
        reader, steps = Turns(SETTINGS.reads, teaming.layouts["vehicle_ai"]), 0
        encoder = TripEncoder(trait_model(), team)
        while not teaming.over[0]:
            teaming.intend(driver.act(teaming.observe("driver")))
            seen = teaming.observe("vehicle_ai")
            every = np.ones(1, np.bool_)
            features, read = encoder.observe(seen, every)[0], reader.read(seen, every)[0]
            read = np.concatenate([features, read])
            np.testing.assert_allclose(driven.turns[k, steps], read, atol=1e-5)
            teaming.step(hmi.act(seen))
            steps += 1
        assert driven.driving[k].tolist() == [t < steps for t in range(100)]
        np.testing.assert_allclose(driven.z[k], encoder.latent().mean[0], rtol=1e-4, atol=1e-4)


def test_attention_and_traits_that_are_shown_change_no_drive(driven, monkeypatch):
    shown = TeamConfig(ai_sees_attention=True, observe_traits=True)
    assert {"traits", "distracted"} <= set(vehicle_ai_layout(shown).slices)
    assert "distracted" not in vehicle_ai_layout(SETTINGS.team).slices
    monkeypatch.setattr(EvidenceSettings, "team", shown)
    seeing = drive_all(SETTINGS)
    for name in ("turns", "driving", "z"):
        np.testing.assert_array_equal(getattr(seeing, name), getattr(driven, name))


def test_drives_end_with_the_crash(driven):
    lengths = driven.driving.sum(axis=1)
    assert len(set(lengths.tolist())) > 3
    for length, on in zip(lengths, driven.driving, strict=True):
        assert on[:length].all()


def test_each_hmi_sits_beside_an_equal_share(driven):
    since = driven.turns[:, :, -DERIVED + 5 : -DERIVED + 16].argmax(axis=2)
    alerted = (since < 10) & driven.driving
    assert not alerted[:6].any()
    assert alerted[6:].any(axis=1).all()


def test_how_many_drive_at_once_changes_nothing(driven, monkeypatch):
    told = []
    monkeypatch.setattr(driving, "_AT_ONCE", 4)
    few = drive_all(SETTINGS, told.append)
    assert told == [4, 2, 4, 2]
    np.testing.assert_array_equal(few.driving, driven.driving)
    np.testing.assert_array_equal(few.turns[few.driving], driven.turns[driven.driving])


def test_other_seeds_are_other_drives(driven):
    other = drive_all(replace(SETTINGS, seed=1))
    assert (other.traits.beta != driven.traits.beta).any()


def test_names_that_nobody_knows_are_refused():
    with pytest.raises(ValueError, match="unknown HMI 'siren'"):
        drive_all(replace(SETTINGS, hmis=("siren",)))
    with pytest.raises(ValueError, match="unknown driver policy 'autopilot'"):
        drive_all(replace(SETTINGS, driver_policy="autopilot"))
