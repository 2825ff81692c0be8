import numpy as np
import pytest
import torch
from rsl_rl.storage import RolloutStorage
from standing_world import CrashingWorld, StandingWorld
from tensordict import TensorDict

from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.agents.learned.policy import LearnedPolicy, PolicyCard, make_card
from hmi_marl.agents.memory import Memoryless
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.teaming import Teaming
from hmi_marl.envs.vector import TeamVecEnv
from hmi_marl.exact import oracle
from hmi_marl.training.ppo.learner import PPOLearner, ShuffledOnce, TwoLearners, play_batch
from hmi_marl.training.ppo.models import (
    IntentShown,
    SeatView,
    make_actor,
    make_critic,
    make_joint_actor,
    weights_of,
)
from hmi_marl.training.protocols.settings import PPOSettings
from hmi_marl.training.runs.processes import Processes

TINY = NetworkConfig((8,))
KEEP_SPEED = 1


class KeepsSpeed(Memoryless):
    def act(self, observations):
        return np.full(len(observations), KEEP_SPEED)


def env_for(seat, num_teams=16, world=CrashingWorld, **settings):
    config = TeamConfig(**({"driver": "homer", "duration": 1.0} | settings))
    teaming = Teaming(config, num_teams, world(config.scene, num_teams))
    return TeamVecEnv(teaming, seat, None if seat == "team" else KeepsSpeed())


def learner_for(env, cards, settings=PPOSettings(num_mini_batches=2), seed=0, centralised=True):  # noqa: B008
    torch.manual_seed(seed)
    view = SeatView(env, cards, centralised)
    return PPOLearner(
        make_joint_actor(*cards) if len(cards) == 2 else make_actor(*cards),
        make_critic(view.critic_inputs, TINY),
        view,
        env.get_observations(),
        env.max_episode_length,
        len(cards),
        settings,
        "cpu",
        Processes(),
    )


def card_for(env, seat, network=TINY, **choices):
    return make_card(seat, env.teaming.config, network, knows_traits=True, **choices)


def learn_from(env, learner, seed):
    torch.manual_seed(seed)
    learner.begin(0.0)
    play_batch(env, learner, seed)
    return learner.learn(env.get_observations())


def same(one, two):
    assert set(one) == set(two)
    return all(torch.equal(one[name], two[name]) for name in one)


def test_time_outs_alone_are_worth_what_was_seen_last():
    env = env_for("driver", 4, world=StandingWorld, reward="driving")
    settings = PPOSettings(num_mini_batches=1, gamma=0.9, reward_scale=0.5)
    learner = learner_for(env, (card_for(env, "driver"),), settings)
    with torch.no_grad():  # V = 1 + 2 time
        for weight in learner.ppo.critic.parameters():
            weight.zero_()
        learner.ppo.critic.mlp[0].weight[0, env.layouts["critic"]["time"]] = 1.0
        learner.ppo.critic.mlp[2].weight[0, 0] = 2.0
        learner.ppo.critic.mlp[2].bias[0] = 1.0
    crashes = {1: [False, True, False, False], 4: [False, False, True, False]}  # by step
    learner.begin(0.0)
    given = []
    with torch.inference_mode():
        seen, _ = env.reset(3)
        for step in range(5):
            env.teaming.world.crash_next = np.array(crashes.get(step, [False] * 4))
            learner.act(seen)
            seen, rewards, dones, extras = env.step(torch.full((4, 1), KEEP_SPEED))
            before = rewards.clone()
            learner.record(rewards, dones, extras)
            assert (rewards == before).all()  # others may read them
            given.append(rewards)
    # Teams 0 and 3 have run out of time, 1 has begun anew after step 1, 2 crashed in the last step.
    assert dones.tolist() == [1, 0, 1, 1]
    expected = 0.5 * torch.stack(given)
    expected[4, [0, 3]] += 0.9 * (1 + 2 * 1.0)
    storage = learner.ppo.storage
    torch.testing.assert_close(storage.rewards.squeeze(-1), expected)
    assert storage.dones.squeeze(-1).sum(0).tolist() == [1, 1, 1, 1]
    learner.learn(seen)
    last = expected[4].clone()
    last[1] += 0.9 * (1 + 2 * 3 / 5)  # goes on, three steps into its second episode
    torch.testing.assert_close(storage.returns[4].squeeze(-1), last)


