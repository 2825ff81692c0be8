from typing import Any

import numpy as np
import pytest

from hmi_marl.envs.drivers import PAPER_DRIVERS
from hmi_marl.experiments.adaptation.hmis import EXPECTED
from hmi_marl.experiments.criteria import GAP_DRIVERS
from hmi_marl.reporting.verdicts import Outcome
from hmi_marl.reproduction import findings
from hmi_marl.reproduction.claims import CLAIMS, Claim, claims_json, judge
from hmi_marl.reproduction.findings import kinds_apart, personalised_beats, share_apart

METRICS = ("distraction_return", "speed_return", "attention_return")


def about(mean: float, half: float = 1.0) -> dict[str, float]:
    return {"mean": mean, "low": mean - half, "high": mean + half}


def table(*changes: tuple[str, str, str, float]) -> dict[str, Any]:
    """A table in which everything is -100, but for (HMI, driver, metric, value)."""
    changed = {change[:3]: change[3] for change in changes}
    cells = [
        {"hmi": hmi, "driver": driver}
        | {metric: about(changed.get((hmi, driver, metric), -100.0)) for metric in METRICS}
        for hmi in (*PAPER_DRIVERS, "AvgHMI", "NoHMI")
        for driver in PAPER_DRIVERS
    ]
    return {"table": {"tables": {"printed": cells, "eta-1": cells}}}


def verdict(check: findings.Check, results: Any) -> Outcome:
    return check(results).outcome


def in_distraction(value: float, *cells: tuple[str, str]) -> list[tuple[str, str, str, float]]:
    return [(*cell, "distraction_return", value) for cell in cells]


def in_speed(value: float, *cells: tuple[str, str]) -> list[tuple[str, str, str, float]]:
    return [(*cell, "speed_return", value) for cell in cells]


def test_averages_differ_where_their_intervals_do_not_overlap() -> None:
    def averages(personalised: float, printed: float, eta_1: float) -> Any:
        return {
            "table": {
                "averages": {
                    variant: [
                        {"hmi": hmi, "metric": "speed_return", "ours": about(mean)}
                        for hmi, mean in (("personalised", personalised), ("average", other))
                    ]
                    for variant, other in (("printed", printed), ("eta-1", eta_1))
                }
            }
        }

    check = personalised_beats("average", "speed_return")
    assert verdict(check, averages(450.0, 440.0, 447.0)) == Outcome.SUPPORTED
    assert verdict(check, averages(450.0, 440.0, 448.5)) == Outcome.PARTLY
    assert verdict(check, averages(450.0, 450.0, 460.0)) == Outcome.NOT_SUPPORTED
    reason = check(averages(450.0, 440.0, 447.0)).reason
    assert "450 against 440 with η as printed; 450 against 447 with η = 1" in reason


def test_two_cells_of_the_paper_are_out_of_reach() -> None:
    found = findings.reachable_cells({})
    assert found.outcome == Outcome.PARTLY
    assert found.reason.startswith("10 of 12")
    assert "lisa -85 (own), bart -123 (own)" in found.reason


def test_bart_is_distracted_most_where_nobody_comes_near() -> None:
    check = findings.bart_is_distracted_most
    rows = [("bart", "bart"), ("AvgHMI", "bart"), ("NoHMI", "bart")]
    assert verdict(check, table(*in_distraction(-900.0, *rows))) == Outcome.SUPPORTED
    with_homer = in_distraction(-900.0, *rows, ("NoHMI", "homer"))
    assert verdict(check, table(*with_homer)) == Outcome.PARTLY
    assert verdict(check, table()) == Outcome.NOT_SUPPORTED


def test_the_average_hmi_helps_if_it_gains_nine_tenths_of_what_the_own_one_gains() -> None:
    check = findings.average_hmi_helps
    alone = in_distraction(-1100.0, ("NoHMI", "marge"), ("NoHMI", "homer"))
    assert verdict(check, table(*alone)) == Outcome.SUPPORTED
    short = in_distraction(-220.0, ("AvgHMI", "homer"))  # 88 %
    assert verdict(check, table(*alone, *short)) == Outcome.PARTLY


def test_where_there_is_nothing_to_gain_nothing_is_gained() -> None:
    found = findings.average_hmi_helps(table())
    assert found.outcome == Outcome.NOT_SUPPORTED
    assert "0 % of what the own HMI gains" in found.reason


def test_the_average_hmi_beats_marges_own_or_not() -> None:
    check = findings.average_beats_marges
    assert verdict(check, table()) == Outcome.NOT_SUPPORTED
    better = in_distraction(-45.0, ("AvgHMI", "marge"))
    assert verdict(check, table(*better)) == Outcome.SUPPORTED


def test_the_average_hmi_costs_speed_and_homer_more() -> None:
    check = findings.average_costs_speed
    marge, homer = in_speed(-110.0, ("AvgHMI", "marge")), in_speed(-130.0, ("AvgHMI", "homer"))
    assert verdict(check, table(*marge, *homer)) == Outcome.SUPPORTED
    assert verdict(check, table(*homer)) == Outcome.PARTLY
    assert verdict(check, table()) == Outcome.NOT_SUPPORTED


