"""Fixtures of the trainers' tests, which also run without those of ``tests/conftest.py``."""

import pytest


@pytest.fixture(autouse=True)
def libraries_are_unmeasured(request: pytest.FixtureRequest) -> None:
    """Other libraries' loops do not count for coverage: what they call of ours is tested elsewhere."""
    try:
        request.getfixturevalue("unmeasured")
    except pytest.FixtureLookupError:  # make trainers: tests/trainers/run.py
        pass
