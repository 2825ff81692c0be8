"""Datasets that an experiment records once, below its folder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tqdm import tqdm

from hmi_marl.agents.learned.policy import find_policy
from hmi_marl.demonstrations.recording import CollectSettings, collect
from hmi_marl.envs.config import DRIVER
from hmi_marl.files import json_value, sha256_of
from hmi_marl.ownership import owned
from hmi_marl.training.runs.folder import check_same

_FREE = ("driver_policy", "num_teams")
"""Settings that a recorded dataset may differ in: the policy's folder (its weights are compared
instead), and memory."""


def record(datasets: Mapping[str, CollectSettings], driver_run: Path, folder: Path) -> None:
    """Record what is not recorded yet, and check that the rest was recorded alike.

    Args:
        datasets: what to record, by the name of its folder.
        driver_run: run of their driver policy.
        folder: where these folders lie.

    Raises:
        FileNotFoundError: there is no such driver policy.
        ModuleNotFoundError: the data extra is not installed.
        ValueError: a dataset that is there was recorded otherwise.
    """
    from hmi_marl.demonstrations.parquet import TRUTH, read_about, write_demonstrations

    for name, dataset in datasets.items():
        truth = folder / name / TRUTH
        if truth.is_file():  # which is written last
            about = read_about(truth)
            before = _binding(about.get("settings", {}))
            check_same(before, _binding(json_value(dataset)), truth.parent)
            weights = find_policy(driver_run, DRIVER).with_suffix(".safetensors")
            if about["driver_policy"].get("sha256") != sha256_of(weights):
                raise ValueError(
                    f"{truth.parent} was recorded with another driver policy than that of "
                    f"{driver_run}; choose another --out, or remove the folder"
                )
            continue
        total = dataset.total_steps
        with (
            owned(folder / name),
            tqdm(total=total, unit=" steps", unit_scale=True, desc=name) as bar,
        ):
            write_demonstrations(folder / name, collect(dataset, bar.update))


def _binding(settings: dict[str, Any]) -> dict[str, Any]:
    return {"settings": {name: value for name, value in settings.items() if name not in _FREE}}
