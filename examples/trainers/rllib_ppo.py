"""Learn both seats with RLlib's PPO, a policy for each, taking turns or both at once.

RLlib pins a Gymnasium of its own, so give it an environment of its own.
Needs: pip install hmi-marl torch "ray[rllib]"

Run: python examples/trainers/rllib_ppo.py --turns --iterations 20
"""

import argparse

import ray
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv, PettingZooEnv
from ray.tune.registry import register_env

from hmi_marl import merge_v0

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--turns", action="store_true", help="take turns, or else act at once")
parser.add_argument("--iterations", type=int, default=20)
parser.add_argument("--batch", type=int, default=2000, help="steps in an iteration")
parser.add_argument("--runners", type=int, default=1, help="processes that collect, or 0")
parser.add_argument("--duration", type=float, default=20.0, help="of an episode [s]")
parser.add_argument("--world", default="batched")
args = parser.parse_args()


def make(_):
    """The environment, made in each process that collects."""
    settings = {"driver": "homer", "world": args.world, "duration": args.duration}
    if args.turns:
        return PettingZooEnv(merge_v0.env(**settings))
    return ParallelPettingZooEnv(merge_v0.parallel_env(**settings))


if __name__ == "__main__":
    ray.init(include_dashboard=False)
    register_env("merge", make)
    config = (
        PPOConfig()
        .environment("merge")
        .env_runners(num_env_runners=args.runners, rollout_fragment_length="auto")
        .multi_agent(
            policies={"driver", "vehicle_ai"},
            policy_mapping_fn=lambda agent, episode, **_: agent,
        )
        .training(
            train_batch_size_per_learner=args.batch, minibatch_size=args.batch // 4, num_epochs=4
        )
    )
    algorithm = config.build_algo()
    for _ in range(args.iterations):
        result = algorithm.train()["env_runners"]
        print("return of each agent:", result["agent_episode_returns_mean"])
    algorithm.stop()
    ray.shutdown()
