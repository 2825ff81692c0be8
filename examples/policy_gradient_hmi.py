"""Learn when to alert, in one file: REINFORCE with a baseline on the vehicle AI's Gymnasium seat.

The policy sees whether the driver was distracted and how far an accepted alert has worn off. Its
return is printed next to the exact optimum. Needs the train extra: pip install 'hmi-marl[train]'

Run: python examples/policy_gradient_hmi.py --driver homer --episodes 60
"""

import argparse

import gymnasium
import numpy as np
import torch

import hmi_marl
from hmi_marl import oracle

parser = argparse.ArgumentParser(
    description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
)
parser.add_argument("--driver", default="homer", help="lisa, bart, ... (default: %(default)s)")
parser.add_argument("--episodes", type=int, default=60, help="to learn from (default: %(default)s)")
parser.add_argument("--duration", type=float, default=10.0, help="[s] (default: %(default)s)")
parser.add_argument(
    "--seed", type=int, default=0, help="of the first episode (default: %(default)s)"
)
args = parser.parse_args()

torch.manual_seed(args.seed)
env = gymnasium.make(
    "hmi_marl/MergeHMI-v0",
    partner="rule",
    driver=args.driver,
    duration=args.duration,
    end_at_crash=False,
    scene=hmi_marl.Scene(vehicles=1),
)
layout, horizon = env.unwrapped.layout, env.unwrapped.config.horizon
policy = torch.nn.Linear(3, 1)
optimizer = torch.optim.Adam(policy.parameters(), lr=0.1)
best = oracle.solve_alerts(args.driver, horizon=horizon).total_return

recent: list[float] = []
for episode in range(args.episodes):
    # The first reset begins the series of this seed, the others go on with it.
    observation, _ = env.reset(seed=None if episode else args.seed)
    log_probabilities, rewards, over = [], [], False
    while not over:
        names = ("distracted", "accepted", "counter")
        parts = [float(layout.scalar(observation, name)) for name in names]
        choice = torch.distributions.Bernoulli(logits=policy(torch.tensor(parts)).squeeze())
        alert = choice.sample()
        log_probabilities.append(choice.log_prob(alert))
        observation, _, terminated, truncated, info = env.step(int(alert))
        # An alert acts within the window, so the attention terms of the next steps judge it.
        rewards.append(info["distraction"] + info["alert"] + info["accept_alert"])
        over = terminated or truncated
    credit = np.convolve(rewards[::-1], np.full(8, 1.0))[: len(rewards)][::-1]
    advantage = torch.tensor((credit - credit.mean()) / (credit.std() + 1e-6), dtype=torch.float32)
    loss = -(torch.stack(log_probabilities) * advantage).mean()
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()
    recent = [*recent, sum(rewards)][-10:]
    if (episode + 1) % 10 == 0 or episode + 1 == args.episodes:
        mean = np.mean(recent)
        print(f"episode {episode + 1:>4}  attention return {mean:8.1f}  (optimum {best:.1f})")
env.close()
