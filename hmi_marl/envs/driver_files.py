"""Driver files: JSON with the traits of one driver, measured from a person or written by hand.

A file such as ``measured/visitor-17.json`` holds at least ::

    {"format": "hmi-marl driver 1",
     "driver": {"name": "visitor-17", "beta": 0.04, "alpha": 0.2, "eta": 0.1, "inflation": 6.0}}

and may hold ``about``, a mapping of anything, and a checksum over all of it, which is then checked.
Everything that takes a driver's name takes the path of such a file.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hmi_marl.checks import shown
from hmi_marl.files import json_value, with_checksum, without_checksum, write_json
from hmi_marl.reading import read_json
from hmi_marl.typed_json import read_as

if TYPE_CHECKING:
    from hmi_marl.envs.drivers import Driver  # which imports this module

FORMAT = "hmi-marl driver 1"
_BYTES = 2**20
"""Largest driver file [bytes]."""
_NAME = re.compile(r"[A-Za-z0-9_-]{1,64}")


def read_driver(path: str | Path, kind: type[Driver]) -> Driver:
    """Read the driver of a file.

    Args:
        path: of the file.
        kind: the class :class:`~hmi_marl.envs.drivers.Driver`, whose module imports this one.

    Raises:
        ValueError: no such file, or none that can be read; something else in it; a changed one; or
            traits out of their range. The message names the file.
    """
    path = Path(path)
    try:
        content = read_json(path, _BYTES)
    except FileNotFoundError:
        raise ValueError(f"there is no driver file {path}") from None
    except OSError as error:
        raise ValueError(f"cannot read the driver file {path}: {error.strerror}") from None
    try:
        return _driver(content, kind)
    except ValueError as error:
        raise ValueError(f"{path} is no driver file that can be used: {error}") from None


def write_driver(path: str | Path, driver: Driver, about: Mapping[str, Any] | None = None) -> None:
    """Write a driver file.

    Args:
        path: of the file; ends in .json.
        driver: its name has letters, digits, - and _ alone.
        about: how the traits were found.

    Raises:
        ValueError: a name or a path that :func:`read_driver` would not take.
        OSError: it cannot be written.
    """
    if not is_driver_file(str(path)):
        raise ValueError(f"the name of a driver file ends in .json, not {shown(str(path))}")
    write_json(Path(path), driver_content(driver, about))


def driver_content(driver: Driver, about: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return the content of a driver file; see :func:`write_driver`."""
    _check_name(driver.name)
    content = {"format": FORMAT, "driver": json_value(driver), "about": json_value(about or {})}
    return with_checksum(content)


def is_driver_file(text: str) -> bool:
    """Whether a driver's name stands for a file."""
    return text.lower().endswith(".json")


def _driver(content: Any, kind: type[Driver]) -> Driver:
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise ValueError(f"it is a mapping whose format is {FORMAT!r}")
    if "sha256" in content:
        content = without_checksum(content)
    if odd := sorted(set(content) - {"format", "driver", "about"}):
        raise ValueError(f"it has unknown fields: {shown(odd)}")
    driver = read_as(kind, content.get("driver"))
    _check_name(driver.name)
    return driver


def _check_name(name: str) -> None:
    if not _NAME.fullmatch(name):
        raise ValueError(
            f"a driver's name in a file has up to 64 of A-Z, a-z, 0-9, - and _, not {shown(name)}"
        )
