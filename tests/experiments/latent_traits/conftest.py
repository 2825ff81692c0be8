"""Fixtures of the tests of latent traits."""

from collections.abc import Iterator

import pytest

from hmi_marl.experiments.latent_traits import probes


@pytest.fixture(scope="module")
def few_folds() -> Iterator[None]:
    """Regress traits with two folds instead of five, where others test how well that goes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(probes, "_FOLDS", 2)
        yield
