import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.agents.learned.policy import LearnedPolicy, make_card
from hmi_marl.envs.alerts import Fatigue
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.rewards import TERMS
from hmi_marl.envs.streams import episode_seed
from hmi_marl.exact import oracle
from hmi_marl.exact.oracle import solve_alerts
from hmi_marl.experiments.episodes import Episodes
from hmi_marl.experiments.metrics_table.table import (
    Cell,
    TableConfig,
    known_rule,
    make_cell,
    make_table,
    play_cell,
)
from hmi_marl.files import json_value, write_json

ESTIMATES = ("steps", "speed_return", "distraction_return", "attention_return", "min_time_headway")


def tiny(**settings: Any) -> TableConfig:
    small = {"drivers": ("homer",), "hmis": ("own",), "episodes": 1}
    return TableConfig(**{**small, "duration": 2.0, "vehicles": (1, 3), **settings})


def some_episodes(length: list[int], **given: list[float]) -> Episodes:
    count = len(length)
    return Episodes(
        seeds=np.arange(count, dtype=np.uint64),
        length=np.array(length),
        crashed=np.array(given.get("crashed", [False] * count), np.bool_),
        alerts=np.array(given.get("alerts", [0] * count)),
        distracted=np.zeros(count, np.int64),
        min_time_headway=np.array(given.get("headway", [1.0] * count)),
        median_time_headway=np.full(count, 2.0),
        returns={name: np.array(given.get(name, [0.0] * count)) for name in TERMS},
    )


@pytest.fixture(scope="module")
def config() -> TableConfig:
    return tiny(drivers=("homer", "lisa"), hmis=("NoHMI", "AvgHMI", "own"), episodes=5)


@pytest.fixture(scope="module")
def progress_seen() -> list[int]:
    return []


@pytest.fixture(scope="module")
def cells(config: TableConfig, progress_seen: list[int]) -> list[Cell]:
    return make_table(config, workers=1, progress=progress_seen.append)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"drivers": ("homer", "moe")}, "unknown driver 'moe'; known: lisa, marge"),
        ({"hmis": ("own", "siren")}, "unknown HMI 'siren'; hmi-marl --help lists all"),
        ({"driver_policy": "autopilot"}, r"unknown driver policy 'autopilot'; known: rule"),
        ({"episodes": 0}, "episodes lies in 1 to .*, but got 0"),
        ({"seed": -1}, r"a seed lies in \[0, 2\^64\), but got -1"),
        ({"world": "moon"}, "unknown world 'moon'; known: highway"),
        ({"drivers": ("Homer", "lisa", "homer")}, "drivers names 'homer' twice"),
        ({"hmis": ("own", "AvgHMI", "avghmi")}, "hmis names 'avghmi' twice"),
        ({"drivers": ()}, "at least one driver and one HMI"),
        ({"hmis": ()}, "at least one driver and one HMI"),
        ({"hmis": ("random:2",)}, r"an alert rate lies in \[0, 1\], but got 2"),
        ({"hmis": ("random:often",)}, "takes a number"),
        ({"hmis": ("optimal:moe",)}, "unknown driver 'moe'"),
        ({"hmis": ("when-distracted",), "ai_sees_attention": False}, "use 'belief'"),
        ({"alert_window": 0}, "alert_window lies in 1 to"),
        ({"duration": 0.3}, "not a whole number of steps"),
        ({"vehicles": (5, 1)}, "runs backwards"),
    ],
)
def test_errors_are_told_at_the_door(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        TableConfig(**settings)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"drivers": "homer"}, "drivers takes a tuple of names, not 'homer'"),
        ({"hmis": "own"}, "hmis takes a tuple of names, not 'own'"),
        ({"hmis": ("own", 3)}, "hmis takes a tuple of names"),
        ({"episodes": 2.0}, r"episodes is a whole number, not 2\.0"),
        ({"episodes": True}, "episodes is a whole number, not True"),
        ({"seed": 1.0}, r"a seed is an integer, not 1\.0"),
    ],
)
def test_values_of_another_kind_are_told_at_the_door(
    settings: dict[str, Any], message: str
) -> None:
    with pytest.raises(TypeError, match=message):
        TableConfig(**settings)


