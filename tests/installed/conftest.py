"""The wheel and the environments that it is tried in."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.register_assert_rewrite("installed.checks")

from installed.environments import (  # noqa: E402
    PYTHONS,
    Environment,
    Spec,
    build_wheel,
    find_python,
    installed,
)


@pytest.fixture(scope="session")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel of this checkout."""
    return build_wheel(tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="session")
def environment(
    request: pytest.FixtureRequest, wheel: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Environment]:
    """The environment of a spec, there as long as its tests run."""
    spec: Spec = request.param
    interpreter = find_python(spec.python)
    if interpreter is None:
        pytest.skip(
            f"there is no Python {spec.python}: put python{spec.python} on the PATH, or name it "
            f"in {PYTHONS}"
        )
    folder = tmp_path_factory.mktemp(f"with-{spec.name}") / "environment"
    with installed(spec, interpreter, wheel, folder) as made:
        yield made
