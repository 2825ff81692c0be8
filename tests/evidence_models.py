"""Evidence models and HMIs with weights as they come, and trips in which they can be watched."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.adaptive.evidence_model import EvidenceCard, EvidenceModel, save_evidence
from hmi_marl.agents.adaptive.hmis import Trained
from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.agents.learned.policy import PolicyCard, make_card, save_policy
from hmi_marl.agents.learned.trait_model import TraitModel, load_traits
from hmi_marl.envs.config import VEHICLE_AI, TeamConfig
from hmi_marl.envs.drivers import DRIVERS
from hmi_marl.envs.teaming import Teaming

HIDDEN = TeamConfig(driver="bart", ai_sees_attention=False, duration=4.0)
SMALL: dict[str, Any] = {
    "latent": 3,
    "reader": NetworkConfig((6,)),
    "place": NetworkConfig((5,), "tanh"),
    "expected": NetworkConfig((4,)),
}


@cache
def trait_model() -> TraitModel:
    """Load the trait model that comes with the package."""
    return load_traits(Trained().traits)


def drawn(shapes: dict[str, tuple[int, ...]], seed: int = 0) -> dict[str, NDArray[np.float32]]:
    """Weights of these shapes, any."""
    rng = np.random.default_rng(seed)
    return {
        name: (0.5 * rng.standard_normal(shape)).astype(np.float32)
        for name, shape in shapes.items()
    }


def evidence_weights(card: EvidenceCard, seed: int = 0) -> dict[str, NDArray[np.float32]]:
    """Any, but for units that are positive."""
    weights = drawn(card.shapes, seed)
    return weights | {"read.scale": np.abs(weights["read.scale"]) + np.float32(0.5)}


def untrained_evidence(config: TeamConfig = HIDDEN, seed: int = 0, **sizes: Any) -> EvidenceModel:
    """Make a small evidence model."""
    card = EvidenceCard.for_team(config, trait_model(), **(SMALL | sizes))
    return EvidenceModel(card, evidence_weights(card, seed))


def hidden_card(config: TeamConfig = HIDDEN, context: int = 0) -> PolicyCard:
    """Return the card of a small HMI that sees no attention and no traits."""
    return make_card(VEHICLE_AI, config, NetworkConfig((6,), rnn_hidden_dim=3), False, context)


def save_trained(folder: Path, config: TeamConfig = HIDDEN, seed: int = 1) -> Trained:
    """Save all learned models that adaptive HMIs need in ``folder``.

    ``seed`` is that of the HMI conditioned on z.
    """
    model = untrained_evidence(config)
    save_evidence(folder / "evidence", model.card, model.weights)
    conditioned = hidden_card(config, 2 * model.card.context)
    save_policy(folder / "conditioned", conditioned, drawn(conditioned.shapes, seed=seed))
    plain = hidden_card(config)
    for number, name in enumerate(DRIVERS):
        save_policy(folder / f"hidden-{name}", plain, drawn(plain.shapes, seed=2 + number))
    names = "evidence", "conditioned", "hidden-{}"
    return Trained(*(str(folder / name) for name in names))


def seeds(count: int, first: int = 0) -> NDArray[np.uint64]:
    """Seeds of ``count`` episodes."""
    return np.arange(first, first + count, dtype=np.uint64)


def turns(
    teams: Teaming,
    intents: NDArray[np.int64],
    alerts: NDArray[np.int64] | Callable[[NDArray[np.float32]], NDArray[np.int64]],
) -> Iterator[NDArray[np.float32]]:
    """Yield the vehicle AI's observations in each turn of a trip.

    Args:
        teams: teams at the start of their episodes.
        intents: shape (T, N).
        alerts: shape (T, N), or a function of the observation.
    """
    for t, intended in enumerate(intents):
        teams.intend(intended)
        seen = teams.observe(VEHICLE_AI)
        yield seen
        teams.step(alerts(seen) if callable(alerts) else alerts[t])


def any_intents(steps: int, count: int, seed: int = 0) -> NDArray[np.int64]:
    """Draw intended actions that often repeat, shape (T, N)."""
    return np.random.default_rng(seed).choice([1, 1, 1, 3, 4], (steps, count))


def any_alerts(steps: int, count: int, rate: float = 0.3, seed: int = 1) -> NDArray[np.int64]:
    """Shape (T, N)."""
    return (np.random.default_rng(seed).random((steps, count)) < rate).astype(np.int64)


def small_evaluation(monkeypatch: Any) -> None:
    """Let the evaluation of adaptive HMIs take trips of 2 s, on one thread, of a few groups."""
    import numba

    from hmi_marl.experiments.adaptation import evaluation as adapt

    every, team = adapt.groups, replace(HIDDEN, duration=2.0)
    wanted = "lisa", "bart", "population", "change to bart"
    monkeypatch.setattr(numba.config, "NUMBA_NUM_THREADS", 1)
    monkeypatch.setattr(adapt, "TEAM", team)
    monkeypatch.setattr(adapt, "CHANGE_STEP", team.horizon // 2)
    monkeypatch.setattr(adapt, "RECOVERED", 5)
    monkeypatch.setattr(
        adapt, "groups", lambda settings: tuple(g for g in every(settings) if g.name in wanted)
    )
