import base64
import json
import math
from dataclasses import replace
from functools import cache
from html.parser import HTMLParser
from io import BytesIO
from pathlib import Path

import pytest
from matplotlib.figure import Figure
from PIL import Image

import hmi_marl
from hmi_marl.envs.rewards import TERMS
from hmi_marl.experiments.experiment import Place, conduct
from hmi_marl.experiments.protocols.analysis import CURVES, Comparison
from hmi_marl.experiments.protocols.experiment import (
    CURVE_TITLES,
    ProtocolComparison,
    curves_figure,
    swap_figure,
    terms_figure,
)
from hmi_marl.experiments.protocols.plan import ALL_DRIVERS, Sums
from hmi_marl.reporting.blocks import as_text
from hmi_marl.reporting.report import Report
from hmi_marl.reporting.statistics import Estimate
from hmi_marl.reporting.verdicts import Outcome

SETTINGS = ProtocolComparison(
    protocols=("two-stage", "simultaneous"), seeds=2, drivers=("bart", "homer"), num_teams=16
)
COMMAND = "hmi-marl compare --out '<script>alert(1)</script>'"


def made(settings: ProtocolComparison = SETTINGS, crashes: int = 0) -> Comparison:
    """Pair k has a team return of -100 + 10 k; own policies of simultaneous crash."""
    played = {}
    for k, pair in enumerate(settings.pairs()):
        crashed = crashes if pair.driver.startswith("simultaneous") else 0
        terms = dict.fromkeys(TERMS, 0.0) | {"distraction": 100.0 * (10 * k - 100)}
        sums = Sums(100, crashed, 5000, 50.0, 300, math.nan, terms)
        played[pair] = {ALL_DRIVERS: sums, "bart": sums, "homer": replace(sums, episodes=0)}
    curves = {
        run.name: [
            dict.fromkeys(CURVES, run.number + 0.1 * k) | {"steps": 100 * k, "seconds": 2.0 * k}
            for k in range(1, 4)
        ]
        for run in settings.runs
    }
    return Comparison(settings, played, curves, workers=2)


