r"""Learned evidence about the driver from each turn, for any candidate traits.

The context encoder of a trait model (:mod:`hmi_marl.agents.learned.trait_encoder`) reads the trip
under way; its features w_t of the last steps, what z follows from, and what only the vehicle AI's
seat shows, a^H_t, are read by a small network that returns a vector e_t for each turn. Another
network maps every driver θ = (β, α, η, inflation) to a vector w(θ) in the same space. The evidence
is

.. math::
    \log p(\text{turn}_t | \text{turns before}, θ) \approx e_t \cdot w(θ) + \text{const}

and that of several windows of one driver is their sum: given the driver, windows are independent,
so they are pooled by adding e_t. For the attention chain alone such a sum is exact: e_t would count
events and w(θ) hold the logarithms of β, 1 - β, β - η ... A third network maps every driver to the
z that the encoder gives for a window of theirs on average, so that a belief about drivers is a
belief about z.

It learns from drives with known traits (:mod:`hmi_marl.training.evidence`); the encoder stays as it
is. No trait, and nothing of d, is an input.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.adaptive.trip_encoder import TripEncoder
from hmi_marl.agents.learned.cards import CardFormat, checked_reads, find_card
from hmi_marl.agents.learned.network import (
    Network,
    NetworkConfig,
    Weights,
    digest_of,
    part_of,
    part_shapes,
)
from hmi_marl.agents.learned.situations import LONG_AGO
from hmi_marl.agents.learned.trait_model import TraitModel
from hmi_marl.checks import Checked, Units
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import TRAIT_NAMES, Driver, Traits
from hmi_marl.envs.observations import Layout, traits_part, vehicle_ai_layout
from hmi_marl.envs.team_step import NO_ACTION
from hmi_marl.envs.worlds import VEHICLE_ACTIONS
from hmi_marl.exact.bayes_filter import check_candidates

READS = ("intended_action", "previous_intended_action", "applied_action")
"""Parts of the vehicle AI's observation that are read by default, besides the encoder's features:
intended and applied actions."""
HIDDEN = ("traits", *TRAIT_NAMES, "distracted", "accepted", "counter", "fatigue")
"""Observation parts, and columns with names of their own, hidden from driver inference."""
_ACTIONS = len(VEHICLE_ACTIONS)
_SINCE = LONG_AGO + 1
DERIVED = _ACTIONS + 5 * _SINCE
"""Columns in addition to the read parts: one-hot v_{t-2}; one-hot steps from the last alert to step
t - 1, and the same where that step revealed a distracted driver or an attentive one; one-hot steps
from the last step before it that revealed attention, if it showed distraction, and if not."""


@dataclass(frozen=True)
class EvidenceCard(Checked):
    """Description of an evidence model, without its weights.

    Raises:
        ValueError: sizes that make no model.
    """

    reads: tuple[tuple[str, int], ...]
    """Names and sizes of the parts of the vehicle AI's observation that it reads, in order."""
    encoder: str
    """Digest of the trait model whose encoder it reads; see :attr:`TraitModel.digest`."""
    features: Units
    """Features of that encoder."""
    context: Units
    """Z, size of that encoder's z."""
    latent: Units = 16
    """Size of e_t and w(θ)."""
    reader: NetworkConfig = field(default_factory=lambda: NetworkConfig((64,)))
    """Network from turns to e_t."""
    place: NetworkConfig = field(default_factory=lambda: NetworkConfig((64, 64)))
    """Network from traits to w."""
    expected: NetworkConfig = field(default_factory=lambda: NetworkConfig((64, 64)))
    """Network from traits to the expected z."""
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
        for name in ("reader", "place", "expected"):
            if getattr(self, name).rnn_hidden_dim:
                raise ValueError(
                    f"an evidence model has no recurrent layer: set {name}.rnn_hidden_dim to 0"
                )

    @classmethod
    def for_team(
        cls, config: TeamConfig, traits: TraitModel, names: Sequence[str] = READS, **sizes: Any
    ) -> EvidenceCard:
        """Make the card of a model that reads these parts in teams set up by ``config``.

        Args:
            config: settings of the teams.
            traits: the trait model whose encoder it reads.
            names: parts of the vehicle AI's observation.
            sizes: other fields of the card.

        Raises:
            ValueError: a part that is not in the vehicle AI's observation.
        """
        card = traits.card
        of_encoder = traits.digest, card.encoder.features, card.latent
        return cls(parts_shown(config, names), *of_encoder, **sizes)

    @property
    def read_size(self) -> int:
        """Number of columns of an observation that it reads."""
        return sum(size for _, size in self.reads)

    @property
    def standardised(self) -> int:
        """Number of input columns, the first ones, that are in units of the training drives."""
        return self.features + self.read_size

    @property
    def inputs(self) -> int:
        """Number of input columns: features of the encoder, read parts, derived columns."""
        return self.standardised + DERIVED

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Names and shapes of the weights."""
        sizes = {
            "reader": (self.inputs, self.latent),
            "place": (len(TRAIT_NAMES), self.latent),
            "expected": (len(TRAIT_NAMES), self.context),
        }
        columns = (self.standardised,)
        units = {"read.centre": columns, "read.scale": columns}
        return units | part_shapes(self, sizes)


def parts_shown(config: TeamConfig, names: Sequence[str]) -> tuple[tuple[str, int], ...]:
    """Return names and sizes of parts of the vehicle AI's observation.

    Raises:
        ValueError: a part that it does not have.
    """
    layout = vehicle_ai_layout(config)
    if unknown := [name for name in names if name not in layout]:
        raise ValueError(f"no part {unknown[0]!r} to read; there are {', '.join(layout.slices)}")
    return tuple((name, layout[name].stop - layout[name].start) for name in names)


FORMAT = CardFormat("hmi-marl evidence 4", "evidence model", EvidenceCard)
NAME = "evidence.json"
"""File name of the card; the weights are in ``evidence.safetensors`` next to it."""


class Turns:
    """Build a model's inputs, but for the encoder's features, from the vehicle AI's observations.

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
        self._shown_ago = np.full(count, LONG_AGO)
        self._showed = np.zeros(count, np.bool_)

    def begin(self, which: NDArray[np.bool_]) -> None:
        """Begin new trips where ``which``, shape (N,), is set."""
        self._applied_before = np.where(which, NO_ACTION, self._applied_before)
        self._since = np.where(which, LONG_AGO, self._since)
        self._shown_ago = np.where(which, LONG_AGO, self._shown_ago)
        self._showed = np.where(which, False, self._showed)

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
        distracted = shows & (applied == before)
        ago = since[:, None] == np.arange(_SINCE)
        shown_ago = self._shown_ago[:, None] == np.arange(_SINCE)
        derived = [
            before[:, None] == np.arange(_ACTIONS),
            ago,
            ago & (shows & (applied != before))[:, None],
            ago & distracted[:, None],
            shown_ago & self._showed[:, None],
            shown_ago & ~self._showed[:, None],
        ]
        self._since = np.where(new, since, self._since)
        self._applied_before = np.where(new, applied, self._applied_before)
        later = np.where(shows, 0, np.minimum(self._shown_ago + 1, LONG_AGO))
        self._shown_ago = np.where(new, later, self._shown_ago)
        self._showed = np.where(new & shows, distracted, self._showed)
        return np.concatenate([observations[:, self._columns], *derived], axis=1, dtype=np.float32)


