"""Make TorchRL environments of one seat, of both seats, and of both seats in one group.

A group stacks its agents, so SuperSuit pads them to one size first; an action that the AI does
not have counts as its action 0, no alert. Needs: pip install hmi-marl torchrl supersuit

Run: python examples/trainers/torchrl_groups.py --steps 200
"""

import argparse

import supersuit
import torch
from tensordict.nn import TensorDictModule
from torch.distributions import Categorical
from torchrl.envs import GymEnv, PettingZooWrapper
from torchrl.modules import MultiAgentMLP, ProbabilisticActor
from torchrl.objectives import ClipPPOLoss, ValueEstimators

import hmi_marl  # noqa: F401 (names the environments)
from hmi_marl import merge_v0

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--steps", type=int, default=200, help="in a batch")
parser.add_argument("--batches", type=int, default=5, help="that PPO learns from")
parser.add_argument("--duration", type=float, default=20.0, help="of an episode [s]")
parser.add_argument("--world", default="batched")
args = parser.parse_args()
settings = {"driver": "homer", "world": args.world, "duration": args.duration}

# One seat, for any trainer of TorchRL.
seat = GymEnv("hmi_marl/MergeHMI-v0", categorical_action_encoding=True, **settings)
print("one seat", seat.rollout(args.steps)["observation"].shape)

# Taking turns, a group for each agent; "mask" says whose turn it is.
turns = PettingZooWrapper(merge_v0.env(**settings), use_mask=True)
print("turns", turns.rollout(args.steps)["vehicle_ai", "mask"].sum().item(), "of the AI")

# Both at once in one group, the team's state for a centralised critic.
team = merge_v0.parallel_env(**settings)
team = supersuit.pad_action_space_v0(supersuit.pad_observations_v0(team))
both = PettingZooWrapper(team, group_map={"car": ["driver", "vehicle_ai"]})
size, actions = both.observation_spec["car", "observation"].shape[-1], 5

# PPO for the group, a network of its own for each agent.
key = {kind: ("car", kind) for kind in ("observation", "logits", "action", "reward", "state_value")}
heads = {"n_agents": 2, "share_params": False}
act = ProbabilisticActor(
    TensorDictModule(
        MultiAgentMLP(size, actions, centralized=False, **heads),
        [key["observation"]],
        [key["logits"]],
    ),
    in_keys={"logits": key["logits"]},
    out_keys=[key["action"]],
    distribution_class=Categorical,
    return_log_prob=True,
)
value = TensorDictModule(
    MultiAgentMLP(size, 1, centralized=True, **heads), [key["observation"]], [key["state_value"]]
)
loss = ClipPPOLoss(act, value)
ends = {kind: ("car", kind) for kind in ("done", "terminated")}
loss.set_keys(action=key["action"], reward=key["reward"], value=key["state_value"], **ends)
loss.make_value_estimator(ValueEstimators.GAE, gamma=0.99, lmbda=0.95)
optimizer = torch.optim.Adam(loss.parameters(), lr=3e-4)
for _ in range(args.batches):
    with torch.no_grad():
        batch = both.rollout(args.steps, act, break_when_any_done=False)
        loss.value_estimator(batch)
    for _ in range(4):
        terms = loss(batch)
        optimizer.zero_grad()
        sum(term for name, term in terms.items() if name.startswith("loss_")).backward()
        optimizer.step()
    print("reward of a step", batch["next", "car", "reward"].mean(0).flatten().tolist())
