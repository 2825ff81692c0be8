import json
import re
from pathlib import Path
from typing import Any

import pytest
import simulated_pages
from cited import missing, missing_in
from simulated_pages import COMMAND
from simulated_reports import report

from hmi_marl.cli import parse
from hmi_marl.envs.drivers import PAPER_DRIVERS
from hmi_marl.experiments.experiment import with_seed
from hmi_marl.reporting.blocks import Figure, Table, Text, Verdicts
from hmi_marl.reporting.cards import Cards, Tally
from hmi_marl.reporting.pages import PagedReport
from hmi_marl.reporting.statistics import Estimate, mean
from hmi_marl.reporting.verdicts import EPISODES, Outcome, Part, Verdict
from hmi_marl.reproduction.claims import CLAIMS, claims_json, judge
from hmi_marl.reproduction.exact_page import exact_values
from hmi_marl.reproduction.exhibits import hidden_attention, personalisation
from hmi_marl.reproduction.paper_items import paper_items
from hmi_marl.reproduction.report import NUMBERS, full_report
from hmi_marl.reproduction.suite import TIMINGS, Record, full_suite, shared_driver

SHIPPED = Path(__file__).parents[2] / "docs" / "report"


@pytest.fixture(scope="module")
def shipped() -> dict:
    return json.loads((SHIPPED / NUMBERS).read_text("utf-8"))


def test_the_shipped_verdicts_are_what_the_shipped_numbers_support(shipped: dict) -> None:
    judged = judge(shipped["stages"])
    check_alike(claims_json(judged.claims), shipped["claims"])
    for name, own in judged.experiments.items():
        check_alike([one.as_json() for one in own], shipped["stages"][name].get("verdicts", []))


def check_alike(one: Any, other: Any) -> None:
    """Compare JSON content; last bits differ from processor to processor."""
    if isinstance(one, dict):
        assert one.keys() == other.keys()
        for name, value in one.items():
            check_alike(value, other[name])
    elif isinstance(one, list | tuple):
        for each, its in zip(one, other, strict=True):
            check_alike(each, its)
    elif isinstance(one, float):
        assert one == pytest.approx(other, rel=1e-9, abs=1e-12)
    else:
        assert one == other


def test_the_shipped_report_is_of_a_full_run(shipped: dict) -> None:
    assert shipped["command"] == "hmi-marl reproduce"
    suite = full_suite()
    settings = {one.name: one.settings() for one in suite}
    assert shipped["settings"] == json.loads(json.dumps(settings))
    assert list(shipped["stages"]) == [one.name for one in suite]
    for path in SHIPPED.iterdir():
        assert not re.search(r"/(home|root|tmp|work)/", path.read_text("utf-8")), path.name


SHOWN = (
    Table("A table of <numbers>", ("a", "b"), (("1", "7"),), sources=("/extra",)),
    Figure("bars", "some bars", b"PNG", sources=("/extra",)),
)


@pytest.fixture(scope="module")
def records() -> list[Record]:
    return simulated_pages.records(SHOWN)


@pytest.fixture(scope="module")
def made(records: list[Record]) -> PagedReport:
    return full_report(records, COMMAND, {"table": {"this time": 61.4, "playing": 12.0}})


def test_pages_need_nothing_and_lead_to_each_other(
    made: PagedReport, records: list[Record], tmp_path: Path
) -> None:
    page = made.write(tmp_path)
    html = {path.name: path.read_text("utf-8") for path in tmp_path.glob("*.html")}
    names = [record.experiment.name for record in records]
    others = ("index", "claims", "exact", "made", "times")
    assert set(html) == {f"{name}.html" for name in (*others, *names)}
    for text in html.values():
        for name in html:
            assert f'<a href="{name}"' in text
        assert not re.search(r"<(script|link|iframe|object)|https?:|url\(", text)
        assert "prefers-color-scheme: dark" in text
        assert 'name="viewport"' in text
        assert "reproduce --seed 3" in text
    for name in names:
        assert "A table of &lt;numbers&gt;" in html[f"{name}.html"]
        assert f"hmi-marl reproduce {name} --seed 3" in html[f"{name}.html"]
        assert f'<h2 id="{name}">' in html["made.html"]
        assert f'href="made.html#{name}"' in html[f"{name}.html"]
    assert "not supported" in html["claims.html"]
    assert "OUT OF REACH" in html["exact.html"]
    assert "The Bayes classifier" in html["exact.html"]
    assert "61 s" in html["times.html"]
    assert page == tmp_path / "index.html"
    content = json.loads((tmp_path / NUMBERS).read_text("utf-8"))
    assert [cell["paper"] for cell in content["audit"] if not cell["reachable"]] == [-85.0, -123.0]
    assert set(content["made with"]) >= {"hmi-marl", "Python", "numpy", "torch"}


