"""Fixtures of the trainers' tests, which also run without those of ``tests/conftest.py``."""

from contextlib import suppress

import pytest


@pytest.fixture(autouse=True)
def libraries_are_unmeasured(request: pytest.FixtureRequest) -> None:
    """Leave other libraries' loops out of coverage: what they call of ours is tested elsewhere."""
    with suppress(pytest.FixtureLookupError):  # make trainers: tests/trainers/run.py
        request.getfixturevalue("unmeasured")
