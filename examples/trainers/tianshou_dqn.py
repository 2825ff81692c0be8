"""Learn one seat with Tianshou's DQN, then both seats, taking turns, with a DQN each.

Tianshou wants one space for all agents, so SuperSuit pads them; an action that the AI does not
have counts as its action 0, no alert. Needs: pip install hmi-marl tianshou supersuit

Run: python examples/trainers/tianshou_dqn.py --steps 20000
"""

import argparse

import gymnasium
import supersuit
from tianshou.algorithm import DQN, MultiAgentOffPolicyAlgorithm
from tianshou.algorithm.modelfree.dqn import DiscreteQLearningPolicy
from tianshou.algorithm.optim import AdamOptimizerFactory
from tianshou.data import Collector, VectorReplayBuffer
from tianshou.env import DummyVectorEnv, PettingZooEnv, SubprocVectorEnv
from tianshou.trainer import OffPolicyTrainerParams
from tianshou.utils.net.common import Net

import hmi_marl  # noqa: F401 (names the environments)
from hmi_marl import merge_v0

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--steps", type=int, default=20_000, help="of all cars together")
parser.add_argument("--cars", type=int, default=4)
parser.add_argument("--duration", type=float, default=20.0, help="of an episode [s]")
parser.add_argument("--world", default="batched")
parser.add_argument("--processes", action="store_true", help="one for each car of the one seat")
args = parser.parse_args()
settings = {"driver": "homer", "world": args.world, "duration": args.duration}


def dqn(observation_space, action_space):
    """A DQN for these spaces."""
    policy = DiscreteQLearningPolicy(
        model=Net(
            state_shape=observation_space.shape,
            action_shape=int(action_space.n),
            hidden_sizes=[64, 64],
        ),
        observation_space=observation_space,
        action_space=action_space,
        eps_training=0.1,
    )
    return DQN(policy=policy, optim=AdamOptimizerFactory(lr=1e-3), target_update_freq=100)


def train(algorithm, cars):
    """Learn from these cars; returns the mean return of the last collection."""
    collector = Collector(algorithm, cars, VectorReplayBuffer(20_000, len(cars)))
    parameters = OffPolicyTrainerParams(
        training_collector=collector,
        max_epochs=1,
        epoch_num_steps=args.steps,
        collection_step_num_env_steps=10 * len(cars),
        update_step_num_gradient_steps_per_sample=0.1,
        batch_size=64,
    )
    return algorithm.run_training(parameters)


def seat():
    """The vehicle AI's seat, beside a driver that follows rules."""
    return gymnasium.make("hmi_marl/MergeHMI-v0", reward="attention", **settings)


def both():
    """Both seats, padded to one size."""
    env = merge_v0.env(reward="individual", **settings)
    return PettingZooEnv(supersuit.pad_action_space_v0(supersuit.pad_observations_v0(env)))


if __name__ == "__main__":
    vector = SubprocVectorEnv if args.processes else DummyVectorEnv
    cars = vector([seat for _ in range(args.cars)])
    one = seat()
    print("one seat", train(dqn(one.observation_space, one.action_space), cars).train_step)
    cars.close()

    team = both()
    learners = [dqn(team.observation_space, team.action_space) for _ in team.agents]
    algorithm = MultiAgentOffPolicyAlgorithm(algorithms=learners, env=team)
    print(
        "both seats", train(algorithm, DummyVectorEnv([both for _ in range(args.cars)])).train_step
    )
