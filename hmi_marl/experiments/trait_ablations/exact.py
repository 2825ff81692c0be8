"""Exact posterior of the same strangers, which no encoder can beat."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

import hmi_marl
from hmi_marl.envs.drivers import TRAIT_NAMES
from hmi_marl.experiments.latent_traits.posterior import evaluate_posteriors
from hmi_marl.experiments.trait_ablations.judging import JUDGED, checksum
from hmi_marl.files import json_value, with_checksum, without_checksum, write_json
from hmi_marl.reading import read_json
from hmi_marl.reporting.statistics import Estimate

_CASE = "hidden-known"
"""a^H hidden, the driver policy known."""
_DEVIATIONS = 1.96
"""Standard deviations in half of a 95 % interval."""


def exact_r2(
    recordings: Path, strangers: int, windows: int, driver_run: Path, path: Path
) -> dict[str, Estimate]:
    """Compute R² of the posterior mean by trait, or read from ``path`` what was found before.

    Args:
        recordings: folder of the recordings.
        strangers: number of judged strangers, the first ones.
        windows: number of windows that are read of each.
        driver_run: run of the driver policy that drove them.
        path: file of the result.

    Raises:
        ValueError: see :func:`evaluate_posteriors`.
    """
    about = {
        "version": hmi_marl.__version__,
        "recording": checksum(recordings / JUDGED),
        "strangers": strangers,
        "windows": windows,
    }
    with suppress(FileNotFoundError, ValueError, KeyError):  # a damaged file is made again
        content = without_checksum(read_json(path))
        if content.get("about") == about:
            return {name: Estimate.from_json(content["r2"][name]) for name in TRAIT_NAMES}
    found = _compute(recordings, strangers, windows, driver_run)
    write_json(path, with_checksum({"about": about, "r2": json_value(found)}))
    return found


def _compute(
    recordings: Path, strangers: int, windows: int, driver_run: Path
) -> dict[str, Estimate]:
    from hmi_marl.demonstrations.parquet import read_demonstrations

    data = read_demonstrations(recordings / JUDGED)
    judged = np.unique(data.observed.driver)[1::2][:strangers]  # the others fit the probes
    some = data.take(np.isin(data.observed.driver, judged))
    row = evaluate_posteriors(some, _CASE, windows, driver_policy=str(driver_run))
    # With an error, so that averages over training seeds, which share it, leave it as it is.
    return {
        name: replace(
            score.r2, error=(score.r2.high - score.r2.low) / (2 * _DEVIATIONS), count=row.drivers
        )
        for name, score in row.traits.items()
    }