def test_the_last_seed_of_all_can_be_played() -> None:
    assert tiny(seed=2**64 - 1, episodes=1).seed == 2**64 - 1
    assert tiny(seed=2**64 - 2, episodes=3).seed == 2**64 - 2


@pytest.mark.parametrize("workers", [0, -3])
def test_no_workers_are_refused(workers: int) -> None:
    with pytest.raises(ValueError, match=f"workers lies in 1 to .*, but got {workers}"):
        make_table(tiny(), workers=workers, progress=lambda _: pytest.fail("it has begun"))


def test_the_default_table_is_the_papers() -> None:
    config = TableConfig()
    assert config.drivers == ("lisa", "marge", "bart", "homer")
    assert {"NoHMI", "AvgHMI", "own"} <= set(config.hmis)
    assert config.team("bart").horizon == 100
    assert config.team("bart").alert_window == 7


@pytest.mark.usefixtures("unmeasured")
@pytest.mark.slow
def test_the_result_does_not_depend_on_the_number_of_workers(
    config: TableConfig, cells: list[Cell]
) -> None:
    assert make_table(config, workers=2) == cells


def test_cells_come_row_by_row(cells: list[Cell]) -> None:
    assert [(cell.hmi, cell.driver) for cell in cells] == [
        (hmi, driver) for hmi in ("NoHMI", "AvgHMI", "own") for driver in ("homer", "lisa")
    ]


def test_progress_sums_up_to_all_episodes(
    config: TableConfig, cells: list[Cell], progress_seen: list[int]
) -> None:
    assert sum(progress_seen) == config.episodes * len(cells)
    assert min(progress_seen) >= 1


def test_a_table_plays_the_series_of_its_seed() -> None:
    config = tiny(seed=7, episodes=6)
    (cell,) = make_table(config, workers=1)
    episodes = play_cell(config, "homer", "own", range(6))
    assert episodes.seeds.tolist() == episode_seed(7, np.arange(6)).tolist()
    assert cell == make_cell(config, "homer", "own", episodes)
    (other,) = make_table(tiny(seed=107, episodes=6), workers=1)
    assert other != cell


@pytest.mark.parametrize("driver", ["homer", "lisa"])
def test_exact_returns_are_the_oracles(cells: list[Cell], driver: str) -> None:
    exact = {c.hmi: c.exact_distraction_return for c in cells if c.driver == driver}
    optimum = oracle.solve_alerts(driver, 7, 10)
    averaged = oracle.solve_alerts("average", 7, 10).policy
    assert exact["own"] == oracle.evaluate(optimum.policy, driver, 7, 10).distraction_return
    assert exact["AvgHMI"] == oracle.evaluate(averaged, driver, 7, 10).distraction_return
    assert exact["NoHMI"] == oracle.evaluate(0.0, driver, 7, 10).distraction_return
    for cell in cells:
        if cell.driver == driver:
            assert cell.optimal_distraction_return == optimum.distraction_return
            reachable = oracle.reachable_by_steps(driver, 7, 10)
            reach = cell.reachable_distraction_return_same_steps
            assert cell.steps.mean <= 10
            assert reachable[10, 0] <= reach.least <= reach.most <= reachable[1, 1]
            if cell.steps.low == cell.steps.high == 10:
                assert reach == pytest.approx(oracle.reachable(driver, 7, 10))


def test_the_window_and_the_duration_reach_the_exact_returns() -> None:
    config = tiny(alert_window=2, duration=3.0)
    cell = make_cell(config, "marge", "own", some_episodes([15]))
    own = oracle.solve_alerts("marge", window=2, horizon=15)
    assert cell.exact_distraction_return == own.distraction_return
    assert own.distraction_return != oracle.solve_alerts("marge", 7, 15).distraction_return