def test_what_it_learns_from_falls_along_lines():
    env = env_for("driver")
    settings = PPOSettings(
        num_mini_batches=2,
        entropy_coef=0.04,
        final_entropy_coef=0.02,
        learning_rate=1e-3,
        final_learning_rate=2e-4,
    )
    learner = learner_for(env, (card_for(env, "driver"),), settings)
    for progress, entropy, rate in ((0.0, 0.04, 1e-3), (0.25, 0.035, 8e-4), (1.0, 0.02, 2e-4)):
        learner.begin(progress)
        assert learner.ppo.entropy_coef == pytest.approx(entropy)
        assert [g["lr"] for g in learner.ppo.optimizer.param_groups] == [pytest.approx(rate)]
        play_batch(env, learner, 0)
        assert learner.learn(env.get_observations())["learning_rate"] == pytest.approx(rate)


@pytest.mark.parametrize("memory", [0, 3])
def test_what_was_saved_goes_on_as_if_nothing_had_happened(memory):
    env = env_for("vehicle_ai")
    cards = (card_for(env, "vehicle_ai", NetworkConfig((8,), rnn_hidden_dim=memory)),)
    first, second = learner_for(env, cards), learner_for(env, cards, seed=1)
    for seed in range(2):
        learn_from(env, first, seed)
    learn_from(env, second, 9)  # has learned something else
    saved = {name: values.clone() for name, values in first.tensors().items()}
    assert any(name.startswith("optimizer.") for name in saved)
    assert not same(saved, second.tensors())
    second.load(saved)
    assert same(saved, second.tensors())
    for seed in (2, 3):
        assert learn_from(env, first, seed) == learn_from(env, second, seed)
    assert same(first.tensors(), second.tensors())
    assert not same(saved, first.tensors())


def test_a_learner_that_has_learned_nothing_can_be_saved_too():
    env = env_for("vehicle_ai")
    cards = (card_for(env, "vehicle_ai"),)
    first, second = learner_for(env, cards), learner_for(env, cards, seed=1)
    second.load(first.tensors())
    assert learn_from(env, first, 2) == learn_from(env, second, 2)
    assert same(first.tensors(), second.tensors())


def test_what_was_saved_of_other_networks_is_refused():
    env = env_for("vehicle_ai")
    first = learner_for(env, (card_for(env, "vehicle_ai"),))
    wider = learner_for(env, (card_for(env, "vehicle_ai", NetworkConfig((9,))),))
    with pytest.raises(RuntimeError, match="size mismatch"):
        wider.load(first.tensors())


def test_a_memory_is_learned_from_as_it_was_when_it_acted():
    # Replayed with the memory that was stored, every action is as likely as when it was drawn.
    env = env_for("vehicle_ai", 12)
    card = card_for(env, "vehicle_ai", NetworkConfig((8,), rnn_hidden_dim=4))
    learner = learner_for(env, (card,), PPOSettings(num_mini_batches=3))
    for weight in learner.ppo.actor.parameters():
        torch.nn.init.normal_(weight, std=0.7)
    for seed in (1, 2):  # nothing may be left of the first batch in the second
        learner.begin(0.0)
        play_batch(env, learner, seed)
        storage = learner.ppo.storage
        assert storage.dones[:-1].any()
        actor = learner.ppo.actor
        for batch in storage.recurrent_mini_batch_generator(3, 1):
            actor(
                batch.observations,
                masks=batch.masks,
                hidden_state=batch.hidden_states[0],
                stochastic_output=True,
            )
            log_probs = actor.get_output_log_prob(batch.actions)
            torch.testing.assert_close(log_probs, batch.old_actions_log_prob.squeeze(-1))
        storage.clear()


def two_learners(env, turns):
    cards = [card_for(env, seat, sequential=turns) for seat in ("driver", "vehicle_ai")]
    driver, vehicle_ai = (learner_for(env, (card,)) for card in cards)
    return TwoLearners(driver, vehicle_ai, IntentShown(env) if turns else None)


