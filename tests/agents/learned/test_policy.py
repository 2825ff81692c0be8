import gymnasium
import numpy as np
import pytest

from hmi_marl import Scene, merge_v0
from hmi_marl.agents.catalogue import make_hmi
from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.agents.learned.policy import (
    FORMAT,
    LearnedPolicy,
    PolicyCard,
    load_policy,
    make_card,
)
from hmi_marl.agents.partners import make_vec
from hmi_marl.envs.alerts import Fatigue
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import DRIVERS
from hmi_marl.envs.observations import driver_layout, vehicle_ai_layout
from hmi_marl.envs.single import MergeDriver, MergeHMI
from hmi_marl.envs.streams import Stream, uniform
from hmi_marl.envs.teaming import Teaming

SMALL = {"scene": Scene(vehicles=2), "duration": 1.0}
CONFIG = TeamConfig()
TINY = NetworkConfig((3,))
SEEDS = np.arange(6, dtype=np.uint64)


def weights_for(card, seed=0):
    rng = np.random.default_rng(seed)
    return {n: rng.standard_normal(shape).astype(np.float32) for n, shape in card.shapes.items()}


def policy_for(seat, config=CONFIG, greedy=True, seed=0, **card):
    made = make_card(seat, config, TINY, **({"knows_traits": True} | card))
    return LearnedPolicy(made, weights_for(made, seed), config, greedy)


def observations(layout, count=6, seed=0):
    """Drawn within the bounds, a^H among them in turn."""
    rng = np.random.default_rng(seed)
    seen = rng.uniform(0, 1, (count, layout.size)).astype(np.float32)
    if "intended_action" in layout:
        seen[:, layout["intended_action"]] = np.eye(5)[np.arange(count) % 5]
    return seen


def softmax(logits):
    odds = np.exp(logits - logits.max(-1, keepdims=True))
    return odds / odds.sum(-1, keepdims=True)


def chosen(cumulated, draws):
    """Return the action with each draw in its share of [0, 1]."""
    return [int((row[:-1] <= draw).sum()) for row, draw in zip(cumulated, draws, strict=True)]


def linear(weights, x):
    """Outputs of a network of one hidden ReLU layer."""
    hidden = np.maximum(x @ weights["layer0.weight"].T + weights["layer0.bias"], 0)
    return hidden @ weights["layer1.weight"].T + weights["layer1.bias"]


def test_a_driver_reads_its_whole_observation():
    layout, policy = driver_layout(CONFIG), policy_for("driver")
    assert policy.card.inputs == layout.size
    assert policy.card.outputs == 5
    seen = observations(layout)
    expected = softmax(linear(policy.weights, seen))
    np.testing.assert_allclose(policy.probabilities(seen), expected, rtol=1e-5)
    assert policy.act(seen).tolist() == expected.argmax(1).tolist()


def test_parts_are_found_by_name_wherever_they_lie():
    # Trained blind to attention and traits, then seated where both are shown: same answers.
    trained_on = TeamConfig(ai_sees_attention=False, observe_traits=False)
    card = make_card("vehicle_ai", trained_on, TINY, knows_traits=True)
    weights = weights_for(card)
    before, after = vehicle_ai_layout(trained_on), vehicle_ai_layout(CONFIG)
    assert before.size == after.size - 3 - 4
    blind = observations(before)
    shown = observations(after, seed=1)
    for part in before.parts:
        shown[:, after[part.name]] = blind[:, before[part.name]]
    answers = [
        LearnedPolicy(card, weights, config).probabilities(seen)
        for config, seen in ((trained_on, blind), (CONFIG, shown))
    ]
    np.testing.assert_array_equal(*answers)


def test_it_reads_in_the_order_of_its_card():
    card = PolicyCard("driver", (("traits", 4), ("speed", 1)), TINY)
    weights = weights_for(card)
    layout = driver_layout(CONFIG)
    seen = observations(layout)
    x = np.concatenate([seen[:, layout["traits"]], seen[:, layout["speed"]]], axis=1)
    policy = LearnedPolicy(card, weights, CONFIG)
    np.testing.assert_allclose(policy.probabilities(seen), softmax(linear(weights, x)), rtol=1e-5)


