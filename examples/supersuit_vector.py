"""Both agents as one batch, padded to the same shapes, for trainers that share parameters.

SuperSuit pads observations and actions and makes a vector environment of several cars; each row
of a batch is one agent of one car. Needs the interop extra: pip install 'hmi-marl[interop]'

Run: python examples/supersuit_vector.py --cars 2 --steps 50
"""

import argparse

import numpy as np
import supersuit

from hmi_marl import merge_v0

parser = argparse.ArgumentParser(
    description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
)
parser.add_argument("--cars", type=int, default=2, help="in one batch (default: %(default)s)")
parser.add_argument("--steps", type=int, default=50, help="of each car (default: %(default)s)")
args = parser.parse_args()

env = merge_v0.parallel_env(driver=["lisa", "marge", "bart", "homer"])
env = supersuit.pad_observations_v0(env)
env = supersuit.pad_action_space_v0(env)  # the AI's actions above 1 count as no alert
vector = supersuit.pettingzoo_env_to_vec_env_v1(env)
vector = supersuit.concat_vec_envs_v1(vector, args.cars, num_cpus=1, base_class="gymnasium")

observations, _ = vector.reset(seed=0)
print(f"{args.cars} cars, {vector.num_envs} agents, observations {observations.shape}")
rng = np.random.default_rng(0)
total = np.zeros(vector.num_envs)
for _ in range(args.steps):
    actions = rng.integers(vector.action_space.n, size=vector.num_envs)
    observations, rewards, terminated, truncated, _ = vector.step(actions)
    total += rewards
rows = zip(range(vector.num_envs), total / args.steps, strict=True)
print("mean reward of a step, random actions:")
for row, reward in rows:
    print(f"  car {row // 2}  {('driver', 'vehicle_ai')[row % 2]:<11}{reward:7.2f}")
vector.close()
