import numpy as np
import pytest

from hmi_marl.envs.drivers import DRIVERS
from hmi_marl.envs.rewards import RewardWeights
from hmi_marl.exact import oracle
from hmi_marl.experiments.driver_map.cases import (
    AVERAGE,
    PAPER,
    WEIGHTS,
    WHEN_DISTRACTED,
    Case,
    Grid,
    climb,
    solve_case,
)

SMALL = Grid(1, 3, (0.1, 0.505))


def test_the_midpoint_rule_by_hand():
    # One cell and 3: middles 1/6, 1/2, 5/6. Of β²: coarse 1/4; fine (1 + 9 + 25) / 36 / 3 = 35/108.
    beta, _, eta = SMALL.middles.T
    assert sorted(set(beta)) == pytest.approx([1 / 6, 1 / 2, 5 / 6])
    assert sorted(set(eta)) == pytest.approx([k / 12 for k in (1, 3, 5, 7, 9, 11)])
    assert SMALL.integral(eta).value == pytest.approx(0.5)
    found = SMALL.integral(beta**2)
    assert found.value == pytest.approx(35 / 108)
    assert found.error == pytest.approx(35 / 108 - 1 / 4)
    assert abs(found.value - 1 / 3) < found.error
    # A share: β > 0.4 holds for two of three middles, and for the one of the coarse rule.
    share = SMALL.integral(beta > 0.4)
    assert (share.value, share.error) == (pytest.approx(2 / 3), pytest.approx(1 / 3))


def test_what_is_left_of_the_error_is_about_a_ninth_of_it_where_the_integrand_is_smooth():
    grid = Grid(4, 2, (0.1,))
    beta, alpha, eta = grid.middles.T
    found = grid.integral(np.exp(beta - 2 * alpha) * np.cos(eta))
    exact = (np.e - 1) * (1 - np.exp(-2.0)) / 2 * np.sin(1.0)
    assert 0.08 * found.error < abs(found.value - exact) < 0.16 * found.error


def test_slices_are_in_the_order_of_eta_beta_alpha():
    points = SMALL.slices.reshape(2, 3, 3, 3)
    assert points[1, 2, 0].tolist() == [1.0, 0.0, 0.505]  # β, α and η of [η, β, α]
    assert points[0, 1, 2].tolist() == [0.5, 1.0, 0.1]


def test_the_highest_point_is_found_along_a_ridge_and_at_an_edge():
    def ridge(points):
        beta, alpha, eta = points.T
        return -np.abs(beta - eta) - (beta - 0.3) ** 2 - alpha

    most, where = climb(ridge, np.array([0.8, 0.5, 0.8]), 0.1)
    assert most == pytest.approx(0.0, abs=1e-6)
    assert where == pytest.approx([0.3, 0.0, 0.3], abs=1e-3)


def test_losses_are_those_of_the_oracle():
    case = Case(5, "distraction costs 3 x", 12)
    found = solve_case(case, SMALL, threads=1)
    given = 5, 12, RewardWeights(distraction=-30.0)
    rule = np.arange(2.0).reshape(1, 2, 1, 1)
    for name, loss in found.losses[WHEN_DISTRACTED].named.items():
        best = oracle.solve_alerts(name, *given).total_return
        assert loss == pytest.approx(best - oracle.evaluate(rule, name, *given).total_return)
    assert max(found.losses[WHEN_DISTRACTED].named.values()) > 0.1
    assert found.losses[AVERAGE].named["average"] == 0.0
    flat = np.array(found.losses[WHEN_DISTRACTED].slices)
    inner = case.losses(SMALL.middles, 1)[WHEN_DISTRACTED]
    assert flat.shape == (2, 3, 3)
    assert found.losses[WHEN_DISTRACTED].most >= max(flat.max(), inner.max())
    assert found.losses[WHEN_DISTRACTED].mean.value == pytest.approx(inner.mean())
    average = DRIVERS["average"].traits
    assert flat[1, 1, 1] == pytest.approx(found.losses[WHEN_DISTRACTED].named["average"])
    assert SMALL.slices.reshape(2, 3, 3, 3)[1, 1, 1].tolist() == list(average[:3])


def test_with_attention_hidden_the_average_driver_loses_nothing_to_its_own_rule():
    found = solve_case(Case(3, PAPER, 10, 0.5), SMALL, threads=1)
    assert list(found.losses) == [AVERAGE]
    assert found.losses[AVERAGE].named["average"] == pytest.approx(0.0, abs=1e-9)
    assert found.losses[AVERAGE].named["bart"] > 1.0


def test_every_case_has_a_file_of_its_own():
    cases = [Case(n, w, 100, share) for n in (1, 11) for w in WEIGHTS for share in (None, 0.1, 1.0)]
    assert len({case.name for case in cases}) == len(cases)


def test_in_two_percent_of_a_uniform_population_another_rule_is_best():
    """The paper's weights, N = 7, 100 steps: the number that the documentation quotes."""
    grid = Grid(5, 2, (0.1,))
    values = Case(7, PAPER, 100).losses(grid.middles, 1)[WHEN_DISTRACTED]
    assert grid.integral(values > 1e-6).value == pytest.approx(0.0227, abs=1e-4)
    assert values.max() == pytest.approx(276.7, abs=0.1)  # of these; elsewhere it is more
    assert Case(7, PAPER, 100).losses(np.array([[0.0363, 0.0, 0.0363]]), 1)[WHEN_DISTRACTED] > 612
    beta, alpha, eta = grid.middles[values > 1e-6].T
    assert max(alpha.max(), beta.max()) < 0.8
    assert np.median(alpha) < 0.2
    assert eta.max() < 0.6