@pytest.mark.parametrize("turns", [True, False])
def test_two_that_learn_at_once_see_and_get_what_their_seats_do(turns):
    env = env_for("team", reward="individual")
    learner = two_learners(env, turns)
    learner.begin(0.0)
    rewards_given = []
    with torch.inference_mode():
        seen, _ = env.reset(1)
        for _ in range(env.max_episode_length):
            actions = learner.act(seen)
            seen, rewards, dones, extras = env.step(actions)
            learner.record(rewards, dones, extras)
            rewards_given.append(extras["rewards"])
    stored = {seat: getattr(learner, seat).ppo.storage for seat in ("driver", "vehicle_ai")}
    intents = stored["driver"].actions[..., 0].long()
    shown = stored["vehicle_ai"].observations["actor"][
        ..., env.layouts["vehicle_ai"]["intended_action"]
    ]
    in_the_critic = env.layouts["critic"]["intended_action"]
    known = stored["vehicle_ai"].observations["critic"][..., in_the_critic]
    now = torch.nn.functional.one_hot(intents, 5).float()
    if turns:
        assert (shown == now).all()
        assert (known == now).all()  # its values are of the state in which it acts
        assert not (stored["driver"].observations["critic"][..., in_the_critic] == now).all()
    else:
        assert (known == shown).all()
        begins = torch.cat([torch.ones(1, 16), stored["driver"].dones[:-1].squeeze(-1)])
        before = torch.cat([torch.zeros(1, 16, 5), now[:-1]]) * (1 - begins).unsqueeze(-1)
        assert (shown == before).all()
    for seat, storage in stored.items():
        scaled = 0.1 * torch.stack([given[seat] for given in rewards_given])
        steps_on = storage.dones.squeeze(-1) == 0
        torch.testing.assert_close(storage.rewards.squeeze(-1)[steps_on], scaled[steps_on])
    assert not torch.equal(stored["driver"].rewards, stored["vehicle_ai"].rewards)
    losses = learner.learn(seen)
    assert {"value", "vehicle_ai_value", "entropy", "vehicle_ai_entropy"} <= set(losses)
    assert np.isfinite(list(losses.values())).all()


class Everything:
    """A view that shows the critic the state, and the actor too, once for each seat."""

    def __init__(self, seats):
        self.seats = seats

    def __call__(self, observations):
        state = observations["state"]
        groups = {"actor": torch.cat([state] * self.seats, dim=-1), "critic": state}
        return TensorDict(groups, batch_size=observations.batch_size)


def state_of(index, sizes):
    return TensorDict({"state": torch.eye(sizes)[index]}, batch_size=[len(index)])


def bandit(actor, columns, worth, iterations=50, teams=64, steps=4):
    """Learn a bandit of as many states as ``worth(state, actions)`` takes."""
    settings = PPOSettings(
        num_mini_batches=4, learning_rate=1e-2, final_learning_rate=1e-2, reward_scale=1.0
    )
    states = 5
    learner = PPOLearner(
        actor,
        make_critic(states, TINY),
        Everything(columns),
        state_of(torch.zeros(teams, dtype=torch.long), states),
        steps,
        columns,
        settings,
        "cpu",
        Processes(),
    )
    never = torch.zeros(teams, dtype=torch.bool)
    for iteration in range(iterations):
        learner.begin(iteration / iterations)
        with torch.inference_mode():
            for _ in range(steps):
                state = torch.randint(states, (teams,))
                actions = learner.act(state_of(state, states))
                learner.record(worth(state, actions), torch.ones(teams), {"time_outs": never})
        learner.learn(state_of(state, states))
    every = torch.arange(states)
    with torch.no_grad():
        return actor(learner.view(state_of(every, states))).long().tolist()


def test_one_head_learns_the_best_action_of_every_state():
    torch.manual_seed(0)
    actor = make_actor(PolicyCard("driver", (("speed", 5),), TINY))
    best = torch.tensor([3, 0, 4, 1, 2])

    def worth(state, actions):
        return (actions[:, 0] == best[state]).float()

    assert bandit(actor, 1, worth) == [[3], [0], [4], [1], [2]]


