"""Learn both seats with AgileRL's IPPO, in a process for each car.

Needs: pip install hmi-marl agilerl

Run: python examples/trainers/agilerl_ippo.py --steps 20000
"""

import argparse
import functools

from agilerl.algorithms import IPPO
from agilerl.training.train_multi_agent_on_policy import train_multi_agent_on_policy
from agilerl.vector.pz_async_vec_env import AsyncPettingZooVecEnv

from hmi_marl import merge_v0

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--steps", type=int, default=20_000, help="of all cars together")
parser.add_argument("--cars", type=int, default=4)
parser.add_argument("--batch", type=int, default=128, help="steps of each car to learn from")
parser.add_argument("--duration", type=float, default=20.0, help="of an episode [s]")
parser.add_argument("--world", default="batched")
args = parser.parse_args()

if __name__ == "__main__":
    make = functools.partial(
        merge_v0.parallel_env,
        driver="homer",
        reward="individual",
        world=args.world,
        duration=args.duration,
    )
    car = make()
    agents = car.possible_agents
    learners = IPPO(
        observation_spaces=[car.observation_space(agent) for agent in agents],
        action_spaces=[car.action_space(agent) for agent in agents],
        agent_ids=agents,
        batch_size=64,
        learn_step=args.batch,
    )
    cars = AsyncPettingZooVecEnv([make for _ in range(args.cars)])
    _, fitness = train_multi_agent_on_policy(
        cars,
        "merge_v0",
        "IPPO",
        [learners],
        sum_scores=False,
        max_steps=args.steps,
        evo_steps=args.batch * args.cars,
        eval_steps=args.batch,
        verbose=False,
    )
    print("return of each agent:", fitness)
    cars.close()
