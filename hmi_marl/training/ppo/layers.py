"""Forward and backward passes of linear layers, written out.

Networks of 64 units are so small that autograd's bookkeeping and copies take a good part of the
learner's time. These passes work in place, and write gradients where they belong.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import torch
from rsl_rl.models import MLPModel  # type: ignore[import-untyped]

from hmi_marl.agents.learned.policy import INTENTS
from hmi_marl.training.ppo.gru import GRU
from hmi_marl.training.ppo.models import TwoSeats

_aten = torch.ops.aten
_ACTIVATIONS: dict[type[torch.nn.Module], tuple[Callable[..., object], Callable[..., object]]] = {
    torch.nn.ReLU: (torch.relu_, lambda g, y: _aten.threshold_backward(g, y, 0.0, grad_input=g)),
    torch.nn.Tanh: (torch.tanh_, lambda g, y: _aten.tanh_backward(g, y, grad_input=g)),
    torch.nn.ELU: (
        torch.nn.functional.elu_,
        lambda g, y: _aten.elu_backward(g, 1.0, 1.0, 1.0, True, y, grad_input=g),
    ),
}
"""Activations in place, and their backward passes in place: from dL/dy to dL/dx, given y."""


Passed = Sequence[Any]
"""What a forward pass leaves for the backward pass: tensors, or what each part leaves."""


class Layers:
    """Linear layers with an activation between them, of a network made by rsl_rl.

    Args:
        network: the layers. Their weights are shared, and must stay where they lie in memory.
    """

    def __init__(self, network: torch.nn.Module) -> None:
        layers = [layer for layer in network.modules() if not list(layer.children())]
        linear = [layer for layer in layers if isinstance(layer, torch.nn.Linear)]
        self._weights = [layer.weight.detach() for layer in linear]
        # How a layer is called: with the bias, and the weight turned.
        self._linear = [(layer.bias.detach(), layer.weight.detach().t()) for layer in linear]
        kind = type(layers[1]) if len(layers) > 1 else torch.nn.ReLU
        self._activate, self._activate_backward = _ACTIVATIONS[kind]

    def forward(self, inputs: torch.Tensor) -> list[torch.Tensor]:
        """Return the inputs of every layer, shape (N, units), and the outputs at last."""
        passed = [inputs]
        for bias, weight in self._linear[:-1]:
            passed.append(torch.addmm(bias, passed[-1], weight))
            self._activate(passed[-1])
        bias, weight = self._linear[-1]
        passed.append(torch.addmm(bias, passed[-1], weight))
        return passed

    def backward(
        self,
        passed: Passed,
        gradient: torch.Tensor,
        into: Sequence[torch.Tensor],
        of_inputs: bool = False,
    ) -> torch.Tensor:
        """Write the gradient of the loss with respect to the weights.

        Args:
            passed: what :meth:`forward` returned.
            gradient: gradient with respect to the outputs.
            into: tensors for the gradients of weight and bias of every layer, in their order.
            of_inputs: also return the gradient with respect to the inputs.
        """
        for place in reversed(range(len(self._linear))):
            torch.mm(gradient.t(), passed[place], out=into[2 * place])
            torch.sum(gradient, 0, out=into[2 * place + 1])
            if place > 0 or of_inputs:
                gradient = gradient.mm(self._weights[place])
            if place > 0:
                self._activate_backward(gradient, passed[place])
        return gradient


class Policy(Protocol):
    """Passes of an actor. Recorded steps have shape (N,), or (T, N) for a recurrent one."""

    def act(
        self, inputs: torch.Tensor, memory: torch.Tensor | None
    ) -> tuple[torch.Tensor, torch.Tensor | None]:
        """Return the logits in one step of N teams, and the new recurrent state.

        ``memory``, shape (N, units), is None at the start of an episode.
        """
        ...

    def forward(
        self, inputs: torch.Tensor, carried: torch.Tensor | None
    ) -> tuple[torch.Tensor, Passed]:
        """Return the logits of recorded steps, and what :meth:`backward` needs.

        ``carried``, shape (T, N), is 0 where a step begins another episode, else 1; only recurrent
        policies need it.
        """
        ...

    def backward(
        self, passed: Passed, gradient: torch.Tensor, into: Sequence[torch.Tensor]
    ) -> None:
        """Write the gradient for every weight, given that for the logits."""


def policy_of(actor: MLPModel) -> Policy:
    """Return the passes of an actor of either seat, or of both."""
    gru = actor.rnn.rnn if actor.is_recurrent else None
    if isinstance(actor.mlp, TwoSeats):
        return Composite(actor.mlp, gru)
    return _policy_of_seat(actor.mlp, gru)


def _policy_of_seat(layers: torch.nn.Module, gru: torch.nn.GRU | None) -> Policy:
    return Feedforward(layers) if gru is None else Recurrent(layers, gru)


class Feedforward:
    """:class:`Policy` of one seat."""

    def __init__(self, layers: torch.nn.Module) -> None:
        self._layers = Layers(layers)

    def act(
        self, inputs: torch.Tensor, memory: torch.Tensor | None
    ) -> tuple[torch.Tensor, torch.Tensor | None]:
        """See :meth:`Policy.act`."""
        return self._layers.forward(inputs)[-1], None

    def forward(
        self, inputs: torch.Tensor, carried: torch.Tensor | None
    ) -> tuple[torch.Tensor, Passed]:
        """See :meth:`Policy.forward`."""
        passed = self._layers.forward(inputs.flatten(0, -2))
        return passed[-1].view(*inputs.shape[:-1], -1), passed

    def backward(
        self, passed: Passed, gradient: torch.Tensor, into: Sequence[torch.Tensor]
    ) -> None:
        """See :meth:`Policy.backward`."""
        self._layers.backward(passed, gradient.flatten(0, -2), into)


class Composite:
    """:class:`Policy` of both seats, of which the vehicle AI's may have a GRU."""

    def __init__(self, seats: TwoSeats, gru: torch.nn.GRU | None) -> None:
        self._seats = seats
        self._driver = Feedforward(seats.driver)
        self._vehicle_ai = _policy_of_seat(seats.vehicle_ai, gru)
        self._weights = len(list(seats.driver.parameters()))

    def act(
        self, inputs: torch.Tensor, memory: torch.Tensor | None
    ) -> tuple[torch.Tensor, torch.Tensor | None]:
        """See :meth:`Policy.act`."""
        of_driver, of_vehicle_ai = self._seats.split(inputs)
        intents, _ = self._driver.act(of_driver, None)
        alerts, memory = self._vehicle_ai.act(of_vehicle_ai, memory)
        return torch.cat([intents, alerts], dim=-1), memory

    def forward(
        self, inputs: torch.Tensor, carried: torch.Tensor | None
    ) -> tuple[torch.Tensor, Passed]:
        """See :meth:`Policy.forward`."""
        of_driver, of_vehicle_ai = self._seats.split(inputs)
        intents, one = self._driver.forward(of_driver, None)
        alerts, other = self._vehicle_ai.forward(of_vehicle_ai, carried)
        return torch.cat([intents, alerts], dim=-1), (one, other)

    def backward(
        self, passed: Passed, gradient: torch.Tensor, into: Sequence[torch.Tensor]
    ) -> None:
        """See :meth:`Policy.backward`."""
        one, other = passed
        of_intents, of_alerts = gradient[..., :INTENTS], gradient[..., INTENTS:]
        self._driver.backward(one, of_intents, into[: self._weights])
        self._vehicle_ai.backward(other, of_alerts, into[self._weights :])


