"""Going on with the run that a folder holds, if it is the same run."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from hmi_marl.agents.catalogue import learned_file
from hmi_marl.agents.learned.shipped import is_shipped
from hmi_marl.envs.config import DRIVER
from hmi_marl.files import json_value

SETTINGS = "run.json"
POLICY = "driver_policy"
FREE = ("device", "threads", "checkpoint_every")
"""Settings of the machine rather than the run: they may differ when it goes on elsewhere."""


def told(settings: object) -> dict[str, Any]:
    """A run's settings, a dataclass, as JSON; whose driver it takes is told by checksum, not place.

    Raises:
        FileNotFoundError, ValueError: there is no such driver.
    """
    content: dict[str, Any] = json_value(settings)
    name = content.get(POLICY)
    weights = learned_file(name, DRIVER) if isinstance(name, str) else None
    if isinstance(name, str) and weights is not None:
        short = name.lower() if is_shipped(name) else Path(name).name
        digest = hashlib.sha256(weights.read_bytes()).hexdigest()
        content[POLICY] = {"name": short, "sha256": digest}
    return content


def read_settings(path: Path) -> dict[str, Any]:
    """What the run was begun with.

    Raises:
        ValueError: the file is missing or damaged.
    """
    try:
        about = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ValueError(f"{path} is missing beside its checkpoint") from None
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise ValueError(f"{path} is damaged: {error}") from None
    if not isinstance(about, dict):
        raise ValueError(f"{path} does not tell the settings of a run")
    return about


def check_same(before: dict[str, Any], now: dict[str, Any], folder: Path) -> None:
    """Raise ``ValueError`` unless a run that is there was begun as one would be now.

    Args:
        before: ``run.json`` of the run.
        now: the same of the one that is asked for.
        folder: of the run.
    """

    def binding(about: dict[str, Any]) -> dict[str, Any]:
        settings = {k: v for k, v in about.get("settings", {}).items() if k not in FREE}
        policy = settings.get(POLICY)
        if isinstance(policy, dict):  # wherever it lies and whatever its folder is called
            settings[POLICY] = policy.get("sha256")
        own = {k: v for k, v in about.items() if k not in ("settings", "command")}
        return own | settings

    old, new = binding(before), binding(now)
    differing = [name for name in new if old.get(name) != new[name]]
    if differing:
        told = ", ".join(f"{n} = {old.get(n)!r}, now {new[n]!r}" for n in differing)
        raise ValueError(
            f"{folder} holds another run ({told}); choose another --out, or remove the folder"
        )
