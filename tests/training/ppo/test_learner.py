import copy

import numpy as np
import pytest
import torch
from rsl_rl.algorithms import PPO
from rsl_rl.storage import RolloutStorage
from rsl_rl.utils import split_and_pad_trajectories
from standing_world import CrashingWorld, StandingWorld
from tensordict import TensorDict

from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.agents.learned.policy import LearnedPolicy, PolicyCard, make_card
from hmi_marl.agents.memory import Memoryless
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.teaming import Teaming
from hmi_marl.envs.vector import TeamVecEnv
from hmi_marl.exact import oracle
from hmi_marl.training.ppo.layers import policy_of
from hmi_marl.training.ppo.learner import PPOLearner, TwoLearners, play_batch
from hmi_marl.training.ppo.models import (
    Inputs,
    IntentShown,
    SeatView,
    make_actor,
    make_critic,
    make_joint_actor,
    weights_of,
)
from hmi_marl.training.ppo.shards import Shards
from hmi_marl.training.protocols.settings import PPOSettings

TINY = NetworkConfig((8,))
KEEP_SPEED = 1


class KeepsSpeed(Memoryless):
    def act(self, observations):
        return np.full(len(observations), KEEP_SPEED)


def env_for(seat, num_teams=16, world=CrashingWorld, **settings):
    config = TeamConfig(**({"driver": "homer", "duration": 1.0} | settings))
    teaming = Teaming(config, num_teams, world(config.scene, num_teams))
    return TeamVecEnv(teaming, seat, None if seat == "team" else KeepsSpeed())


SETTINGS = PPOSettings(num_mini_batches=2)
ONE = Shards()


def learner_for(env, cards, settings=SETTINGS, seed=0, centralised=True, shards=ONE):
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
        shards,
    )


def card_for(env, seat, network=TINY, **choices):
    return make_card(seat, env.teaming.config, network, knows_traits=True, **choices)


SEATS_WITH_MEMORY = ["vehicle_ai", "team"]


def cards_for(env, seat, memory):
    """Card of the vehicle AI, or cards of both seats, with so many recurrent units."""
    network = NetworkConfig((8,), rnn_hidden_dim=memory)
    if seat == "team":
        return card_for(env, "driver"), card_for(env, "vehicle_ai", network, by_intent=True)
    return (card_for(env, seat, network),)


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
        for weight in learner.critic.parameters():
            weight.zero_()
        learner.critic.mlp[0].weight[0, env.layouts["critic"]["time"]] = 1.0
        learner.critic.mlp[2].weight[0, 0] = 2.0
        learner.critic.mlp[2].bias[0] = 1.0
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
    rollout = learner.shards[0].rollout
    torch.testing.assert_close(rollout.rewards, expected)
    assert rollout.dones.sum(0).tolist() == [1, 1, 1, 1]
    learner.learn(seen)
    last = expected[4].clone()
    last[1] += 0.9 * (1 + 2 * 3 / 5)  # goes on, three steps into its second episode
    torch.testing.assert_close(rollout.returns[4], last)


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
        assert learner.entropy_coef == pytest.approx(entropy)
        assert [g["lr"] for g in learner.optimizer.param_groups] == [pytest.approx(rate)]
        play_batch(env, learner, 0)
        assert learner.learn(env.get_observations())["learning_rate"] == pytest.approx(rate)


@pytest.mark.parametrize("seat", SEATS_WITH_MEMORY)
@pytest.mark.parametrize("memory", [0, 3])
def test_what_was_saved_goes_on_as_if_nothing_had_happened(memory, seat):
    env = env_for(seat)
    cards = cards_for(env, seat, memory)
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


@pytest.mark.parametrize("seat", SEATS_WITH_MEMORY)
def test_a_memory_is_learned_from_as_it_was_when_it_acted(seat):
    # Replayed with the memory that was stored, every action is as likely as when it was drawn.
    env = env_for(seat, 12)
    learner = learner_for(env, cards_for(env, seat, 4), PPOSettings(num_mini_batches=3))
    for weight in learner.actor.parameters():
        torch.nn.init.normal_(weight, std=0.7)
    for seed in (1, 2):  # nothing may be left of the first batch in the second
        learner.begin(0.0)
        play_batch(env, learner, seed)
        (shard,) = learner.shards
        assert shard.rollout.dones[:-1].any()
        shard.evaluate(learner.view(env.get_observations()).critic)
        for batch in shard.mini_batches():
            policy, head = policy_of(learner.actor), learner.actor.distribution
            head.update(policy.forward(batch.actor, batch.carried)[0])
            torch.testing.assert_close(head.log_prob(batch.actions), batch.log_prob)


