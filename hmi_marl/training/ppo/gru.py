"""Forward and backward passes of a recurrent layer (GRU), written out.

For layers of some 32 units over episodes of a hundred steps a large part of autograd's time is
bookkeeping (``benchmarks/recurrent.py`` compares). Here a step back through time is four calls,
since the derivatives of the gates are computed for all steps at once. With 64 units and 256 teams
in a mini-batch, or more, torch's own layer is the faster one. Arrays have the teams last, so that
the gates of a step lie side by side in memory.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch


@dataclass(frozen=True)
class PassedMemory:
    """What a forward pass leaves for the backward pass; shape (T, units, N) unless said."""

    inputs: torch.Tensor
    """Inputs, shape (T, N, columns)."""
    before: torch.Tensor
    """State that each step began with."""
    reset: torch.Tensor
    """Gate r."""
    update: torch.Tensor
    """Gate z."""
    new: torch.Tensor
    """Candidate n for the state after the step."""
    new_by_memory: torch.Tensor
    """U_n h + c_n, the candidate's part that r weighs."""
    carried: Sequence[torch.Tensor | None]
    """For each step 1 for teams whose state it was given, 0 for those that began another episode,
    shape (N,); None where all went on."""


class GRU:
    r"""A recurrent layer that is shared with a module of torch.

    With r and z the gates, x the inputs and h the state before:

    .. math::
        r &= σ(W_r x + b_r + U_r h + c_r), \quad z = σ(W_z x + b_z + U_z h + c_z) \\
        n &= \tanh(W_n x + b_n + r (U_n h + c_n)), \quad h' = (1 - z) n + z h

    Args:
        module: its weights are shared, and must stay where they lie in memory.
    """

    def __init__(self, module: torch.nn.GRU) -> None:
        weights = [weight.detach() for weight in module.parameters()]
        self._input_weight, self._memory_weight, input_bias, memory_bias = weights
        self._input_bias, self._memory_bias = input_bias[:, None], memory_bias[:, None]
        self.units = module.hidden_size

    def step(self, inputs: torch.Tensor, memory: torch.Tensor | None) -> torch.Tensor:
        """Return the state after one step of N teams, shape (N, units); None for a state of 0."""
        if memory is None:
            memory = inputs.new_zeros(len(inputs), self.units)
        before = memory.t()
        given = torch.addmm(self._input_bias, self._input_weight, inputs.t())
        known = torch.addmm(self._memory_bias, self._memory_weight, before)
        return self._advance(self._parts(given), self._parts(known), before).t()

    def _parts(self, values: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return the part of both gates, of the reset gate alone, and of the candidate."""
        units = self.units
        return (
            values[..., : 2 * units, :],
            values[..., :units, :],
            values[..., 2 * units :, :],
        )

    def _advance(
        self,
        given: Sequence[torch.Tensor],
        known: Sequence[torch.Tensor],
        before: torch.Tensor,
        into: torch.Tensor | None = None,
    ) -> torch.Tensor:
        """Turn the parts that come from the inputs into gates and candidate; return h'."""
        gates, reset, new = given
        gates.add_(known[0]).sigmoid_()
        new.addcmul_(reset, known[2]).tanh_()
        return torch.lerp(new, before, gates[self.units :], out=into)

    def forward(
        self, inputs: torch.Tensor, carried: torch.Tensor
    ) -> tuple[torch.Tensor, PassedMemory]:
        """Go through T steps of N teams, and return the states after them, (T, N, units).

        Args:
            inputs: shape (T, N, columns).
            carried: shape (T, N), 0 where a step begins with a state of 0, as every episode's first
                does, and else 1.
        """
        steps, teams = inputs.shape[:2]
        weights = self._input_weight.expand(steps, -1, -1)
        given = torch.baddbmm(self._input_bias, weights, inputs.transpose(1, 2))
        known = self._memory_bias.expand(steps, -1, teams)
        known = known.clone(memory_format=torch.contiguous_format)  # which products are added to
        hidden = given.new_empty(steps, self.units, teams)
        whole = (carried != 0).all(1).tolist()
        carries = [
            None if all_go_on else carry for all_go_on, carry in zip(whole, carried, strict=True)
        ]
        before = torch.zeros_like(hidden[0])
        each = zip(
            zip(*(part.unbind() for part in self._parts(given)), strict=True),
            zip(*(part.unbind() for part in self._parts(known)), strict=True),
            known.unbind(),
            hidden.unbind(),
            carries,
            strict=True,
        )
        for of_inputs, of_memory, product, after, carry in each:
            if carry is not None:
                before = before * carry
            product.addmm_(self._memory_weight, before)
            before = self._advance(of_inputs, of_memory, before, after)
        units, first = self.units, torch.zeros_like(hidden[:1])
        passed = PassedMemory(
            inputs=inputs,
            before=torch.cat([first, hidden[:-1]]).mul_(carried[:, None]),
            reset=given[:, :units],
            update=given[:, units : 2 * units],
            new=given[:, 2 * units :],
            new_by_memory=known[:, 2 * units :],
            carried=carries,
        )
        return hidden.transpose(1, 2), passed

    def backward(
        self, passed: PassedMemory, of_hidden: torch.Tensor, into: Sequence[torch.Tensor]
    ) -> None:
        """Write the gradient of the loss with respect to the weights.

        Args:
            passed: what :meth:`forward` left.
            of_hidden: gradient with respect to the states that others read, shape (T, N, units).
            into: tensors for the gradients, in the order of the module's parameters.
        """
        steps, teams, units = of_hidden.shape
        reset, update, new = passed.reset, passed.update, passed.new
        # Derivatives of the state after a step with respect to what enters tanh, the reset gate,
        # the update gate, and U_n h + c_n.
        derivatives = new.new_empty(4, units, steps, teams)
        by_new, by_reset, by_update, by_memory = derivatives.transpose(1, 2).unbind()
        torch.mul(1.0 - update, 1.0 - new.square(), out=by_new)
        torch.mul(by_new, passed.new_by_memory * reset * (1.0 - reset), out=by_reset)
        torch.mul(passed.before - new, update * (1.0 - update), out=by_update)
        torch.mul(by_new, reset, out=by_memory)
        # Gradients of the loss with respect to the same.
        gradients = torch.empty_like(derivatives)
        of_memory = gradients.view(4 * units, steps, teams)[units:]
        back, of_state = self._memory_weight.t(), torch.zeros_like(new[0])
        each = zip(
            of_hidden.transpose(1, 2).contiguous().unbind(),
            derivatives.unbind(2),
            gradients.unbind(2),
            of_memory.unbind(1),
            update.unbind(),
            passed.carried,
            strict=True,
        )
        for of_output, derivative, gradient, through_memory, z, carry in reversed(list(each)):
            of_state += of_output
            torch.mul(of_state, derivative, out=gradient)
            of_state.mul_(z).addmm_(back, through_memory)
            if carry is not None:
                of_state.mul_(carry)
        rows = gradients.view(4 * units, -1)
        new_rows, gate_rows, memory_rows = rows[:units], rows[units : 3 * units], rows[units:]
        inputs, before = passed.inputs.flatten(0, 1), passed.before.transpose(0, 1)
        of_input_weight, of_memory_weight, of_input_bias, of_memory_bias = into
        for part, of in ((gate_rows, slice(0, 2 * units)), (new_rows, slice(2 * units, None))):
            torch.mm(part, inputs, out=of_input_weight[of])
            torch.sum(part, 1, out=of_input_bias[of])
        torch.mm(memory_rows, before.reshape(units, -1).t(), out=of_memory_weight)
        torch.sum(memory_rows, 1, out=of_memory_bias)
