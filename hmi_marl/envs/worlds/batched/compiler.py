"""How the functions of the batched world are compiled."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

from numba import njit

_OPTIONS: dict[str, Any] = {"error_model": "numpy", "_nrt": False}

compiled: Any = njit(**_OPTIONS)
"""A function of one world. It divides by zero as NumPy does, and it makes no arrays and counts no
references to them, which would cost more than all the rest."""

inlined: Any = njit(forceinline=True, **_OPTIONS)
"""The same, always merged into its caller."""


def source_stamp() -> str:
    """A fingerprint of everything that the kernels are compiled from.

    numba looks for changes only in the file of the outermost function. The kernels carry this
    stamp, so that a change in any of the files makes numba compile them anew.
    """
    here = Path(__file__).parent
    sources = [
        *sorted(here.glob("*.py")),
        here.parents[1] / "scene.py",
        here.parents[1] / "streams.py",
    ]
    digest = hashlib.sha256()
    for source in sources:
        digest.update(source.read_bytes())
    return digest.hexdigest()
