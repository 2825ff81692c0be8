import json
from dataclasses import replace

import numpy as np
import pytest
from cited import missing

from hmi_marl.experiments.adaptation.evaluation import (
    POPULATION,
    REGRET_AT,
    WHEN,
    Result,
)
from hmi_marl.experiments.adaptation.experiment import (
    AdaptEvaluation,
    closed_parts,
    figure,
    tables,
)
from hmi_marl.experiments.adaptation.hmis import (
    ADAPTIVE,
    AVERAGE,
    CONDITIONED,
    EXPECTED,
    KNOWING,
    LEARNED_AVERAGE,
    NONE,
)
from hmi_marl.experiments.adaptation.trips import Closed
from hmi_marl.experiments.experiment import Place, conduct
from hmi_marl.reporting.blocks import Verdicts, as_text
from hmi_marl.reporting.report import Stopwatch
from hmi_marl.reporting.statistics import Estimate
from hmi_marl.reporting.verdicts import Outcome

HMIS = (KNOWING, AVERAGE, NONE, LEARNED_AVERAGE, *ADAPTIVE)
NO_SHARE = Estimate(np.nan, np.nan, np.nan)


def about(middle, half=0.1):
    return Estimate(middle, middle - half, middle + half, half / 20, 400)


def steady(name, one=0.95, three=0.98, first=1.0, learned=True):
    """Of drivers who stay; shares after one trip and three, what the first seconds are worth."""

    def shares(hmi):
        share = dict(zip(WHEN, (0.5, 0.8, one, three), strict=True))
        return {when: Closed(about(share[when]), about(50.0), about(2.0)) for when in WHEN}

    return Result(
        group=name,
        exact_worth=12.34 if name != POPULATION else None,
        returns={hmi: [about(100.0)] * 4 for hmi in HMIS},
        shares={hmi: shares(hmi) for hmi in HMIS},
        learned_shares={hmi: shares(hmi) for hmi in HMIS} if learned else {},
        first_seconds={hmi: about(first) for hmi in HMIS},
        total_regret={hmi: dict.fromkeys(REGRET_AT, about(3.0)) for hmi in HMIS},
        regret={hmi: [1.0] * 80 for hmi in HMIS},
        belief={} if name == POPULATION else {hmi: [0.5] * 80 for hmi in ADAPTIVE},
        after_change={},
    )


def changing(name, regret=0.05):
    return replace(
        steady(f"change to {name}"),
        exact_worth=None,
        shares={},
        learned_shares={},
        after_change={hmi: about(regret) for hmi in HMIS},
    )


def results(**changes):
    given = {
        "lisa": steady("lisa"),
        "bart": steady("bart"),
        "population": steady(POPULATION, learned=False),
        "change": changing("bart"),
    }
    return list((given | changes).values())


CLAIMS = [
    "lisa: 90 % of the gap closed after 1 trip",
    "lisa: 97 % of the gap closed after 3 trips",
    "bart: 90 % of the gap closed after 1 trip",
    "bart: 97 % of the gap closed after 3 trips",
    "population: 90 % of the gap closed after 1 trip",
    "population: 90 % of the gap closed after 3 trips",
    "population: 80 % of the gap closed by the HMI conditioned on z after 1 trip",
    "population: 90 % of the gap closed by the HMI conditioned on z after 3 trips",
    "lisa: first 5 s worse than AvgHMI by less than 3",
    "bart: first 5 s worse than AvgHMI by less than 3",
    "population: first 5 s worse than AvgHMI by less than 3",
    "change to bart: within 10 % of knowing after 20 s",
]


def verdicts(every):
    return {verdict.claim: verdict.holds for verdict in AdaptEvaluation().judge_of(every)}


def test_what_is_asked_of_it():
    found = verdicts(results())
    assert list(found) == CLAIMS
    assert all(found.values())


