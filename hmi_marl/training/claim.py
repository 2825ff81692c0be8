"""Going on with the run that a folder holds, if it is the same run."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

SETTINGS = "run.json"
FREE = ("device", "threads", "checkpoint_every")
"""Settings of the machine rather than the run: they may differ when it goes on elsewhere."""


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
        return {k: v for k, v in about.items() if k not in ("settings", "command")} | settings

    old, new = binding(before), binding(now)
    differing = [name for name in new if old.get(name) != new[name]]
    if differing:
        told = ", ".join(f"{n} = {old.get(n)!r}, now {new[n]!r}" for n in differing)
        raise ValueError(
            f"{folder} holds another run ({told}); choose another --out, or remove the folder"
        )
