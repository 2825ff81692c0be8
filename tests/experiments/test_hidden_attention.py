import json
from functools import partial

import numpy as np
import pytest
from cited import missing
from scripted_drivers import RevealingDriver
from standing_world import StandingWorld

from hmi_marl.agents import make_hmi
from hmi_marl.cli import main
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.streams import part_seed
from hmi_marl.exact import oracle
from hmi_marl.exact.hidden_attention import rule_return, solve_belief
from hmi_marl.experiments import experiment
from hmi_marl.experiments import hidden_attention as module
from hmi_marl.experiments.episodes import (
    evaluation_seeds,
    exact_settings,
    play_episodes,
    play_named,
)
from hmi_marl.experiments.hidden_attention import (
    BAYES_AVERAGE,
    BAYES_OWN,
    LEARNED_AVERAGE,
    LEARNED_OWN,
    NONE,
    HiddenAttention,
    HiddenRow,
)
from hmi_marl.experiments.signalling import revealing_share
from hmi_marl.reporting.blocks import as_text
from hmi_marl.reporting.statistics import Estimate
from hmi_marl.reporting.verdicts import Outcome


def row(difference, bayes=-200.0):
    """Of an HMI that is ``difference`` better than a Bayes filter that comes to ``bayes``."""
    found = Estimate(difference, difference - 0.2, difference + 0.2, 0.1, 10_000)
    hmis = (BAYES_OWN, BAYES_AVERAGE)
    return HiddenRow(
        driver="bart",
        revealing=0.3,
        attention_return={hmi: Estimate(bayes, bayes, bayes) for hmi in hmis},
        steps=dict.fromkeys(hmis, Estimate(95.5, 95.0, 96.0)),
        exact_same_steps={BAYES_OWN: -213.5, BAYES_AVERAGE: -380.0},
        played_minus_exact=dict.fromkeys(hmis, found),
        learned_minus_bayes=found,
        bayes_own_minus_average=found,
        worth_minus_exact=found,
        own_minus_bayes_average=found,
        own_minus_average=found,
        exact_own=-225.0,
        exact_average=-400.0,
    )


def test_a_learned_hmi_is_as_good_within_a_hundredth_of_the_filter():
    supported, not_supported, undetermined = Outcome
    for found, outcome in (
        (row(1.0), supported),
        (row(-1.7), supported),
        (row(-2.0), undetermined),
        (row(-2.3), not_supported),
        (row(-2.3, bayes=1000.0), supported),
    ):
        (verdict,) = HiddenAttention(seeds=1).judge_of([found])
        assert verdict.outcome is outcome


def test_the_exact_worth_of_knowing_the_driver_comes_before_the_learned_one():
    text = as_text(HiddenAttention(seeds=1).blocks_of([row(-1.7)]))
    assert text.index("exact worth of knowing") < text.index("own - AvgHMI, learned")
    assert text.index("+166.5") < text.index("+175.0")
    assert "exact -213.5" in text
    assert "95.5 steps" in text
    assert "independent of attention" in text
    numbers = HiddenAttention(seeds=1).numbers_of([row(-1.7)])
    assert numbers["rows"][0]["exact_worth"] == 175.0
    assert numbers["rows"][0]["exact_worth_same_steps"] == 166.5
    assert not missing(HiddenAttention(seeds=1).blocks_of([row(-1.7)]), numbers)


def test_a_random_driver_reveals_in_four_of_five_steps(tmp_path):
    # a^H is any of five actions; one of them is the last applied one.
    team = TeamConfig(driver="lisa", duration=10.0, ai_sees_attention=False)
    share = revealing_share(team, "random", np.arange(64, dtype=np.uint64))
    assert share == pytest.approx(0.8, abs=4 * np.sqrt(0.16 / (64 * 30)))


# One length for all that is compared.

BART = TeamConfig(driver="bart", ai_sees_attention=False)


def played(share, play):
    """Episodes with Bayes filters and without alerts; learned HMIs play like these filters."""
    hmis = {BAYES_OWN: f"belief:bart:{share}", BAYES_AVERAGE: f"belief:average:{share}"}
    found = {label: play(hmi) for label, hmi in (hmis | {NONE: "never"}).items()}
    return {LEARNED_OWN: found[BAYES_OWN], LEARNED_AVERAGE: found[BAYES_AVERAGE], **found}