class EvidenceModel:
    """Learned networks of evidence; weights as in ``card.shapes``.

    Raises:
        ValueError: weights that do not fit the card.
    """

    def __init__(self, card: EvidenceCard, weights: Weights) -> None:
        FORMAT.check(card, weights)
        self.card, self.weights = card, weights
        self._reader, self._place, self._expected = (
            Network(getattr(card, part), part_of(weights, part))
            for part in ("reader", "place", "expected")
        )

    @property
    def digest(self) -> str:
        """SHA-256 checksum of the weights."""
        return digest_of(self.weights, self.card.shapes)

    def read(self, turns: NDArray[np.float32]) -> NDArray[np.float64]:
        """Return e_t, shape (N, latent), of turns, shape (N, ``card.inputs``)."""
        return self._reader(self.standardise(turns))

    def standardise(self, turns: NDArray[np.float32]) -> NDArray[np.float32]:
        """Standardise features and read columns of turns (N, columns) by the training drives."""
        out = turns.copy()
        size = self.card.standardised
        out[:, :size] = (out[:, :size] - self.weights["read.centre"]) / self.weights["read.scale"]
        return out

    def places(self, traits: Traits) -> NDArray[np.float64]:
        """Return w of K drivers, shape (K, latent)."""
        return self._place(traits_part(traits).astype(np.float32))

    def expected(self, traits: Traits) -> NDArray[np.float64]:
        """Return the z that a window of each of K drivers has on average, shape (K, Z)."""
        return self._expected(traits_part(traits).astype(np.float32))

    def check_encoder(self, traits: TraitModel) -> None:
        """Raise ``ValueError`` unless it has learned to read the encoder of this trait model."""
        if traits.digest != self.card.encoder:
            raise ValueError(
                "this evidence model reads the encoder of another trait model; name the one that "
                "it was trained with, or learn it anew with hmi-marl reproduce adapt"
            )


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

    Args:
        model: the evidence model.
        traits: the trait model whose encoder it reads.
        drivers: the candidates.
        config: settings of the teams.

    Raises:
        ValueError: no candidates, another trait model than the evidence model has learned to read,
            or teams with other observations than the models read.
    """

    def __init__(
        self,
        model: EvidenceModel,
        traits: TraitModel,
        drivers: Sequence[str | Driver],
        config: TeamConfig,
    ) -> None:
        self.drivers = check_candidates(drivers)
        self.model = model
        model.check_encoder(traits)
        names = [name for name, _ in model.card.reads]
        if parts_shown(config, names) != model.card.reads:
            raise ValueError(
                "this evidence model reads other columns than these teams show; use the scene that "
                "it was trained in"
            )
        self.encoder = TripEncoder(traits, config)
        """The trips so far, from which z follows."""
        self._turns = Turns(names, vehicle_ai_layout(config))
        self.places = model.places(Traits.of(self.drivers))
        """Vectors w of the candidates, shape (K, latent)."""
        self.reset(1)

    def reset(self, count: int, which: NDArray[np.bool_] | None = None) -> None:
        """See :meth:`Evidence.reset`."""
        self.encoder.reset(count, which)
        if which is None:
            self._turns.reset(count)
        else:
            self._turns.begin(which)

    def begin(self, which: NDArray[np.bool_]) -> None:
        """See :meth:`Evidence.begin`."""
        self.encoder.begin(which)
        self._turns.begin(which)

    def observe(
        self, observations: NDArray[np.float32], new: NDArray[np.bool_]
    ) -> NDArray[np.float64]:
        """See :meth:`Evidence.observe`."""
        features = self.encoder.observe(observations, new)
        turns = np.concatenate(
            [features, self._turns.read(observations, new)], axis=1, dtype=np.float32
        )
        gains = self.model.read(turns) @ self.places.T
        return np.where(new[:, None], gains, 0.0)
