import pytest

from hmi_marl.envs.drivers import DRIVERS, PAPER_DRIVERS
from hmi_marl.training.protocols.alternating import Alternating
from hmi_marl.training.protocols.joint import Joint, Simultaneous
from hmi_marl.training.protocols.settings import LEARNED, Phase
from hmi_marl.training.protocols.two_stage import TwoStage


def names(card):
    return {name for name, _ in card.reads}


def test_the_papers_two_stages():
    first, second = TwoStage(hmi_for="homer", driver_steps=500, hmi_steps=300).phases()
    assert (first.seat, first.partner, first.steps) == ("driver", "never", 500)
    assert first.team.reward == "driving"
    assert first.team.population.drivers == tuple(DRIVERS[name] for name in PAPER_DRIVERS)
    assert (second.seat, second.partner, second.steps) == ("vehicle_ai", LEARNED, 300)
    assert second.team.reward == "team"
    assert second.team.only_driver == DRIVERS["homer"]
    assert [card.seat for phase in (first, second) for card in phase.cards] == [
        "driver",
        "vehicle_ai",
    ]


@pytest.mark.parametrize("population", ["population", "Population"])
def test_an_hmi_for_everybody_assists_those_who_drive(population):
    _, second = TwoStage(hmi_for=population, drivers=("bart", "lisa")).phases()
    assert second.team.population.drivers == (DRIVERS["bart"], DRIVERS["lisa"])


@pytest.mark.parametrize("partner", ["rule", "random", "runs/before"])
def test_a_driver_that_is_there_already_is_not_learned_again(partner):
    (only,) = TwoStage(driver_policy=partner).phases()
    assert (only.seat, only.partner) == ("vehicle_ai", partner)


def test_the_driver_may_be_learned_alone():
    (only,) = TwoStage(hmi_steps=0).phases()
    assert (only.seat, only.partner) == ("driver", "never")


def test_one_composite_policy_for_both_seats():
    (only,) = Joint(steps=700).phases()
    assert (only.seat, only.joint, only.steps, only.partner) == ("team", True, 700, None)
    driver, vehicle_ai = only.cards
    assert (driver.seat, driver.by_intent) == ("driver", False)
    assert (vehicle_ai.seat, vehicle_ai.by_intent) == ("vehicle_ai", True)
    assert "intended_action" not in names(vehicle_ai)
    assert only.sequential  # the alert is drawn given the intent


@pytest.mark.parametrize("sequential", [True, False])
def test_two_agents_at_once(sequential):
    (only,) = Simultaneous(steps=700, sequential=sequential).phases()
    assert (only.seat, only.joint, only.partner) == ("team", False, None)
    assert only.sequential == sequential
    assert [card.sequential for card in only.cards] == [sequential] * 2
    assert "intended_action" in names(only.cards[1])


def test_best_responses_in_rounds():
    phases = Alternating(rounds=3, driver_steps=3000, hmi_steps=600).phases()
    assert [phase.name for phase in phases] == [
        f"round {k}, {seat}" for k in (1, 2, 3) for seat in ("driver", "vehicle_ai")
    ]
    assert [phase.partner for phase in phases] == ["never"] + [LEARNED] * 5
    assert [phase.steps for phase in phases] == [1000, 200] * 3
    assert [phase.progress for phase in phases][::2] == [(0, 1 / 3), (1 / 3, 2 / 3), (2 / 3, 1)]
    assert [phase.team.reward for phase in phases] == ["driving", "team"] * 3


def test_more_rounds_than_steps_still_learn_something():
    assert {phase.steps for phase in Alternating(rounds=4, driver_steps=1).phases()[::2]} == {1}


@pytest.mark.parametrize("protocol", [TwoStage, Joint, Simultaneous, Alternating])
def test_what_policies_are_to_know_of_the_driver(protocol):
    for condition, knows in (("traits", True), ("hidden", False)):
        for phase in protocol(condition=condition).phases():
            assert phase.team.observe_traits  # of the environment nothing changes
            assert ["traits" in names(card) for card in phase.cards] == [knows] * len(phase.cards)


@pytest.mark.parametrize("protocol", [TwoStage, Joint, Simultaneous, Alternating])
def test_hidden_attention_is_not_read(protocol):
    phases = protocol(ai_sees_attention=False).phases()
    cards = [card for phase in phases for card in phase.cards if card.seat == "vehicle_ai"]
    assert cards
    assert not any("distracted" in names(card) for card in cards)


@pytest.mark.parametrize("protocol", [TwoStage, Joint, Simultaneous, Alternating])
def test_the_vehicle_ai_may_be_told_what_to_read(protocol):
    for phase in protocol(hmi_reads=("speed", "distracted")).phases():
        for card in phase.cards:
            everything = card.seat == "driver"
            assert ("lidar" in names(card)) == everything
            assert everything or names(card) == {"speed", "distracted"}


@pytest.mark.parametrize("protocol", [TwoStage, Joint, Simultaneous, Alternating])
def test_only_the_vehicle_ai_has_a_memory(protocol):
    for phase in protocol(rnn_hidden_dim=6).phases():
        for card in phase.cards:
            assert card.network.rnn_hidden_dim == (6 if card.seat == "vehicle_ai" else 0)


def test_batches_are_whole_episodes_of_every_team():
    phase = Phase("x", "driver", TwoStage(duration=2.0).phases()[0].team, steps=1001)
    assert phase.team.horizon == 10
    assert phase.iterations(num_teams=10) == 11
    assert phase.iterations(num_teams=20) == 6
    assert phase.iterations(num_teams=2000) == 1
