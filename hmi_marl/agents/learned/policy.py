r"""Learned policies for either seat, and their files.

A :class:`PolicyCard` describes a policy except for its weights: the parts of its seat's observation
that it reads, by name; its conditioning; its network; and its training. So a policy that reads no
attention also works in an environment that shows it.

A vehicle AI's network either reads a^H_t and returns the logits of a^A, or, if both seats were
learned as one composite policy, returns the logits of a^A for every a^H (``by_intent``),
π(a^A | a^H, s), from which the row of the observed a^H_t is taken.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.agents.learned.cards import CardFormat, find_card
from hmi_marl.agents.learned.network import Network, NetworkConfig, Weights, below_zero
from hmi_marl.agents.memory import Draws
from hmi_marl.checks import Checked, UnitsOrZero, check_choice
from hmi_marl.envs.alerts import FULL, Strengths
from hmi_marl.envs.config import AGENTS, DRIVER, VEHICLE_AI, TeamConfig
from hmi_marl.envs.observations import COLUMN_NAMES, Layout, driver_layout, vehicle_ai_layout
from hmi_marl.envs.streams import Stream
from hmi_marl.envs.worlds import VEHICLE_ACTIONS
from hmi_marl.exact.intent_network import FeedForward

INTENT, TRAITS = "intended_action", "traits"
CONTEXT_OF = "context_of"
"""Key in a card's training: digest of the model that z comes from."""
INTENTS = len(VEHICLE_ACTIONS)
"""Number of the driver's actions."""
_LAYOUTS = {DRIVER: driver_layout, VEHICLE_AI: vehicle_ai_layout}
_STREAMS = {DRIVER: Stream.DRIVER_POLICY, VEHICLE_AI: Stream.HMI_POLICY}


def seat_layout(seat: str, config: TeamConfig) -> Layout:
    """Return the layout of the seat's observation in teams set up by ``config``."""
    return _LAYOUTS[seat](config)


@dataclass(frozen=True)
class PolicyCard(Checked):
    """Description of a learned policy, without its weights.

    Raises:
        ValueError: an unknown seat, or parts and sizes that make no policy.
    """

    seat: str
    """"driver" or "vehicle_ai"."""
    reads: tuple[tuple[str, int], ...]
    """Names and sizes of the parts of the observation that it reads, in their order."""
    network: NetworkConfig = field(default_factory=NetworkConfig)
    """Sizes of its network."""
    context: UnitsOrZero = 0
    """Z, size of the vector z that the policy is conditioned on; 0 for none."""
    by_intent: bool = False
    """Whether a vehicle AI's network returns logits for each a^H instead of reading a^H."""
    sequential: bool = True
    """Whether it was trained with sequential moves, so that the vehicle AI sees a^H_t."""
    alert_strengths: Strengths = FULL
    """Alerts that a vehicle AI can give; (1.0,) is alert or no alert."""
    training: dict[str, Any] = field(default_factory=dict)
    """How it was trained: version, configuration, protocol, seed, steps."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_choice("a policy's seat", self.seat, AGENTS)
        object.__setattr__(self, "reads", tuple((str(n), int(size)) for n, size in self.reads))
        if not self.reads or min(size for _, size in self.reads) < 1:
            raise ValueError("a policy reads parts of at least one column")
        if self.by_intent and (self.seat == DRIVER or INTENT in dict(self.reads)):
            raise ValueError("by_intent is for a vehicle AI that does not read intended_action")

    @property
    def inputs(self) -> int:
        """Number of input columns of the network."""
        return sum(size for _, size in self.reads) + self.context

    @property
    def actions(self) -> int:
        """Number of actions."""
        return INTENTS if self.seat == DRIVER else len(self.alert_strengths) + 1

    @property
    def outputs(self) -> int:
        """Number of logits of the network."""
        return self.actions * (INTENTS if self.by_intent else 1)

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Names and shapes of the weights."""
        return self.network.shapes(self.inputs, self.outputs)

    def reading(self, names: Sequence[str]) -> PolicyCard:
        """Return the card of a policy that reads only these parts.

        Raises:
            ValueError: this one does not read one of them; the message lists those it reads.
        """
        known = dict(self.reads)
        if unknown := [name for name in names if name not in known]:
            raise ValueError(f"no part {unknown[0]!r} to read; there are {', '.join(known)}")
        return replace(self, reads=tuple(read for read in self.reads if read[0] in names))

    def with_context(self, size: int) -> PolicyCard:
        """Return the card of a vehicle AI conditioned on z of this size instead of the traits."""
        if self.seat == DRIVER:
            return self
        traits = (TRAITS, *COLUMN_NAMES[TRAITS])
        reads = tuple((name, columns) for name, columns in self.reads if name not in traits)
        return replace(self, reads=reads, context=size)

    def columns(self, layout: Layout) -> NDArray[np.int64]:
        """Return the indices of the read columns in an observation.

        Raises:
            ValueError: the observation lacks a part, or has it in another size.
        """
        for name, size in self.reads:
            if name not in layout:
                raise ValueError(
                    f"this {self.seat} policy reads {name!r}, which the {self.seat}'s observation "
                    f"does not show here{_HINTS.get(name, '')}"
                )
            shown = layout[name].stop - layout[name].start
            if shown != size:
                raise ValueError(
                    f"this {self.seat} policy reads {size} columns of {name!r}, but here it has "
                    f"{shown}; use the scene that it was trained on"
                )
        return layout.columns(name for name, _ in self.reads)


