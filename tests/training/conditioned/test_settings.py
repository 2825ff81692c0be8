import numpy as np
import pytest

from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.envs.drivers import get_driver
from hmi_marl.training.conditioned.settings import (
    HMI_READS,
    ConditionedSettings,
    strangers,
    with_any_inflation,
)


def test_strangers_come_back_by_their_seed():
    one = strangers(20, 3)
    assert strangers(20, 3) == one
    assert strangers(12, 3) == one[:12]
    assert not set(strangers(20, 4)) & set(one)
    drivers = [get_driver(text) for text in one]
    assert [driver.name for driver in drivers[:2]] == ["stranger-0", "stranger-1"]
    assert len({driver.traits for driver in drivers}) == 20


def test_strangers_are_drawn_evenly():
    table = np.array([get_driver(text).traits for text in strangers(1000, 0)])
    middle, width = np.array([0.5, 0.5, 0.5, 5.0]), np.array([1.0, 1.0, 1.0, 8.0])
    assert (np.abs(table.mean(axis=0) - middle) < 4 * width / np.sqrt(12 * 1000)).all()
    assert (np.abs(table - middle) <= width / 2).all()


def test_inflations_are_spread_over_their_range():
    found = with_any_inflation(strangers(3, 1), 4)
    assert len(found) == 12
    assert [driver.inflation for driver in found[:4]] == [2.0, 4.0, 6.0, 8.0]
    assert len({driver.traits[:3] for driver in found}) == 3


def test_the_card_reads_no_attention_no_traits_and_z_with_its_uncertainty():
    settings = ConditionedSettings(network=NetworkConfig((8,), rnn_hidden_dim=3))
    card = settings.card(5)
    assert (card.context, card.network) == (10, settings.network)
    assert dict(card.reads).keys() == set(HMI_READS)
    assert not settings.team.ai_sees_attention


def test_steps_are_those_of_all_trips():
    settings = ConditionedSettings(strangers=10, types=2, trips=3, rounds=5, batch=4)
    assert settings.trips_per_round == 3 * (10 + 4 * 2)
    assert settings.steps == 5 * 54 * 100


@pytest.mark.parametrize(
    ("changes", "found"),
    [
        ({"strangers": 0}, "strangers lies in 1 to .*, but got 0"),
        ({"rounds": 0}, "rounds lies in 1 to"),
        ({"revealing": 1.5}, r"revealing lies in \[0, 1\], but got 1\.5"),
        ({"network": NetworkConfig((8,))}, r"network\.rnn_hidden_dim is at least 1, but got 0"),
        ({"strangers": 2, "types": 1}, "batch lies in 1 to 12, .* but got 64"),
        ({"seed": -1}, "a seed lies in"),
    ],
    ids=str,
)
def test_settings_that_make_no_sense_are_refused(changes, found):
    with pytest.raises(ValueError, match=found):
        ConditionedSettings(**changes)
