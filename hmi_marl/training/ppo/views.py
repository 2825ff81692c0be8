"""Inputs of actors and critics, taken from an environment's observations."""

from __future__ import annotations

from typing import Protocol

import torch
from tensordict import TensorDict

from hmi_marl.agents.learned.policy import INTENT, INTENTS, PolicyCard
from hmi_marl.envs.config import VEHICLE_AI
from hmi_marl.envs.vector import TeamVecEnv


class View(Protocol):
    """Function from an environment's observation groups to the groups ``actor`` and ``critic``."""

    def __call__(self, observations: TensorDict) -> TensorDict:
        """Groups ``actor`` and ``critic``, both of shape (N, columns)."""
        ...


def unchanged(observations: TensorDict) -> TensorDict:
    """:class:`View` of observations that have the groups ``actor`` and ``critic`` already."""
    return observations


class Context(Protocol):
    """Function from drivers' traits to vectors z."""

    size: int
    """Z."""
    digest: str
    """Checksum that distinguishes it from contexts in which z means something else."""

    def __call__(self, traits: torch.Tensor) -> torch.Tensor:
        """From traits of shape (N, 4), unscaled, to z of shape (N, Z)."""
        ...


class SeatView:
    """:class:`View` of one seat, or of both seats of a composite policy.

    Args:
        env: environment that gives the observations.
        cards: cards of the seats, whose inputs are concatenated for the actor.
        centralised: the critic reads the team's whole state, else the actor's inputs.
        context: gives z, if the policies are conditioned on it.
    """

    def __init__(
        self,
        env: TeamVecEnv,
        cards: tuple[PolicyCard, ...],
        centralised: bool,
        context: Context | None = None,
    ) -> None:
        self._columns = {
            card.seat: torch.from_numpy(card.columns(env.layouts[card.seat])).to(env.device)
            for card in cards
        }
        self._context = {card.seat: context if card.context else None for card in cards}
        self._centralised = centralised
        actor = sum(card.inputs for card in cards)
        self.critic_inputs = env.layouts["critic"].size if centralised else actor
        """Columns that the critic reads."""

    def __call__(self, observations: TensorDict) -> TensorDict:
        """See :meth:`View.__call__`."""
        read = []
        for seat, columns in self._columns.items():
            read.append(observations[seat].index_select(1, columns))
            context = self._context[seat]
            if context is not None:
                read.append(context(observations["traits"]))
        actor = read[0] if len(read) == 1 else torch.cat(read, dim=1)
        critic = observations["critic"] if self._centralised else actor
        return TensorDict({"actor": actor, "critic": critic}, batch_size=observations.batch_size)


class IntentShown:
    """Put the a^H_t that the driver has just chosen into observations, as sequential moves do.

    An environment with simultaneous moves shows a^H_{t-1}; nothing else differs.
    """

    def __init__(self, env: TeamVecEnv) -> None:
        self._columns = {group: env.layouts[group][INTENT] for group in (VEHICLE_AI, "critic")}

    def __call__(self, observations: TensorDict, intents: torch.Tensor) -> TensorDict:
        """Observations with a^H of shape (N, 1) in the vehicle AI's and the critic's groups.

        The other groups are shared with ``observations``, which are not changed.
        """
        one_hot = torch.nn.functional.one_hot(intents.long().squeeze(-1), INTENTS)
        groups = {name: observations[name] for name in observations.keys()}  # noqa: SIM118
        for name, columns in self._columns.items():
            groups[name] = groups[name].clone()
            groups[name][:, columns] = one_hot.to(groups[name].dtype)
        return TensorDict(groups, batch_size=observations.batch_size)