def make_card(
    seat: str,
    config: TeamConfig,
    network: NetworkConfig,
    knows_traits: bool | Sequence[str],
    context: int = 0,
    by_intent: bool = False,
    sequential: bool = True,
) -> PolicyCard:
    """Make the card of a policy that reads its seat's observation.

    Args:
        seat, config: the seat, and settings of the teams.
        network: sizes of the network.
        knows_traits: whether it reads the driver's traits, or the names of those that it reads.
        context, by_intent, sequential: see :class:`PolicyCard`.

    Raises:
        ValueError: no such trait.
    """
    names = (TRAITS,) if knows_traits is True else tuple(knows_traits or ())
    for name in names:
        check_choice("a policy reads", name, (TRAITS, *COLUMN_NAMES[TRAITS]))
    reads: list[tuple[str, int]] = []
    for part in seat_layout(seat, config).parts:
        if part.name == TRAITS:
            reads += [(name, part.size if name == TRAITS else 1) for name in names]
        elif not (by_intent and part.name == INTENT):
            reads.append((part.name, part.size))
    strengths = config.alert_strengths if seat == VEHICLE_AI else FULL
    return PolicyCard(seat, tuple(reads), network, context, by_intent, sequential, strengths)


_HINTS = {
    **dict.fromkeys((TRAITS, *COLUMN_NAMES[TRAITS]), " (observe_traits=False hides it)"),
    "distracted": " (ai_sees_attention=False hides it)",
    "fatigue": " (only with fatigue=, and unless ai_sees_attention=False hides it)",
}


FORMAT = CardFormat("hmi-marl policy 3", "policy", PolicyCard)
"""Files of a policy: a card and weights for each seat."""