@pytest.mark.parametrize(
    ("change", "missed"),
    [
        ({"lisa": steady("lisa", one=0.89)}, CLAIMS[0]),
        ({"lisa": steady("lisa", three=0.96)}, CLAIMS[1]),
        ({"bart": steady("bart", one=0.89)}, CLAIMS[2]),
        ({"lisa": steady("lisa", first=-3.2)}, CLAIMS[8]),
        ({"change": changing("bart", regret=0.11)}, CLAIMS[11]),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_what_is_missed_is_reported(change, missed):
    found = verdicts(results(**change))
    assert [claim for claim, holds in found.items() if not holds] == [missed]
    text = as_text([Verdicts(AdaptEvaluation().judge_of(results(**change)))])
    assert f"not supported  {missed}" in text


def test_both_hmis_are_judged_for_the_population():
    given = steady(POPULATION, learned=False)
    weak = replace(given, shares=given.shares | {CONDITIONED: steady("x", one=0.79).shares[NONE]})
    found = verdicts(results(population=weak))
    assert [claim for claim, holds in found.items() if not holds] == [CLAIMS[6]]


def test_what_the_intervals_leave_open_is_undetermined():
    for change in (
        {"lisa": steady("lisa", one=0.895)},
        {"lisa": steady("lisa", first=-3.005)},
        {"change": changing("bart", regret=0.105)},
        {"lisa": without_gap("lisa")},
    ):
        judged = AdaptEvaluation().judge_of(results(**change))
        left = {one.outcome for one in judged if not one.holds}
        assert left == {Outcome.UNDETERMINED}


def test_a_gap_that_is_none_closes_nothing():
    none = replace(steady("lisa").shares[EXPECTED]["3 trips"], gap=about(-5.0))
    parts = closed_parts("lisa", none, 0.9)
    assert [part.outcome() for part in parts] == [Outcome.NOT_SUPPORTED, Outcome.SUPPORTED]


def without_gap(name):
    given = steady(name)
    none = {when: Closed(NO_SHARE, about(0.0, 3.0), about(2.0)) for when in WHEN}
    return replace(given, shares=dict.fromkeys(HMIS, none))


def test_where_there_is_no_gap_no_share_is_given():
    every = [*results(), without_gap("marge")]
    (shares,) = (t.rows for t in tables(every) if t.title.startswith("Share of the gap"))
    marge = [row for row in shares if row[0] == "marge"]
    assert len(marge) == len(ADAPTIVE)
    assert all(row[2:6] == ["no gap"] * 4 for row in marge)
    lisa = next(row for row in shares if row[:2] == ["lisa", EXPECTED])
    assert lisa[4] == "95.0 [85.0, 105.0]"
    assert "marge: first 5 s worse than AvgHMI by less than 3" in verdicts(every)
    content = json.dumps(AdaptEvaluation().numbers_of(every), allow_nan=False)
    assert json.loads(content)["results"][-1]["shares"][EXPECTED]["10 s"]["share"]["mean"] is None


def test_a_verdict_without_a_gap_gives_no_percentage():
    judged = AdaptEvaluation().judge_of(results(lisa=without_gap("lisa")))
    told = [verdict.summary for verdict in judged if verdict.claim.startswith("lisa: 9")]
    assert len(told) == 2
    assert all("share of it closed unknown" in text for text in told)


def test_tables_are_whole():
    for table in tables(results()):
        assert table.rows
        assert all(len(row) == len(table.head) for row in table.rows)
    assert not missing(tables(results()), AdaptEvaluation().numbers_of(results()))
    titles = [table.title for table in tables(results())]
    assert len(titles) == len(set(titles))


def test_the_figure_is_a_picture_that_shows_its_numbers():
    one = figure(results()).drawn
    assert one.startswith(b"\x89PNG")
    other = replace(steady("lisa"), regret={hmi: [3.0] * 80 for hmi in HMIS})
    assert figure(results(lisa=other)).drawn != one


def test_a_report_is_written(tmp_path, monkeypatch):
    monkeypatch.setattr(AdaptEvaluation, "play", lambda self, place: results())
    monkeypatch.setattr(AdaptEvaluation, "check", lambda self, place: None)
    monkeypatch.setattr(AdaptEvaluation, "settings", lambda self: {"drivers": 40})
    watch = Stopwatch()
    watch.seconds["playing"] = 12.0
    place = Place(tmp_path, tmp_path, command_line="hmi-marl adapt --quick", watch=watch)
    text = conduct(AdaptEvaluation(), place).text
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"adapt.txt", "adapt.json", "adapt.png", "index.html"}
    assert (tmp_path / "adapt.txt").read_text("utf-8") == text + "\n"
    content = json.loads((tmp_path / "adapt.json").read_text("utf-8"))
    assert [verdict["claim"] for verdict in content["verdicts"]] == CLAIMS
    assert content["command"] == "hmi-marl adapt --quick"
    assert content["settings"] == {"drivers": 40}
    assert [result["group"] for result in content["results"]] == [
        "lisa",
        "bart",
        "population",
        "change to bart",
    ]
    page = (tmp_path / "index.html").read_text("utf-8")
    assert "hmi-marl adapt --quick" in page
    for claim in CLAIMS:
        assert claim in page
        assert claim in text
