import json

import numpy as np
import pytest
from cited import missing

from hmi_marl.cli import main
from hmi_marl.envs.alerts import Fatigue
from hmi_marl.exact import oracle
from hmi_marl.experiments import graded_alerts as graded
from hmi_marl.experiments.criteria import GRADED_OPTIMUM_SHARE
from hmi_marl.experiments.graded_alerts import CASES, Case, GradedAlerts, GradedRow
from hmi_marl.reporting.blocks import as_text
from hmi_marl.reporting.statistics import Estimate
from hmi_marl.reporting.verdicts import Outcome
from hmi_marl.training.ppo.run import train

WEARY = Case("weary", "average", (0.5, 1.0), (20, 5, 1.0))
FRESH = Case("fresh", "homer", (0.5, 1.0))
TINY = GradedAlerts(hmi_steps=1, episodes=100, num_teams=8, seeds=1)


def row(learned, optimum, silent):
    estimate = Estimate(learned, learned - 1, learned + 1, 0.5, 10_000)
    return GradedRow(FRESH, estimate, estimate, optimum, 0.0, silent, 9.0, (4.0, 5.0))


def test_share_and_shortfall_by_hand():
    good = row(learned=980.0, optimum=1000.0, silent=600.0)
    assert good.shortfall == pytest.approx(0.02)
    assert good.share == pytest.approx(380 / 400)
    assert good.least == pytest.approx(970.0)
    assert good.part().outcome() is Outcome.SUPPORTED
    short = row(learned=960.0, optimum=1000.0, silent=-600.0)
    assert short.part().outcome() is Outcome.NOT_SUPPORTED
    near = row(learned=970.5, optimum=1000.0, silent=-600.0)
    assert near.part().outcome() is Outcome.UNDETERMINED
    # A loss: 3 % of -100 would be 3, but what counts is the gain over silence, 497 of 500.
    loss = row(learned=-103.0, optimum=-100.0, silent=-600.0)
    assert (loss.shortfall, loss.share) == (pytest.approx(0.03), pytest.approx(0.994))
    assert loss.least == pytest.approx(-115.0)
    assert loss.part().outcome() is Outcome.SUPPORTED
    more = row(learned=-120.0, optimum=-100.0, silent=-600.0)
    assert more.part().outcome() is Outcome.NOT_SUPPORTED
    told = good.as_json()
    assert told["case"]["strengths"] == [0.5, 1.0]
    assert told["learned"]["mean"] == 980.0
    assert (told["least"], told["shortfall"]) == (pytest.approx(970.0), pytest.approx(0.02))


def test_the_text_tells_every_case_and_whether_it_holds():
    rows = [row(980.0, 1000.0, 600.0), row(900.0, 1000.0, 600.0)]
    text = as_text(TINY.blocks_of(rows))
    assert text.count("homer, 0.5 1") == 2
    assert text.count("970.0") == 2  # the least return that is asked for
    assert [verdict.holds for verdict in TINY.judge_of(rows)] == [True, False]
    assert not missing(TINY.blocks_of(rows), TINY.numbers_of(rows))
    assert WEARY.describe() == "average, 0.5 1, fatigue 20 5 1"


def test_hmis_read_what_the_optimum_depends_on_and_no_more():
    for case in (*CASES, WEARY, FRESH):
        (phase,) = TINY.training(case).phases()
        names = ["time", "distracted", "accepted", "counter"] + ["fatigue"] * bool(case.fatigue)
        assert [name for name, _ in phase.cards[0].reads] == names
        assert phase.cards[0].alert_strengths == case.strengths
        assert phase.team == TINY.team(case)


def test_in_most_cases_the_strongest_alert_when_distracted_is_not_enough():
    # Or learning it would prove nothing.
    missed = 0
    for case in CASES:
        team = GradedAlerts().team(case)
        given = {"strengths": team.alert_strengths, "fatigue": team.fatigue}
        best = oracle.solve_alerts(case.driver, **given)
        rule = graded.strongest_alert(team.alerts, 0.0, 1.0)
        plain = oracle.evaluate(rule, case.driver, **given)
        assert plain.total_return < best.total_return
        missed += plain.total_return < GRADED_OPTIMUM_SHARE * best.total_return
    assert missed >= 3


def test_a_case_is_assessed_beside_what_is_exact(tmp_path):
    train(TINY.training(WEARY), tmp_path / WEARY.name, quiet=True)
    found = TINY.assess(WEARY, tmp_path)
    given = {"strengths": (0.5, 1.0), "fatigue": Fatigue(20, 5, 1.0)}
    best = oracle.solve_alerts("average", 7, 100, **given)
    assert found.optimum == pytest.approx(best.total_return)
    assert found.silent == pytest.approx(oracle.evaluate(0.0, "average", **given).total_return)
    assert found.silent < found.strongest < found.optimum
    assert found.optimal_alerts == pytest.approx(best.rate_by_strength.sum(axis=1))
    played, error = found.optimal_played, found.optimal_played.high - found.optimal_played.mean
    assert abs(played.mean - found.optimum) <= 2 * error  # about 4 standard errors
    assert np.isfinite(found.learned.mean)


@pytest.mark.usefixtures("trained_here")
def test_the_command_learns_writes_prints_and_goes_on(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("hmi_marl.experiments.graded_alerts.CASES", (FRESH,))
    size = ["--hmi-steps", "1", "--episodes", "4", "--num-teams", "8", "--seeds", "2"]
    arguments = ["reproduce", "graded", *size, "--workers", "1", "--out", str(tmp_path)]
    assert main(arguments) == 0
    first = capsys.readouterr().out
    assert "homer, 0.5 1" in first
    content = json.loads((tmp_path / "graded.json").read_text())
    (told,) = content["rows"]
    assert told["optimum"] == pytest.approx(
        oracle.solve_alerts("homer", strengths=(0.5, 1.0)).total_return
    )
    assert content["training_seeds"] == 2
    own = [seed["rows"][0]["learned"]["mean"] for seed in content["by_seed"]]
    assert told["learned"]["mean"] == pytest.approx(np.mean(own))
    learned = (tmp_path / "fresh" / "vehicle_ai.safetensors").read_bytes()
    assert (tmp_path / "seed-1" / "fresh" / "vehicle_ai.safetensors").read_bytes() != learned
    assert {"training fresh", "training seed-1/fresh"} <= set(content["seconds"])
    written = (tmp_path / "fresh" / "vehicle_ai.safetensors").stat().st_mtime_ns
    assert main(arguments) == 0
    again, times = capsys.readouterr().out, "Time of each part"
    assert again.partition(times)[0] == first.partition(times)[0]
    assert (tmp_path / "fresh" / "vehicle_ai.safetensors").stat().st_mtime_ns == written
    assert (tmp_path / "fresh" / "vehicle_ai.safetensors").read_bytes() == learned
    assert main(["reproduce", "graded", "--quick", "--episodes", "3"]) == 2
    assert "--quick sets the sizes itself" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_a_learned_hmi_reaches_97_percent_of_the_optimum(case, tmp_path):
    settings = GradedAlerts()
    train(settings.training(case), tmp_path / case.name, quiet=True)
    assert settings.assess(case, tmp_path).part().outcome() is Outcome.SUPPORTED