class Recurrent:
    """:class:`Policy` of a seat with a GRU."""

    def __init__(self, layers: torch.nn.Module, gru: torch.nn.GRU) -> None:
        self._layers, self._gru = Layers(layers), GRU(gru)
        self._weights = len(list(layers.parameters()))

    def act(
        self, inputs: torch.Tensor, memory: torch.Tensor | None
    ) -> tuple[torch.Tensor, torch.Tensor | None]:
        """See :meth:`Policy.act`."""
        memory = self._gru.step(inputs, memory)
        return self._layers.forward(torch.cat([memory, inputs], dim=-1))[-1], memory

    def forward(
        self, inputs: torch.Tensor, carried: torch.Tensor | None
    ) -> tuple[torch.Tensor, Passed]:
        """See :meth:`Policy.forward`."""
        assert carried is not None
        remembered, of_memory = self._gru.forward(inputs, carried)
        together = torch.cat([remembered, inputs], dim=-1)
        passed = self._layers.forward(together.flatten(0, 1))
        return torch.unflatten(passed[-1], 0, inputs.shape[:2]), (passed, of_memory)

    def backward(
        self, passed: Passed, gradient: torch.Tensor, into: Sequence[torch.Tensor]
    ) -> None:
        """See :meth:`Policy.backward`."""
        layers, of_memory = passed
        of_inputs = self._layers.backward(
            layers, gradient.flatten(0, 1), into[: self._weights], of_inputs=True
        )
        of_hidden = of_inputs[:, : self._gru.units].view(*gradient.shape[:2], -1)
        self._gru.backward(of_memory, of_hidden, into[self._weights :])
