"""The wheel and the environments that it is tried in."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.register_assert_rewrite("installed.checks")

from installed.environments import Environments, build_wheel  # noqa: E402


@pytest.fixture(scope="session")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel of this checkout."""
    return build_wheel(tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="session")
def environments(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Environments]:
    """Environments with the wheel in them."""
    kept = Environments(wheel, tmp_path_factory.mktemp("environments"))
    yield kept
    kept.close()