def test_without_help_homer_loses_eight_a_step() -> None:
    # p(d = 1) is 0.8 after one step, and stays there: 0.8 (1 - 0.2) + 0.2 0.8
    cell = make_cell(tiny(), "homer", "NoHMI", some_episodes([10, 5]))
    assert cell.exact_distraction_return == pytest.approx(-80.0)
    assert cell.exact_distraction_return_same_steps == pytest.approx(-60.0)


@pytest.mark.parametrize(
    ("hmi", "sees"), [("belief", True), ("belief:lisa", True), ("belief", False), ("own", False)]
)
def test_an_hmi_on_the_belief_has_no_exact_return(hmi: str, sees: bool) -> None:
    config = tiny(hmis=(hmi,), ai_sees_attention=sees)
    cell = make_cell(config, "homer", hmi, some_episodes([10]))
    assert cell.exact_distraction_return is None
    assert cell.exact_distraction_return_same_steps is None
    assert cell.optimal_distraction_return == pytest.approx(-18.959998976)


def test_a_cell_sums_up_its_episodes_by_hand() -> None:
    episodes = some_episodes(
        [10, 5],
        crashed=[False, True],
        alerts=[3, 1],
        headway=[1.5, np.inf],
        speed_reward=[50.0, 20.0],
        distraction=[-20.0, -40.0],
        alert=[10.0, 20.0],
        accept_alert=[30.0, 60.0],
    )
    cell = make_cell(tiny(), "homer", "own", episodes)
    assert cell.episodes == 2
    assert cell.steps.mean == 7.5
    assert cell.speed_return.mean == 35.0
    assert cell.distraction_return.mean == -30.0
    assert cell.attention_return.mean == (20.0 + 40.0) / 2
    # 3 alerts in 2 s are 90 a minute, 1 in 1 s is 60
    assert cell.alerts.mean == pytest.approx(75.0)
    assert cell.crash_rate.mean == 0.5
    assert cell.min_time_headway.mean == 1.5
    # Student's t with one degree of freedom would go far below
    assert cell.alerts.low == cell.steps.low == 0.0
    assert cell.speed_return.low < 0.0


def test_a_cell_as_json_has_the_promised_keys(cells: list[Cell]) -> None:
    for cell in cells:
        content = json.loads(json.dumps(cell.as_json(), allow_nan=False))
        assert content["driver"] == cell.driver
        assert content["hmi"] == cell.hmi
        assert content["episodes"] == 5
        for name in ESTIMATES:
            fields = {"mean", "low", "high", "error", "count", "luck", "luck_count"}
            assert content[name].keys() == fields
        assert content["speed_return"] == vars(cell.speed_return)
        assert content["distraction_return"] == vars(cell.distraction_return)
        assert content["alerts"] == cell.alerts.mean
        assert content["alerts_interval"] == [cell.alerts.low, cell.alerts.high]
        assert content["crash_rate"] == cell.crash_rate.mean
        assert content["crash_rate_interval"] == [cell.crash_rate.low, cell.crash_rate.high]
        assert content["exact_distraction_return"] == cell.exact_distraction_return
        least, most = cell.reachable_distraction_return_same_steps
        assert content["reachable_distraction_return_same_steps"] == {"least": least, "most": most}


def test_what_is_not_known_is_null_in_json(tmp_path: Path) -> None:
    cell = make_cell(
        tiny(hmis=("belief",)), "homer", "belief", some_episodes([10], headway=[np.inf])
    )
    write_json(tmp_path / "cell.json", cell.as_json())
    content = json.loads((tmp_path / "cell.json").read_text())
    nothing = {"low": None, "high": None, "error": None, "luck": 0.0, "luck_count": 0}
    assert content["min_time_headway"] == {"mean": None, "count": 0, **nothing}
    assert content["speed_return"] == {"mean": 0.0, "count": 1, **nothing}
    assert content["alerts"] == 0.0
    assert content["alerts_interval"] == [None, None]
    assert content["exact_distraction_return"] is None


