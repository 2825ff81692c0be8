"""Which windows are labelled, and how: by who drives, or by how they like help.

A label is all that a supervised setting is told beyond what was observed. Of a simulated driver
the preference is η, how far they let an alert influence them: the answer to a question that people
could be asked. No other trait is looked at, and η only of labelled windows.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hmi_marl.demonstrations.dataset import MISSING, Demonstrations
from hmi_marl.envs.drivers import TRAIT_NAMES
from hmi_marl.training.traits.settings import Supervision


def choose_labelled(
    driver: NDArray[np.int64], share: float, rng: np.random.Generator
) -> NDArray[np.bool_]:
    """Mark a share of every known driver's windows, at least one, drawn by ``rng``.

    Args:
        driver: of each window, shape (E,); -1 if not known.
        share: in (0, 1].
        rng: to draw by.
    """
    marked = np.zeros(len(driver), np.bool_)
    for who in np.unique(driver[driver != MISSING]):
        theirs = np.flatnonzero(driver == who)
        marked[rng.permutation(theirs)[: max(1, round(share * len(theirs)))]] = True
    return marked


def make_labels(
    demonstrations: Demonstrations,
    supervision: Supervision,
    share: float,
    rng: np.random.Generator,
    preferences: Mapping[str, float] | None = None,
) -> NDArray[np.float64]:
    """Labels of all windows, shape (E,), NaN where there is none.

    Args:
        demonstrations: the windows.
        supervision: "none", "id" or "preference".
        share: of each driver's windows that is labelled.
        rng: draws which.
        preferences: what people answered, by their names, in [0, 1]; of simulated drivers not
            needed.

    Raises:
        ValueError: preferences that are not known, or out of [0, 1]; or all labels are the same.
    """
    observed = demonstrations.observed
    marked = choose_labelled(observed.driver, share, rng)
    labels = np.full(len(observed), np.nan)
    if supervision == "id":
        labels[marked] = observed.driver[marked]
    elif supervision == "preference":
        labels[marked] = _preferences(demonstrations, marked, preferences)
    if supervision != "none" and len(np.unique(labels[~np.isnan(labels)])) < 2:
        raise ValueError("all labels are the same, so nothing can be learned from them")
    return labels


def _preferences(
    demonstrations: Demonstrations,
    marked: NDArray[np.bool_],
    answers: Mapping[str, float] | None,
) -> NDArray[np.float64]:
    if answers is None:
        if demonstrations.truth is None:
            raise ValueError(
                "nobody knows how these drivers like help: there is no truth beside the "
                "demonstrations; give their answers with --preferences FILE"
            )
        return demonstrations.truth.traits[marked, TRAIT_NAMES.index("eta")]
    observed = demonstrations.observed
    asked = [observed.names[who] for who in observed.driver[marked]]
    missing = sorted(set(asked) - set(answers))
    if missing:
        raise ValueError(f"the preferences say nothing of {', '.join(missing)}")
    values = np.array([float(answers[name]) for name in asked])
    if not ((values >= 0) & (values <= 1)).all():
        raise ValueError("a preference for help lies in [0, 1]")
    return values


def read_preferences(path: Path) -> dict[str, float]:
    """What people answered, from a JSON file {"name": number in [0, 1], ...}.

    Raises:
        FileNotFoundError: no such file.
        ValueError: it holds something else.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise ValueError(f"{path} is no JSON file: {error}") from None
    numbers = isinstance(content, dict) and all(
        isinstance(value, (int, float)) and not isinstance(value, bool)
        for value in content.values()
    )
    if not numbers:
        raise ValueError(f'{path} is to hold {{"name": number in [0, 1], ...}}')
    return {str(name): float(value) for name, value in content.items()}
