import json
import re
from pathlib import Path

import pytest
from simulated_reports import report

from hmi_marl.experiments.experiment import with_seed
from hmi_marl.experiments.hidden_attention import BAYES_OWN, LEARNED_OWN
from hmi_marl.reporting.blocks import Table, Verdicts
from hmi_marl.reporting.statistics import Estimate
from hmi_marl.reporting.verdicts import EPISODES, Part, Verdict
from hmi_marl.reproduction.claims import claims_json, judge
from hmi_marl.reproduction.report import NUMBERS, PAGE, exact_values, full_report, paper_items
from hmi_marl.reproduction.suite import Record, full_suite, shared_driver

RENEWED = {"table", "driver", "hidden", "adapt", "traits", "graded"}
"""Experiments that have been run again since, with other settings; docs/results.md says so."""
ADDED = {"identify"}
"""Experiments that have been added since; docs/results.md has their numbers."""
SHIPPED = Path(__file__).parents[2] / "docs" / "report"


@pytest.fixture(scope="module")
def shipped() -> dict:
    return json.loads((SHIPPED / NUMBERS).read_text("utf-8"))


@pytest.fixture(scope="module")
def numbers() -> dict:
    """Numbers that a run of today would have, made up."""
    stages = report({"id apart": 1.0}, spread=1.0)
    for row in stages["hidden"]["rows"]:
        row |= {"exact_own": 900.0, "exact_average": 890.0}
        row["attention_return"] |= {hmi: {"mean": 895.0} for hmi in (BAYES_OWN, LEARNED_OWN)}
    for setting in stages["traits"]["supervisions"].values():
        setting["average_kl"] = {"mean": 10.0}
        for row in (row for seed in setting["seeds"] for row in seed["identified"]):
            row["ceilings"]["preference"] = row["ceilings"]["identity"]
    return stages


def test_the_shipped_verdicts_are_what_the_shipped_numbers_support(shipped: dict) -> None:
    if "parts" not in shipped["claims"][0]:
        pytest.skip("the shipped report was made before verdicts had parts")
    judged = judge(shipped["stages"])
    assert claims_json(judged.claims) == shipped["claims"]
    for name, own in judged.experiments.items():
        assert [one.as_json() for one in own] == shipped["stages"][name].get("verdicts", [])


def test_the_shipped_report_is_of_a_full_run(shipped: dict) -> None:
    assert shipped["command"] == "hmi-marl reproduce"
    suite = full_suite()
    settings = {one.name: one.settings() for one in suite}
    now = json.loads(json.dumps(settings))
    changed = {name for name in now if shipped["settings"].get(name) != now[name]}
    assert changed == RENEWED | ADDED
    assert list(shipped["stages"]) == [one.name for one in suite if one.name not in ADDED]
    for name in (NUMBERS, PAGE):
        assert not re.search(r"/(home|root|tmp|work)/", (SHIPPED / name).read_text("utf-8"))


def test_the_report_needs_nothing_besides_itself(numbers: dict, tmp_path: Path) -> None:
    shown = (Table("A table of <numbers>", ("a", "b"), (("1", "2"),)),)
    suite = [one for one in full_suite() if one.name in numbers]
    records = [Record(one, numbers[one.name], shown) for one in suite]
    page = full_report(records, "hmi-marl reproduce --seed 3").write(tmp_path)
    html = page.read_text("utf-8")
    for record in records:
        assert f'<h2 id="{record.experiment.name}">' in html
        assert f'href="#{record.experiment.name}"' in html
    assert html.count("A table of &lt;numbers&gt;") == len(records)
    assert not re.search(r"<(script|link|iframe|object)|https?:|url\(", html)
    assert "prefers-color-scheme: dark" in html
    assert 'name="viewport"' in html
    for told in ("not supported", "OUT OF REACH", "The Bayes classifier", "reproduce --seed 3"):
        assert told in html
    content = json.loads((tmp_path / NUMBERS).read_text("utf-8"))
    assert [cell["paper"] for cell in content["audit"] if not cell["reachable"]] == [-85.0, -123.0]
    assert set(content["made with"]) >= {"hmi-marl", "Python", "numpy", "torch"}
    again = full_report(records, "hmi-marl reproduce --seed 3").write(tmp_path / "again")
    assert again.read_bytes() == page.read_bytes()


def test_verdicts_of_experiments_are_corrected_with_those_on_claims(
    numbers: dict, tmp_path: Path
) -> None:
    near = Part.mean("x", Estimate(2.1, 0.0, 0.0, 1.0, 10_000), EPISODES, above=0.0, seeds=1)
    own = Verdict("a criterion", (near,))
    assert own.holds, "alone"
    suite = [one for one in full_suite() if one.name in numbers]
    records = [
        Record(one, {**numbers[one.name], "verdicts": [own.as_json()]}, (Verdicts([own]),))
        for one in suite
    ]
    made = full_report(records, "hmi-marl reproduce")
    shown = [block for block in made.blocks if isinstance(block, Verdicts)]
    assert len(shown) == 1 + len(suite)
    corrections = {one.correction for block in shown for one in block.verdicts}
    assert len(corrections) == 1
    assert not any(one.holds for block in shown[1:] for one in block.verdicts)
    stage = made.numbers["stages"][suite[0].name]
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
