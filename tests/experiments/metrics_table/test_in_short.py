"""Sentences about tables of every kind; the numbers of their cells are given by hand."""

from __future__ import annotations

import itertools
from types import SimpleNamespace
from typing import Any

import pytest

from hmi_marl.cli import parse
from hmi_marl.envs.config import TeamSettings
from hmi_marl.experiments.metrics_table.in_short import (
    ALIKE,
    DIFFER,
    LEARNED,
    NEXT,
    in_short,
    team_flags,
)
from hmi_marl.experiments.metrics_table.table import TableConfig, make_table

RULE = '"alert exactly when distracted"'
BEST, NOTHING, HALF = (1.0, 1.0), (0.8, 0.0), (0.75, 0.5)
"""Share of steps that follow the rule, and share of what the best alerts gain."""
Shares = tuple[float | None, float | None]


def table(rows: dict[str, Shares | dict[str, Shares]], **settings: Any) -> dict[str, str]:
    """The sentences about rows of HMIs, by title. Names with a slash are of learned policies.

    Args:
        rows: what an HMI's alerts are like, with every driver or with each.
        settings: of the table, and shortfalls of the rule by driver.
    """
    shortfall = settings.pop("shortfall", {})
    config = TableConfig(**{"drivers": ("lisa", "homer")} | settings)
    # The HMIs' names, which need not lie on this disk: only the table's own checks look for them.
    object.__setattr__(config, "hmis", tuple(rows))
    cells: list[Any] = []
    for (hmi, shares), driver in itertools.product(rows.items(), config.drivers):
        following, gain = shares[driver] if isinstance(shares, dict) else shares
        cells.append(
            SimpleNamespace(
                hmi=hmi,
                driver=driver,
                share_following_rule=following,
                share_of_gain=gain,
                rule_shortfall=shortfall.get(driver, 0.0),
                learned="/" in hmi,
            )
        )
    remarks = in_short(config, cells)
    assert [r.lead for r in remarks] == [
        t for t in (LEARNED, ALIKE, DIFFER, NEXT) if t in {r.lead for r in remarks}
    ]
    for remark in remarks:
        assert remark.text.endswith(".")
        assert remark.as_text() == f"{remark.lead}: {remark.text.replace('`', '')}"
    return {remark.lead: remark.text for remark in remarks}


def test_the_first_run_as_it_should_end() -> None:
    said = table({"NoHMI": NOTHING, "AvgHMI": BEST, "own": BEST, "runs/first": BEST})
    assert said[LEARNED] == (
        "runs/first has learned to alert exactly when the driver is distracted: it does so in "
        "100 % of the steps with every driver, and earns 100 % of what the best possible alerts "
        "gain over none with every driver."
    )
    assert said[ALIKE] == (
        f"AvgHMI, own and runs/first do the same: {RULE} is the exact optimum for all of lisa and "
        "homer, and runs/first found it; so knowing who drives gains nothing as long as their "
        "attention is seen."
    )
    assert "--no-ai-sees-attention" in said[NEXT]
    assert DIFFER not in said


def test_a_learned_hmi_that_is_nearly_there_is_told_with_its_numbers() -> None:
    almost = {"lisa": (0.9996, 0.9989), "homer": (1.0, 1.0)}
    said = table({"NoHMI": NOTHING, "own": BEST, "runs/first": almost})
    assert "99.9 % (lisa), 100 % (homer) of the steps" in said[LEARNED]
    assert "99.8 % (lisa), 100 % (homer) of what" in said[LEARNED], "rounded down, never up"
    assert "runs/first found it" in said[ALIKE]


def test_a_learned_hmi_that_missed_the_optimum_is_told_so() -> None:
    missed = {"lisa": BEST, "homer": (0.712, 0.6)}
    said = table({"NoHMI": NOTHING, "AvgHMI": BEST, "own": BEST, "runs/first": missed})
    assert said[LEARNED].startswith(
        "runs/first has not found the best possible alerts for homer: it earns 100 % (lisa), 60 % "
        f"(homer) of what those gain over no alerts, and agrees with {RULE} in 100 % (lisa), "
        "71.2 % (homer) of the steps"
    )
    assert said[ALIKE].startswith("AvgHMI and own do the same: ")
    assert "which runs/first did not find" in said[ALIKE]
    assert "found it" not in said[ALIKE]
    assert "for longer" in said[NEXT]


def test_without_two_optimal_rows_it_is_told_how_rows_differ() -> None:
    said = table({"NoHMI": NOTHING, "runs/first": HALF})
    assert ALIKE not in said
    assert said[DIFFER] == (
        "The rows earn from 0 % (NoHMI) to 50 % (runs/first) of what the best possible alerts gain "
        "over none on average over the drivers."
    )


def test_rows_that_are_alike_without_being_optimal_are_not_called_optimal() -> None:
    said = table({"random": HALF, "random:0.501": (0.75, 0.504)})
    assert said[ALIKE].startswith("All rows earn about 50.4 % of what the best possible alerts")
    assert "optimum" not in said[ALIKE]


def test_without_a_learned_row_nothing_was_learned() -> None:
    said = table({"NoHMI": NOTHING, "AvgHMI": BEST, "own": BEST})
    assert LEARNED not in said
    assert "found it" not in said[ALIKE]
    assert "hmi-marl train two-stage --hmi-for homer --out runs/homer" in said[NEXT]


def test_one_row_alone_is_not_compared() -> None:
    said = table({"own": BEST})
    assert set(said) == {NEXT}