@pytest.mark.parametrize(
    ("hidden", "message"),
    [
        (
            {"ai_sees_attention": False},
            r"this vehicle_ai policy reads 'distracted', which the vehicle_ai's observation does "
            r"not show here \(ai_sees_attention=False hides it\)",
        ),
        (
            {"observe_traits": False},
            r"reads 'traits', which .* not show here \(observe_traits=False hides it\)",
        ),
        (
            {"scene": Scene(lidar_cells=8)},
            "reads 32 columns of 'lidar', but here it has 16; use the scene that it was trained on",
        ),
    ],
    ids=str,
)
def test_a_seat_that_lacks_what_it_reads_is_refused(hidden, message):
    card = policy_for("vehicle_ai").card
    with pytest.raises(ValueError, match=message):
        LearnedPolicy(card, weights_for(card), TeamConfig(**hidden))


def test_an_unknown_part_is_reported_without_a_hint():
    card = PolicyCard("driver", (("weather", 1),))
    with pytest.raises(ValueError, match=r"reads 'weather', .* does not show here$"):
        card.columns(driver_layout(CONFIG))


@pytest.mark.parametrize(
    ("card", "message"),
    [
        ({"seat": "passenger"}, "seat is one of driver, vehicle_ai, not 'passenger'"),
        ({"reads": ()}, "reads parts of at least one column"),
        ({"reads": (("speed", 0),)}, "reads parts of at least one column"),
        ({"context": -1}, "context lies in 0 to"),
        ({"seat": "driver", "by_intent": True}, "by_intent is for a vehicle AI"),
        (
            {"by_intent": True, "reads": (("speed", 1), ("intended_action", 5))},
            "that does not read intended_action",
        ),
    ],
    ids=str,
)
def test_impossible_cards_are_refused(card, message):
    with pytest.raises(ValueError, match=message):
        PolicyCard(**({"seat": "vehicle_ai", "reads": (("speed", 1),)} | card))


def test_what_a_card_leaves_out():
    names = {
        (knows, by_intent): dict(make_card("vehicle_ai", CONFIG, TINY, knows, 0, by_intent).reads)
        for knows in (True, False)
        for by_intent in (True, False)
    }
    everything = {part.name for part in vehicle_ai_layout(CONFIG).parts}
    assert set(names[True, False]) == everything
    assert set(names[False, False]) == everything - {"traits"}
    assert set(names[True, True]) == everything - {"intended_action"}
    assert set(names[False, True]) == everything - {"traits", "intended_action"}


@pytest.mark.parametrize("seat", ["driver", "vehicle_ai"])
def test_a_policy_may_read_some_traits_alone(seat):
    layouts = {"driver": driver_layout, "vehicle_ai": vehicle_ai_layout}
    layout, whole = layouts[seat](CONFIG), make_card(seat, CONFIG, TINY, True)
    card = make_card(seat, CONFIG, TINY, ("inflation",))
    assert card.reads == (*whole.reads[:-1], ("inflation", 1))
    assert card.columns(layout).tolist() == [*whole.columns(layout)[:-4], layout.size - 1]
    assert make_card(seat, CONFIG, TINY, ("traits",)) == whole
    assert make_card(seat, CONFIG, TINY, ()) == make_card(seat, CONFIG, TINY, False)
    assert make_card(seat, CONFIG, TINY, ("eta", "beta")).inputs == whole.inputs - 2
    with pytest.raises(ValueError, match=r"a policy reads .*inflation.*'courage'"):
        make_card(seat, CONFIG, TINY, ("courage",))
    unseen = TeamConfig(observe_traits=False)
    with pytest.raises(ValueError, match=r"reads 'inflation', .*\(observe_traits=False hides it"):
        card.columns(layouts[seat](unseen))
    assert "inflation" not in dict(make_card(seat, unseen, TINY, ("inflation",)).reads)


def test_single_traits_give_way_to_a_context_too():
    card = make_card("vehicle_ai", CONFIG, TINY, ("inflation",)).with_context(3)
    assert card == make_card("vehicle_ai", CONFIG, TINY, False, context=3)


