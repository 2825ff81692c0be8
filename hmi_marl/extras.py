"""Optional packages: which extra installs a module, and one error for all that are missing."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from types import MappingProxyType

EXTRAS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "video": ("imageio_ffmpeg",),
        "train": ("torch", "rsl_rl", "tensordict", "tensorboard", "onnx"),
        "interop": ("stable_baselines3", "supersuit"),
        "data": ("pyarrow", "sklearn", "minari", "h5py"),
        "ray": ("ray",),
        "people": ("itsdangerous", "starlette", "statsmodels", "uvicorn", "websockets"),
    }
)
"""Modules that each extra of ``pyproject.toml`` installs, by their import names."""
TRAINING = EXTRAS["train"]
"""Modules needed for training; rsl_rl imports onnx."""
_EXTRA_OF = {module: extra for extra, modules in EXTRAS.items() for module in modules}


def need(feature: str, *modules: str) -> None:
    """Check that the modules of :data:`EXTRAS` that a feature needs are installed.

    Imports none of them. ``feature`` is the subject of the error.

    Raises:
        ModuleNotFoundError: some are missing; the message names the extras to install.
    """
    missing = [module for module in modules if not _is_installed(module)]
    if missing:
        raise _missing(feature, *missing)


@contextmanager
def needing(feature: str) -> Iterator[None]:
    """Name the extra to install where an import in the block fails without it.

    Raises:
        ModuleNotFoundError: as :func:`need`; or as it was, where no extra installs the module.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        module = (error.name or "").partition(".")[0]
        if module not in _EXTRA_OF or "pip install" in str(error):
            raise
        raise _missing(feature, module) from error


def _is_installed(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except ImportError:  # an import hook that refuses it
        return False
    except ValueError:  # imported already, by something that gave it no spec
        return True


def _missing(feature: str, *modules: str) -> ModuleNotFoundError:
    firsts = {_EXTRA_OF[module]: module for module in reversed(modules)}  # one for each extra
    extras = [extra for extra in EXTRAS if extra in firsts]
    named = " and ".join(firsts[extra] for extra in extras)
    advice = f"pip install 'hmi-marl[{','.join(extras)}]'"
    return ModuleNotFoundError(f"{feature} needs {named}: {advice}", name=modules[0])
