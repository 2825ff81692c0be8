from pathlib import Path
from typing import Any

import numpy as np
import pytest
from trait_models import save_driver

from hmi_marl.agents.learned.policy import load_policy
from hmi_marl.demonstrations.dataset import Demonstrations
from hmi_marl.demonstrations.recording import CollectSettings, collect
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import DRIVERS, PAPER_DRIVERS, Driver
from hmi_marl.exact import evidence_by_source as module
from hmi_marl.exact import identify as identifying
from hmi_marl.exact.evidence_by_source import SOURCES, evidence_by_source
from hmi_marl.exact.identify import identify
from hmi_marl.exact.trait_likelihood import TraitLikelihood, Windows

STEPS = (1, 4, 10)


class Fixed:
    """The same probabilities whatever it sees."""

    def __init__(self, *chances: float) -> None:
        self.chances = np.array(chances)

    def reset(self, seeds: Any, which: Any = None) -> None:
        pass

    def probabilities(self, observations: Any) -> Any:
        return np.tile(self.chances, (len(observations), 1))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save_driver(tmp_path_factory.mktemp("driver"), 0)


@pytest.fixture(scope="module")
def settings(folder: Path) -> CollectSettings:
    return CollectSettings(
        steps=40, duration=2.0, vehicles=(1, 8), driver_policy=str(folder), num_teams=100
    )


@pytest.fixture(scope="module")
def data(settings: CollectSettings) -> Demonstrations:
    """Sixteen windows of ten steps."""
    (data,) = collect(settings)
    return data


def arrays(data: Demonstrations) -> tuple[Any, ...]:
    seen = data.observed
    return seen.seeds, seen.actions, seen.alerts, seen.length


def found(settings: CollectSettings, data: Demonstrations, steps: Any = STEPS) -> Any:
    team = settings.team(PAPER_DRIVERS)
    policy = load_policy(settings.driver_policy, "driver", team, greedy=False)
    intended = data.truth.intended if data.truth is not None else None
    return evidence_by_source(team, policy, PAPER_DRIVERS, *arrays(data), intended, steps)


def test_two_steps_by_hand() -> None:
    mona = Driver("mona", beta=0.3, alpha=0.6, eta=0.0, inflation=1.0)
    policy = Fixed(0.1, 0.2, 0.3, 0.25, 0.15)
    # Both windows intend 3, then 1; the second window's car keeps 3, so that she was distracted.
    intended, applied = np.array([[3, 1], [3, 1]]), np.array([[3, 1], [3, 3]])
    nothing, whole = np.zeros((2, 2), np.int64), np.array([2, 2])
    config = TeamConfig(driver="lisa", duration=0.4)
    given = np.arange(2), applied, nothing, whole, intended, (1, 2)
    evidence = evidence_by_source(config, policy, [mona], *given)
    distracted = 0.3 * (1 - 0.6) + 0.7 * 0.3  # in the second step
    expected = {
        "intended": (0.25, 0.25 * 0.2, 0.25 * 0.2),
        "chain": (1.0, 1 - distracted, distracted),
        "seen": (0.25, 0.05 * (1 - distracted), 0.05 * distracted),
        # The same action could also have been intended.
        "hidden": (
            0.25,
            0.25 * (1 - distracted) * 0.2,
            0.25 * (distracted + (1 - distracted) * 0.25),
        ),
    }
    for source, (first, one, other) in expected.items():
        after_one, after_two = evidence[source]
        np.testing.assert_allclose(np.exp(after_one.log_evidence), [[first], [first]])
        np.testing.assert_allclose(np.exp(after_two.log_evidence), [[one], [other]])


def test_they_agree_with_the_other_exact_answers(
    settings: CollectSettings, data: Demonstrations
) -> None:
    evidence, team = found(settings, data), settings.team(PAPER_DRIVERS)
    policy = load_policy(settings.driver_policy, "driver", team, greedy=False)
    seeds, actions, alerts, length = arrays(data)
    assert data.truth is not None
    traits = np.array([DRIVERS[name].traits for name in PAPER_DRIVERS])
    everyone = np.tile(traits[:, None], (len(seeds), 1, 1, 1))  # (E, K, 1, 4)
    persons = np.arange(len(seeds))
    for place, steps in enumerate(STEPS):
        cut = np.minimum(length, steps)
        expected = identify(team, policy, PAPER_DRIVERS, seeds, actions, alerts, cut)
        np.testing.assert_allclose(
            evidence["hidden"][place].log_evidence, expected.log_evidence, rtol=1e-12
        )
        given = seeds, actions, alerts, cut, data.truth.intended, persons
        windows = Windows.checked(team, *given)
        for source, known in (("seen", policy), ("chain", None)):
            likelihood = TraitLikelihood(team, known, windows)(persons, everyone)[:, :, 0]
            np.testing.assert_allclose(
                evidence[source][place].log_evidence, likelihood, rtol=1e-6, atol=1e-6
            )


def test_parts_of_the_windows_do_not_change_it(
    settings: CollectSettings, data: Demonstrations, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = found(settings, data)
    monkeypatch.setattr(identifying, "_ROWS", 12)  # three windows of four candidates
    parts = found(settings, data)
    for source in SOURCES:
        for one, other in zip(whole[source], parts[source], strict=True):
            np.testing.assert_allclose(one.log_evidence, other.log_evidence, rtol=1e-12)


def test_a_short_window_is_read_as_a_whole(settings: CollectSettings, data: Demonstrations) -> None:
    seeds, actions, alerts, length = arrays(data)
    team, policy = settings.team(PAPER_DRIVERS), Fixed(*[0.2] * 5)
    length = np.where(np.arange(len(length)) % 2, length, 3)
    assert data.truth is not None
    given = seeds, actions, alerts, length, data.truth.intended
    three, ten = evidence_by_source(team, policy, ["lisa", "bart"], *given, (3, 10))["hidden"]
    short = length == 3
    np.testing.assert_array_equal(three.log_evidence[short], ten.log_evidence[short])
    assert (three.log_evidence[~short] > ten.log_evidence[~short]).all()
    none = evidence_by_source(team, policy, ["lisa"], *(a[:0] for a in given), (3,))
    assert none["seen"][0].log_evidence.shape == (0, 1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"steps": ()}, "steps are one or more rising numbers"),
        ({"steps": (2, 2)}, r"steps are one or more rising numbers, not \[2, 2\]"),
        ({"steps": (0, 2)}, "steps is at least 1|steps lies in 1"),
        ({"intended": np.zeros((2, 3), np.int64)}, r"intended has shape \(16, 10\), not \(2, 3\)"),
        ({"intended": np.full((16, 10), 5)}, "intended actions"),
        ({"drivers": []}, "candidate"),
    ],
)
def test_bad_input_is_refused(
    settings: CollectSettings, data: Demonstrations, change: dict[str, Any], message: str
) -> None:
    assert data.truth is not None
    given = {"drivers": PAPER_DRIVERS, "intended": data.truth.intended, "steps": STEPS} | change
    seeds, actions, alerts, length = arrays(data)
    with pytest.raises(ValueError, match=message):
        evidence_by_source(
            settings.team(PAPER_DRIVERS),
            Fixed(*[0.2] * 5),
            seeds=seeds,
            actions=actions,
            alerts=alerts,
            length=length,
            **given,
        )


def test_every_source_is_explained() -> None:
    assert module.__doc__ is not None
    assert all(f"\n{source} " in module.__doc__ for source in SOURCES)
