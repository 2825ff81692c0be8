"""Trips under way, encoded step by step from the seat of the vehicle AI.

The context encoder of a trait model sums features of steps (see
:mod:`hmi_marl.agents.learned.trait_encoder`), so a trip that has just begun is encoded by the same
weights as a recorded window, and z of several trips follows from the sum over all their steps.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.learned.situations import Recent
from hmi_marl.agents.learned.trait_encoder import EncoderState, Latent
from hmi_marl.agents.learned.trait_model import TraitModel
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.observations import vehicle_ai_layout
from hmi_marl.envs.team_step import NO_ACTION


class TripEncoder:
    """Encode the trips of N teams with the context encoder of a trait model.

    A turn of the vehicle AI shows s_t and what became of the step before, v_{t-1} and a^A_{t-1}; so
    a turn completes the step before it. a^H, attention and traits are not read.

    Args:
        traits: the trait model.
        config: settings of the teams.

    Raises:
        ValueError: teams whose observed states are other ones than the model reads.
    """

    def __init__(self, traits: TraitModel, config: TeamConfig) -> None:
        self._layout = vehicle_ai_layout(config)
        for name, size in traits.card.reads:
            there = name in self._layout and self._layout[name]
            if not there or there.stop - there.start != size:
                raise ValueError(
                    f"this trait model reads {size} columns of {name!r}, which these teams do not "
                    "show; use the scene that it was trained on"
                )
        self._columns = self._layout.columns(name for name, _ in traits.card.reads)
        self._encoder = traits.encoder
        self.reset(1)

    def reset(self, count: int, which: NDArray[np.bool_] | None = None) -> None:
        """Begin trips of unknown drivers.

        Args:
            count: N, which may change if ``which`` is None.
            which: the teams concerned, shape (N,); all by default.
        """
        if which is None:
            self._state = self._encoder.begin(count)
            self._recent = Recent(count)
            self._before = np.zeros((count, len(self._columns)), np.float32)
            self._past = np.zeros_like(self._state.sums)
        else:
            self.begin(which)
            self._past = np.where(which[:, None], 0.0, self._past)

    def begin(self, which: NDArray[np.bool_]) -> None:
        """Begin other trips of the same drivers where ``which``, shape (N,), is set."""
        now, chosen = self._state, which[:, None]
        self._past = self._past + np.where(chosen, now.sums, 0.0)
        self._state = EncoderState(
            np.where(chosen[..., None], 0.0, now.recent), np.where(chosen, 0.0, now.sums)
        )
        self._recent.forget(which)

    @property
    def sums(self) -> NDArray[np.float64]:
        """Sums over the steps of all trips, as :meth:`Encoder.encode` returns them."""
        return self._past + self._state.sums

    def latent(self) -> Latent:
        """Return q(z | all trips).

        Raises:
            ValueError: a team that has not completed a step.
        """
        return self._encoder.latent(self.sums)

    def observe(
        self, observations: NDArray[np.float32], new: NDArray[np.bool_]
    ) -> NDArray[np.float64]:
        """Read a turn, and return the features of the step that it completes.

        Args:
            observations: of the vehicle AI's seat, shape (N, D).
            new: teams in a turn that has not been observed yet, shape (N,).

        Returns:
            w_{t-1} of the encoder, shape (N, features); 0 where no step is completed.
        """
        applied = self._layout.chosen(observations, "applied_action")
        alerts = (self._layout.scalar(observations, "alerted") > 0).astype(np.int64)
        done, recent = new & (applied != NO_ACTION), self._recent
        since, before = recent.since_alert, recent.applied
        x = recent.situation(self._before, alerts)
        recent.since_alert = np.where(done, recent.since_alert, since)
        recent.acted(np.where(done, applied, before))
        now, after = self._state, self._encoder.read(self._state, x, applied)
        features = np.where(done[:, None], after.sums - now.sums, 0.0)[:, :-1]
        self._state = EncoderState(
            np.where(done[:, None, None], after.recent, now.recent),
            np.where(done[:, None], after.sums, now.sums),
        )
        states = observations[:, self._columns]
        self._before = np.where(new[:, None], states, self._before)
        return features