def test_all_but_durations_is_the_same_again(
    made: PagedReport, records: list[Record], tmp_path: Path
) -> None:
    made.write(tmp_path / "one")
    again = full_report(records, COMMAND, {"table": {"this time": 99.0}})
    again.write(tmp_path / "again")
    one, other = (
        {path.name: path.read_bytes() for path in (tmp_path / name).iterdir()}
        for name in ("one", "again")
    )
    assert one.keys() == other.keys()
    assert {name for name in one if one[name] != other[name]} == {"times.html", TIMINGS}


def test_every_number_is_where_its_source_says(made: PagedReport) -> None:
    assert not missing_in(made)
    kinds = [type(block) for page in made.pages for block in page.blocks]
    assert {Table, Figure, Verdicts, Tally, Cards} <= set(kinds)


def test_a_number_that_is_not_at_its_source_is_found(made: PagedReport) -> None:
    content = json.loads(json.dumps(made.content))
    content["stages"]["table"]["extra"] = [1, 8]
    content["claims"][3]["parts"][0]["value"] = 0.123
    content["exhibits"][0]["paper"] = 3.0
    found = []
    for page in made.pages[:3]:
        found += missing(page.blocks, content, page.cited.within)
    assert [each.partition(": ")[2] or each for each in found] == [
        "what personalisation is worth: 181.8 is at none of its sources",
        f"{len(CLAIMS)} claims are others",
        "7 is at none of its sources",
    ]
    lost = Table("t", ("a",), (("1",),), sources=("/stages/none",))
    with pytest.raises(ValueError, match="names nothing"):
        missing([lost], content)
    assert missing([Table("t", ("a",), (("1",),))], content)


def test_the_summary_counts_the_verdicts_and_has_three_exhibits(made: PagedReport) -> None:
    text, tally, cards = made.pages[0].blocks
    assert isinstance(text, Text)
    assert text.text.count(". ") == 1  # two sentences
    assert isinstance(tally, Tally)
    outcomes = [claim["outcome"] for claim in made.numbers["claims"]]
    assert tally.counts == {outcome: outcomes.count(outcome) for outcome in Outcome}
    assert isinstance(cards, Cards)
    assert [card.page for card in cards.cards] == ["table.html", "hidden.html", "traits.html"]
    for card, exhibit in zip(cards.cards, made.numbers["exhibits"], strict=True):
        assert re.fullmatch(r"[+-]?[\d.]+ \[[+-]?[\d.]+, [+-]?[\d.]+\]( %)?", card.value)
        assert card.figure.drawn.startswith(b"\x89PNG")
        assert card.figure.drawn_dark != card.figure.drawn
        assert exhibit["title"] == card.title
    assert "in the paper +181.8" in cards.cards[0].sentence


def test_the_first_exhibit_compares_returns_of_the_same_number_of_steps() -> None:
    own = {f"own {driver} same steps": -80.0 for driver in PAPER_DRIVERS}
    whole = {f"own {driver} exact": -700.0 for driver in PAPER_DRIVERS}
    found = personalisation(report(own | whole)["table"])
    assert found.numbers["exact"] == pytest.approx(-80.0 + 95.0)  # AvgHMI has 100 in whole trips
    assert "by the exact values of the best rules +15.0" in found.sentence


def test_the_second_exhibit_compares_worths_of_the_same_number_of_steps() -> None:
    found = hidden_attention(
        report({"bart exact worth": 139.0, "bart exact worth, whole trips": 700.0})["hidden"]
    )
    assert found.numbers == {"exact": 139.0, "least": 0.0}
    assert "By exact rules over as many steps: +139.0, and least" in found.sentence


