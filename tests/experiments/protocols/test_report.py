"""The report of a comparison: text, page, figures and JSON, of results that are made up."""

import base64
import json
from dataclasses import replace
from html.parser import HTMLParser
from io import BytesIO
from pathlib import Path

import pytest
from cited import missing_in
from comparisons import SMALL, comparison, number_of
from matplotlib.figure import Figure
from PIL import Image

import hmi_marl
from hmi_marl.experiments.experiment import Place, conduct
from hmi_marl.experiments.protocols.experiment import ProtocolComparison
from hmi_marl.experiments.protocols.figures import (
    cross_figure,
    curves_figure,
    profile_figure,
    sweep_figure,
)
from hmi_marl.reporting.blocks import as_text
from hmi_marl.reporting.report import Report

COMMAND = "hmi-marl compare --out '<script>alert(1)</script>'"
BOTH = replace(SMALL, tasks=("seen", "hidden"))


def varied(pair):
    return 500.0 + number_of(pair.driver)


def write_report(out: Path, made) -> Report:
    """Write the report of a comparison that was made."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ProtocolComparison, "run", lambda self, place: made)
        return conduct(made.settings, Place(out, out, command_line=COMMAND))


class Page(HTMLParser):
    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.links: list[str] = []
        self.text = ""
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.links += [value or "" for name, value in attrs if name in ("src", "srcset")]

    def handle_data(self, data: str) -> None:
        self.text += data


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("report")


@pytest.fixture(scope="module", autouse=True)
def written(out: Path) -> Report:
    return write_report(out, comparison(BOTH, varied))


def test_the_page_needs_no_other_file(out: Path) -> None:
    page = Page((out / "index.html").read_text("utf-8"))
    assert not {"script", "link", "iframe"} & set(page.tags)
    start = "data:image/png;base64,"
    pictures = [link for link in page.links if link.startswith(start)]
    assert all(link.startswith("compare.json#/") for link in set(page.links) - set(pictures))
    drawn = [base64.b64decode(link.removeprefix(start), validate=True) for link in pictures]
    dark, shown = drawn[::2], drawn[1::2]
    assert not set(dark) & set(shown)
    kinds = ("curves", "cross", "profile")
    names = [f"seen-{kind}" for kind in kinds]
    names += [f"hidden-{kind}" for kind in ("curves", "cross", "sweep", "profile")]
    assert sorted(shown) == sorted((out / f"{name}.png").read_bytes() for name in names)
    for content in drawn:
        with Image.open(BytesIO(content)) as image:
            assert image.format == "PNG"


def test_the_page_begins_with_the_answer(out: Path) -> None:
    page = Page((out / "index.html").read_text("utf-8"))
    start = page.text.index("When does joint training help?")
    assert start < page.text.index("Protocols minus two-stage") < page.text.index("seen: results")
    assert page.text.index("seen: results") < page.text.index("hidden: results")
    assert COMMAND in page.text
    assert hmi_marl.__version__ in page.text


def test_the_text_is_written_as_it_is_printed(written: Report, out: Path) -> None:
    assert (out / "compare.txt").read_text("utf-8") == written.text + "\n"


def test_every_number_is_where_its_source_says(written: Report) -> None:
    assert not missing_in(written)


def test_json_holds_every_runs_numbers_and_no_nan(out: Path) -> None:
    content = json.loads((out / "compare.json").read_text("utf-8"), parse_constant=pytest.fail)
    assert content["hmi_marl_version"] == hmi_marl.__version__
    assert content["command"] == COMMAND
    hidden = content["tasks"]["hidden"]
    made = comparison(BOTH, varied).tasks["hidden"]
    assert len(hidden["pairs"]) == len(made.played)
    assert set(hidden["training"]) == {run.name for run in made.plan.runs}
    joint = hidden["arms"]["joint"]
    assert joint["over_runs"]["attention_return"]["mean"] == 501.0
    assert len(joint["scores_by_run_and_driver"]) == 3
    assert [point["weight"] for point in hidden["sweep"]] == [0.0, 0.1, 1.0, None]
    assert content["tasks"]["seen"]["findings"]["two-stage"] == "reference"
    settings = {
        name: tuple(value) if isinstance(value, list) else value
        for name, value in content["settings"].items()
    }
    assert ProtocolComparison(**settings) == BOTH


def section(title: str) -> list[str]:
    made = comparison(BOTH, varied)
    text = as_text(made.settings.blocks(made)).split("\n")
    start = next(k for k, line in enumerate(text) if line.startswith(title))
    ends = [k for k, line in enumerate(text) if k > start and line and not line.startswith(" ")]
    return [line.strip() for line in text[start + 1 : ends[0] if ends else None]]


def test_the_summary_worked_by_hand() -> None:
    head, first, *_ = section("hidden: results")
    assert head.startswith("driver and HMI")
    entries = [entry.strip() for entry in first.split("  ") if entry.strip()]
    assert entries[:2] == ["two-stage", "3"]
    assert entries[2] == "0.751 [0.750, 0.752]"  # 501 of -400 to 800
    assert entries[4] == "501.0 [498.5, 503.5]"  # Student's t, two degrees of freedom
    assert entries[-1] == "0.0 [0.0, 1.3]"  # Wilson, none of 300


def test_costs_count_gradient_steps() -> None:
    _, first, *_ = section("seen: costs")
    assert first.split()[:3] == ["two-stage", "8,000", "120"]
    assert "61.0 [58.5, 63.5]" in first


@pytest.mark.parametrize("protocols", [("joint",), ("two-stage",), ("simultaneous", "two-stage")])
def test_few_protocols_with_one_seed_can_be_reported(protocols, tmp_path: Path) -> None:
    alone = replace(SMALL, protocols=protocols, seeds=1, few_seeds=1)
    write_report(tmp_path, comparison(alone, varied))
    content = json.loads((tmp_path / "compare.json").read_text("utf-8"))
    claims = [v for v in content.get("verdicts", []) if "crashes no more" not in v["claim"]]
    assert {v["outcome"] for v in claims} <= {"undetermined"}, "a single run decides nothing"


def test_the_figures_show_the_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: drawn.append(figure))
    results = comparison(BOTH, varied).tasks["hidden"]
    for draw in (curves_figure, cross_figure, sweep_figure, profile_figure):
        draw(results)
    curves, cross, swept, profile = drawn
    line = curves.axes[0].lines[0]
    assert line.get_label() == "two-stage"
    assert list(line.get_xdata()) == pytest.approx([0.004, 0.008])
    assert list(line.get_ydata()) == pytest.approx([101.0, 501.0])
    assert len(curves.axes[0].collections) == 3, "a band for each protocol with three runs"
    assert [text.get_text() for text in cross.axes[0].texts][:2] == ["501", "501"]
    assert len(cross.axes[0].patches) == 3, "own pairs are framed"
    labels = [text.get_text() for text in swept.axes[0].texts]
    assert labels == ["free", "λ 0.1", "λ 1", "two-stage"]
    assert profile.axes[0].lines[0].get_ydata()[0] == 1.0
