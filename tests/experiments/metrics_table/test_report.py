import base64
import csv
import json
import math
import re
from copy import copy
from dataclasses import replace
from html.parser import HTMLParser
from io import BytesIO, StringIO
from pathlib import Path

import numpy as np
import pytest
from cited import missing
from foreign_texts import FOREIGN
from matplotlib.figure import Figure
from PIL import Image

import hmi_marl
from hmi_marl.envs.rewards import TERMS
from hmi_marl.experiments.episodes import Episodes
from hmi_marl.experiments.metrics_table import report
from hmi_marl.experiments.metrics_table.in_short import in_short
from hmi_marl.experiments.metrics_table.report import table_figure
from hmi_marl.experiments.metrics_table.table import Cell, TableConfig, make_cell
from hmi_marl.reporting.blocks import Clip, as_text
from hmi_marl.reporting.statistics import Estimate
from hmi_marl.text import printable

COMMAND = "hmi-marl table --drivers homer lisa --episodes 3"
CLIP = b"GIF89a and so on"
WITHOUT_CLIP = {"table.txt", "table.csv", "table.json", "table.png", "index.html"}


class Page(HTMLParser):
    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.links: list[str] = []
        self.rows: list[list[str]] = []
        self.text = ""
        self.in_cell = False
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.links += [value or "" for name, value in attrs if name in ("src", "href", "srcset")]
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")
            self.in_cell = True

    def handle_endtag(self, tag: str) -> None:
        if tag in ("td", "th"):
            self.in_cell = False

    def handle_data(self, data: str) -> None:
        self.text += data
        if self.in_cell:
            self.rows[-1][-1] += data


def cell(config: TableConfig, driver: str, hmi: str, speeds: list[float]) -> Cell:
    count = len(speeds)
    episodes = Episodes(
        seeds=np.arange(count, dtype=np.uint64),
        length=np.full(count, 10),
        crashed=np.arange(count) == 0,
        alerts=np.arange(count),
        distracted=np.zeros(count, np.int64),
        min_time_headway=np.full(count, np.inf),
        median_time_headway=np.full(count, np.inf),
        returns={name: np.zeros(count) for name in TERMS}
        | {"speed_reward": np.array(speeds), "distraction": -10.0 * np.arange(count)},
    )
    return make_cell(config, driver, hmi, episodes)


@pytest.fixture(scope="module")
def config() -> TableConfig:
    return TableConfig(
        drivers=("homer", "lisa"), hmis=("NoHMI", "belief"), episodes=3, duration=2.0
    )


@pytest.fixture(scope="module")
def cells(config: TableConfig) -> list[Cell]:
    speeds = {"homer": [40.0, 41.0, 45.0], "lisa": [30.25, 30.5, 33.75]}
    return [
        cell(config, driver, hmi, speeds[driver])
        for hmi in config.hmis
        for driver in config.drivers
    ]


@pytest.fixture(scope="module")
def alone() -> tuple[TableConfig, list[Cell]]:
    config = TableConfig(drivers=("homer",), hmis=("belief",), episodes=1, duration=2.0)
    return config, [cell(config, "homer", "belief", [42.0])]


def clip(caption: str = "") -> Clip:
    return Clip("clip", caption, CLIP, ["/clip"])


def png_size(content: bytes) -> tuple[int, int]:
    with Image.open(BytesIO(content)) as image:
        assert image.format == "PNG"
        return image.size


def embedded(page: Page, kind: str) -> list[bytes]:
    start = f"data:image/{kind};base64,"
    return [
        base64.b64decode(link.removeprefix(start), validate=True)
        for link in page.links
        if link.startswith(start)
    ]


CAPTION = "4.0 to 8.0 s: homer drives."


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory, config: TableConfig, cells: list[Cell]) -> Path:
    """The folder of a report with a clip."""
    folder = tmp_path_factory.mktemp("shown") / "out"
    page = report.write_report(folder, config, cells, COMMAND, clip(CAPTION))
    assert page == folder / "index.html"
    return folder


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory, config: TableConfig, cells: list[Cell]) -> Path:
    """The folder of a report without a clip, where an older one had one."""
    folder = tmp_path_factory.mktemp("plain")
    (folder / "clip.gif").write_bytes(CLIP)
    report.write_report(folder, config, cells, COMMAND)
    return folder


@pytest.fixture(scope="module")
def plain_page(plain: Path) -> str:
    return (plain / "index.html").read_text("utf-8")


def test_a_report_writes_all_its_files(shown: Path, config: TableConfig, cells: list[Cell]) -> None:
    assert {path.name for path in shown.iterdir()} == WITHOUT_CLIP | {"clip.gif"}
    assert (shown / "table.txt").read_text("utf-8") == (
        report.make_report(config, cells, COMMAND, clip(CAPTION)).text + "\n"
    )
    assert (shown / "table.csv").read_text("utf-8") == report.as_csv(cells)
    assert png_size((shown / "table.png").read_bytes())[0] > 800