@pytest.mark.parametrize("seat", SEATS_WITH_MEMORY)
@pytest.mark.parametrize("memory", [0, 4])
def test_written_passes_are_those_of_autograd(memory, seat):
    env = env_for(seat, 12)
    learner = learner_for(env, cards_for(env, seat, memory), PPOSettings(num_mini_batches=3))
    actor = learner.actor
    for weight in actor.parameters():
        torch.nn.init.normal_(weight, std=0.7)
    learner.begin(0.0)
    play_batch(env, learner, 1)
    (shard,) = learner.shards
    assert shard.rollout.dones[:-1].any()
    for batch in shard.mini_batches():
        policy, weights = policy_of(actor), list(actor.parameters())
        with torch.no_grad():
            logits, passed = policy.forward(batch.actor, batch.carried)
        inputs, masks, hidden = batch.actor, None, None
        if memory:
            ends = torch.zeros_like(batch.carried)
            ends[:-1] = 1.0 - batch.carried[1:]
            inputs, masks = split_and_pad_trajectories(inputs, ends[..., None])
            hidden = torch.zeros(1, masks.shape[1], memory)
        seen = TensorDict({"actor": inputs}, inputs.shape[:-1])
        known = actor.mlp(actor.get_latent(seen, masks, hidden))
        torch.testing.assert_close(logits, known)
        factors = torch.randn(known.shape, generator=torch.Generator().manual_seed(2))
        expected = torch.autograd.grad((factors * known).sum(), weights)
        found = [torch.full_like(weight, torch.nan) for weight in weights]
        policy.backward(passed, factors, found)
        for one, other in zip(found, expected, strict=True):
            torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-5)


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
    stored = {seat: getattr(learner, seat).shards[0].rollout for seat in ("driver", "vehicle_ai")}
    intents = stored["driver"].actions[..., 0].long()
    shown = stored["vehicle_ai"].actor[..., env.layouts["vehicle_ai"]["intended_action"]]
    in_the_critic = env.layouts["critic"]["intended_action"]
    known = stored["vehicle_ai"].critic[..., in_the_critic]
    now = torch.nn.functional.one_hot(intents, 5).float()
    if turns:
        assert (shown == now).all()
        assert (known == now).all()  # its values are of the state in which it acts
        assert not (stored["driver"].critic[..., in_the_critic] == now).all()
    else:
        assert (known == shown).all()
        begins = torch.cat([torch.ones(1, 16), stored["driver"].dones[:-1]])
        before = torch.cat([torch.zeros(1, 16, 5), now[:-1]]) * (1 - begins).unsqueeze(-1)
        assert (shown == before).all()
    for seat, storage in stored.items():
        scaled = 0.1 * torch.stack([given[seat] for given in rewards_given])
        steps_on = storage.dones == 0
        torch.testing.assert_close(storage.rewards[steps_on], scaled[steps_on])
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
        return Inputs(torch.cat([state] * self.seats, dim=-1), state)


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
        seen = TensorDict({"actor": learner.view(state_of(every, states)).actor}, [states])
        return actor(seen).long().tolist()


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


class TwoSteps:
    """A view of episodes of two steps, in whose first step the vehicle AI sees a cue."""

    def __call__(self, observations):
        cue = observations["cue"]
        driver = torch.ones(len(cue), 1)
        return Inputs(torch.cat([driver, cue], dim=-1), cue)


