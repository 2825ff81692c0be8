"""The anchor: a driver policy that a learning driver is held close to.

As in human-regularised PPO (Cornelisse and Vinitsky, arXiv 2403.19648) a divergence from the
anchor is added to the driver's loss: λ KL(π_driver(.|s) || π_anchor(.|s)), a mean over steps and
exact over the five actions.
"""

from __future__ import annotations

import torch
from tensordict import TensorDict

from hmi_marl.agents.learned.policy import LearnedPolicy
from hmi_marl.envs.vector import TeamVecEnv
from hmi_marl.training.ppo.heads import Choice
from hmi_marl.training.ppo.layers import policy_of
from hmi_marl.training.ppo.models import SeatView, load_layers, make_actor


class Anchor:
    """A driver policy without a memory, with the weight λ of the divergence from it.

    Args:
        policy: the policy; its probabilities count, whether it is greedy or not.
        env: environment whose observations it reads, as it sees them.
        kl: weight λ; with 0 the divergence is measured alone.
        device: where it is computed.
    """

    def __init__(self, policy: LearnedPolicy, env: TeamVecEnv, kl: float, device: str) -> None:
        self.kl = kl
        self._view = SeatView(env, (policy.card,), centralised=False)
        actor = make_actor(policy.card)
        load_layers(actor.mlp, policy.weights)
        self._policy = policy_of(actor.to(device))

    def inputs(self, observations: TensorDict) -> torch.Tensor:
        """Return the inputs that it reads, shape (N, columns)."""
        return self._view(observations).actor

    def log_probs(self, inputs: torch.Tensor) -> torch.Tensor:
        """Return log π(a^H | s), shape (n, 5), of the teams of one shard."""
        return Choice(self._policy.act(inputs.clone(), None)[0]).log_probs