def write_report(out: Path, comparison: Comparison) -> Report:
    """Write the report of a comparison that was made."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ProtocolComparison, "run", lambda self, place: comparison)
        return conduct(comparison.settings, Place(out, out, command_line=COMMAND))


class Page(HTMLParser):
    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.links: list[str] = []
        self.text = ""
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.links += [value or "" for name, value in attrs if name in ("src", "href", "srcset")]

    def handle_data(self, data: str) -> None:
        self.text += data


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("report")


@pytest.fixture(scope="module", autouse=True)
def written(out: Path) -> Report:
    return write_report(out, made(crashes=60))


@cache
def text_of(crashes: int) -> str:
    comparison = made(crashes=crashes)
    return as_text(comparison.settings.blocks(comparison))


def block(title: str, crashes: int = 0) -> list[str]:
    """A part of the text, by its title."""
    text = text_of(crashes).split("\n")
    start = text.index(title)
    ends = [k for k, line in enumerate(text) if k > start and line and not line.startswith(" ")]
    return [line.strip() for line in text[start + 1 : ends[0] if ends else None]]


def test_the_page_needs_no_other_file(out: Path) -> None:
    page = Page((out / "index.html").read_text("utf-8"))
    assert not {"script", "link", "iframe"} & set(page.tags)
    start = "data:image/png;base64,"
    shown = [base64.b64decode(link.removeprefix(start), validate=True) for link in page.links]
    assert shown == [(out / f"{name}.png").read_bytes() for name in ("curves", "terms", "swap")]
    for content in shown:
        with Image.open(BytesIO(content)) as image:
            assert image.format == "PNG"


def test_the_page_tells_how_it_was_made(out: Path) -> None:
    page = Page((out / "index.html").read_text("utf-8"))
    assert COMMAND in page.text
    assert hmi_marl.__version__ in page.text
    assert f"{SETTINGS.steps_each:,} environment steps" in page.text
    assert "actions that were drawn (explored)" in page.text
    assert "workers: 2" in page.text


def test_the_text_is_written_as_it_is_printed(written: Report, out: Path) -> None:
    assert (out / "compare.txt").read_text("utf-8") == written.text + "\n"


def test_json_has_no_nan_and_everything_in_it(out: Path) -> None:
    content = json.loads((out / "compare.json").read_text("utf-8"))
    assert content["hmi_marl_version"] == hmi_marl.__version__
    assert content["command"] == COMMAND
    assert content["findings"] == {"two-stage": "reference", "simultaneous": "GAMED"}
    (verdict,) = content["verdicts"]
    assert (verdict["outcome"], verdict["reason"]) == ("not supported", "GAMED with all, bart")
    assert content["protocols"]["two-stage"]["over_seeds"]["time_headway"]["mean"] is None
    assert content["pairs"][0]["by_driver"]["homer"]["team_return"] is None
    assert content["pairs"][0]["by_driver"][ALL_DRIVERS]["team_return"] == -100.0
    assert content["curves"]["two-stage"]["team_return"]["steps"] == [100, 200, 300]
    assert content["curves"]["two-stage"]["team_return"]["mean"] == pytest.approx([0.6, 0.7, 0.8])
    assert content["training_seconds"]["two-stage-run0"] == 6.0
    settings = {
        name: tuple(value) if isinstance(value, list) else value
        for name, value in content["settings"].items()
    }
    assert ProtocolComparison(**settings) == SETTINGS


def test_the_summary_worked_by_hand() -> None:
    head, *rows = block("Final team return, crashes and alerts")
    assert head.startswith("driver and HMI")
    # pairs 0 and 4 are two-stage's own: -100 and -60; 300 alerts in 50 minutes
    own = rows[0].split("  ")
    own = [entry.strip() for entry in own if entry.strip()]
    assert own[0] == "two-stage"
    assert own[1] == "-80.0 [-334.1, 174.1]"
    assert own[5] == "0.0 [0.0, 1.9]"  # Wilson, none of 200
    assert own[6] == "6.0 [6.0, 6.0]"
    assert own[8] == "-"
    assert [row.split("  ")[0] for row in rows[1:6]] == [
        "simultaneous",
        "rule, never",
        "rule, when-distracted",
        "two-stage, never",
        "two-stage, when-distracted",
    ]


def test_own_pairs_are_marked() -> None:
    _, first, second, *_ = block("Swapped partners")
    # two-stage with both HMIs: -100 and -90, then -60 and -50 with the other seed
    assert first.split()[1:4] == ["*-80.0", "[-334.1,", "174.1]*"]
    assert first.count("*") == second.count("*") == 2
    assert second.endswith("*-50.0 [-304.1, 204.1]*")


def test_verdicts_name_their_drivers() -> None:
    def judged(comparison: Comparison) -> list[tuple[str, str, str]]:
        return [
            (verdict.claim.split(":")[0], verdict.outcome, verdict.reason)
            for verdict in comparison.settings.judge(comparison)
        ]

    assert judged(made(crashes=60)) == [
        ("simultaneous", Outcome.NOT_SUPPORTED, "GAMED with all, bart")
    ]
    assert judged(made()) == [("simultaneous", Outcome.UNTESTABLE, "unknown with homer")]
    rows = block("Does crashing pay?", crashes=60)
    assert rows[1].split()[:2] + rows[1].split()[-1:] == ["two-stage", "all", "reference"]
    assert rows[4].split()[:2] + rows[4].split()[-1:] == ["simultaneous", "all", "GAMED"]


def test_the_time_of_a_run() -> None:
    _, row, *_ = block("Wall time")
    assert row.split() == ["two-stage", "300", "6.0", "[6.0,", "6.0]", "50"]


def test_one_protocol_with_one_seed_can_be_reported(tmp_path: Path) -> None:
    alone = replace(SETTINGS, protocols=("joint",), seeds=1, crash_check=False)
    write_report(tmp_path, made(alone))
    content = json.loads((tmp_path / "compare.json").read_text("utf-8"))
    assert content["findings"] == {"joint": "unknown"}
    assert content["verdicts"][0]["outcome"] == "cannot be tested here"
    assert content["dependence"][0]["on_protocol"]["mean"] is None


def test_an_entry_says_what_is_known() -> None:
    assert Estimate(1.26, 1.0, 1.5).shown() == "1.3 [1.0, 1.5]"
    assert Estimate(-0.01, math.nan, math.nan).shown() == "0.0"
    assert Estimate(math.nan, math.nan, math.nan).shown() == "-"


def test_the_figures_show_the_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: drawn.append(figure))
    for draw in (curves_figure, swap_figure, terms_figure):
        draw(made())
    curves, swap, terms = drawn
    assert [panel.get_title() for panel in curves.axes] == list(CURVE_TITLES.values())
    line = curves.axes[0].lines[0]
    assert line.get_label() == "two-stage"
    assert list(line.get_ydata()) == pytest.approx([0.6, 0.7, 0.8])
    assert list(line.get_xdata()) == pytest.approx([1e-4, 2e-4, 3e-4])
    assert [next(iter(seed.get_ydata())) for seed in curves.axes[0].lines[1:3]] == [0.1, 1.1]
    low, high = curves.axes[0].get_ylim()
    assert low < 0.1
    assert 1.3 < high < 1.5, "the axes show what was seen, not the band"
    assert [text.get_text() for text in swap.axes[0].texts] == ["-80", "-70", "-60", "-50"]
    assert len(swap.axes[0].patches) == 2
    distraction = terms.axes[TERMS.index("distraction")]
    assert [bar.get_height() for bar in distraction.patches] == [-80.0, -50.0]
    assert list(distraction.lines[0].get_ydata()) == [-100.0, -60.0]


@pytest.mark.parametrize(("seeds", "bands"), [(1, 0), (2, 0), (3, 2)])
def test_two_seeds_have_no_band(seeds: int, bands: int, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: drawn.append(figure))
    curves_figure(made(replace(SETTINGS, seeds=seeds)))
    assert len(drawn[0].axes[0].collections) == bands
