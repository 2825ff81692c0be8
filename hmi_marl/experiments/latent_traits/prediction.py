r"""Measure how well strangers' actions are predicted from z, compared with their true traits.

Three networks of one shape learn π(v_t | x_t, c) by imitation of one half of the strangers. As c,
one is given z of *other* windows of the driver, one the true traits, one nothing. Judged is the
log-likelihood of what the other half of the strangers did. If z holds all of the traits that can be
seen in what people do, the first two are equal.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.learned.situations import ACTIONS, situations
from hmi_marl.agents.learned.trait_model import TraitModel
from hmi_marl.demonstrations.dataset import Demonstrations
from hmi_marl.experiments.latent_traits.strangers import strangers_pools
from hmi_marl.extras import needing
from hmi_marl.reporting import statistics
from hmi_marl.reporting.statistics import Estimate

HIDDEN = (64,)
"""Hidden units of each network."""
EPOCHS, BATCH, RATE = 12, 512, 2e-3
"""Passes over the actions that are learned from, steps in a batch, and learning rate."""
_SMALLEST = 1e-9
"""Least probability of an action, so that one that was never seen does not decide everything."""


@dataclass(frozen=True)
class ActionPrediction:
    """Log-likelihood per step of the judged strangers' actions [nats], over strangers."""

    z: Estimate
    """Given z of other windows of theirs."""
    traits: Estimate
    """Given their true traits."""
    nothing: Estimate
    """Given neither."""
    traits_minus_z: Estimate
    """Paired by stranger: what is lost by knowing z in place of the traits."""


def has_pairs(driver: NDArray[np.int64], size: int) -> bool:
    """Return whether each stranger has two pools of ``size`` windows, given that of each, (E,)."""
    whose = driver[strangers_pools(driver, size)[0][:, 0]]
    return bool(np.unique(whose, return_counts=True)[1].min() > 1)


class ActionPredictor:
    """Predict actions of one population of strangers, given z or something else.

    Args:
        population: strangers with two pools of windows or more each, and the truth.
        size: windows in a pool.
        seed: seed of the networks.

    Raises:
        ValueError: the truth is not known, or see :func:`strangers_pools`; or a driver who has a
            single pool (:func:`has_pairs`).
    """

    def __init__(self, population: Demonstrations, size: int, seed: int = 0) -> None:
        observed, truth = population.observed, population.truth
        if truth is None:
            raise ValueError("actions are predicted from traits only where the truth is known")
        pools, fits = strangers_pools(observed.driver, size)
        if not has_pairs(observed.driver, size):
            raise ValueError(
                f"predicting actions takes two pools of {size} windows of each stranger, but of "
                "one there is one pool; collect more --windows"
            )
        first = np.unique(observed.driver[pools[:, 0]], return_index=True)[1]
        self._observed, self._seed = observed, seed
        self._sources, self._judged, self._fits = pools[first], pools[first + 1], fits[first]
        self._traits = truth.traits_of(self._sources)

    def judge(self, model: TraitModel) -> ActionPrediction:
        """Predict from z of this model.

        Raises:
            ModuleNotFoundError: scikit-learn is not installed.
        """
        z = self._likelihood(model.latents(model.encode(self._observed), self._sources).mean)
        traits, nothing = self._others
        return ActionPrediction(*map(statistics.mean, (z, traits, nothing, traits - z)))

    @cached_property
    def _others(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Log-likelihood of each judged stranger given the traits, and given nothing."""
        nothing = np.zeros((len(self._traits), 0))
        return self._likelihood(self._traits), self._likelihood(nothing)

    def _likelihood(self, given: NDArray[np.float64]) -> NDArray[np.float64]:
        """Learn given (S, C) of S strangers; return that of each judged one, per step, (S',)."""
        with needing("predicting actions"):
            from sklearn.exceptions import ConvergenceWarning
            from sklearn.neural_network import MLPClassifier
            from sklearn.pipeline import make_pipeline
            from sklearn.preprocessing import StandardScaler

        inputs, actions, _ = self._steps(given, self._fits)
        network = MLPClassifier(
            HIDDEN,
            learning_rate_init=RATE,
            batch_size=min(BATCH, len(inputs)),
            max_iter=EPOCHS,
            random_state=self._seed,
        )
        model = make_pipeline(StandardScaler(), network)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)  # stopped early on purpose
            model.fit(inputs, actions)
        inputs, actions, whose = self._steps(given, ~self._fits)
        chances = np.zeros((len(inputs), ACTIONS))
        chances[:, network.classes_] = model.predict_proba(inputs)
        chosen = np.maximum(chances[np.arange(len(actions)), actions], _SMALLEST)
        return np.bincount(whose, np.log(chosen)) / np.bincount(whose)

    def _steps(
        self, given: NDArray[np.float64], which: NDArray[np.bool_]
    ) -> tuple[NDArray[np.float32], NDArray[np.int64], NDArray[np.int64]]:
        """Inputs (B, D + C), actions (B,) and strangers (B,), from 0, of all steps of some."""
        some = self._observed.take(self._judged[which].ravel())
        taken, x = some.steps_taken, situations(some.states, some.actions, some.alerts)
        steps = some.length.reshape(np.count_nonzero(which), -1).sum(axis=1)
        whose = np.repeat(np.arange(len(steps)), steps)
        inputs = np.concatenate([x[taken], given[which][whose]], axis=1, dtype=np.float32)
        return inputs, some.actions[taken], whose
