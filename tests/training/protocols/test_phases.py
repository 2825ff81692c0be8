from dataclasses import replace

import pytest

from hmi_marl.envs.drivers import DRIVERS, PAPER_DRIVERS
from hmi_marl.training.protocols.alternating import Alternating
from hmi_marl.training.protocols.anchored import load_anchor
from hmi_marl.training.protocols.fine_tune import FineTune
from hmi_marl.training.protocols.joint import Joint, Simultaneous
from hmi_marl.training.protocols.settings import LEARNED, Budget, Phase
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


def test_two_stages_and_then_both_together():
    settings = FineTune(
        driver_steps=500, hmi_steps=300, together_steps=200, together_progress=0.25, anchor_kl=0.0
    )
    *stages, together = settings.phases()
    assert tuple(stages) == TwoStage(driver_steps=500, hmi_steps=300).phases()
    assert (together.seat, together.joint, together.steps) == ("team", False, 200)
    assert together.cards == (*stages[0].cards, *stages[1].cards)  # so their learners go on
    assert together.progress == (0.25, 1.0)
    assert (together.team.reward, together.anchor) == ("team", None)
    assert settings.driver_terms == Simultaneous().driver_terms  # in the end


def test_an_hmi_may_begin_to_learn_together_with_its_driver():
    first, last = FineTune(hmi_steps=0).phases()
    assert (first.seat, last.seat) == ("driver", "team")


def test_the_driver_is_anchored_while_both_learn():
    for settings in (
        Joint(anchor="trained:driver", anchor_kl=0.5),
        Simultaneous(anchor="trained:driver", anchor_kl=0.5),
        FineTune(anchor="trained:driver", anchor_kl=0.5),
    ):
        *others, last = settings.phases()
        assert (last.anchor, last.anchor_kl) == ("trained:driver", 0.5)
        assert {phase.anchor for phase in others} <= {None}
    assert FineTune(anchor="first-stage").phases()[-1].anchor == LEARNED


@pytest.mark.parametrize("protocol", [TwoStage, Simultaneous, Alternating, FineTune])
def test_both_may_move_at_the_same_time_in_every_phase(protocol):
    assert all(phase.sequential for phase in protocol().phases())
    assert not any(phase.sequential for phase in protocol(sequential=False).phases())


@pytest.mark.parametrize(
    ("driver_steps", "hmi_steps", "share", "stages"),
    [
        (80, 20, 0.5, (40, 10, 50)),
        (80, 20, 0.2, (60, 20, 20)),  # 64 and 16, in whole batches of 10
        (10, 10, 0.5, (10, 0, 10)),
        (10, 10, 0.99, (10, 0, 10)),
        (20, 10, 0.01, (10, 10, 10)),
    ],
)
def test_a_budget_is_shared_among_three_stages(driver_steps, hmi_steps, share, stages):
    budget = Budget(driver_steps, hmi_steps, together_share=share, batch=10)
    assert budget.stages == stages
    assert sum(stages) == budget.steps


def test_the_trained_driver_is_an_anchor_and_others_are_told():
    (phase,) = Simultaneous().phases()
    assert load_anchor("trained:driver", phase.team).card.seat == "driver"
    with pytest.raises(ValueError, match=r"a learned driver policy, .* not 'rule'"):
        load_anchor("rule", phase.team)
    with pytest.raises(ValueError, match=r"trained:homer is of kind vehicle_ai"):
        load_anchor("trained:homer", phase.team)
    with pytest.raises(ValueError, match=r"reads 'traits', which .* does not show here"):
        load_anchor("trained:driver", replace(phase.team, observe_traits=False))


def test_more_rounds_than_steps_still_learn_something():
    assert {phase.steps for phase in Alternating(rounds=4, driver_steps=1).phases()[::2]} == {1}


@pytest.mark.parametrize("protocol", [TwoStage, Joint, Simultaneous, Alternating, FineTune])
def test_what_policies_are_to_know_of_the_driver(protocol):
    for condition, known in (
        ("traits", {"traits"}),
        ("inflation", {"inflation"}),
        ("hidden", set()),
    ):
        for phase in protocol(condition=condition).phases():
            assert phase.team.observe_traits  # of the environment nothing changes
            read = [names(card) & {"traits", "inflation"} for card in phase.cards]
            assert read == [known] * len(phase.cards)


@pytest.mark.parametrize("protocol", [TwoStage, Joint, Simultaneous, Alternating, FineTune])
def test_hidden_attention_is_not_read(protocol):
    phases = protocol(ai_sees_attention=False).phases()
    cards = [card for phase in phases for card in phase.cards if card.seat == "vehicle_ai"]
    assert cards
    assert not any("distracted" in names(card) for card in cards)


@pytest.mark.parametrize("protocol", [TwoStage, Joint, Simultaneous, Alternating, FineTune])
def test_the_vehicle_ai_may_be_told_what_to_read(protocol):
    for phase in protocol(hmi_reads=("speed", "distracted")).phases():
        for card in phase.cards:
            everything = card.seat == "driver"
            assert ("lidar" in names(card)) == everything
            assert everything or names(card) == {"speed", "distracted"}


@pytest.mark.parametrize("protocol", [TwoStage, Joint, Simultaneous, Alternating, FineTune])
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