def test_the_composite_head_learns_an_alert_for_every_intent():
    # Which alert is right depends on the intent, and the intent's worth on the alert being right.
    torch.manual_seed(0)
    driver = PolicyCard("driver", (("speed", 5),), TINY)
    vehicle_ai = PolicyCard("vehicle_ai", (("speed", 5),), TINY, by_intent=True)
    best = torch.tensor([4, 3, 2, 1, 0])

    def worth(state, actions):
        intent, alert = actions[:, 0].long(), actions[:, 1]
        right = (alert == intent % 2).float()
        return right + right * (intent == best[state]).float()

    learned = bandit(make_joint_actor(driver, vehicle_ai), 2, worth)
    assert learned == [[4, 0], [3, 1], [2, 0], [1, 1], [0, 0]]


def rule_of(policy, env):
    """Whether a policy alerts in each [t, d, i, c], beside a driver who keeps speed."""
    config = env.teaming.config
    layout, window = env.layouts["vehicle_ai"], config.alert_window
    env.reset(0)
    seen = env.get_observations()["vehicle_ai"][:1].numpy()
    grid = np.indices((config.horizon, 2, 2, window)).reshape(4, -1)
    t, d, i, c = grid
    seen = np.repeat(seen, grid.shape[1], axis=0)
    for name, values in {
        "time": t / config.horizon,
        "distracted": d,
        "accepted": i,
        "counter": c / window,
        "alerted": (i == 1) & (c == 0),
    }.items():
        seen[:, layout[name].start] = values
    for name in ("previous_intended_action", "applied_action"):
        seen[:, layout[name]] = np.eye(5)[KEEP_SPEED] * (t > 0)[:, None]
    policy.reset(np.zeros(len(seen), np.uint64))
    return policy.act(seen).reshape(config.horizon, 2, 2, window)


@pytest.mark.parametrize("name", ["marge", "homer"])
def test_ppo_learns_the_exact_optimum_of_alerting(name):
    env = env_for("vehicle_ai", 64, world=StandingWorld, driver=name, duration=2.0)
    card = card_for(env, "vehicle_ai", NetworkConfig((16,)))
    iterations = 60
    settings = PPOSettings(num_mini_batches=4, learning_rate=5e-3, final_learning_rate=1e-4)
    learner = learner_for(env, (card,), settings)
    for iteration in range(iterations):
        learner.begin(iteration / iterations)
        torch.manual_seed(iteration)
        row = play_batch(env, learner, 1000 * iteration)
        learner.learn(env.get_observations())
    policy = LearnedPolicy(card, weights_of(learner.ppo.actor), env.teaming.config)
    best = oracle.solve_alerts(name, horizon=10)
    reached = oracle.evaluate(rule_of(policy, env), name, horizon=10).total_return
    never = oracle.evaluate(0.0, name, horizon=10).total_return
    assert best.total_return > never + 5  # there is something to learn
    assert reached == pytest.approx(best.total_return, rel=0.01)
    assert row["attention_return"] == pytest.approx(best.total_return, rel=0.25)


def test_gathering_once_gives_the_batches_of_rsl_rl():
    sample = TensorDict({"actor": torch.zeros(6, 3)}, batch_size=[6])
    batches = []
    for kind in (RolloutStorage, ShuffledOnce):
        storage = kind("rl", 6, 4, sample, [1])
        torch.manual_seed(3)
        storage.observations["actor"].copy_(torch.rand(4, 6, 3))
        for name in ("actions", "values", "returns", "advantages", "actions_log_prob"):
            getattr(storage, name).copy_(torch.rand(4, 6, 1))
        storage.distribution_params = (torch.rand(4, 6, 2),)
        batches.append(list(storage.mini_batch_generator(3, 2)))
    assert len(batches[0]) == len(batches[1]) == 6
    for theirs, ours in zip(*batches, strict=True):
        assert (theirs.observations == ours.observations).all()
        for name in ("actions", "values", "returns", "advantages", "old_actions_log_prob"):
            assert torch.equal(getattr(theirs, name), getattr(ours, name))
        assert torch.equal(*(b.old_distribution_params[0] for b in (theirs, ours)))