def test_everybody_but_lisa_is_slower_without_help() -> None:
    check = findings.no_help_costs_speed
    slower = in_speed(-130.0, *(("NoHMI", driver) for driver in ("marge", "bart", "homer")))
    assert verdict(check, table(*slower)) == Outcome.SUPPORTED
    lisa = in_speed(-130.0, ("NoHMI", "lisa"))
    assert verdict(check, table(*slower, *lisa)) == Outcome.PARTLY


def test_lisa_and_bart_ignore_help_and_the_others_do_not() -> None:
    check = findings.receptive_drivers
    heeding = in_distraction(-300.0, ("NoHMI", "marge"), ("NoHMI", "homer"))
    assert verdict(check, table(*heeding)) == Outcome.SUPPORTED
    bart = in_distraction(-120.0, ("NoHMI", "bart"))
    found = check(table(*heeding, *bart))
    assert found.outcome == Outcome.PARTLY
    assert "lisa 0 %, marge 67 %, bart 17 %, homer 67 %" in found.reason


def test_personal_rewards_count_in_every_table_and_with_attention_hidden() -> None:
    def hidden(gain: float) -> Any:
        rows = [
            {"driver": d, "own_minus_average": about(gain)} for d in (*PAPER_DRIVERS, "average")
        ]
        return {"hidden": {"rows": rows}}

    better = [(d, d, "attention_return", 50.0) for d in PAPER_DRIVERS]
    check = findings.personal_rewards
    assert verdict(check, table(*better) | hidden(5.0)) == Outcome.SUPPORTED
    assert verdict(check, table() | hidden(5.0)) == Outcome.PARTLY
    assert verdict(check, table() | hidden(0.5)) == Outcome.NOT_SUPPORTED


def test_caution_shows_in_headway_after_all_training() -> None:
    def rows(headway: float) -> Any:
        both = [{"time_headway": 9.0}, {"time_headway": 0.1}]
        return {"driver": {"rows": [*both, {"time_headway": 1.0}, {"time_headway": headway}]}}

    check = findings.caution_keeps_distance
    verdicts = [verdict(check, rows(headway)) for headway in (1.2, 1.1, 1.0)]
    assert verdicts == [Outcome.SUPPORTED, Outcome.PARTLY, Outcome.NOT_SUPPORTED]


# Latent traits.


def traits(
    clouds: dict[str, tuple[float, float]] | None = None,
    kl: tuple[float, float, float] = (10.0, 100.0, 100.0),
    named: tuple[float, float, float] = (0.5, 0.95, 0.95),
    exact: float = 1.0,
    from_one: float = 0.4,
) -> dict[str, Any]:
    """All three settings alike but for KL and accuracy; ``clouds`` are the drivers' centres."""
    rng = np.random.default_rng(0)
    centres = clouds or {"lisa": (0, 0), "marge": (0, 9), "bart": (9, 0), "homer": (9, 9)}
    means = np.concatenate([rng.normal(centre, 0.5, (40, 2)) for centre in centres.values()])
    drivers = [name for name in centres for _ in range(40)]

    def row(windows: int, accuracy: float) -> dict[str, Any]:
        types = {"linear_probe": about(accuracy, 0.01), "chance": 0.25}
        return {"windows": windows, "types": types, "ceilings": {"identity": about(exact, 0.01)}}

    settings = {
        name: {
            "accuracy": about(accuracy, 0.01),
            "average_kl": about(average, 0.1),
            "seeds": [
                {
                    "identified": [row(1, from_one), row(8, accuracy)],
                    "embedding": {"means": means.tolist(), "drivers": drivers},
                }
            ],
        }
        for name, average, accuracy in zip(("none", "id", "preference"), kl, named, strict=True)
    }
    return {"traits": {"pool": 8, "supervisions": settings}}


ONE_PLACE = dict.fromkeys(PAPER_DRIVERS, (0.0, 0.0))


def test_kinds_are_told_apart_by_the_nearest_centre() -> None:
    means = np.array([[0.0], [1.0], [9.0], [10.0], [4.0], [6.0]])
    drivers = ["a", "a", "b", "b", "c", "c"]
    assert share_apart(means, drivers, ["a"], ["b"]) == 1.0
    assert share_apart(means, drivers, ["a", "c"], ["b"]) == 1.0
    # Centres at 5 and 8: of a's 0 and 10, and of b's 4 and 12, one each lies by the other.
    mixed = np.array([[0.0], [10.0], [4.0], [12.0]])
    assert share_apart(mixed, ["a", "a", "b", "b"], ["a"], ["b"]) == 0.5


def test_kinds_that_lie_apart_are_supported() -> None:
    check = kinds_apart("id", ["bart"], ["homer"], "Bart against Homer")
    assert verdict(check, traits()) == Outcome.SUPPORTED
    assert verdict(check, traits(ONE_PLACE)) == Outcome.NOT_SUPPORTED
    near = ONE_PLACE | {"homer": (0.8, 0.0)}  # 79 % at 1.6 standard deviations
    assert verdict(check, traits(near)) == Outcome.PARTLY


