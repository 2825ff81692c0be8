"""Learn one seat in the manner of CleanRL: a vector of cars and PPO, on one page.

Needs: pip install hmi-marl torch

Run: python examples/trainers/cleanrl_ppo.py --steps 100000
"""

import argparse

import gymnasium
import numpy as np
import torch
from torch import nn
from torch.distributions import Categorical

import hmi_marl  # noqa: F401 (names the environments)

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--seat", default="MergeHMI", choices=["MergeDriver", "MergeHMI"])
parser.add_argument("--steps", type=int, default=100_000, help="of all cars together")
parser.add_argument("--cars", type=int, default=8)
parser.add_argument("--batch", type=int, default=128, help="steps of each car to learn from")
parser.add_argument("--vector", default="sync", choices=["sync", "async"])
parser.add_argument("--duration", type=float, default=20.0, help="of an episode [s]")
parser.add_argument("--world", default="batched")
parser.add_argument("--seed", type=int, default=0)
args = parser.parse_args()
GAMMA, LAMBDA, CLIP = 0.98, 0.95, 0.2


def layers(inputs, outputs):
    """A small network."""
    return nn.Sequential(
        nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, outputs)
    )


if __name__ == "__main__":
    torch.manual_seed(args.seed)
    cars = gymnasium.make_vec(
        f"hmi_marl/{args.seat}-v0",
        num_envs=args.cars,
        vectorization_mode=args.vector,
        # The step after an end would be a reset; this way every row is a step.
        vector_kwargs={"autoreset_mode": gymnasium.vector.AutoresetMode.SAME_STEP},
        driver="homer",
        world=args.world,
        duration=args.duration,
    )
    cars = gymnasium.wrappers.vector.RecordEpisodeStatistics(cars)
    size, actions = cars.single_observation_space.shape[0], int(cars.single_action_space.n)
    actor, critic = layers(size, actions), layers(size, 1)
    optimizer = torch.optim.Adam([*actor.parameters(), *critic.parameters()], lr=1e-3)
    seen = torch.as_tensor(cars.reset(seed=args.seed)[0])

    for _ in range(args.steps // (args.cars * args.batch)):
        rows, returns = [], []
        for _ in range(args.batch):
            with torch.no_grad():
                policy = Categorical(logits=actor(seen))
                action = policy.sample()
            after, reward, terminated, truncated, info = cars.step(action.numpy())
            ended = terminated | truncated
            last = np.array(after)
            if ended.any():  # the value at the end is of what was seen last, not of the new start
                last[ended] = np.stack(list(info["final_obs"][ended]))
                returns += list(info["episode"]["r"][ended])
            with torch.no_grad():
                value, following = critic(seen)[:, 0], critic(torch.as_tensor(last))[:, 0]
            reward = torch.as_tensor(0.1 * reward, dtype=torch.float32)
            target = reward + GAMMA * following * torch.as_tensor(~terminated)
            rows.append((seen, action, policy.log_prob(action), value, target, ended))
            seen = torch.as_tensor(np.array(after))
        advantages, gain = [], torch.zeros(args.cars)
        for _, _, _, value, target, ended in reversed(rows):
            gain = target - value + GAMMA * LAMBDA * gain * torch.as_tensor(~ended)
            advantages.insert(0, gain)
        advantage = torch.cat(advantages)
        x, action, log_prob, value = (torch.cat([row[k] for row in rows]) for k in range(4))
        wanted = advantage + value
        advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        for _ in range(4):
            for part in torch.randperm(len(x)).chunk(4):
                policy = Categorical(logits=actor(x[part]))
                ratio = (policy.log_prob(action[part]) - log_prob[part]).exp()
                gains = advantage[part]
                clipped = torch.clamp(ratio, 1 - CLIP, 1 + CLIP) * gains
                loss = -torch.min(ratio * gains, clipped).mean() - 0.01 * policy.entropy().mean()
                loss = loss + 0.5 * (critic(x[part])[:, 0] - wanted[part]).square().mean()
                optimizer.zero_grad()
                loss.backward()
                optimizer.step()
        print(f"mean return {np.mean(returns) if returns else float('nan'):.1f}")
    cars.close()