def test_exact_values_are_over_the_lengths_that_each_hmi_played():
    # A car that stands crashes after 10 to 99 steps, whatever attention does.
    count, share, team = 3000, 0.4, BART
    crash_at = {hmi: 10 + (np.arange(count) * step) % 90 for hmi, step in (("a", 7), ("b", 11))}

    class Crashing(StandingWorld):
        def __init__(self, at):
            super().__init__(team.scene, count)
            self.at = at

        def step(self, actions, which):
            self.crash_next = np.full(count, len(self.actions) + 1) == self.at
            super().step(actions, which)

    def play(hmi):
        at = crash_at["b" if "average" in hmi else "a"]
        policy, driver = make_hmi(hmi, team), RevealingDriver(team, share)
        return play_episodes(team, driver, policy, np.arange(count), Crashing(at))

    row = HiddenRow.of(team, share, played(share, play))
    assert row.steps[BAYES_OWN].mean == pytest.approx(crash_at["a"].mean())
    assert row.driver == "bart"
    for hmi, found in row.played_minus_exact.items():
        assert abs(found.mean) < 4 * found.error, hmi
        assert found.mean == pytest.approx(
            row.attention_return[hmi].mean - row.exact_same_steps[hmi]
        )
    worth = row.worth_minus_exact
    assert abs(worth.mean) < 4 * worth.error
    assert worth.mean == pytest.approx(
        row.bayes_own_minus_average.mean - row.exact_worth_same_steps
    )
    # Whole trips have about twice as many steps.
    assert row.bayes_own_minus_average.mean < 0.7 * row.exact_worth
    assert row.exact_same_steps[LEARNED_OWN] == row.exact_same_steps[BAYES_OWN]
    assert row.exact_same_steps[LEARNED_AVERAGE] == row.exact_same_steps[BAYES_AVERAGE]
    for name, hmi in ((row.exact_own, "bart"), (row.exact_average, "average")):
        rule = solve_belief(hmi, team.alert_window, team.horizon, team.weights, share)
        assert name == pytest.approx(rule_return(rule, "bart", team.weights))


def test_with_the_rule_based_driver_what_is_played_is_exact_over_as_many_steps():
    # Its crashes do depend on attention and its revelations on each other, though hardly.
    count = 500
    seeds = part_seed(evaluation_seeds(count), 1)
    share = revealing_share(BART, "rule", seeds)
    row = HiddenRow.of(BART, share, played(share, lambda hmi: play_named(BART, "rule", hmi, count)))
    assert 90 < row.steps[NONE].mean < 98
    for hmi, found in row.played_minus_exact.items():
        assert abs(found.mean) < 4 * found.error, hmi
    none = row.attention_return[NONE]
    whole = oracle.evaluate(0.0, **exact_settings(BART)).total_return
    assert none.mean - whole > 4 * none.error, "crashes make trips shorter"
    error = row.worth_minus_exact.error
    assert abs(row.worth_minus_exact.mean) < 4 * error
    assert row.exact_worth - row.exact_worth_same_steps > 5.0


@pytest.mark.usefixtures("trained_here")
@pytest.mark.parametrize("given", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_the_command_compares_learned_hmis_with_bayes_filters(given, tmp_path, capsys, monkeypatch):
    for owner, name in ((experiment, "TwoStage"), (module, "TwoStage"), (module, "TeamConfig")):
        monkeypatch.setattr(owner, name, partial(getattr(owner, name), duration=2.0))
    size = ["--hmi-steps", "1", "--driver-steps", "1", "--rnn-hidden-dim", "4", "--episodes", "4"]
    size += ["--num-teams", "16", "--seeds", "1"]
    command = ["reproduce", "hidden", *size, "--workers", "1"]
    if given:
        made = [
            "train",
            "two-stage",
            "--num-teams",
            "16",
            "--duration",
            "2",
            "--driver-steps",
            "1",
            "--hmi-steps",
            "1",
        ]
        assert main([*made, "--out", str(tmp_path / "driver-run")]) == 0
        command += ["--driver-run", str(tmp_path / "driver-run")]
    assert main([*command, "--out", str(tmp_path)]) == 0
    content = json.loads((tmp_path / "hidden.json").read_text())
    drivers = [row["driver"] for row in content["rows"]]
    assert drivers == ["lisa", "marge", "bart", "homer", "average"]
    assert "Paired differences" in capsys.readouterr().out
