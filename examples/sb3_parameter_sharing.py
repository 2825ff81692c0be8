"""Both agents learn with one policy, by stable-baselines3's PPO: parameter sharing via SuperSuit.

SuperSuit pads both agents' spaces to one size, marks each row with its agent, and makes a batch of
several cars' agents, which stable-baselines3 takes for as many cars with one agent each. Moves are
simultaneous, so the AI sees what the driver intended in the last step.
Needs the interop extra: pip install 'hmi-marl[interop]'

Run: python examples/sb3_parameter_sharing.py --driver homer --steps 80000
"""

import argparse

import numpy as np
import supersuit
import torch
from pettingzoo.utils import BaseParallelWrapper
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.utils import set_random_seed
from stable_baselines3.common.vec_env import VecMonitor
from tqdm import tqdm

from hmi_marl import make_driver_policy, make_hmi, merge_v0

parser = argparse.ArgumentParser(
    description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
)
parser.add_argument("--driver", default="homer", help="lisa, bart, ... (default: %(default)s)")
parser.add_argument(
    "--steps", type=int, default=80_000, help="of all cars together (default: %(default)s)"
)
parser.add_argument("--cars", type=int, default=8, help="in one batch (default: %(default)s)")
parser.add_argument(
    "--batch", type=int, default=256, help="steps of each car to learn from (default: %(default)s)"
)
parser.add_argument(
    "--duration", type=float, default=20.0, help="of an episode [s] (default: %(default)s)"
)
parser.add_argument(
    "--episodes", type=int, default=20, help="to evaluate on (default: %(default)s)"
)
parser.add_argument("--seed", type=int, default=0, help="(default: %(default)s)")
args = parser.parse_args()
torch.set_num_threads(1)  # with networks as small as these, more threads only wait for each other


class MarksTruncation(BaseParallelWrapper):
    """Marks episodes that ended by their time alone, where stable-baselines3 looks for it.

    SuperSuit's vector environment gives terminated *or* truncated as done. The value of what
    follows would then be learned as 0 at the end of every episode that no crash ended.
    """

    def step(self, actions):
        """Step the team."""
        observations, rewards, terminated, truncated, infos = super().step(actions)
        for agent, info in infos.items():
            info["TimeLimit.truncated"] = truncated[agent] and not terminated[agent]
        return observations, rewards, terminated, truncated, infos


# Each agent gets its own reward: the driver for driving and attention, the AI for its alerts.
env = merge_v0.parallel_env(
    driver=args.driver, world="batched", duration=args.duration, reward="individual"
)
own_actions = {agent: env.action_space(agent).n for agent in env.possible_agents}  # 5 and 2

# The driver's 52 numbers are followed by zeros up to the AI's 65. One policy acts for both, so
# two more numbers, one of them above 0, say for which agent. (In this order: the indicator
# wants observations of one size. It is as large as the largest bound of the spaces, 5, and lies
# outside its own bound, which stable-baselines3 does not check.)
padded = supersuit.agent_indicator_v0(supersuit.pad_observations_v0(env))

# Both choose from 5 actions. An action that an agent does not have counts as its action 0, it is
# not clipped to the last one: 2, 3 and 4 of the AI mean no alert. So an untrained policy alerts in
# one step of five.
learning = supersuit.pad_action_space_v0(MarksTruncation(padded))


def unpadded(agent: str, action: int) -> int:
    """Return the agent's action for one from the padded space, as SuperSuit reads it."""
    return action if action < own_actions[agent] else 0


# Rewards of up to 30 a step make values of hundreds; a tenth of them is learned from.
learning = supersuit.reward_lambda_v0(learning, lambda reward: 0.1 * reward)
cars = supersuit.pettingzoo_env_to_vec_env_v1(learning)  # one car, a row for each agent
cars = supersuit.concat_vec_envs_v1(cars, args.cars, base_class="stable_baselines3")

# This vector environment has no seed(), so neither PPO(seed=...) nor cars.seed() work. Seed
# torch and NumPy by hand and the cars below the wrapper: SuperSuit gives car k the series of
# seed + k, and each reset that follows goes on with it.
set_random_seed(args.seed)
cars.venv.reset(seed=args.seed)
cars = VecMonitor(cars)  # keeps what the progress bar shows
model = PPO(
    "MlpPolicy",
    cars,
    n_steps=args.batch,
    batch_size=2 * args.cars * args.batch // 8,
    n_epochs=5,
    learning_rate=1e-3,
    gamma=0.98,
    ent_coef=0.01,
    device="cpu",
)


def mean_returns(team, act) -> dict[str, float]:
    """Mean return of each agent over evaluation episodes, always the same ones.

    ``act(agent, observation)`` chooses an action for an agent of ``team``, a parallel environment.
    """
    totals = dict.fromkeys(team.possible_agents, 0.0)
    for episode in range(args.episodes):
        observations, _ = team.reset(seed=10_000 + episode)
        while team.agents:
            actions = {agent: act(agent, seen) for agent, seen in observations.items()}
            observations, rewards, *_ = team.step(actions)
            for agent, reward in rewards.items():
                totals[agent] += reward / args.episodes
    return totals


def learned(agent: str, observation: np.ndarray) -> int:
    """Draw an action of the shared policy, as in learning."""
    return unpadded(agent, int(model.predict(observation)[0]))


def by_rule(hmi_name: str) -> dict[str, float]:
    """Mean returns of the rule-based driver with one of the HMIs that need no learning."""
    config = env.unwrapped.config
    seats = {
        "driver": make_driver_policy("rule", config),
        "vehicle_ai": make_hmi(hmi_name, config, sequential=False),
    }
    for policy in seats.values():
        policy.reset(np.zeros(1, np.uint64))  # neither of them draws anything
    return mean_returns(env, lambda agent, seen: int(seats[agent].act(seen[None])[0]))


class Progress(BaseCallback):
    """Progress bar with the mean return of an agent's latest episodes, as scaled for learning."""

    def _on_training_start(self) -> None:
        batch = args.cars * args.batch  # whole batches are played
        total = -(-args.steps // batch) * batch
        self.bar = tqdm(total=total, unit=" car steps", desc="learning", mininterval=1.0)

    def _on_step(self) -> bool:
        self.bar.update(args.cars)
        return True

    def _on_rollout_end(self) -> None:
        returns = [episode["r"] for episode in self.model.ep_info_buffer]
        if returns:
            self.bar.set_postfix({"return": f"{np.mean(returns):.1f}"})

    def _on_training_end(self) -> None:
        self.bar.close()


rows = {"untrained": mean_returns(padded, learned)}
model.learn(2 * args.steps, callback=Progress())  # stable-baselines3 counts each agent's step
rows["learned"] = mean_returns(padded, learned)
rows["rule, no HMI"] = by_rule("never")
rows["rule, optimal HMI"] = by_rule("optimal")
print(f"{args.driver}, mean return over {args.episodes} episodes")
print(f"{'':<20}{'driver':>10}{'vehicle_ai':>12}{'together':>10}")
for name, row in rows.items():
    print(f"{name:<20}{row['driver']:>10.1f}{row['vehicle_ai']:>12.1f}{sum(row.values()):>10.1f}")
cars.close()