class LearnedPolicy:
    """A learned policy; weights as in ``card.shapes``.

    It takes the likeliest action if ``greedy``, else draws it from the episode's seed and the step.

    Raises:
        ValueError: weights that do not fit the card, or observations that lack what it reads.
    """

    def __init__(
        self, card: PolicyCard, weights: Weights, config: TeamConfig, greedy: bool = True
    ) -> None:
        FORMAT.check(card, weights)
        if card.seat == VEHICLE_AI and card.alert_strengths != config.alert_strengths:
            raise ValueError(
                f"this vehicle_ai policy gives alerts of strengths {card.alert_strengths}, but "
                f"here alert_strengths = {config.alert_strengths}"
            )
        self.card, self.weights, self.greedy = card, weights, greedy
        self._layout = seat_layout(card.seat, config)
        self._columns = card.columns(self._layout)
        self._network = Network(card.network, weights)
        self._draws = Draws(_STREAMS[card.seat])
        self._context: NDArray[np.float32] | None = None

    @property
    def reads(self) -> tuple[str, ...]:
        """Parts of the observation that it reads."""
        return (*dict(self.card.reads), *((INTENT,) if self.card.by_intent else ()))

    @property
    def sequential(self) -> bool:
        """Whether a vehicle AI expects to see a^H_t rather than a^H_{t-1}."""
        return self.card.sequential

    @property
    def context(self) -> NDArray[np.float32] | None:
        """Vector z, shape (Z,) for all teams or (N, Z); must be set if the policy reads it.

        Raises:
            ValueError: another shape, or numbers that are not finite.
        """
        return None if self._context is None else self._context.copy()

    @context.setter
    def context(self, z: ArrayLike) -> None:
        values = np.array(z, np.float32)
        if values.ndim not in (1, 2) or values.shape[-1] != self.card.context:
            raise ValueError(
                f"this policy takes a vector z of size {self.card.context}, but got an array of "
                f"shape {values.shape}"
            )
        if not np.isfinite(values).all():
            raise ValueError("a vector z is finite everywhere")
        self._context = values

    def reset(self, seeds: NDArray[np.uint64], which: NDArray[np.bool_] | None = None) -> None:
        """See :meth:`Policy.reset`."""
        self._network.forget(len(seeds), which)
        self._draws.reset(seeds, which)

    def act(self, observations: NDArray[np.float32]) -> NDArray[np.int64]:
        """See :meth:`Policy.act`."""
        probabilities = self.probabilities(observations)
        if self.greedy:
            return probabilities.argmax(axis=1)
        below = np.cumsum(probabilities, axis=1)[:, :-1]
        return (self._draws.next()[:, None] >= below).sum(axis=1)

    def probabilities(self, observations: NDArray[np.float32]) -> NDArray[np.float64]:
        """Return π(a | observation), shape (N, actions), and update the recurrent state.

        Raises:
            FloatingPointError: the logits are not finite, so no action follows from them.
            RuntimeError: the policy is conditioned on z, and none has been set.
        """
        inputs = observations[:, self._columns]
        if self.card.context:
            if self._context is None:
                raise RuntimeError("this policy is conditioned on a vector z: set policy.context")
            z = np.broadcast_to(self._context, (len(inputs), self.card.context))
            inputs = np.concatenate([inputs, z], axis=1)
        logits = self._network(inputs)
        if self.card.by_intent:
            intent = self._layout.get(observations, INTENT)  # one-hot; zeros (equal odds) if none
            logits = logits.reshape(len(logits), INTENTS, -1)
            logits = (logits * intent[:, :, None]).sum(axis=1)
        odds = np.exp(below_zero(logits))
        return odds / odds.sum(axis=1, keepdims=True)

    def feedforward(self) -> FeedForward | None:
        """Describe the network, for loops that compute the probabilities of many candidates.

        Returns:
            None if the probabilities do not follow from a feed-forward network and the present
            observation alone.
        """
        own = type(self).probabilities is LearnedPolicy.probabilities
        if not own or self.card.context or self.card.by_intent or self.card.network.rnn_hidden_dim:
            return None
        layers = tuple(
            (
                self.weights[f"layer{k}.weight"].astype(np.float64),
                self.weights[f"layer{k}.bias"].astype(np.float64),
            )
            for k in range(len(self.card.network.hidden_dims) + 1)
        )
        return FeedForward(self._columns, layers, self.card.network.activation)


def save_policy(folder: Path, card: PolicyCard, weights: Weights) -> Path:
    """Write ``<seat>.safetensors`` and ``<seat>.json`` into ``folder``; return the latter.

    Raises:
        ValueError: weights that do not fit the card.
    """
    return FORMAT.save(folder / f"{card.seat}.json", card, weights)


def find_policy(place: str | Path, seat: str) -> Path:
    """Return the path of the card of a seat's policy; see :func:`find_card`.

    Raises:
        FileNotFoundError: there is none; the message says for which seats there is one.
    """
    there = [agent for agent in AGENTS if (Path(place) / f"{agent}.json").is_file()]
    hint = f"; it holds one for {' and '.join(there)}" if there else ""
    return find_card(place, seat, f"policy for the seat of {seat}", hint)


def read_policy(path: Path) -> tuple[PolicyCard, dict[str, NDArray[np.float32]]]:
    """Return a policy's card and weights; see :meth:`CardFormat.read`."""
    return FORMAT.read(path)


def load_policy(
    place: str | Path, seat: str, config: TeamConfig, greedy: bool = True
) -> LearnedPolicy:
    """Load a seat's policy from the folder of a run, a policy's ``.json``, or ``trained:NAME``.

    Raises:
        FileNotFoundError, ValueError: see :func:`find_policy` and :meth:`CardFormat.read`; also a
            policy for the other seat, or one that reads what is not shown here.
    """
    path = find_policy(place, seat)
    card, weights = read_policy(path)
    if card.seat != seat:
        raise ValueError(f"{path} is a policy for the seat of {card.seat}, not of {seat}")
    try:
        return LearnedPolicy(card, weights, config, greedy)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