def test_what_is_played_has_the_exact_value_of_as_many_steps_next_to_it(made: PagedReport) -> None:
    (page,) = (page for page in made.pages if page.name == "exact")
    (table,) = (
        block
        for block in page.blocks
        if isinstance(block, Table) and "worth of knowing" in block.head
    )
    for row in table.rows:
        cells = dict(zip(table.head, row, strict=True))
        assert cells["Bayes filter, own"] == "895.0\nexact 880.0"
        assert re.fullmatch(r"[-\d.]+ \[.+\]\nexact 0\.0", cells["worth of knowing"])
        assert cells["own, whole trips"] == "900.0"
    assert "the lengths that the episodes" in table.note
    assert "independent of attention" in table.note


def test_a_gain_that_never_differs_has_no_interval_of_zero_width() -> None:
    table = report()["table"]
    between = table["differences"]["printed"]["between_rows"]["own - AvgHMI"]
    assert "[" in personalisation(table).shown
    between["distraction_return"]["all"] = mean([0.0] * 9).as_json()
    found = personalisation(table)
    assert found.shown == "+0.0"
    assert "mean of four drivers, in every trip;" in found.sentence


def test_a_report_without_an_exhibits_experiment_lacks_its_card(records: list[Record]) -> None:
    some = [record for record in records if record.experiment.name in ("hidden", "graded")]
    made = full_report(some, "hmi-marl reproduce")
    (cards,) = (block for block in made.pages[0].blocks if isinstance(block, Cards))
    assert [card.page for card in cards.cards] == ["hidden.html"]
    assert not missing_in(made)


def test_commands_of_pages_are_understood(made: PagedReport) -> None:
    for page in made.pages:
        assert parse(page.cited.command.split()[1:])


def test_verdicts_of_experiments_are_corrected_with_those_on_claims() -> None:
    near = Part.mean("x", Estimate(2.1, 0.0, 0.0, 1.0, 10_000), EPISODES, above=0.0, seeds=1)
    own = Verdict("a criterion", (near,))
    assert own.holds, "alone"
    records = [
        Record(each.experiment, {**each.numbers, "verdicts": [own.as_json()]}, each.blocks)
        for each in simulated_pages.records([Verdicts([own])])
    ]
    made = full_report(records, "hmi-marl reproduce")
    blocks = [block for page in made.pages for block in page.blocks]
    shown = [block for block in blocks if isinstance(block, Verdicts)]
    assert len(shown) == 1 + len(records)
    corrections = {one.correction for block in shown for one in block.verdicts}
    assert len(corrections) == 1
    assert not any(one.holds for block in shown[1:] for one in block.verdicts)
    stage = made.numbers["stages"][records[0].experiment.name]
    assert stage["verdicts"][0]["outcome"] == "undetermined"


def test_every_table_and_figure_of_the_paper_is_told(shipped: dict) -> None:
    whole = paper_items(shipped["stages"])
    here = {row[0]: row[2] for row in whole.rows}
    assert len(here) == 4 + 4
    assert here["Table of driver parameters"] == "the same four"
    assert here["Table of rewards"] == "all eight, with the same coefficients"
    assert "average KL" in here["Figure 4, latent embeddings"]
    nothing = paper_items({})
    assert [row[0] for row in nothing.rows if row[2] == "not run"] == [
        "Figure 4, latent embeddings",
        "Table of metrics",
    ]


def test_exact_values_are_those_of_the_oracle() -> None:
    homer = next(row for row in exact_values() if row["driver"] == "homer")
    assert homer["distraction_return"] == pytest.approx(-125.98, abs=0.01)
    assert homer["reachable_distraction_return"]["least"] == pytest.approx(-800.0)


def test_a_quick_one_is_the_same_but_smaller(tmp_path: Path) -> None:
    full, quick = full_suite(), full_suite(quick=True)
    assert [one.name for one in quick] == [one.name for one in full]
    for one, other in zip(full, full_suite(seed=5), strict=True):
        assert one != other
        assert with_seed(one, 5) == other
        assert one.settings()["seed"] == 0
    assert quick[0].settings()["hmi_steps"] < full[0].settings()["hmi_steps"]
    job = full[0].driver_job(tmp_path / full[0].name)
    assert job is not None
    assert shared_driver(full, tmp_path) == job.folder