def test_a_report_without_a_clip_shows_none_and_removes_an_older_one(
    plain: Path, plain_page: str
) -> None:
    assert {path.name for path in plain.iterdir()} == WITHOUT_CLIP
    page = Page(plain_page)
    assert page.tags.count("img") == 1
    assert "One episode" not in page.text


def test_the_page_needs_nothing_besides_itself(shown: Path) -> None:
    html = (shown / "index.html").read_text("utf-8")
    page = Page(html)
    pictures = [link for link in page.links if link.startswith("data:image/")]
    assert len(pictures) == 5  # the clip, and the figure by width and for dark pages
    assert {link for link in page.links if link not in pictures} == {
        "table.json#/cells",
        "table.json#/clip",
    }
    assert not {"script", "link", "iframe"} & set(page.tags)
    assert "@import" not in html
    assert "url(" not in html
    dark_narrow, narrow, dark, wide = embedded(page, "png")
    assert len({dark_narrow, narrow, dark, wide}) == 4
    assert wide == (shown / "table.png").read_bytes()
    assert png_size(narrow)[0] < png_size(narrow)[1], "panels stand one below the other"
    assert embedded(page, "gif") == [CLIP]


def test_the_page_begins_with_what_came_out(
    shown: Path, config: TableConfig, cells: list[Cell]
) -> None:
    html = (shown / "index.html").read_text("utf-8")
    page = Page(html)
    made = report.make_report(config, cells, COMMAND, clip())
    assert not missing(made.blocks, made.numbers)
    remarks = in_short(config, cells)
    assert remarks
    for remark in remarks:
        assert remark.lead in page.text
        assert remark.text.replace("`", "") in page.text
    assert page.text.index(remarks[-1].lead) < page.text.index(CAPTION)
    assert page.text.index("4.0 to 8.0 s") < page.text.index(report.METRICS[0][1])
    own = re.sub('<p class="source">.*?</p>', "", html)
    assert own.count("<code>") == 2, "the command to try next, and the one that made the page"


def test_json_has_the_sentences_and_the_caption(
    shown: Path, config: TableConfig, cells: list[Cell]
) -> None:
    content = json.loads((shown / "table.json").read_text("utf-8"))
    assert content["clip"] == CAPTION
    assert content["clip"] in Page((shown / "index.html").read_text("utf-8")).text
    assert content["in_short"] == [
        {"title": remark.lead, "text": remark.text} for remark in in_short(config, cells)
    ]


def test_a_page_is_made_for_telephones(plain_page: str) -> None:
    html = plain_page
    assert '<meta name="viewport" content="width=device-width, initial-scale=1">' in html
    tables = html.count("<table>")
    assert tables == html.count('<div class="wide"><table>') == len(report.METRICS)


def test_the_page_tells_how_it_was_made(plain_page: str) -> None:
    page = Page(plain_page)
    assert COMMAND in page.text
    assert hmi_marl.__version__ in page.text
    assert "seed = 0" in page.text
    assert "duration = 2.0" in page.text
    assert "4 cells of 3 episodes" in page.text


def test_the_page_shows_the_entries_of_the_text(
    plain_page: str, config: TableConfig, cells: list[Cell]
) -> None:
    page = Page(plain_page)
    heads = [row for row in page.rows if row[1:] == ["homer", "lisa"]]
    assert len(heads) == len(report.METRICS)
    rows = [row for row in page.rows if row[0] in ("NoHMI", "belief")]
    assert len(rows) == 2 * len(report.METRICS)
    text = as_text(report.metric_tables(config, cells))
    for entry in (entry for row in rows for entry in row):
        assert entry in text


def test_csv_parses_back_to_the_same_numbers(cells: list[Cell]) -> None:
    lines = list(csv.DictReader(StringIO(report.as_csv(cells))))
    assert [(line["hmi"], line["driver"]) for line in lines] == [
        (cell.hmi, cell.driver) for cell in cells
    ]
    for line, cell in zip(lines, cells, strict=True):
        for name in ("speed_return", "distraction_return", "alerts", "crash_rate"):
            estimate = getattr(cell, name)
            ends = (float(line[name]), float(line[f"{name}_low"]), float(line[f"{name}_high"]))
            assert Estimate(*ends) == estimate
        least, most = cell.reachable_distraction_return_same_steps
        assert float(line["reachable_distraction_return_same_steps_least"]) == least
        assert float(line["reachable_distraction_return_same_steps_most"]) == most
    assert float(lines[0]["speed_return"]) == 42.0
    assert float(lines[1]["speed_return"]) == 31.5


def test_csv_leaves_empty_what_is_not_known(cells: list[Cell]) -> None:
    no_hmi, *_, belief = csv.DictReader(StringIO(report.as_csv(cells)))
    assert belief["exact_distraction_return"] == ""
    assert belief["min_time_headway"] == ""
    assert float(no_hmi["exact_distraction_return"]) == pytest.approx(-80.0)