def test_supervision_counts_if_kl_doubles() -> None:
    check = findings.supervision_counts
    assert verdict(check, traits(kl=(10.0, 20.0, 20.0))) == Outcome.SUPPORTED
    assert verdict(check, traits(kl=(10.0, 20.0, 19.0))) == Outcome.PARTLY
    assert verdict(check, traits(kl=(10.0, 5.0, 19.0))) == Outcome.NOT_SUPPORTED


def test_supervision_suffices_at_nine_of_ten() -> None:
    check = findings.supervision_suffices
    assert verdict(check, traits()) == Outcome.SUPPORTED
    assert verdict(check, traits(named=(0.5, 0.95, 0.6))) == Outcome.PARTLY


def test_structure_is_uncovered_partly_above_chance() -> None:
    check = findings.structure_uncovered
    verdicts = [verdict(check, traits(named=(share, 1.0, 1.0))) for share in (0.95, 0.5, 0.4)]
    assert verdicts == [Outcome.SUPPORTED, Outcome.PARTLY, Outcome.NOT_SUPPORTED]


def test_more_windows_are_clearer() -> None:
    check = findings.more_is_clearer
    assert verdict(check, traits()) == Outcome.SUPPORTED
    assert verdict(check, traits(from_one=0.6)) == Outcome.PARTLY
    assert "unsupervised 40 % from 1, 50 % from 8" in check(traits()).reason


def test_the_scenario_hides_who_drives_only_if_nobody_can_tell() -> None:
    check = findings.scenario_hides
    assert verdict(check, traits()) == Outcome.NOT_SUPPORTED
    assert verdict(check, traits(exact=0.9)) == Outcome.NOT_SUPPORTED  # they are told apart
    alike = {"lisa": (0, 0), "marge": (0, 0), "bart": (20, 0), "homer": (30, 0)}
    assert verdict(check, traits(alike, exact=0.9)) == Outcome.SUPPORTED
    assert verdict(check, traits(alike)) == Outcome.NOT_SUPPORTED  # they could be
    blind = traits()
    for setting in blind["traits"]["supervisions"].values():
        for row in setting["seeds"][0]["identified"]:
            row["ceilings"] = None
    assert verdict(check, blind) == Outcome.NOT_RUN


def test_separation_among_the_distracted_is_held_against_that_among_the_attentive() -> None:
    pytest.importorskip("sklearn")
    check = findings.distraction_separates
    centres = {"lisa": (0, 0), "marge": (1, 0), "bart": (20, 0), "homer": (30, 0)}
    assert verdict(check, traits(centres)) == Outcome.SUPPORTED
    other_way = {"lisa": (0, 0), "marge": (10, 0), "bart": (20, 0), "homer": (21, 0)}
    assert verdict(check, traits(other_way)) == Outcome.NOT_SUPPORTED


def test_graded_alerts_are_learned_by_all_or_some() -> None:
    check = findings.graded_alerts
    assert verdict(check, {"graded": {"rows": [{"holds": True}] * 2}}) == Outcome.SUPPORTED
    found = check({"graded": {"rows": [{"holds": True}, {"holds": False}]}})
    assert found.outcome == Outcome.PARTLY
    assert found.reason.startswith("1 of 2 HMIs")


def test_the_representation_is_useful_where_it_earns_what_knowing_is_worth() -> None:
    def shares(*earned: float | None) -> Any:
        rows = [
            {"group": who, "shares": {EXPECTED: {"3 trips": {"share": {"mean": share}}}}}
            for who, share in zip(GAP_DRIVERS, earned, strict=True)
        ]
        return {"adapt": {"results": rows}}

    check = findings.representation_is_useful
    assert verdict(check, shares(0.95, 0.9)) == Outcome.SUPPORTED
    assert verdict(check, shares(0.95, 0.6)) == Outcome.PARTLY
    assert verdict(check, shares(0.3, None)) == Outcome.NOT_SUPPORTED


# The claims.


def test_a_claim_without_its_stages_is_not_judged() -> None:
    def never(results: Any) -> Any:
        raise AssertionError

    found = Claim("somewhere", "something", ("table", "hidden"), never).judge({"table": {}})
    assert found.outcome == Outcome.NOT_RUN
    assert found.reason == "this run has no stage hidden"


def test_what_only_people_can_tell_is_said_to_be_so() -> None:
    judged = judge({})
    assert [(one.claim, one.where) for one in judged] == [(c.text, c.where) for c in CLAIMS]
    outcomes = {one.outcome for one, claim in zip(judged, CLAIMS, strict=True) if not claim.needs}
    assert outcomes == {Outcome.UNTESTABLE, Outcome.PARTLY}  # the audit needs no experiment
    content = claims_json(judged)[0]
    assert content["outcome"] == "cannot be tested here"
    assert set(content) == {"where", "claim", "needs", "outcome", "reason"}