@pytest.mark.parametrize("place", ["trained:driver-inflation", None])
def test_a_driver_who_reads_inflation_alone_does_not_depend_on_other_traits(place):
    """Actions over random observations; None is a policy of random weights."""
    if place is None:
        control = policy_for("driver", knows_traits=("inflation",), greedy=False)
    else:
        control = load_policy(place, "driver", CONFIG, greedy=False)
    layout, rng = driver_layout(CONFIG), np.random.default_rng(3)
    low, high = layout.bounds
    seeds = np.arange(500, dtype=np.uint64)
    seen = rng.uniform(low, high, (500, layout.size)).astype(np.float32)
    control.reset(seeds)
    before, acted = control.probabilities(seen), control.act(seen)
    others = seen.copy()
    for name in ("beta", "alpha", "eta"):
        others[:, layout[name]] = rng.uniform(0, 1, (500, 1))
    control.reset(seeds)
    np.testing.assert_array_equal(control.probabilities(others), before)
    np.testing.assert_array_equal(control.act(others), acted)
    others[:, layout["inflation"]] = 1.0 - others[:, layout["inflation"]]
    assert (control.probabilities(others) != before).any(axis=1).mean() > 0.9
    trained = load_policy("trained:driver", "driver", CONFIG)
    others = seen.copy()
    others[:, layout["beta"]] = 1.0 - others[:, layout["beta"]]
    assert (trained.probabilities(others) != trained.probabilities(seen)).any(axis=1).mean() > 0.9


@pytest.mark.parametrize("driver", ["homer", "lisa"])
def test_what_a_policy_reads_of_the_traits_is_the_same_in_every_environment(driver):
    team = TeamConfig(driver=driver, **SMALL)
    policy = policy_for("driver", team, knows_traits=("inflation",))
    column = policy.card.columns(driver_layout(team))[-1]
    inflation = DRIVERS[driver].inflation / 20
    single = MergeDriver(make_hmi("never", team), team)
    assert single.reset(seed=1)[0][column] == np.float32(inflation)
    vector = make_vec(3, "team", threads=1, **vars(team))
    assert vector.get_observations()["driver"][:, column].tolist() == [np.float32(inflation)] * 3
    # A partner is shown the parts that it reads, and of the traits all of them.
    teams = Teaming(team, 2, "batched")
    teams.reset(SEEDS[:2])
    shown = teams.observe("driver", policy.reads)
    np.testing.assert_array_equal(shown, teams.observe("driver"))
    traits = teams.observe("driver", ["inflation"])
    assert traits[:, driver_layout(team)["traits"]].any()
    assert not np.delete(traits, driver_layout(team).columns(["traits"]), axis=1).any()


def test_a_context_takes_the_place_of_the_vehicle_ais_traits():
    driver, ai = policy_for("driver").card, policy_for("vehicle_ai").card
    assert driver.with_context(3) is driver
    conditioned = ai.with_context(3)
    assert conditioned.context == 3
    assert "traits" not in dict(conditioned.reads)
    assert conditioned.inputs == ai.inputs - 4 + 3


def test_a_policy_may_read_some_parts_alone():
    card = policy_for("vehicle_ai").card.reading(["time", "speed"])
    assert card.reads == (("speed", 1), ("time", 1))  # in the order of the observation
    with pytest.raises(ValueError, match="no part 'weather' to read; there are lidar, speed, "):
        policy_for("vehicle_ai").card.reading(["speed", "weather"])


def test_weights_are_checked_against_the_card():
    card = PolicyCard("driver", (("speed", 1),), TINY)
    weights = weights_for(card)
    FORMAT.check(card, weights)
    lost = {name: values for name, values in weights.items() if name != "layer1.bias"}
    with pytest.raises(ValueError, match=r"do not fit the policy's card: layer1\.bias"):
        FORMAT.check(card, lost)
    with pytest.raises(ValueError, match="do not fit the policy's card: odd"):
        FORMAT.check(card, weights | {"odd": np.zeros(1)})
    with pytest.raises(
        ValueError, match=r"layer1\.bias has shape \(4,\), but the card says \(5,\)"
    ):
        FORMAT.check(card, weights | {"layer1.bias": np.zeros(4)})
    for bad in (np.nan, np.inf):
        with pytest.raises(ValueError, match=r"layer1\.bias is not finite everywhere"):
            FORMAT.check(card, weights | {"layer1.bias": np.full(5, bad)})


def test_a_context_is_read_after_the_observation():
    policy = policy_for("vehicle_ai", knows_traits=False, context=2)
    layout = vehicle_ai_layout(CONFIG)
    seen = observations(layout)
    parts = np.delete(seen, np.r_[layout["traits"]], axis=1)
    for z in (np.array([0.5, -1.0]), np.arange(12.0).reshape(6, 2)):
        policy.context = z
        x = np.concatenate([parts, np.broadcast_to(z, (6, 2))], axis=1)
        expected = softmax(linear(policy.weights, x))
        np.testing.assert_allclose(policy.probabilities(seen), expected, rtol=1e-4, atol=1e-7)


