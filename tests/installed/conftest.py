"""The wheel and the environments that it is tried in."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.register_assert_rewrite("installed.checks")

from installed.kept import Environments, Shared  # noqa: E402


@pytest.fixture(scope="session")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shared]:
    """What all processes of this run make once."""
    own = tmp_path_factory.getbasetemp()
    kept = Shared((own.parent if "PYTEST_XDIST_WORKER" in os.environ else own) / "installed")
    yield kept
    kept.close()


@pytest.fixture(scope="session")
def wheel(shared: Shared) -> Path:
    """The wheel of this checkout."""
    return shared.wheel()


@pytest.fixture(scope="session")
def environments(
    shared: Shared, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Environments]:
    """Environments with the wheel in them."""
    kept = Environments(shared, tmp_path_factory.mktemp("environments"))
    yield kept
    kept.close()
