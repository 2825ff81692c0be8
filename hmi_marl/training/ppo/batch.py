"""One batch: a whole episode of every team, played, recorded and averaged."""

from __future__ import annotations

from typing import Any

import torch

from hmi_marl.envs.rewards import ATTENTION_TERMS, TERMS
from hmi_marl.envs.vector import TeamVecEnv
from hmi_marl.training.ppo.learner import Learner


def play_batch(env: TeamVecEnv, learner: Learner, seed: int) -> dict[str, float]:
    """Play as many steps as an episode has, from the start of every team's episode.

    Teams that crash begin another episode, which the end of the batch truncates.

    Args:
        env: environment, which is reset.
        learner: acts and records.
        seed: seed of the first team; team k gets the series of episodes of ``seed + k``.

    Returns:
        Means over the teams' first episodes, which are all complete: the seat's ``return``,
        each reward term, ``team_return`` (all eight), ``attention_return`` (the last three),
        ``length``, ``crash_rate`` and ``alerts``.
    """
    first = _FirstEpisodes(env.num_envs)
    with torch.inference_mode():
        observations, _ = env.reset(seed)
        for _ in range(env.max_episode_length):
            actions = learner.act(observations)
            observations, rewards, dones, extras = env.step(actions)
            learner.record(rewards, dones, extras)
            if "final_teams" in extras:
                first.add(extras)
    return first.means()


class _FirstEpisodes:
    """Statistics of each team's first episode in a batch."""

    def __init__(self, teams: int) -> None:
        self._waiting = torch.ones(teams, dtype=torch.bool)
        self._values: dict[str, list[torch.Tensor]] = {}

    def add(self, extras: dict[str, Any]) -> None:
        """Add the episodes that ended in a step."""
        teams = extras["final_teams"].cpu()
        first = self._waiting[teams]
        self._waiting[teams] = False
        for name, values in extras["log"].items():
            self._values.setdefault(name.removeprefix("Episode/"), []).append(values[first])

    def means(self) -> dict[str, float]:
        """Return means over all teams."""
        means = {name: float(torch.cat(kept).mean()) for name, kept in self._values.items()}
        means["team_return"] = sum(means[term] for term in TERMS)
        means["attention_return"] = sum(means[term] for term in ATTENTION_TERMS)
        return means