def test_a_context_that_does_not_fit_is_refused():
    policy = policy_for("vehicle_ai", context=2)
    assert policy.context is None
    seen = observations(vehicle_ai_layout(CONFIG))
    with pytest.raises(RuntimeError, match=r"conditioned on a vector z: set policy\.context"):
        policy.act(seen)
    for z in (0.5, [0.5], [0.5] * 3, np.zeros((2, 6)), np.zeros((1, 6, 2))):
        with pytest.raises(ValueError, match="takes a vector z of size 2, but got an array of sha"):
            policy.context = z
    for bad in (np.nan, np.inf):
        with pytest.raises(ValueError, match="a vector z is finite everywhere"):
            policy.context = [0.0, bad]
    assert policy.context is None


def test_by_intent_takes_the_row_of_what_the_driver_is_about_to_do():
    policy = policy_for("vehicle_ai", by_intent=True)
    layout = vehicle_ai_layout(CONFIG)
    seen = observations(layout)
    parts = np.delete(seen, np.r_[layout["intended_action"]], axis=1)
    rows = linear(policy.weights, parts).reshape(6, 5, 2)
    expected = softmax(rows[np.arange(6), [0, 1, 2, 3, 4, 0]])
    np.testing.assert_allclose(policy.probabilities(seen), expected, rtol=1e-4, atol=1e-7)


def test_by_intent_knows_nothing_before_the_first_intent_is_seen():
    policy = policy_for("vehicle_ai", by_intent=True)
    layout = vehicle_ai_layout(CONFIG)
    seen = observations(layout)
    seen[:, layout["intended_action"]] = 0.0  # at once, in the first step
    assert (policy.probabilities(seen) == 0.5).all()
    assert policy.act(seen).tolist() == [0] * 6


def test_drawn_actions_follow_the_seed_and_the_step():
    policy, layout = policy_for("driver", greedy=False), driver_layout(CONFIG)
    seen = observations(layout)
    policy.reset(SEEDS)
    for step in range(3):
        draws = uniform(SEEDS, Stream.DRIVER_POLICY, np.full(6, step, np.uint64))
        cumulated = policy.probabilities(seen).cumsum(axis=1)
        expected = chosen(cumulated, draws)
        assert policy.act(seen).tolist() == expected
    policy.reset(SEEDS, SEEDS == 4)
    draws = uniform(SEEDS, Stream.DRIVER_POLICY, np.where(SEEDS == 4, 0, 3).astype(np.uint64))
    expected = chosen(cumulated, draws)
    assert policy.act(seen).tolist() == expected


def test_drawn_actions_come_as_often_as_they_are_likely():
    count = 20_000
    policy, layout = policy_for("driver", greedy=False), driver_layout(CONFIG)
    # A mild policy: every action is likely enough to be counted.
    policy = LearnedPolicy(
        policy.card, {n: 0.1 * w for n, w in policy.weights.items()}, CONFIG, greedy=False
    )
    seen = np.repeat(observations(layout, 1), count, axis=0)
    policy.reset(np.arange(count, dtype=np.uint64))
    actions = policy.act(seen)
    expected = policy.probabilities(seen[:1])[0]
    share = np.bincount(actions, minlength=5) / count
    assert (np.abs(share - expected) < 4 * np.sqrt(expected * (1 - expected) / count)).all()


def test_drawing_needs_seeds():
    with pytest.raises(RuntimeError, match=r"call reset\(seeds\) first"):
        policy_for("driver", greedy=False).act(observations(driver_layout(CONFIG)))


def test_a_memory_begins_with_the_episode():
    card = make_card("vehicle_ai", CONFIG, NetworkConfig((3,), rnn_hidden_dim=2), knows_traits=True)
    policy = LearnedPolicy(card, weights_for(card), CONFIG)
    seen = observations(vehicle_ai_layout(CONFIG))
    policy.reset(SEEDS)
    first, second = policy.probabilities(seen), policy.probabilities(seen)
    assert not np.allclose(first, second)
    policy.reset(SEEDS, SEEDS < 2)
    third = policy.probabilities(seen)
    np.testing.assert_array_equal(third[:2], first[:2])
    policy.reset(SEEDS[:1])
    np.testing.assert_allclose(policy.probabilities(seen[:1]), first[:1], atol=1e-12)