def test_json_holds_the_cells_and_how_to_make_them(plain: Path, config: TableConfig) -> None:
    content = json.loads((plain / "table.json").read_text("utf-8"))
    assert content["hmi_marl_version"] == hmi_marl.__version__
    assert len(content["cells"]) == 4
    assert content["cells"][1]["speed_return"]["mean"] == 31.5
    assert content["cells"][0]["min_time_headway"]["mean"] is None
    settings = {
        name: tuple(value) if isinstance(value, list) else value
        for name, value in content["settings"].items()
    }
    assert TableConfig(**settings) == config


def test_the_text_has_a_block_for_each_metric(config: TableConfig, cells: list[Cell]) -> None:
    blocks = as_text(report.metric_tables(config, cells)).split("\n\n")
    assert len(blocks) == len(report.METRICS)
    for block, (_, title, _) in zip(blocks, report.METRICS, strict=True):
        head, columns, *rows = block.splitlines()
        assert head == title
        assert columns.split() == ["homer", "lisa"]
        assert [row.split()[0] for row in rows] == ["NoHMI", "belief"]


def test_entries_of_the_text_worked_by_hand(config: TableConfig, cells: list[Cell]) -> None:
    blocks = as_text(report.metric_tables(config, cells)).split("\n\n")
    speed, distraction, attention, alerts, crashes, headway = blocks
    # standard deviation sqrt(7) over sqrt(3), two degrees of freedom: 4.3027 x 1.5275
    assert "42 [35, 49]" in speed
    # 0, -10, -20; for NoHMI, Homer's exact -80 over ten steps
    assert "-10 [-35, 15] (-80)" in distraction
    assert distraction.splitlines()[-1].count("(") == 0, "the belief has no exact return"
    # the other two terms are 0 here
    assert "-10 [-35, 15]" in attention
    assert attention.startswith("Attention return")
    # 0, 1 and 2 alerts in 2 s, and never fewer than none
    assert "30 [0, 105]" in alerts
    # Wilson, one of three
    assert "0.33 [0.06, 0.79]" in crashes
    assert headway.splitlines()[-1].split() == ["belief", "-", "-"]


def test_one_episode_alone_has_entries_without_an_interval(
    alone: tuple[TableConfig, list[Cell]],
) -> None:
    config, cells = alone
    assert math.isnan(cells[0].speed_return.low)
    speed = as_text(report.metric_tables(config, cells)).split("\n\n")[0]
    assert speed.splitlines()[-1].split() == ["belief", "42"]


def test_policies_in_any_folder_have_their_table_and_their_figure(
    tmp_path: Path, alone: tuple[TableConfig, list[Cell]]
) -> None:
    config, cells = alone
    named = copy(config)
    object.__setattr__(named, "hmis", FOREIGN)  # where there are no such policies
    rows = [replace(cells[0], hmi=name) for name in FOREIGN]
    command = "hmi-marl table --out '<script>alert(1)</script>' && \"x\""
    written_page = report.write_report(tmp_path, named, rows, command)
    assert png_size((tmp_path / "table.png").read_bytes())[0] > 800
    text, html = (tmp_path / "table.txt").read_text("utf-8"), written_page.read_text("utf-8")
    page = Page(html)
    for name in FOREIGN:
        assert printable(name).strip() in text
    assert "\x1b" not in text + html
    assert "<script" not in html, "what could be markup is escaped"
    assert "script" not in page.tags
    assert command in page.text
    written = json.loads((tmp_path / "table.json").read_text())
    assert written["settings"]["hmis"] == list(FOREIGN)


def test_results_are_written_before_anything_is_drawn(
    tmp_path: Path, alone: tuple[TableConfig, list[Cell]], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise ValueError("no such mathematics")

    monkeypatch.setattr(Figure, "savefig", fail)
    with pytest.raises(ValueError, match="no such mathematics"):
        report.write_report(tmp_path, *alone, COMMAND)
    assert {path.name for path in tmp_path.iterdir()} == {"table.csv", "table.json", "table.txt"}


def test_one_episode_alone_can_be_drawn(alone: tuple[TableConfig, list[Cell]]) -> None:
    assert png_size(table_figure(*alone)) == (1210, 704)


def test_the_figure_shows_the_numbers(
    config: TableConfig, cells: list[Cell], monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: drawn.append(figure))
    table_figure(config, cells)
    axes = {panel.get_title(): panel for panel in drawn[0].axes}
    speed = axes["speed return"]
    assert [bar.get_height() for bar in speed.patches] == [42.0, 31.5, 42.0, 31.5]
    ends = [ends[:, 1] for errors in speed.collections for ends in errors.get_segments()]
    wanted = [(c.speed_return.low, c.speed_return.high) for c in cells]
    np.testing.assert_allclose(ends, wanted)
    exact = [line for line in axes["distraction return"].lines if line.get_marker() == "_"]
    np.testing.assert_allclose(
        [line.get_ydata() for line in exact], [[-80.0, -20.0], [np.nan, np.nan]]
    )
    assert [text.get_text() for text in speed.get_xticklabels()] == ["homer", "lisa"]
