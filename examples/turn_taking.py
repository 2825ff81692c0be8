"""Sequential moves: a driver and the HMI that may alert them (PettingZoo AEC).

Run: python examples/turn_taking.py --driver bart --hmi optimal
"""

import argparse

from hmi_marl import make_driver_policy, make_hmi, merge_v0

parser = argparse.ArgumentParser(
    description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
)
parser.add_argument("--driver", default="homer", help="lisa, bart, ... (default: %(default)s)")
parser.add_argument("--hmi", default="optimal", help="never, always, ... (default: %(default)s)")
parser.add_argument("--duration", type=float, default=20.0, help="[s] (default: %(default)s)")
parser.add_argument("--seed", type=int, default=0, help="of the episode (default: %(default)s)")
args = parser.parse_args()

env = merge_v0.env(driver=args.driver, duration=args.duration, reward="individual")
env.reset(seed=args.seed)
policies = {
    "driver": make_driver_policy("rule", env.unwrapped.config),
    "vehicle_ai": make_hmi(args.hmi, env.unwrapped.config),
}
for policy in policies.values():
    policy.reset(env.unwrapped.team.teaming.seeds)

returns = dict.fromkeys(env.possible_agents, 0.0)
distracted = alerts = steps = 0
for agent in env.agent_iter():
    observation, reward, terminated, truncated, info = env.last()
    returns[agent] += reward
    if terminated or truncated:
        env.step(None)
        continue
    action = int(policies[agent].act(observation[None])[0])
    env.step(action)
    if agent == "vehicle_ai":
        steps += 1
        alerts += action
        distracted += env.infos[agent]["distracted"]

print(f"{args.driver} with {args.hmi!r}: {alerts} alerts, distracted {distracted} of {steps} steps")
for agent, value in returns.items():
    print(f"  {agent:<11} return {value:8.2f}")
