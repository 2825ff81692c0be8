from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from demonstrations import made_up
from trait_models import untrained

from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.agents.learned.policy import make_card, save_policy
from hmi_marl.agents.learned.situations import situations
from hmi_marl.agents.learned.trait_model import TraitModel
from hmi_marl.demonstrations.dataset import Observed
from hmi_marl.demonstrations.recording import CollectSettings, collect
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import Driver
from hmi_marl.exact.identify import Identification
from hmi_marl.experiments.latent_traits.ceiling import evidence
from hmi_marl.experiments.latent_traits.imitation import (
    action_likelihood,
    checked_pools,
    driver_latents,
    pool_latents,
)
from hmi_marl.files import json_value
from hmi_marl.reporting import statistics
from hmi_marl.reporting.statistics import Estimate

NAMES = ("lisa", "bart", "mona")


def blind(name: str, values: Any) -> Any:
    """A policy that does not read z, which comes last."""
    if name == "policy.layer0.weight":
        values[:, -2:] = 0.0
    return values


def even(name: str, values: Any) -> Any:
    """A policy that takes any action."""
    return values * (not name.startswith("policy"))


@pytest.fixture(scope="module")
def observed() -> Observed:
    """Six windows of each of three drivers, of different lengths."""
    length = [6, 4, 5, 3, 6, 2] * 3
    return made_up(length, driver=[0, 1, 2] * 6, names=NAMES).observed


def windows_of(observed: Observed, name: str) -> np.ndarray:
    return np.flatnonzero([label == name for label in observed.labels()])


POOLS = np.array([[0, 3], [6, 9], [12, 15], [1, 4], [7, 10], [2, 5], [8, 11], [14, 17]])
"""Three of lisa's, two of bart's, three of mona's."""


def by_hand(model: TraitModel, observed: Observed, judged: int, given: int) -> float:
    """Mean log-likelihood of one pool's actions with z of another, step by step."""
    z = pool_latents(model, observed, POOLS[[given]]).mean[0]
    total, steps = 0.0, 0
    for window in POOLS[judged]:
        data = (getattr(observed, name)[[window]] for name in ("states", "actions", "alerts"))
        x = situations(*data)[0]
        for t in range(observed.length[window]):
            total += model.policy(x[[t]], z)[0, observed.actions[window, t]]
            steps += 1
    return total / steps


def test_a_pool_is_the_sum_of_its_windows(observed: Observed) -> None:
    model = untrained(observed.layout)
    sums = [
        model.encoder.encode(one.states, one.actions, one.alerts, one.length)[0]
        for one in (observed.take([window]) for window in (6, 3))
    ]
    expected = model.encoder.latent(np.sum(sums, axis=0)[None])
    found = pool_latents(model, observed, [[6, 3], [1, 7]])
    np.testing.assert_allclose(found.mean[:1], expected.mean, rtol=1e-12)
    np.testing.assert_allclose(found.variance[:1], expected.variance, rtol=1e-12)


def test_a_drivers_z_is_of_all_their_windows(observed: Observed) -> None:
    unknown = replace(observed, driver=np.where(np.arange(18) < 3, -1, observed.driver))
    model = untrained(observed.layout)
    found = driver_latents(model, unknown)
    assert list(found) == list(NAMES)
    windows = windows_of(observed, "bart")[1:]
    np.testing.assert_allclose(found["bart"], pool_latents(model, unknown, [windows]).mean[0])


def test_likelihoods_by_hand(observed: Observed) -> None:
    model = untrained(observed.layout)
    lisa, bart, mona = action_likelihood(model, observed, POOLS)
    assert [(row.driver, row.pools) for row in (lisa, bart, mona)] == [
        ("lisa", 3),
        ("bart", 2),
        ("mona", 3),
    ]
    # Own z is from the pool before; others' in turn: of bart, mona, bart; of mona, lisa; ...
    for row, judged, own, other in (
        (lisa, (0, 1, 2), (2, 0, 1), (3, 6, 3)),
        (bart, (3, 4), (4, 3), (5, 1)),
        (mona, (5, 6, 7), (7, 5, 6), (0, 4, 2)),
    ):
        a, b = (
            np.array([by_hand(model, observed, j, k) for j, k in zip(judged, given, strict=True)])
            for given in (own, other)
        )
        for found, values in ((row.own, a), (row.other, b), (row.own_minus_other, a - b)):
            assert vars(found) == pytest.approx(vars(statistics.mean(values)))
        assert row.exact is None


def test_a_policy_that_does_not_read_z_is_the_same_with_any(observed: Observed) -> None:
    for row in action_likelihood(untrained(observed.layout, change=blind), observed, POOLS):
        assert row.own == row.other
        assert row.own_minus_other == statistics.Estimate(0.0, 0.0, 0.0)


