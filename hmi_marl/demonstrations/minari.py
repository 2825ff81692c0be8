"""Demonstrations as a Minari dataset: observed data only, in HDF5.

An episode's ``observations`` are its states, its ``actions`` the applied actions between them. A
crash is a termination; later steps of the standing car are left out. (After a crash in the last
step of a window no state is recorded, and the last one is repeated.) Otherwise the window's end is
a truncation, and its last action, which leads to no recorded state, is left out. Rewards are zeros,
since they are not observed. ``infos["alert"]`` holds a^A for every state, and ``options["driver"]``
of an episode's metadata the driver's name, if known. ``recover_environment()`` makes
:class:`hmi_marl.demonstrations.env.DemonstratedDriver`, if the demonstrations come from one.

Needs minari with h5py, which come with the ``data`` extra.
"""

from __future__ import annotations

import json
import os
import re
import warnings
from pathlib import Path

import numpy as np
from gymnasium import spaces

from hmi_marl.demonstrations.dataset import Observed
from hmi_marl.demonstrations.env import env_spec
from hmi_marl.envs.worlds import VEHICLE_ACTIONS
from hmi_marl.extras import needing
from hmi_marl.workers import environment

with needing("exporting to Minari"):
    import h5py  # noqa: F401
    import minari
    from minari.data_collector import EpisodeBuffer

_PLACE = "MINARI_DATASETS_PATH"


def minari_id(folder: Path) -> str:
    """Return the name of the Minari dataset of a dataset's folder."""
    return re.sub(r"[^-\w]", "_", f"hmi_marl-{folder.resolve().name}") + "-v0"


def minari_place(folder: Path) -> Path:
    """Return the folder to write to: in ``MINARI_DATASETS_PATH`` if set, else in ``folder``.

    Raises:
        FileExistsError: it exists already.
    """
    place = Path(os.environ.get(_PLACE) or folder / "minari") / minari_id(folder)
    if place.exists():
        raise FileExistsError(f"{place} is there already; remove it, or choose another --out")
    return place


def check_for_minari(observed: Observed, folder: Path) -> Path:
    """Return the folder that :func:`export_minari` will write, or raise its errors."""
    place = minari_place(folder)
    if (observed.length[~observed.crashed] < 2).any():
        raise ValueError("a window of a single step holds no transition for Minari")
    return place


def export_minari(observed: Observed, folder: Path) -> Path:
    """Write a Minari dataset and return its folder.

    Args:
        observed: episodes of at least two steps, or of one that ends in a crash.
        folder: folder of the demonstrations, which names the dataset.

    Raises:
        FileExistsError: see :func:`minari_place`.
        ValueError: an episode of a single step without a crash, which holds no transition.
    """
    place = check_for_minari(observed, folder)
    buffers = [_buffer(observed, k) for k in range(len(observed))]
    layout = [f"{part.name}: {part.size}" for part in observed.layout.parts]
    absolute = str(place.parent.resolve())  # Minari loses its way on relative ones
    with environment({_PLACE: absolute}), warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*env", UserWarning)  # recordings may have none
        minari.create_dataset_from_buffers(
            place.name,
            buffers,
            env=env_spec(observed),
            observation_space=observed.layout.space(),
            action_space=spaces.Discrete(len(VEHICLE_ACTIONS)),
            description=f"Columns: {', '.join(layout)}. Made as {json.dumps(observed.about)}",
            algorithm_name="hmi-marl collect",
            author="hmi-marl",
            author_email="",
            code_permalink="",
            data_format="hdf5",
        )
    return place


def _buffer(observed: Observed, k: int) -> EpisodeBuffer:
    crashed, length = bool(observed.crashed[k]), int(observed.length[k])
    actions = int(observed.crash_step[k]) + 1 if crashed else length - 1
    states = np.minimum(np.arange(actions + 1), length - 1)  # after the last step: the last one
    label = observed.labels()[k]
    ends = np.arange(actions) == actions - 1
    return EpisodeBuffer(
        id=k,
        seed=None if observed.seeds is None else int(observed.seeds[k]),
        options=None if label is None else {"driver": label},
        observations=observed.states[k, states],
        actions=observed.actions[k, :actions],
        rewards=np.zeros(actions),
        terminations=ends & crashed,
        truncations=ends & (not crashed),
        infos={"alert": observed.alerts[k, states]},
    )
