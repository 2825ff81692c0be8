r"""Learned evidence about the driver from each turn, for any candidate traits.

An encoder reads the turns of a trip and returns a vector e_t for each; another network maps every
driver θ = (β, α, η, inflation) to a vector w(θ) in the same latent space. The evidence is

.. math::
    \log p(\text{turn}_t | \text{turns before}, θ) \approx e_t \cdot w(θ) + \text{const}

and that of several windows of one driver is their sum: given the driver, windows are independent,
so they are pooled by adding e_t. The encoder's recurrent state is reset every ``segment`` turns, so
that a previous driver is soon forgotten. For the attention chain alone such a sum is exact: e_t
would count events and w(θ) hold the logarithms of β, 1 - β, β - η ...

It reads the vehicle AI's observation, including a^H_t, and learns from drives with known traits
(:mod:`hmi_marl.training.evidence`). So it also uses driving style, which the exact evidence of the
chain does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.learned.cards import CardFormat, checked_reads, find_card, part_shapes
from hmi_marl.agents.learned.network import Network, NetworkConfig, Weights, part_of
from hmi_marl.agents.learned.situations import LONG_AGO
from hmi_marl.checks import Checked, Count, Units
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import TRAIT_NAMES, Driver, Traits
from hmi_marl.envs.observations import Layout, traits_part, vehicle_ai_layout
from hmi_marl.envs.team_step import NO_ACTION
from hmi_marl.envs.worlds import VEHICLE_ACTIONS
from hmi_marl.exact.bayes_filter import check_candidates
from hmi_marl.files import sha256

READS = ("intended_action", "previous_intended_action", "applied_action")
"""Parts of the vehicle AI's observation that an encoder reads by default: intended and applied
actions. Lidar and speed would improve the estimate of inflation and worsen those of β, α and η."""
HIDDEN = ("traits", *TRAIT_NAMES, "distracted", "accepted", "counter", "fatigue")
"""Observation parts, and columns with names of their own, hidden from driver inference."""
_ACTIONS = len(VEHICLE_ACTIONS)
_SINCE = LONG_AGO + 1
DERIVED = _ACTIONS + 3 * _SINCE
"""Columns in addition to the read parts: one-hot v_{t-2}; one-hot steps from the last alert to step
t - 1, and the same where that step revealed an attentive driver or a distracted one."""


@dataclass(frozen=True)
class EvidenceCard(Checked):
    """Description of an evidence model, without its weights.

    Raises:
        ValueError: sizes that make no model.
    """

    reads: tuple[tuple[str, int], ...]
    """Names and sizes of the parts of the vehicle AI's observation that it reads, in order."""
    latent: Units = 16
    """Z, size of e_t and w(θ)."""
    segment: Count = 25
    """Turns after which the encoder's recurrent state is reset."""
    encoder: NetworkConfig = field(default_factory=lambda: NetworkConfig((64,), rnn_hidden_dim=48))
    """Network from turns to e_t."""
    place: NetworkConfig = field(default_factory=lambda: NetworkConfig((64, 64)))
    """Network from traits to w."""
    training: dict[str, Any] = field(default_factory=dict)
    """How it was trained."""

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "reads", checked_reads(self.reads, "an evidence model"))
        for name, _ in self.reads:
            if name in HIDDEN:
                raise ValueError(
                    f"an evidence model may not read {name!r}: driver inference hides it"
                )
        if self.place.rnn_hidden_dim:
            raise ValueError("only the encoder may be recurrent: set place.rnn_hidden_dim to 0")

    @classmethod
    def for_team(
        cls, config: TeamConfig, names: Sequence[str] = READS, **sizes: Any
    ) -> EvidenceCard:
        """Make the card of a model that reads these parts in teams set up by ``config``.

        Raises:
            ValueError: a part that is not in the vehicle AI's observation.
        """
        layout = vehicle_ai_layout(config)
        if unknown := [name for name in names if name not in layout]:
            raise ValueError(
                f"no part {unknown[0]!r} to read; there are {', '.join(layout.slices)}"
            )
        return cls(tuple((n, layout[n].stop - layout[n].start) for n in names), **sizes)

    @property
    def read_size(self) -> int:
        """Number of columns of an observation that it reads."""
        return sum(size for _, size in self.reads)

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Names and shapes of the weights."""
        sizes = {
            "encoder": (self.read_size + DERIVED, self.latent),
            "place": (len(TRAIT_NAMES), self.latent),
        }
        units = {"read.centre": (self.read_size,), "read.scale": (self.read_size,)}
        return units | part_shapes(self, sizes)


FORMAT = CardFormat("hmi-marl evidence 3", "evidence model", EvidenceCard)
NAME = "evidence.json"
"""File name of the card; the weights are in ``evidence.safetensors`` next to it."""


class Turns:
    """Build the encoder's inputs for N trips from the vehicle AI's observations.

    The parts named in ``reads`` are read unchanged.
    """

    def __init__(self, reads: Sequence[str], layout: Layout) -> None:
        self._layout = layout
        self._columns = layout.columns(reads)
        self.reset(1)

    def reset(self, count: int) -> None:
        """Begin trips of ``count`` teams."""
        self._applied_before = np.full(count, NO_ACTION)
        self._since = np.full(count, LONG_AGO)

    def begin(self, which: NDArray[np.bool_]) -> None:
        """Begin new trips where ``which``, shape (N,), is set."""
        self._applied_before = np.where(which, NO_ACTION, self._applied_before)
        self._since = np.where(which, LONG_AGO, self._since)

    def read(
        self, observations: NDArray[np.float32], new: NDArray[np.bool_]
    ) -> NDArray[np.float32]:
        """Return the inputs of this turn, shape (N, columns read + DERIVED).

        Observations have shape (N, D). ``new``, shape (N,), marks the turns to remember.
        """
        layout = self._layout
        applied = layout.chosen(observations, "applied_action")
        intended = layout.chosen(observations, "previous_intended_action")
        alerted = layout.scalar(observations, "alerted") > 0
        since = np.where(alerted, 0, np.minimum(self._since + 1, LONG_AGO))
        before = self._applied_before
        shows = (before != NO_ACTION) & (intended != before)
        ago = since[:, None] == np.arange(_SINCE)
        derived = [
            before[:, None] == np.arange(_ACTIONS),
            ago,
            ago & (shows & (applied != before))[:, None],
            ago & (shows & (applied == before))[:, None],
        ]
        self._since = np.where(new, since, self._since)
        self._applied_before = np.where(new, applied, self._applied_before)
        return np.concatenate([observations[:, self._columns], *derived], axis=1, dtype=np.float32)


class EvidenceModel:
    """Learned encoder and network of latent vectors; weights as in ``card.shapes``.

    Raises:
        ValueError: weights that do not fit the card.
    """

    def __init__(self, card: EvidenceCard, weights: Weights) -> None:
        FORMAT.check(card, weights)
        self.card, self.weights = card, weights
        self._place = Network(card.place, part_of(weights, "place"))

    @property
    def digest(self) -> str:
        """SHA-256 checksum of the weights, which identifies the latent space."""
        arrays = (np.asarray(self.weights[n], np.float32, order="C") for n in self.card.shapes)
        return sha256(b"".join(array.tobytes() for array in arrays))

    def encoder(self) -> Network:
        """Return an encoder with a separate recurrent state."""
        return Network(self.card.encoder, part_of(self.weights, "encoder"))

    def standardise(self, turns: NDArray[np.float32]) -> NDArray[np.float32]:
        """Standardise the read columns of turns (N, columns) by the training drives."""
        out = turns.copy()
        size = self.card.read_size
        out[:, :size] = (out[:, :size] - self.weights["read.centre"]) / self.weights["read.scale"]
        return out

    def places(self, traits: Traits) -> NDArray[np.float64]:
        """Return w of K drivers, shape (K, Z)."""
        return self._place(traits_part(traits).astype(np.float32))


def save_evidence(folder: Path, card: EvidenceCard, weights: Weights) -> Path:
    """Write an evidence model into ``folder``; return the path of its card.

    Raises:
        ValueError: weights that do not fit the card.
    """
    return FORMAT.save(folder / NAME, card, weights)


def load_evidence(place: str | Path) -> EvidenceModel:
    """Load an evidence model from the folder of a run, the ``.json`` itself, or ``trained:NAME``.

    Raises:
        FileNotFoundError, ValueError: see :func:`find_card` and :meth:`CardFormat.read`.
    """
    hint = "; learn one with hmi-marl reproduce adapt"
    return EvidenceModel(*FORMAT.read(find_card(place, "evidence", "evidence model", hint)))


class LearnedEvidence:
    """Evidence for K candidates by a learned model; see :class:`Evidence`.

    Raises:
        ValueError: no candidates, or teams with other observations than the model reads.
    """

    def __init__(
        self, model: EvidenceModel, drivers: Sequence[str | Driver], config: TeamConfig
    ) -> None:
        self.drivers = check_candidates(drivers)
        self.model = model
        names = [name for name, _ in model.card.reads]
        if EvidenceCard.for_team(config, names).reads != model.card.reads:
            raise ValueError(
                "this evidence model reads other columns than these teams show; use the scene that "
                "it was trained in"
            )
        self._turns = Turns(names, vehicle_ai_layout(config))
        self._encoder = model.encoder()
        self.places = model.places(Traits.of(self.drivers))
        """Vectors w of the candidates, shape (K, Z)."""
        self.reset(1)

    def reset(self, count: int) -> None:
        """See :meth:`Evidence.reset`."""
        self._turns.reset(count)
        self._encoder.forget(count)
        self._read = np.zeros(count, np.int64)  # turns of the current trip

    def begin(self, which: NDArray[np.bool_]) -> None:
        """See :meth:`Evidence.begin`."""
        self._turns.begin(which)
        self._encoder.forget(len(which), which)
        self._read = np.where(which, 0, self._read)

    def observe(
        self, observations: NDArray[np.float32], new: NDArray[np.bool_]
    ) -> NDArray[np.float64]:
        """See :meth:`Evidence.observe`."""
        turns = self.model.standardise(self._turns.read(observations, new))
        self._encoder.forget(len(new), new & (self._read % self.model.card.segment == 0))
        self._read = self._read + new
        gains = self._encoder(turns, new) @ self.places.T
        return np.where(new[:, None], gains, 0.0)