def test_evidence_is_shared_out_over_steps(observed: Observed) -> None:
    # Candidates stand in another order than the names, and there are more of them.
    drivers = tuple(Driver(name, 0.5, 0.5, 0.5, 1.0) for name in ("mona", "homer", "lisa", "bart"))
    found = Identification(drivers, -np.arange(72.0).reshape(18, 4))
    model = untrained(observed.layout, change=even)
    _, bart, _ = action_likelihood(model, observed, POOLS, found)
    assert bart.own.mean == pytest.approx(-np.log(5))
    # Windows 1, 4 and 7, 10 have 4 + 6 and 4 + 6 steps; column 3 of row k is -(4k + 3).
    exact = np.array([-(7 + 19) / 10, -(31 + 43) / 10])
    assert bart.exact is not None
    assert bart.exact_minus_own is not None
    assert vars(bart.exact) == pytest.approx(vars(statistics.mean(exact)))
    assert bart.exact_minus_own.mean == pytest.approx(exact.mean() + np.log(5))


def test_only_the_true_policy_reaches_the_exact_likelihood(tmp_path: Path) -> None:
    # Who steers takes any action. So does the model's policy, which is right about a driver who is
    # never distracted, and is not about one who repeats what they did.
    card = make_card("driver", TeamConfig(), NetworkConfig((2,)), knows_traits=False)
    weights = {name: np.zeros(size, np.float32) for name, size in card.shapes.items()}
    save_policy(tmp_path, card, weights)
    drivers = ("calm:0,1,0,1", "vague:0.8,0.2,0,3")
    settings = CollectSettings(
        drivers=drivers, steps=400, duration=2.0, driver_policy=str(tmp_path), num_teams=10_000
    )
    (data,) = collect(settings)
    observed = data.observed
    pools = np.arange(80).reshape(20, 4)
    found = evidence(observed, None, drivers)
    model = untrained(observed.layout, change=even)
    calm, vague = action_likelihood(model, observed, pools, found)
    assert calm.exact_minus_own is not None
    assert vague.exact_minus_own is not None
    nothing = Estimate(0.0, 0.0, 0.0, 0.0, calm.exact_minus_own.count)
    assert vars(calm.exact_minus_own) == pytest.approx(vars(nothing), abs=1e-12)
    assert vague.exact_minus_own.low > 0.1


@pytest.mark.parametrize(
    ("pools", "message"),
    [
        ([0, 1], r"integers of shape \(P, n\), but got int64 of shape \(2,\)"),
        ([[0.0, 3.0]], "integers of shape"),
        (np.zeros((0, 2), np.int64), "integers of shape"),
        ([[0, 18]], "lie in 0 to 17"),
        ([[-1, 2]], "lie in 0 to 17"),
        ([[0, 1]], "of one driver who is known"),
        ([[0, 3], [3, 6], [1, 4], [7, 10]], "a window is in the pools twice"),
        ([[0, 3], [6, 9], [1, 4]], "two pools or more of each driver"),
        ([[0, 3], [6, 9]], "two drivers or more"),
    ],
)
def test_pools_that_do_not_fit_are_refused(observed: Observed, pools: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        action_likelihood(untrained(observed.layout), observed, pools)


def test_pools_of_nobody_are_refused(observed: Observed) -> None:
    nobody = replace(observed, driver=np.full(18, -1))
    with pytest.raises(ValueError, match="of one driver who is known"):
        checked_pools(nobody, [[0, 3]])


def test_evidence_of_others_is_refused(observed: Observed) -> None:
    model = untrained(observed.layout)
    candidates = tuple(Driver(name, 0.5, 0.5, 0.5, 1.0) for name in NAMES)
    impossible = np.where(np.arange(18)[:, None] == 7, -np.inf, np.zeros((18, 3)))
    for known, told, message in (
        (2, np.zeros((18, 2)), "mona drove, but is not among the candidates lisa, bart"),
        (3, np.zeros((17, 3)), "the evidence is of 17 windows, but there are 18"),
        (3, impossible, "by the evidence bart cannot have driven"),
    ):
        found = Identification(candidates[:known], told)
        with pytest.raises(ValueError, match=message):
            action_likelihood(model, observed, POOLS, found)


def test_it_is_told_as_json(observed: Observed) -> None:
    rows = action_likelihood(untrained(observed.layout), observed, POOLS)
    content = json_value(rows[0])
    assert (content["driver"], content["exact"]) == ("lisa", None)
    assert content["own"] == rows[0].own.as_json()