@pytest.mark.parametrize("memory", [0, 4])
def test_the_composite_policy_learns_to_remember_what_an_alert_needs(memory):
    # In the second step the alert is right that the cue of the first one says, and a^H if it is 3.
    torch.manual_seed(0)
    driver = PolicyCard("driver", (("speed", 1),), TINY)
    network = NetworkConfig((8,), rnn_hidden_dim=memory)
    vehicle_ai = PolicyCard("vehicle_ai", (("speed", 3),), network, by_intent=True)
    teams, iterations = 64, 30
    settings = PPOSettings(num_mini_batches=2, learning_rate=2e-2, reward_scale=1.0)
    blank = TensorDict({"cue": torch.tensor([[0.0, 0.0, 1.0]]).expand(teams, 3)}, [teams])
    learner = PPOLearner(
        make_joint_actor(driver, vehicle_ai),
        make_critic(3, TINY),
        TwoSteps(),
        blank,
        4,
        2,
        settings,
        "cpu",
    )
    never = torch.zeros(teams, dtype=torch.bool)
    for iteration in range(iterations):
        learner.begin(iteration / iterations)
        with torch.inference_mode():
            for _ in range(2):
                cue = torch.randint(2, (teams,))
                learner.act(TensorDict({"cue": torch.eye(3)[cue]}, [teams]))
                learner.record(torch.zeros(teams), torch.zeros(teams), {"time_outs": never})
                actions = learner.act(blank)
                right = (actions[:, 1] == cue).float() * (actions[:, 0] == 3)
                learner.record(right, torch.ones(teams), {"time_outs": never})
        learner.learn(blank)
    share = right.mean()
    assert share > 0.95 if memory else share < 0.75  # without a memory the alert is a guess


def rule_of(policy, env):
    """Whether a policy alerts in each [t, d, i, c], beside a driver who carries speed."""
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


@pytest.mark.parametrize("name", ["marge", pytest.param("homer", marks=pytest.mark.slow)])
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
    policy = LearnedPolicy(card, weights_of(learner.actor), env.teaming.config)
    best = oracle.solve_alerts(name, horizon=10)
    reached = oracle.evaluate(rule_of(policy, env), name, horizon=10).total_return
    never = oracle.evaluate(0.0, name, horizon=10).total_return
    assert best.total_return > never + 5  # there is something to learn
    assert reached == pytest.approx(best.total_return, rel=0.01)
    assert row["attention_return"] == pytest.approx(best.total_return, rel=0.25)


@pytest.mark.parametrize("seat", SEATS_WITH_MEMORY)
@pytest.mark.parametrize("memory", [0, 3])
@pytest.mark.parametrize("count", [1, 2, 4])
def test_it_learns_what_rsl_rls_ppo_learns(memory, count, seat):
    # With one mini-batch, in which rsl_rl, too, has no order, from the same steps of 8 teams.
    env = env_for(seat, 8)
    cards = cards_for(env, seat, memory)
    settings = PPOSettings(num_mini_batches=1, num_learning_epochs=3)
    learner = learner_for(env, cards, settings, shards=Shards(count))
    actor, critic = copy.deepcopy(learner.actor), copy.deepcopy(learner.critic)
    learner.begin(0.0, [None] * count)
    play_batch(env, learner, 0, Shards(count))

    def of_all(name):
        return torch.cat([getattr(shard.rollout, name) for shard in learner.shards], dim=1)

    seen = {name: of_all(name) for name in ("actor", "critic")}
    sample = TensorDict({name: values[0] for name, values in seen.items()}, [8])
    storage = RolloutStorage("rl", 8, env.max_episode_length, sample, [len(cards)])
    reference = PPO(
        actor,
        critic,
        storage,
        num_learning_epochs=3,
        num_mini_batches=1,
        clip_param=settings.clip_param,
        gamma=settings.gamma,
        lam=settings.gae_lambda,
        entropy_coef=settings.entropy_coef,
        learning_rate=settings.learning_rate,
        max_grad_norm=settings.max_grad_norm,
        use_clipped_value_loss=False,
        schedule="fixed",
    )
    with torch.inference_mode():
        for step in range(env.max_episode_length):
            reference.act(TensorDict({name: seen[name][step] for name in seen}, [8]))
            reference.transition.actions = of_all("actions")[step]
            head = actor.distribution
            reference.transition.actions_log_prob = head.log_prob(of_all("actions")[step])
            rewards, dones = of_all("rewards")[step], of_all("dones")[step]
            reference.process_env_step(None, rewards, dones, {})
        last = learner.view(env.get_observations())
        reference.compute_returns(TensorDict({"actor": last.actor, "critic": last.critic}, [8]))
    expected = reference.update()
    losses = learner.learn(env.get_observations())
    for name, value in expected.items():
        assert losses[name] == pytest.approx(value, rel=1e-4, abs=1e-6), name
    for ours, theirs in ((learner.actor, actor), (learner.critic, critic)):
        for one, other in zip(ours.parameters(), theirs.parameters(), strict=True):
            torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-6)
