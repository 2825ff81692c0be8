"""Files of a run's folder: its settings, by which it is resumed or refused, and its curve."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from hmi_marl.agents.catalogue import learned_file, mixed_names
from hmi_marl.agents.learned.cards import is_shipped
from hmi_marl.agents.learned.trait_model import load_traits
from hmi_marl.checks import shown
from hmi_marl.envs.config import DRIVER
from hmi_marl.files import json_digest, json_value, sha256_of
from hmi_marl.reading import MOST_STATE_VALUES, read_json
from hmi_marl.training.protocols.anchored import OWN_DRIVER
from hmi_marl.typed_json import read_value

SETTINGS = "run.json"
"""Settings of the run."""
CURVE = "curve.json"
"""Learning curve, a row for each batch."""
CHECKPOINT = "checkpoint.safetensors"
"""State to resume from."""
POLICIES = ("driver_policy", "anchor")
"""Settings that name a driver policy, which a run notes with the checksum of its weights."""
TRAIT_MODEL = "traits"
"""Setting that names a trait model, noted with the checksum of its encoder, which alone is read."""
MIXTURE = "mixture"
"""Key of the policies in a mixture of driver policies."""
FREE = ("device", "threads", "checkpoint_every")
"""Settings of the machine, which may differ when a run is resumed."""
_CURVE_BYTES = 2**30
Row = dict[str, int | float | str | None]
"""Row of a learning curve."""


def read_curve(folder: Path) -> list[dict[str, Any]]:
    """Rows of a run's learning curve.

    Raises:
        OSError: there is none.
        ValueError: the file holds no such rows, or none at all.
    """
    path = folder / CURVE
    content = read_json(path, _CURVE_BYTES, MOST_STATE_VALUES)
    try:
        rows: list[dict[str, Any]] = read_value(list[Row], content, "curve")
    except ValueError as error:
        raise ValueError(f"{path} is no learning curve: {error}") from None
    if not rows:
        raise ValueError(f"{path} is no learning curve: it has no rows")
    return rows


def seconds_of(runs: Iterable[Path], folder: Path) -> dict[str, float]:
    """Seconds that each run took in all, interruptions included, by its path in a folder.

    A run elsewhere, and one in the folder itself, goes by its name.
    """
    return {_path_in(folder, run): _seconds(run) for run in runs}


def _path_in(folder: Path, run: Path) -> str:
    inside = run != folder and run.is_relative_to(folder)
    return run.relative_to(folder).as_posix() if inside else run.name


def _seconds(run: Path) -> float:
    seconds = read_curve(run)[-1].get("seconds")
    if not isinstance(seconds, (int, float)):
        raise ValueError(f"{run / CURVE} is no learning curve: its last row has no seconds")
    return seconds


def run_settings(settings: object) -> dict[str, Any]:
    """A run's settings, a dataclass, as JSON, with the models that it reads named by checksums.

    Of a trait model, only the encoder is read and counts.

    Raises:
        FileNotFoundError, ValueError: there is no such driver policy, or no such trait model.
    """
    content: dict[str, Any] = json_value(settings)
    for setting in POLICIES:
        name = content.get(setting)
        if isinstance(name, str) and name != OWN_DRIVER:
            mixed = [_policy(each) for each in mixed_names(name)]
            content[setting] = {MIXTURE: mixed} if mixed else _policy(name)
    if isinstance(name := content.get(TRAIT_MODEL), str):
        content[TRAIT_MODEL] = {"name": _short(name), "sha256": load_traits(name).digest}
    return content


def _policy(name: str) -> str | dict[str, str]:
    """Short name and checksum of a learned driver policy; of another, the name alone."""
    file = learned_file(name, DRIVER)
    return name if file is None else _by_checksum(name, file)


def _by_checksum(name: str, file: Path) -> dict[str, str]:
    """Short name of a model, and the checksum of its weights; ``file`` is these or the card."""
    return {"name": _short(name), "sha256": sha256_of(file.with_suffix(".safetensors"))}


def _short(name: str) -> str:
    return name.lower() if is_shipped(name) else Path(name).name


def read_settings(path: Path) -> dict[str, Any]:
    """Content of a run's ``run.json``.

    Raises:
        ValueError: the file is missing or damaged.
    """
    try:
        about = read_json(path)
    except FileNotFoundError:
        raise ValueError(f"{path} is missing, but there is a checkpoint in its folder") from None
    except ValueError as error:
        raise ValueError(f"{path} is damaged: {error}") from None
    if not isinstance(about, dict) or not isinstance(about.get("settings"), dict):
        raise ValueError(f"{path} does not contain the settings of a run")
    return about


def partners_of(run: Path) -> tuple[str, ...] | None:
    """Return the names of the policies in the mixture of drivers that a run learns with.

    None if nothing was learned in the folder, or without a mixture.

    Raises:
        ValueError: ``run.json`` is damaged.
    """
    if not (run / CHECKPOINT).is_file():  # nothing was learned that could be lost
        return None
    policy = read_settings(run / SETTINGS)["settings"].get("driver_policy")
    mixed = policy.get(MIXTURE) if isinstance(policy, dict) else None
    if not isinstance(mixed, list):
        return None
    return tuple(str(each.get("name") if isinstance(each, dict) else each) for each in mixed)


def check_same(before: dict[str, Any], now: dict[str, Any], folder: Path) -> None:
    """Check that the run in a folder has the settings that are asked for now.

    Args:
        before: ``run.json`` of the run in the folder.
        now: the same of the run that is asked for.
        folder: folder of the run.

    Raises:
        ValueError: something differs, other than settings of the machine.
    """
    old, new = _binding(before), _binding(now)
    differing = [pair for name in new for pair in _differing(name, old.get(name), new[name])]
    if differing:
        details = ", ".join(f"{name} = {shown(a)}, now {shown(b)}" for name, a, b in differing)
        raise ValueError(
            f"{folder} holds another run ({details}); choose another --out, or remove the folder"
        )


def settings_digest(about: dict[str, Any]) -> str:
    """SHA-256 checksum of what must be the same when a run is resumed, of its ``run.json``."""
    return json_digest(_binding(about))


def _differing(name: str, old: Any, new: Any) -> list[tuple[str, Any, Any]]:
    """Names, old and new values of what differs in a setting, within groups of them too."""
    if old == new:
        return []
    if not (isinstance(old, dict) and isinstance(new, dict)):
        return [(name, old, new)]
    within = {**new, **old}
    return [
        pair
        for each in within
        for pair in _differing(f"{name}.{each}", old.get(each), new.get(each))
    ]


def _identity(model: Any) -> Any:
    """Return what identifies a model that a run reads, whatever the name of its folder."""
    if not isinstance(model, dict):
        return model
    if isinstance(mixed := model.get(MIXTURE), list):
        return [_identity(each) for each in mixed]
    return model.get("sha256")


def _binding(about: dict[str, Any]) -> dict[str, Any]:
    """Settings and facts of a run by name, but for those of the machine."""
    settings = {k: v for k, v in about.get("settings", {}).items() if k not in FREE}
    for setting in (*POLICIES, TRAIT_MODEL):
        if setting in settings:  # whatever the name of its folder
            settings[setting] = _identity(settings[setting])
    others = {k: v for k, v in about.items() if k not in ("settings", "command")}
    return others | settings