def test_alerts_and_crashes_of_a_played_table_make_sense(cells: list[Cell]) -> None:
    found = {(cell.hmi, cell.driver): cell for cell in cells}
    assert found["NoHMI", "homer"].alerts.mean == 0.0
    assert found["own", "homer"].alerts.mean > 0.0
    for cell in cells:
        assert cell.steps.mean <= 10
        assert 0.0 < cell.speed_return.mean <= 5.0 * 10
        least, most = cell.reachable_distraction_return_same_steps
        assert least <= cell.optimal_distraction_return <= most


def learned_hmi(config: TeamConfig, **training: Any) -> LearnedPolicy:
    card = make_card("vehicle_ai", config, NetworkConfig((4,)), knows_traits=True)
    weights = {name: np.zeros(shape, np.float32) for name, shape in card.shapes.items()}
    return LearnedPolicy(dataclasses.replace(card, training=training), weights, config)


def test_a_learned_hmi_should_have_become_the_optimum_for_whom_it_was_trained() -> None:
    team = TeamConfig(driver="homer")
    for_lisa = {"team": json_value(TeamConfig(driver="lisa"))}
    lisas, homers = (solve_alerts(name).policy for name in ("lisa", "homer"))
    rule = known_rule(learned_hmi(team, **for_lisa), team)
    np.testing.assert_array_equal(rule, lisas)
    for_both = {"team": json_value(TeamConfig(driver=["lisa", "homer"]))}
    np.testing.assert_array_equal(known_rule(learned_hmi(team, **for_both), team), homers)


def test_a_learned_hmi_that_does_not_see_attention_has_no_known_rule() -> None:
    team = TeamConfig(driver="homer", ai_sees_attention=False)
    assert known_rule(learned_hmi(team), team) is None


def test_the_optimal_attention_return_is_over_as_many_steps_as_the_episodes() -> None:
    config = TableConfig(drivers=("homer",), hmis=("never",), episodes=2)
    cell = make_cell(config, "homer", "never", some_episodes([1, 100]))
    best = solve_alerts("homer")
    first_step = -10 * 0.8 + 10  # attentive before: not alerting earns 10
    assert best.return_after(1) == pytest.approx(first_step)
    expected = (first_step + best.total_return) / 2
    assert cell.optimal_attention_return_same_steps == pytest.approx(expected)


def test_exact_values_are_those_of_the_alerts_that_there_are() -> None:
    config = TableConfig(
        drivers=("homer",),
        hmis=("own", "always"),
        episodes=2,
        alert_strengths=(0.5, 1.0),
        fatigue=(20, 5, 1.0),
    )
    given = {"strengths": (0.5, 1.0), "fatigue": Fatigue(20, 5, 1.0)}
    best = solve_alerts("homer", **given)
    cell = make_cell(config, "homer", "own", some_episodes([100, 100]))
    assert cell.optimal_attention_return_same_steps == pytest.approx(best.total_return)
    assert cell.exact_distraction_return == pytest.approx(best.distraction_return)
    always = make_cell(config, "homer", "always", some_episodes([100, 100]))
    assert always.exact_distraction_return is not None
    assert always.exact_distraction_return < best.distraction_return


def test_a_learned_hmi_of_other_alerts_has_no_known_rule() -> None:
    team = TeamConfig(driver="homer")
    plain = json_value(team)
    np.testing.assert_array_equal(
        known_rule(learned_hmi(team, team=plain), team), solve_alerts("homer").policy
    )
    without = {name: value for name, value in plain.items() if name != "alert_strengths"}
    assert known_rule(learned_hmi(team, team=without), team) is None
    weary = TeamConfig(driver="homer", fatigue=Fatigue())
    assert known_rule(learned_hmi(weary, team=plain), weary) is None
    rule = known_rule(learned_hmi(weary, team=json_value(weary)), weary)
    np.testing.assert_array_equal(rule, solve_alerts("homer", fatigue=Fatigue()).policy)