@pytest.mark.parametrize("greedy", [True, False])
@pytest.mark.parametrize("seat", ["driver", "vehicle_ai"])
def test_it_sits_in_a_gymnasium_seat(seat, greedy):
    name, view = {
        "driver": ("hmi_marl/MergeHMI-v0", MergeHMI),
        "vehicle_ai": ("hmi_marl/MergeDriver-v0", MergeDriver),
    }[seat]
    config = TeamConfig(**SMALL)
    made = gymnasium.make(name, partner=policy_for(seat, config, greedy), **SMALL)
    alone = view(policy_for(seat, config, greedy), config)
    whole, policy = merge_v0.raw_env(**SMALL), policy_for(seat, config, greedy)
    for env in (made, alone):
        whole.reset(seed=3)
        policy.reset(whole.team.teaming.seeds)
        env.reset(seed=3)
        for _ in range(config.horizon):
            for agent in ("driver", "vehicle_ai"):
                mine = policy.act(whole.observe(agent)[None])[0] if agent == seat else 1
                whole.step(int(mine))
            observation, reward, terminated, truncated, info = env.step(1)
            assert info == whole.infos[seat]
            assert reward == whole.rewards[seat]
        assert terminated or truncated
        assert env.observation_space.contains(observation)


def test_it_is_a_partner_of_many_teams():
    torch = pytest.importorskip("torch")
    config = TeamConfig(**SMALL)
    policy = policy_for("driver", config, greedy=False)
    env = make_vec(3, "vehicle_ai", policy, world="highway", seed=5, **SMALL)
    assert env.cfg["partner"] == "LearnedPolicy"
    mirror = policy_for("driver", config, greedy=False)
    mirror.reset(env.teaming.seeds)
    seen = env.get_observations()
    for _ in range(4):
        expected = np.eye(5)[mirror.act(seen["driver"].numpy())]
        shown = seen["vehicle_ai"][:, env.layouts["vehicle_ai"]["intended_action"]]
        np.testing.assert_array_equal(shown.numpy(), expected)
        seen, *_ = env.step(torch.zeros(3, 1))


def test_both_seats_of_a_pettingzoo_environment():
    env = merge_v0.env(**SMALL)
    config = TeamConfig(**SMALL)
    policies = {seat: policy_for(seat, config) for seat in env.possible_agents}
    env.reset(seed=1)
    for policy in policies.values():
        policy.reset(np.array([1], np.uint64))
    steps = 0
    for agent in env.agent_iter():
        observation, _, terminated, truncated, _ = env.last()
        over = terminated or truncated
        env.step(None if over else int(policies[agent].act(observation[None])[0]))
        steps += not over
    assert 2 <= steps <= 2 * config.horizon


GRADED = TeamConfig(alert_strengths=(0.25, 0.5, 1.0))


def test_a_vehicle_ai_has_as_many_actions_as_there_are_alerts_and_one_more():
    policy = policy_for("vehicle_ai", GRADED)
    assert (policy.card.actions, policy.card.outputs) == (4, 4)
    seen = observations(vehicle_ai_layout(GRADED))
    expected = softmax(linear(policy.weights, seen))
    np.testing.assert_allclose(policy.probabilities(seen), expected, rtol=1e-4, atol=1e-7)
    by_intent = policy_for("vehicle_ai", GRADED, by_intent=True)
    assert by_intent.card.outputs == 20
    assert by_intent.probabilities(seen).shape == (6, 4)
    assert make_card("driver", GRADED, TINY, True) == make_card("driver", CONFIG, TINY, True)
    assert make_card("vehicle_ai", CONFIG, TINY, True).actions == 2


@pytest.mark.parametrize("here", [CONFIG, TeamConfig(alert_strengths=(0.3, 0.5, 1.0))], ids=str)
def test_a_policy_of_other_alerts_is_refused(here):
    policy = policy_for("vehicle_ai", GRADED)
    with pytest.raises(ValueError, match=r"alerts of strengths \(0\.25, 0\.5, 1\.0\), but here"):
        LearnedPolicy(policy.card, policy.weights, here)


def test_a_policy_that_reads_fatigue_needs_it_to_be_shown():
    weary = TeamConfig(fatigue=Fatigue())
    policy = policy_for("vehicle_ai", weary)
    with pytest.raises(ValueError, match=r"reads 'fatigue', .* \(only with fatigue=, and unless"):
        LearnedPolicy(policy.card, policy.weights, CONFIG)
    plain = policy_for("vehicle_ai", CONFIG)
    LearnedPolicy(plain.card, plain.weights, weary)  # it need not look
