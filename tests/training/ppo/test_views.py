import numpy as np
import pytest
import torch
from standing_world import standing_teams

from hmi_marl import Scene
from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.agents.learned.policy import PolicyCard, make_card
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.teaming import Teaming
from hmi_marl.envs.vector import TeamVecEnv
from hmi_marl.training.ppo.models import IntentShown, SeatView

CONFIG = TeamConfig(driver=["bart", "lisa", "homer"])


class TwoTraits:
    """z is β and the inflation as they are."""

    size = 2
    digest = "β and the inflation"

    def __call__(self, traits):
        return traits[:, [0, 3]]


def standing(num_teams=4, config=CONFIG):
    return TeamVecEnv(standing_teams(num_teams, **vars(config)))


def card(seat, knows_traits=True, **choices):
    return make_card(seat, CONFIG, NetworkConfig((3,)), knows_traits, **choices)


@pytest.mark.parametrize("seat", ["driver", "vehicle_ai"])
def test_who_knows_everything_reads_the_seats_observation(seat):
    env = standing()
    seen = env.get_observations()
    read = SeatView(env, (card(seat),), centralised=True)(seen)
    assert read.actor is seen[seat]  # not copied
    assert (read.actor == seen[seat]).all()
    assert (read.critic == seen["critic"]).all()


def test_who_is_to_know_no_traits_is_shown_none():
    env = standing()
    seen = env.get_observations()
    view = SeatView(env, (card("driver", knows_traits=False),), centralised=False)
    read = view(seen)
    traits = env.layouts["driver"]["traits"]
    expected = np.delete(seen["driver"].numpy(), np.r_[traits], axis=1)
    np.testing.assert_array_equal(read.actor.numpy(), expected)
    np.testing.assert_array_equal(read.critic.numpy(), expected)  # its own, not the team's
    assert view.critic_inputs == expected.shape[1]


def test_both_seats_lie_side_by_side_in_the_order_of_their_cards():
    env = standing()
    seen = env.get_observations()
    cards = card("driver"), card("vehicle_ai", by_intent=True)
    read = SeatView(env, cards, centralised=True)(seen)
    intended = env.layouts["vehicle_ai"]["intended_action"]
    of_ai = np.delete(seen["vehicle_ai"].numpy(), np.r_[intended], axis=1)
    expected = np.concatenate([seen["driver"].numpy(), of_ai], axis=1)
    np.testing.assert_array_equal(read.actor.numpy(), expected)


def test_a_context_follows_what_the_vehicle_ai_reads():
    env = standing()
    seen = env.get_observations()
    conditioned = card("vehicle_ai").with_context(2)
    view = SeatView(env, (card("driver"), conditioned), centralised=False, context=TwoTraits())
    read = view(seen).actor.numpy()
    traits = env.layouts["vehicle_ai"]["traits"]
    of_ai = np.delete(seen["vehicle_ai"].numpy(), np.r_[traits], axis=1)
    z = env.teaming.traits.as_array()[:, [0, 3]].astype(np.float32)
    expected = np.concatenate([seen["driver"].numpy(), of_ai, z], axis=1)  # none for the driver
    np.testing.assert_array_equal(read, expected)
    assert view.critic_inputs == expected.shape[1]


def test_the_columns_of_the_critic():
    env = standing()
    cards = card("driver"), card("vehicle_ai", by_intent=True)
    assert SeatView(env, cards, centralised=True).critic_inputs == env.layouts["critic"].size
    apart = SeatView(env, cards, centralised=False)
    assert apart.critic_inputs == cards[0].inputs + cards[1].inputs


def test_it_names_the_groups_that_it_reads():
    env = standing()
    both = card("driver"), card("vehicle_ai").with_context(2)
    assert SeatView(env, both[:1], centralised=True).groups == ("driver", "critic")
    assert SeatView(env, both[:1], centralised=False).groups == ("driver",)
    view = SeatView(env, both, centralised=True, context=TwoTraits())
    assert view.groups == ("driver", "vehicle_ai", "traits", "critic")
    seen = env.get_observations()
    assert torch.equal(view(seen.select(*view.groups)).actor, view(seen).actor)


def test_a_context_is_computed_shard_by_shard():
    class Watched(TwoTraits):
        sizes = ()

        def __call__(self, traits):
            self.sizes = (*self.sizes, len(traits))
            return super().__call__(traits)

    env = standing(num_teams=6)
    seen, context = env.get_observations(), Watched()
    cards = (card("vehicle_ai").with_context(2),)
    apart = SeatView(env, cards, centralised=True, context=context, teams=2)(seen)
    assert context.sizes == (2, 2, 2)
    together = SeatView(env, cards, centralised=True, context=TwoTraits())(seen)
    assert torch.equal(apart.actor, together.actor)


def test_what_is_not_shown_cannot_be_read():
    env = standing(config=TeamConfig(observe_traits=False))
    with pytest.raises(ValueError, match="reads 'traits', which the driver's observation does not"):
        SeatView(env, (PolicyCard("driver", (("traits", 4),)),), centralised=True)


def test_a_shown_intent_is_what_taking_turns_shows_to_the_bit():
    settings = {"scene": Scene(vehicles=3), "duration": 3.0, "driver": ["bart", "homer", "lisa"]}
    config = TeamConfig(**settings)
    at_once = TeamVecEnv(Teaming(config, 3, "highway"), seed=11)
    turns = Teaming(config, 3, "highway")
    turns.reset(at_once.teaming.seeds)
    show = IntentShown(at_once)
    rng = np.random.default_rng(0)
    for _ in range(10):
        seen = at_once.get_observations()
        actions = rng.integers(0, (5, 2), (3, 2))
        if turns.over.any():
            break
        shown = show(seen, torch.from_numpy(actions[:, :1].astype(np.float32)))
        np.testing.assert_array_equal(seen["driver"].numpy(), turns.observe("driver"))
        turns.intend(actions[:, 0])
        np.testing.assert_array_equal(shown["vehicle_ai"].numpy(), turns.observe("vehicle_ai"))
        np.testing.assert_array_equal(shown["critic"].numpy(), turns.state())
        assert not (shown["vehicle_ai"] == seen["vehicle_ai"]).all()
        for name in ("driver", "traits"):
            assert shown[name] is seen[name]
        turns.step(actions[:, 1])
        at_once.step(torch.from_numpy(actions))
    assert turns.steps.max() >= 5


def test_showing_an_intent_changes_no_other_tensor():
    env = standing()
    seen = env.get_observations()
    before = seen["vehicle_ai"].clone()
    shown = IntentShown(env)(seen, torch.tensor([[0.0], [1.0], [2.0], [4.0]]))
    assert (seen["vehicle_ai"] == before).all()
    intended = shown["vehicle_ai"][:, env.layouts["vehicle_ai"]["intended_action"]]
    assert intended.tolist() == np.eye(5)[[0, 1, 2, 4]].tolist()
