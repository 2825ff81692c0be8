"""Labels of windows: the driver, or the driver's preference for help.

Labels are the only input of a supervised setting besides the observed driving. The preference of a
simulated driver is η, the influence of alerts: the answer to a question that people could be asked.
No other trait is read, and η only for labelled windows.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hmi_marl.demonstrations.dataset import NOBODY, Demonstrations
from hmi_marl.envs.drivers import TRAIT_NAMES
from hmi_marl.training.traits.settings import Supervision


def choose_labelled(
    driver: NDArray[np.int64], share: float, rng: np.random.Generator
) -> NDArray[np.bool_]:
    """Mark a share of every known driver's windows, at least one, drawn by ``rng``.

    Args:
        driver: driver of each window, shape (E,); -1 if not known.
        share: share of the windows, in (0, 1].
        rng: random generator.
    """
    marked = np.zeros(len(driver), np.bool_)
    for number in np.unique(driver[driver != NOBODY]):
        windows = np.flatnonzero(driver == number)
        marked[rng.permutation(windows)[: max(1, round(share * len(windows)))]] = True
    return marked


def make_labels(
    demonstrations: Demonstrations,
    supervision: Supervision,
    share: float,
    rng: np.random.Generator,
    preferences: Mapping[str, float] | None = None,
) -> NDArray[np.float64]:
    """Return labels of all windows, shape (E,), NaN where there is none.

    Args:
        demonstrations: the windows.
        supervision: "none", "id" or "preference".
        share: share of each driver's windows that is labelled.
        rng: random generator that chooses them.
        preferences: people's answers by name, in [0, 1]; not needed for simulated drivers.

    Raises:
        ValueError: a preference is missing or outside [0, 1], or all labels are the same.
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
                "the preferences of these drivers are unknown, since the demonstrations have no "
                "truth; give the drivers' answers with --preferences FILE"
            )
        return demonstrations.truth.traits[marked, TRAIT_NAMES.index("eta")]
    observed = demonstrations.observed
    asked = [observed.names[number] for number in observed.driver[marked]]
    missing = sorted(set(asked) - set(answers))
    if missing:
        raise ValueError(f"the preferences lack {', '.join(missing)}; add them to the file")
    values = np.array([float(answers[name]) for name in asked])
    inside = (values >= 0) & (values <= 1)
    if not inside.all():
        raise ValueError(f"a preference lies in [0, 1], but got {values[~inside][0]:g}")
    return values


def read_preferences(path: Path) -> dict[str, float]:
    """Read people's answers from a JSON file {"name": number in [0, 1], ...}.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file contains something else.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise ValueError(f"{path} is not a JSON file: {error}") from None
    numbers = isinstance(content, dict) and all(
        isinstance(value, (int, float)) and not isinstance(value, bool)
        for value in content.values()
    )
    if not numbers:
        raise ValueError(f'{path} does not contain {{"name": number in [0, 1], ...}}')
    return {str(name): float(value) for name, value in content.items()}
