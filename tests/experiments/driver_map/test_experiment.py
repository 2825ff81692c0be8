import json
from dataclasses import replace
from pathlib import Path

import pytest
from cited import missing

from hmi_marl.cli import main
from hmi_marl.envs.drivers import DRIVERS
from hmi_marl.experiments.driver_map.cases import (
    ALWAYS_WHEN_DISTRACTED,
    AVERAGE,
    NO_PREVENTION,
    PAPER,
    WEIGHTS,
    WHEN_DISTRACTED,
    Case,
    CaseResult,
    Grid,
    Integral,
    Loss,
)
from hmi_marl.experiments.driver_map.experiment import DriverMap
from hmi_marl.experiments.registry import EXPERIMENTS
from hmi_marl.reporting.blocks import Figure, as_text
from hmi_marl.reporting.verdicts import Outcome, judged_together
from hmi_marl.typed_json import read_as

SHIPPED = Path(__file__).parents[3] / "docs" / "map"

TINY = [
    *("--windows", "2", "7", "--shares", "0.0", "0.35", "--etas", "0.01", "0.505"),
    *("--horizon", "6", "--seen-cells", "1", "--hidden-cells", "1", "--points", "3"),
]


def loss(most=0.0, share=0.0, **named):
    drivers = dict.fromkeys(DRIVERS, 0.0) | named
    share, mean = Integral(share, 0.001), Integral(most / 10, 0.01)
    layer = ((0.0, most), (0.0, 0.5))
    return Loss(mean, share, share, most, (0.1, 0.0, 0.1), drivers, (layer, layer))


def results(settings, seen=None, hidden=None):
    grid = Grid(1, 2, (0.01, 1.0))
    rules = WHEN_DISTRACTED, AVERAGE, NO_PREVENTION, ALWAYS_WHEN_DISTRACTED
    seen, hidden = seen or loss(), hidden or loss()
    made = [CaseResult(case, grid, dict.fromkeys(rules, seen)) for case in settings.seen]
    return made + [CaseResult(case, grid, {AVERAGE: hidden}) for case in settings.hidden]


def outcomes(settings, **losses):
    return [verdict.outcome for verdict in settings.judge(results(settings, **losses))]


def test_verdicts_turn_with_the_losses():
    settings = DriverMap()
    good, bad = Outcome.SUPPORTED, Outcome.NOT_SUPPORTED
    assert outcomes(settings) == [good, good, bad]
    assert outcomes(settings, seen=loss(279.0, 0.023)) == [good, bad, bad]
    assert outcomes(settings, seen=loss(279.0, 0.023, bart=0.1)) == [bad, bad, bad]
    worth = {"lisa": 22.4, "marge": 7.0, "bart": 177.7}
    assert outcomes(settings, hidden=loss(800.0, 0.9, **worth))[2] is bad
    assert outcomes(settings, hidden=loss(800.0, 0.9, **worth, homer=1.1))[2] is good
    verdict = settings.judge(results(settings, seen=loss(279.0, 0.023)))[1]
    assert "largest loss per trip 279" in verdict.summary
    assert "2.3 ± 0.1 % of a uniform population" in verdict.summary


def test_every_problem_is_in_a_table_and_every_figure_is_drawn():
    settings = DriverMap(windows=(1, 7), shares=(0.0, 0.35, 1.0))
    found = results(settings, loss(279.0, 0.023), loss(800.0, 0.9, bart=177.7))
    blocks = settings.blocks(found)
    assert not missing(blocks, settings.numbers(found))
    text = as_text(blocks)
    assert text.count("279 (0.1, 0, 0.1)") == 2 * len(WEIGHTS)
    assert text.count("177.7") == len(settings.hidden) == 3 + 1 + len(WEIGHTS) - 1
    figures = [block for block in blocks if isinstance(block, Figure)]
    assert len(figures) == 3
    assert all(figure.drawn.startswith(b"\x89PNG") for figure in figures)


def test_what_varies_alone_is_not_solved_twice():
    settings = DriverMap()
    hidden = settings.hidden
    assert len(set(hidden)) == len(hidden)
    assert Case(7, PAPER, 100, 0.35) in hidden
    assert len(hidden) == len(settings.shares) + len(settings.windows) - 1 + len(WEIGHTS) - 1
    assert len(settings.seen) == len(settings.windows) * len(WEIGHTS)


@pytest.mark.parametrize(
    "wrong", [{"windows": ()}, {"shares": (0.1, 0.1)}, {"etas": ()}, {"points": 1}]
)
def test_nothing_to_map_is_refused(wrong):
    with pytest.raises(ValueError, match="|".join(wrong)):
        DriverMap(**wrong)


def test_the_command_solves_writes_prints_and_goes_on(tmp_path, capsys, request):
    arguments = ["reproduce", "map", *TINY, "--workers", "2", "--out", str(tmp_path)]
    assert main(arguments) == 0
    first, before = capsys.readouterr().out, (tmp_path / "map.json").read_bytes()
    assert "Attention hidden" in first
    content = json.loads(before)
    solved = sorted((tmp_path / "cases").glob("*.json"))
    assert len(content["cases"]) == len(solved) == 2 * len(WEIGHTS) + 2 + 1 + 3
    assert "slices" not in content["cases"][0]["losses"][AVERAGE]
    assert content["settings"]["weights"][PAPER]["accept_alert"] == 30.0
    assert {path.name for path in tmp_path.glob("*.png")} == {
        "map-seen.png",
        "map-hidden.png",
        "map-curves.png",
    }
    # The next time one of them is damaged, and one is of another version: both are solved again.
    damaged, other = solved[:2]
    good = damaged.read_bytes()
    damaged.write_bytes(good.replace(b"0.", b"1.", 1))
    older = json.loads(other.read_bytes())
    older["about"]["version"] = "0.0.0"
    other.write_text(json.dumps(older))
    written = {path: path.stat().st_mtime_ns for path in solved}
    request.getfixturevalue("undrawn")  # a second time
    assert main(arguments) == 0
    again = json.loads((tmp_path / "map.json").read_bytes())
    assert again["cases"] == content["cases"]
    assert again["verdicts"] == content["verdicts"]
    assert damaged.read_bytes() == good
    changed = {path for path in solved if path.stat().st_mtime_ns != written[path]}
    assert changed == {damaged, other}
    assert main(["reproduce", "map", "--quick", "--points", "3"]) == 2
    assert "--quick sets the sizes itself" in capsys.readouterr().err


def test_the_map_needs_no_extra_and_no_trained_driver():
    where = EXPERIMENTS["map"].value
    assert where.needs == ()
    assert where.load("map") is DriverMap
    assert not DriverMap.uses_driver


def test_other_sizes_are_other_results():
    quick = DriverMap.quick()
    assert replace(quick, points=3).settings() != quick.settings()


def test_the_shipped_map_is_judged_by_the_rule_of_all_reports():
    shipped = json.loads((SHIPPED / "map.json").read_text("utf-8"))
    settings = DriverMap()
    assert shipped["settings"] == json.loads(json.dumps(settings.settings()))
    for case in shipped["cases"]:
        for each in case["losses"].values():
            each["slices"] = []  # which are not shipped
    kept = [read_as(CaseResult, case) for case in shipped["cases"]]
    assert [result.case for result in kept] == settings.seen + settings.hidden
    verdicts = judged_together(settings.judge(kept))
    assert [one.as_json() for one in verdicts] == shipped["verdicts"]
    text = (SHIPPED / "map.txt").read_text("utf-8")
    for one in verdicts:
        assert f"  {one.outcome:<13}  {one.claim}\n" in text
        assert one.summary in text
