from dataclasses import fields, replace

import numba
import numpy as np
import pytest
from evidence_models import HIDDEN, save_trained

from hmi_marl.agents import make_driver_policy, make_hmi
from hmi_marl.agents.adaptive.evidence_model import LearnedEvidence
from hmi_marl.agents.adaptive.hmis import TYPES, ChoosingHMI, ConditionedHMI, ExpectedValueHMI
from hmi_marl.envs.drivers import DRIVERS, Traits
from hmi_marl.exact.evidence import ChainEvidence
from hmi_marl.experiments.adaptation.hmis import (
    ADAPTIVE,
    AVERAGE,
    BAYES,
    KNOWING,
    LEARNED_AVERAGE,
    LEARNED_KNOWING,
    NONE,
    Hmis,
    KnownDriver,
    hmi_names,
    read_by,
)
from hmi_marl.experiments.adaptation.trips import HandOver, play_trips

LISA, MARGE, BART, HOMER = TYPES
SEEDS = np.arange(12, dtype=np.uint64).reshape(4, 3)


@pytest.fixture(autouse=True)
def one_thread(monkeypatch):
    monkeypatch.setattr(numba.config, "NUMBA_NUM_THREADS", 1)


@pytest.fixture
def hmis(tmp_path):
    return Hmis(HIDDEN, save_trained(tmp_path), TYPES, TYPES, revealing=0.4, caution=0.7)


def test_who_drives_is_told_without_a_doubt():
    evidence = KnownDriver([LISA, BART])
    evidence.reset(3)
    evidence.set_drivers(Traits.of([BART, LISA, BART]))
    told = evidence.observe(np.zeros((3, 1), np.float32), np.array([True, True, False]))
    assert told.tolist() == [[-np.inf, 0], [0, -np.inf], [0, 0]]
    evidence.begin(np.ones(3, np.bool_))
    again = evidence.observe(np.zeros((3, 1), np.float32), np.ones(3, np.bool_))
    assert again.tolist() == [[-np.inf, 0], [0, -np.inf], [-np.inf, 0]]
    with pytest.raises(ValueError, match="a driver is not among the candidates"):
        evidence.set_drivers(Traits.of([BART, MARGE, BART]))
    evidence.reset(3, np.array([True, False, False]))
    others = evidence.observe(np.zeros((3, 1), np.float32), np.ones(3, np.bool_))
    assert others.tolist() == [[0, -np.inf], [0, -np.inf], [-np.inf, 0]]


@pytest.mark.parametrize("name", hmi_names([BART]))
def test_an_hmi_reads_what_is_said_and_no_less(name, tmp_path):
    trained = save_trained(tmp_path)
    read = read_by(name, trained)
    Hmis(HIDDEN, read, [BART], TYPES, revealing=0.4, caution=0.7).make(name)
    for field in fields(read):
        missing = replace(read, **{field.name: str(tmp_path / "nothing-{}")})
        factory = Hmis(HIDDEN, missing, [BART], TYPES, revealing=0.4, caution=0.7)
        if getattr(read, field.name):
            with pytest.raises(FileNotFoundError):
                factory.make(name)
        else:
            factory.make(name)


def test_one_learned_for_the_driver_is_there_for_a_type_alone():
    assert LEARNED_KNOWING in hmi_names([BART])
    for drivers in ([BART, LISA], [DRIVERS["average"]]):
        assert LEARNED_KNOWING not in hmi_names(drivers)
        assert {KNOWING, AVERAGE, NONE, LEARNED_AVERAGE, *ADAPTIVE} == set(hmi_names(drivers))


@pytest.mark.parametrize("name", ADAPTIVE)
def test_adaptive_ones_are_of_the_kind_that_their_name_says(name, hmis):
    hmi = hmis.make(name)
    kinds = {"chooses": ChoosingHMI, "conditioned": ConditionedHMI, "expected": ExpectedValueHMI}
    assert type(hmi) is kinds[name.split()[0]]
    evidence = ChainEvidence if name.endswith(BAYES) else LearnedEvidence
    assert type(hmi.estimator.evidence) is evidence
    if name.startswith("expected"):
        assert hmi.caution == 0.7
    assert hmis.make(name) is not hmi


def play(hmis, hmi, drivers, change=None, on_drivers=None):
    policy = make_driver_policy("random", HIDDEN)
    return play_trips(
        HIDDEN, policy, hmi, Traits.of(drivers), SEEDS[: len(drivers)], change, on_drivers
    )


def test_the_knowing_hmi_plays_the_optimum_for_whoever_drives(hmis):
    # Not marge: in her last step an alert may be worth just as much as none.
    drivers = [LISA, BART, HOMER]
    found = play(hmis, hmis.make(KNOWING), drivers, on_drivers=hmis.known.set_drivers)
    for k, driver in enumerate(drivers):
        own = play(hmis, make_hmi(f"belief:{driver.name}:0.4", HIDDEN), drivers)
        np.testing.assert_array_equal(found.rewards[k], own.rewards[k])
        np.testing.assert_array_equal(found.driving[k], own.driving[k])


def test_the_knowing_hmi_is_told_of_a_change_at_once(hmis):
    change = HandOver(1, 10, Traits.of([BART] * 3))
    played = play(hmis, hmis.make(KNOWING), [LISA, LISA, HOMER], change, hmis.known.set_drivers)
    before = play(hmis, hmis.make(KNOWING), [LISA, LISA, HOMER], on_drivers=hmis.known.set_drivers)
    np.testing.assert_array_equal(played.rewards[:, 0], before.rewards[:, 0])
    np.testing.assert_array_equal(played.rewards[:, 1, :10], before.rewards[:, 1, :10])
    barts = play(hmis, make_hmi("belief:bart:0.4", HIDDEN), [BART] * 3)
    np.testing.assert_array_equal(played.rewards[:, 2], barts.rewards[:, 2])


def test_the_others_are_ordinary_hmis(hmis):
    average = hmis.make(AVERAGE)
    assert average.model == DRIVERS["average"]
    assert average._rule.revealing == 0.4
    assert hmis.make(NONE).rate == 0.0
    for name, model in ((LEARNED_AVERAGE, "average"), (LEARNED_KNOWING, "lisa")):
        expected = hmis.trained.hidden_hmi(model, HIDDEN).weights
        for key, values in hmis.make(name).weights.items():
            np.testing.assert_array_equal(values, expected[key])
