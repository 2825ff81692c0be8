"""Each extra alone, from the wheel: all that it promises runs, and the rest says what it needs."""

from __future__ import annotations

from pathlib import Path

import pytest
from installed.checks import Check, checks
from installed.environments import SPECS, Spec
from installed.kept import Environments, MissingPythonError

CASES = [
    # One process makes an environment and runs all that is checked in it.
    pytest.param(spec, check, id=f"{spec.name}: {name}", marks=pytest.mark.xdist_group(spec.name))
    for spec in SPECS
    for name, check in checks(spec)
]


@pytest.mark.wheel
@pytest.mark.parametrize(("spec", "check"), CASES)
def test_from_the_wheel(
    spec: Spec, check: Check, environments: Environments, tmp_path: Path
) -> None:
    try:
        environment = environments.of(spec)
    except MissingPythonError as reason:
        pytest.skip(str(reason))
    check(environment, tmp_path)