def test_one_driver_alone_is_not_called_every_driver() -> None:
    said = table({"own": BEST, "runs/first": BEST}, drivers=("homer",))
    assert "every driver" not in said[LEARNED]
    assert said[ALIKE] == (
        f"own and runs/first do the same: {RULE} is the exact optimum for homer, and runs/first "
        "found it."
    )


def test_where_the_rule_is_not_optimal_no_sentence_says_that_it_is() -> None:
    said = table(
        {"own": (0.9, 1.0), "runs/first": (0.9, 0.995)}, shortfall={"homer": 12.345, "lisa": 1e-9}
    )
    assert "though they agree with" in said[LEARNED]
    assert "in only 90 % of the steps" in said[LEARNED]
    assert said[ALIKE] == (
        "own and runs/first come to the exact optimum for all of lisa and homer, which "
        f"{RULE} falls short of for homer by 12.3."
    )


def test_hidden_attention_is_named_and_compared_with_what_seeing_it_would_gain() -> None:
    said = table(
        {"NoHMI": NOTHING, "belief": BEST, "runs/first": HALF, "AvgHMI": BEST},
        ai_sees_attention=False,
    )
    assert "without seeing the driver's attention" in said[LEARNED]
    assert "has not found" not in said[LEARNED]
    assert "hidden here" in said[DIFFER]
    assert ALIKE not in said
    assert "hmi-marl adapt --quick" in said[NEXT]


def test_with_several_strengths_the_rule_is_of_the_strongest() -> None:
    said = table({"own": BEST, "runs/first": BEST}, alert_strengths=(0.5, 1.0))
    assert (
        "learned to give the strongest alert exactly when the driver is distracted"
        in (said[LEARNED])
    )
    assert '"give the strongest alert exactly when distracted"' in said[ALIKE]
    assert "watch" in said[NEXT], "the belief is for plain alerts alone"


def test_many_learned_hmis_are_told_in_one_sentence() -> None:
    said = table({"a/1": BEST, "a/2": BEST, "a/3": HALF, "NoHMI": NOTHING})
    assert said[LEARNED] == (
        "Of 3 learned HMIs a/1 and a/2 earn at least 99 % of what the best possible alerts gain "
        "over none; a/3 earns 50 % of it on average over the drivers."
    )
    two = table({"a/1": BEST, "a/2": HALF})
    assert two[LEARNED].count("; ") == 1


def test_where_alerts_can_gain_nothing_none_is_told_as_a_gain() -> None:
    said = table({"own": (1.0, None), "runs/first": (1.0, None)})
    assert "earns" not in said[LEARNED]
    assert ALIKE not in said
    needless = table({"own": (1.0, None), "runs/first": (0.4, None)})
    assert "has not found" in needless[LEARNED]
    assert "earns" not in needless[LEARNED]


def test_alerts_that_were_not_judged_are_not_spoken_of() -> None:
    assert set(table({"own": (None, 1.0), "runs/first": (None, None)})) == {NEXT}


def test_seven_drivers_get_a_range() -> None:
    names = tuple(f"d{k}:0.5,0.5,0.5,{k + 1}" for k in range(7))
    shares: dict[str, Shares] = {name: (1.0 - k / 1000, 1.0) for k, name in enumerate(names)}
    assert "99.4 % to 100 % of the steps" in table({"runs/first": shares}, drivers=names)[LEARNED]


@pytest.mark.parametrize(
    ("rows", "settings"),
    [
        ({"own": BEST, "runs/first": BEST}, {}),
        ({"own": BEST, "runs/first": HALF}, {}),
        ({"NoHMI": NOTHING, "own": BEST}, {"drivers": ("lisa", "mona:0.4,0.3,0.5,2")}),
        ({"runs/a run": BEST}, {"alert_window": 3, "vehicles": (2, 4), "end_at_crash": False}),
        ({"runs/first": BEST}, {"alert_strengths": (0.5, 1.0), "fatigue": (10, 2, 0.5)}),
        ({"runs/first": HALF}, {"duration": 10.0, "fatigue": (10, 2, 0.5)}),
        ({"belief": HALF}, {"ai_sees_attention": False}),
    ],
)
def test_the_command_to_try_next_is_understood(
    rows: dict[str, Shares], settings: dict[str, Any]
) -> None:
    import shlex

    _, command, *_ = table(rows, **settings)[NEXT].split("`")
    program, *arguments = shlex.split(command)
    assert program == "hmi-marl"
    parse(arguments)  # exits where it does not understand


def test_flags_are_those_that_are_not_the_default() -> None:
    assert team_flags(TeamSettings()) == []
    settings = TeamSettings(alert_window=3, end_at_crash=False, vehicles=(2, 4))
    assert team_flags(settings) == [
        "--alert-window",
        "3",
        "--no-end-at-crash",
        "--vehicles",
        "2",
        "4",
    ]


def test_a_played_table_gives_the_sentences_that_are_true_of_it() -> None:
    config = TableConfig(
        drivers=("homer",),
        hmis=("NoHMI", "when-distracted", "own"),
        episodes=4,
        duration=4.0,
        world="batched",
    )
    cells = make_table(config, workers=1)
    assert [cell.share_of_gain for cell in cells] == pytest.approx([0.0, 1.0, 1.0])
    said = {remark.lead: remark.text for remark in in_short(config, cells)}
    assert said[ALIKE].startswith(f"when-distracted and own do the same: {RULE} is the exact")
    assert set(said) == {ALIKE, NEXT}
