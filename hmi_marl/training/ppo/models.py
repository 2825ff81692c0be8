"""Actors and critics: inputs out of observations, rsl_rl's models, and their weights by name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from rsl_rl.models import MLPModel, RNNModel  # type: ignore[import-untyped]
from rsl_rl.modules import MLP, RNN  # type: ignore[import-untyped]
from rsl_rl.utils import unpad_trajectories  # type: ignore[import-untyped]
from tensordict import TensorDict

from hmi_marl.agents.learned.network import NetworkConfig, Weights
from hmi_marl.agents.learned.policy import INTENT, INTENTS, PolicyCard
from hmi_marl.envs.config import VEHICLE_AI
from hmi_marl.envs.vector import TeamVecEnv
from hmi_marl.training.ppo.heads import IntentThenAlert, OneAction


@dataclass(frozen=True)
class Inputs:
    """Inputs of an actor and its critic, of shapes (..., columns)."""

    actor: torch.Tensor
    critic: torch.Tensor


class View(Protocol):
    """Function from an environment's observation groups to the inputs of actor and critic."""

    def __call__(self, observations: TensorDict) -> Inputs:
        """Inputs of shape (N, columns)."""
        ...


def unchanged(observations: TensorDict) -> Inputs:
    """:class:`View` of observations that have the groups ``actor`` and ``critic`` already."""
    return Inputs(observations["actor"], observations["critic"])


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
        cards: cards of the seats, whose inputs are concatenated for the actor.
        centralised: the critic reads the team's whole state, else the actor's inputs.
        context: gives z, if the policies are conditioned on it.
        teams: teams in a shard, for which z is computed at a time; by default all.
    """

    def __init__(
        self,
        env: TeamVecEnv,
        cards: tuple[PolicyCard, ...],
        centralised: bool,
        context: Context | None = None,
        teams: int | None = None,
    ) -> None:
        self._columns = {card.seat: _columns(card, env) for card in cards}
        self._teams = env.num_envs if teams is None else teams
        self._context = {card.seat: context if card.context else None for card in cards}
        self._centralised = centralised
        actor = sum(card.inputs for card in cards)
        self.critic_inputs = env.layouts["critic"].size if centralised else actor
        """Columns that the critic reads."""

    @property
    def groups(self) -> tuple[str, ...]:
        """Groups of the environment's observations that it reads."""
        traits = any(context is not None for context in self._context.values())
        return (*self._columns, *["traits"] * traits, *["critic"] * self._centralised)

    def __call__(self, observations: TensorDict) -> Inputs:
        """See :meth:`View.__call__`; inputs may share memory with the observations."""
        read = []
        for seat, columns in self._columns.items():
            seen = observations[seat]
            read.append(seen if columns is None else seen.index_select(1, columns))
            if (context := self._context[seat]) is not None:
                parts = observations["traits"].split(self._teams)
                read.append(torch.cat([context(traits.clone()) for traits in parts]))
        actor = read[0] if len(read) == 1 else torch.cat(read, dim=1)
        return Inputs(actor, observations["critic"] if self._centralised else actor)


def _columns(card: PolicyCard, env: TeamVecEnv) -> torch.Tensor | None:
    """Columns of the seat's observation that a policy reads; None for all of them."""
    layout = env.layouts[card.seat]
    columns = torch.from_numpy(card.columns(layout))
    everything = torch.equal(columns, torch.arange(layout.size))
    return None if everything else columns.to(env.device)


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
            if name not in groups:
                continue
            groups[name] = groups[name].clone()
            groups[name][:, columns] = one_hot.to(groups[name].dtype)
        return TensorDict(groups, batch_size=observations.batch_size)


GROUPS = {"actor": ["actor"], "critic": ["critic"]}
"""Observation groups of actor and critic: each the group of its own name."""


def make_actor(card: PolicyCard) -> MLPModel:
    """Return an actor for one seat, by its card."""
    head = {"class_name": OneAction, "choices": card.actions}
    return _model(card.inputs, 1, card.network, head)


def _model(inputs: int, columns: int, network: NetworkConfig, head: dict[str, Any]) -> MLPModel:
    template = _template("actor", inputs)
    sizes = (template, GROUPS, "actor", columns, network.hidden_dims, network.activation)
    if not (units := network.rnn_hidden_dim):
        return MLPModel(*sizes, distribution_cfg=head)
    return MemoryModel(*sizes, distribution_cfg=head, rnn_type="gru", rnn_hidden_dim=units)


class MemoryModel(RNNModel):  # type: ignore[misc]  # rsl_rl has no types
    """rsl_rl's recurrent model, in which the layers also get the inputs themselves."""

    passed_by = 0
    """Columns, the first ones, that only the layers read."""

    def get_latent(
        self,
        obs: TensorDict,
        masks: torch.Tensor | None = None,
        hidden_state: torch.Tensor | None = None,
    ) -> torch.Tensor:
        """Return hidden state and inputs, concatenated: shape (..., rnn_hidden_dim + inputs).

        The hidden state stands before the inputs that it comes from.
        """
        inputs, first = MLPModel.get_latent(self, obs), self.passed_by
        remembered = self.rnn(inputs[..., first:], masks, hidden_state).squeeze(0)
        if masks is not None:
            inputs = unpad_trajectories(inputs, masks)
        return torch.cat([inputs[..., :first], remembered, inputs[..., first:]], dim=-1)

    def _get_latent_dim(self) -> int:
        return int(self.latent_dim + self.obs_dim)


class TwoSeats(torch.nn.Module):
    """Layers of both seats, each with its own part of the input.

    The vehicle AI's part begins with its hidden state if it is recurrent.
    """

    def __init__(self, driver: PolicyCard, vehicle_ai: PolicyCard) -> None:
        super().__init__()
        self.driver = _mlp(driver)
        self.vehicle_ai = _mlp(vehicle_ai)
        self.driver_inputs = driver.inputs
        """Columns of the driver's layers; those of the vehicle AI's follow."""

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Return logits of a^H, then of a^A for each a^H: (..., 15) with one alert strength."""
        of_driver, of_vehicle_ai = self.split(inputs)
        return torch.cat([self.driver(of_driver), self.vehicle_ai(of_vehicle_ai)], dim=-1)

    def split(self, inputs: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the inputs of both seats."""
        return inputs[..., : self.driver_inputs], inputs[..., self.driver_inputs :]


def make_joint_actor(driver: PolicyCard, vehicle_ai: PolicyCard) -> MLPModel:
    """Return the composite π_H∘π_AI. Each half reads its own seat's inputs and works alone.

    Raises:
        ValueError: a recurrent driver, or a vehicle AI that is not ``by_intent``.
    """
    if driver.network.rnn_hidden_dim:
        raise ValueError(
            "only the vehicle AI's half of the composite policy is recurrent; choose "
            "rnn_hidden_dim = 0 for the driver"
        )
    if not vehicle_ai.by_intent:
        raise ValueError(
            "the composite policy needs a vehicle AI with logits by intent (by_intent)"
        )
    head = {"class_name": IntentThenAlert, "alerts": vehicle_ai.actions}
    units = vehicle_ai.network.rnn_hidden_dim
    replaced = NetworkConfig((1,), rnn_hidden_dim=units)  # by the networks of the seats
    model = _model(driver.inputs + vehicle_ai.inputs, 2, replaced, head)
    model.mlp = TwoSeats(driver, vehicle_ai)
    if units:
        model.passed_by, model.rnn = driver.inputs, RNN(vehicle_ai.inputs, units, type="gru")
    return model


def make_critic(inputs: int, network: NetworkConfig) -> MLPModel:
    """Return a value network; never recurrent."""
    template = _template("critic", inputs)
    return MLPModel(template, GROUPS, "critic", 1, network.hidden_dims, network.activation)


def weights_of(actor: MLPModel) -> dict[str, NDArray[np.float32]]:
    """Return the actor's weights by the names of :meth:`NetworkConfig.shapes`."""
    return layers_of(actor.mlp) | _memory_of_actor(actor)


def weights_of_both(actor: MLPModel) -> tuple[dict[str, NDArray[np.float32]], ...]:
    """Return the weights of the composite policy's two halves, the driver's first."""
    seats = actor.mlp
    return layers_of(seats.driver), layers_of(seats.vehicle_ai) | _memory_of_actor(actor)


def _memory_of_actor(actor: MLPModel) -> dict[str, NDArray[np.float32]]:
    return memory_of(actor.rnn.rnn) if actor.is_recurrent else {}


_MEMORY = {
    "input_weight": "weight_ih_l0",
    "hidden_weight": "weight_hh_l0",
    "input_bias": "bias_ih_l0",
    "hidden_bias": "bias_hh_l0",
}


def _mlp(card: PolicyCard) -> MLP:
    network = card.network
    inputs = network.rnn_hidden_dim + card.inputs
    return MLP(inputs, card.outputs, network.hidden_dims, network.activation)


def layers_of(mlp: torch.nn.Module) -> dict[str, NDArray[np.float32]]:
    """Return the weights of linear layers by the names of :meth:`NetworkConfig.shapes`."""
    linear = [layer for layer in mlp.modules() if isinstance(layer, torch.nn.Linear)]
    weights = {}
    for place, layer in enumerate(linear):
        weights[f"layer{place}.weight"] = array_of(layer.weight)
        weights[f"layer{place}.bias"] = array_of(layer.bias)
    return weights


def load_layers(mlp: torch.nn.Module, weights: Weights) -> None:
    """Load the weights that :func:`layers_of` returned."""
    linear = [layer for layer in mlp.modules() if isinstance(layer, torch.nn.Linear)]
    for place, layer in enumerate(linear):
        layer.weight.data.copy_(torch.tensor(weights[f"layer{place}.weight"]))
        layer.bias.data.copy_(torch.tensor(weights[f"layer{place}.bias"]))


def memory_of(gru: torch.nn.GRU) -> dict[str, NDArray[np.float32]]:
    """Return the weights of a recurrent layer by the names of :meth:`NetworkConfig.shapes`."""
    return {f"memory.{name}": array_of(getattr(gru, its)) for name, its in _MEMORY.items()}


def array_of(tensor: torch.Tensor) -> NDArray[np.float32]:
    """Return a copy for NumPy, without gradients."""
    return tensor.detach().cpu().numpy().copy()


def _template(group: str, size: int) -> TensorDict:
    return TensorDict({group: torch.zeros(1, size)}, batch_size=[1])
