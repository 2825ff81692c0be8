"""The site: its code runs, its commands are understood, its pages are all there, and it builds."""

import importlib.util
import json
import re
import subprocess
import sys

import api_pages
import made_parts
import mathml
import notebook_pages
import notebook_runs
import pytest
import yaml
from fresh import run
from pages import DOCS, PAGES, ROOT, blocks, commands
from trait_models import untrained

import hmi_marl
from hmi_marl.agents.learned.trait_model import save_traits
from hmi_marl.demonstrations.dataset import observed_layout
from hmi_marl.demonstrations.parquet import write_demonstrations
from hmi_marl.demonstrations.recording import CollectSettings, collect
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.observations import vehicle_ai_layout

NOTEBOOKS = ROOT / "examples" / "notebooks"
RAW = {page.relative_to(DOCS).as_posix(): page.read_text() for page in PAGES}
"""Every page as it is in the repository."""


class Texts(dict):
    """Every page as it is on the site, what is made from the code included.

    A page is made when it is first read: all the help texts take seconds.
    """

    def __missing__(self, page):
        self[page] = made_parts.fill(RAW[page])
        return self[page]


TEXTS = Texts()
WITH_CODE = [page for page, text in RAW.items() if "```python" in text]
WITH_COMMANDS = [page for page, text in RAW.items() if commands(text)]


def test_what_is_made_brings_no_code_and_no_command_to_a_page_without():
    assert [page for page in RAW if "```python" in TEXTS[page]] == WITH_CODE
    assert [page for page in RAW if commands(TEXTS[page])] == WITH_COMMANDS


def collected(folder, **settings):
    write_demonstrations(
        folder / "runs" / "demonstrations", collect(CollectSettings(drivers=("homer",), **settings))
    )


def prepare_demonstrations(folder):
    collected(folder, steps=2 * 2401, duration=0.4)  # a window more than the page trains on


def prepare_traits(folder):
    collected(folder, steps=800)
    model = untrained(observed_layout(TeamConfig()))
    save_traits(folder / "runs" / "traits-id", model.card, model.weights)


BEFORE = {"demonstrations.md": prepare_demonstrations, "traits.md": prepare_traits}
"""Prepare tiny versions of what a page reads."""


@pytest.mark.parametrize("page", WITH_CODE)
def test_the_code_of_a_page_runs_from_top_to_bottom(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    BEFORE.get(page, lambda folder: None)(tmp_path)
    code = blocks(TEXTS[page], "python")
    assert len(code) == TEXTS[page].count("```python")
    names = {"__name__": "page"}
    for number, block in enumerate(code):
        exec(compile(block, f"{page}, block {number}", "exec"), names)


WITHOUT_EXTRAS = f"""
import sys
sys.path[:0] = [{str(ROOT / "docs" / "making")!r}]
from hmi_marl.extras import EXTRAS
sys.modules.update(dict.fromkeys(sum(EXTRAS.values(), ())))
import made_parts
print(made_parts.settings())
"""


def test_the_page_of_settings_is_whole_where_only_the_extra_of_the_site_is_installed():
    assert run("-c", WITHOUT_EXTRAS) == made_parts.settings() + "\n"
    assert "training.protocols.settings.PPOSettings" in made_parts.settings()


@pytest.mark.parametrize("page", WITH_CODE)
def test_the_code_of_a_page_imports_from_two_levels_at_most(page):
    for name in re.findall(r"^(?:from|import) (hmi_marl[\w.]*)", TEXTS[page], re.MULTILINE):
        assert name.count(".") <= 2, name


def test_what_is_prepared_is_for_pages_that_are_there():
    assert set(BEFORE) <= set(RAW)


@pytest.mark.parametrize("page", WITH_COMMANDS)
def test_the_command_lines_of_a_page_are_understood(page):
    from hmi_marl.cli import parse

    for arguments in commands(TEXTS[page]):
        parse(arguments)  # exits where it does not understand


def nav_pages(entries):
    for entry in entries:
        (value,) = entry.values() if isinstance(entry, dict) else (entry,)
        yield from nav_pages(value) if isinstance(value, list) else [value]


def test_the_navigation_names_every_page_once():
    nav = list(nav_pages(yaml.safe_load((ROOT / "mkdocs.yml").read_text())["nav"]))
    made = [f"api/{name}.md" for name in ("index", *api_pages.PACKAGES)]
    made += [f"notebooks/{path.stem}.md" for path in NOTEBOOKS.glob("*.ipynb")]
    assert sorted(nav) == sorted([*RAW, *made])


def test_pages_made_from_the_code_say_what_the_code_says():
    environment = TEXTS["environment.md"]
    layout = vehicle_ai_layout(TeamConfig())
    for part in layout.parts:
        where = layout[part.name]
        assert f"| {where.start}:{where.stop} | `{part.name}` |" in environment
    assert "| `accept_alert` | 30 if alert" in environment
    texts = TEXTS["commands.md"]
    headings = re.findall(r"^## (hmi-marl.*)", texts, re.MULTILINE)
    assert {"hmi-marl", "hmi-marl watch", "hmi-marl train two-stage"} <= set(headings)
    assert len(headings) == texts.count("usage: ")
    assert "| `hmi-marl compare` | `train` |" in texts
    assert "## 0.1.0 " in TEXTS["changelog.md"]
    assert "make test" in TEXTS["contributing.md"]


def test_the_page_of_trainers_shows_the_examples_that_their_tests_run():
    page = TEXTS["custom-trainers.md"]
    tests = "".join(test.read_text() for test in (ROOT / "tests" / "trainers").glob("test_*.py"))
    examples = sorted((ROOT / "examples" / "trainers").glob("*.py"))
    assert len(blocks(page, "py")) == len(examples) > 0
    for example in examples:
        assert f"examples/trainers/{example.name}" in page
        assert f'"{example.stem}"' in tests
        assert any(block in example.read_text() for block in blocks(page, "py"))


def test_the_page_of_trainers_names_the_versions_that_are_tested():
    page = TEXTS["custom-trainers.md"]
    pinned = [(ROOT / "constraints.txt").read_text()]
    pinned += [pins.read_text() for pins in (ROOT / "tests" / "trainers" / "pins").glob("*.txt")]
    versions = dict(re.findall(r"^([\w-]+)==(\S+)$", "\n".join(reversed(pinned)), re.MULTILINE))
    of = {"Stable-Baselines3": "stable_baselines3", "rsl_rl": "rsl-rl-lib", "RLlib": "ray"}
    rows = re.findall(r"^\| ([^|]+) \| ([\d.]+) \| (?:ours|own) \|", page, re.MULTILINE)
    assert len(rows) == 8
    for name, version in rows:
        package = of.get(name, name)
        package = "gymnasium" if name.startswith("Gymnasium") else package
        known = {key.lower(): value for key, value in versions.items()}
        assert known[package.lower()] == version, name


def test_an_empty_made_part_ends_at_its_own_end():
    part = "<!-- made: example rllib_ppo -->\n<!-- end -->\n"
    page = made_parts.fill(f"{part}\nbetween\n\n{part}")
    assert page.count("import ray") == 2
    assert "\nbetween\n" in page


@pytest.mark.parametrize(
    "wrong", ["<!-- made: nothing -->\n<!-- end -->", "<!-- made: layouts -->\n", "<!-- made: -->"]
)
def test_a_made_part_that_is_none_is_refused(wrong):
    with pytest.raises(ValueError, match=r"made part|unknown part"):
        made_parts.fill(f"# Title\n\n{wrong}\n")


@pytest.fixture(scope="module")
def reference():
    return api_pages.Reference(ROOT).pages()


def test_the_reference_shows_every_public_name_with_its_docstring(reference):
    root = reference["api/index.md"]
    for name in set(hmi_marl.__all__) - {"__version__"}:
        assert re.search(rf"^## {name}(?: |$)", root, re.MULTILINE), name
    assert "merge_v0" in root
    assert "`beta: Share`: Probability per step of becoming distracted" in root
    assert "def play(" in root
    assert "**Raises:**" in root


def test_the_reference_has_modules_at_most_two_levels_down_and_links_roles(reference):
    exact = reference["api/exact.md"]
    assert "## exact.oracle { #exact-oracle }" in exact
    assert "def solve_alerts(" in exact
    for name, page in reference.items():
        assert not re.search(r":(?:func|class|meth|mod|attr|data|math):`", page), name
    assert "[`oracle.evaluate`](" in exact or "[`evaluate`](#exact-oracle-evaluate)" in exact
    assert sum(page.count("[`") for page in reference.values()) > 100
    for module in api_pages.INTERNAL:
        assert importlib.util.find_spec(module), f"{module} is no module any more"


def test_mathematics_becomes_mathml_and_code_stays():
    page = "Let $b' = 1$ cost `$5` and\n\n$$\n\\frac{a}{b}\n$$\n\n```sh\necho $HOME $PATH\n```\n"
    made = mathml.with_mathml(page)
    assert made.count("<math") == 2
    assert "<mfrac>" in made
    assert "`$5`" in made
    assert "echo $HOME $PATH" in made
    assert mathml.with_mathml("from $5 to $6 a day") == "from $5 to $6 a day"


def words(outputs):
    """The text of a cell's outputs without its numbers, which may round otherwise elsewhere."""
    lines = [
        "".join(output.get("text", output.get("data", {}).get("text/plain", ())))
        for output in outputs
    ]
    return re.sub(r"[\s\d.e+-]+", " ", "".join(lines))


@pytest.mark.parametrize("path", sorted(NOTEBOOKS.glob("*.ipynb")), ids=lambda path: path.stem)
def test_a_notebook_runs_and_shows_what_is_saved_in_it(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    cells = json.loads(path.read_text("utf-8"))["cells"]
    saved = [cell["outputs"] for cell in cells if cell["cell_type"] == "code"]
    for number, outputs in enumerate(notebook_runs.run(path)):
        assert words(outputs) == words(saved[number]), f"cell {number}; run notebook_runs.py"
    assert number == len(saved) - 1


def test_a_notebook_becomes_a_page_with_its_outputs_and_pictures(tmp_path):
    pages = notebook_pages.pages(NOTEBOOKS, tmp_path)
    page = pages["notebooks/environment.md"]
    assert "```text\nalert 0" in page
    assert "](../exact.md)" in page
    pictures = re.findall(r"\]\(([\w-]+\.png)\)", page)
    assert pictures
    assert all((tmp_path / "notebooks" / name).stat().st_size for name in pictures)


def test_an_output_that_is_not_shown_is_refused(tmp_path):
    html = {"output_type": "display_data", "data": {"text/html": ["<b>"]}, "metadata": {}}
    cell = {"cell_type": "code", "source": ["1"], "outputs": [html]}
    (tmp_path / "one.ipynb").write_text(json.dumps({"cells": [cell]}))
    with pytest.raises(ValueError, match="neither text nor a PNG"):
        notebook_pages.pages(tmp_path, tmp_path)


@pytest.mark.slow  # all pages and the whole reference take long
def test_the_site_builds_without_a_warning_and_needs_nothing_from_the_net(tmp_path):
    site = tmp_path / "site"
    command = [sys.executable, str(ROOT / "docs" / "making"), "--site-dir", str(site)]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
    built = {page.relative_to(site).as_posix() for page in site.rglob("*.html")}
    assert {page.removesuffix(".md") + ".html" for page in RAW} <= built
    assert (site / "search.json").is_file()
    elsewhere = r"[\"']?(?:https?:)?//"
    styles = r'<link[^>]+rel="(?:stylesheet|preconnect)"[^>]+href='
    for page in built:
        text = (site / page).read_text()
        assert not re.search(rf"<(?:img|script)[^>]+src={elsewhere}", text), page
        assert not re.search(styles + elsewhere, text), page
    for style in site.rglob("*.css"):
        assert not re.search(rf"(?:@import|url\()\s*{elsewhere}", style.read_text()), style


def test_a_dead_link_or_anchor_fails(tmp_path):
    (tmp_path / "docs").mkdir()
    (tmp_path / "mkdocs.yml").write_text(
        f"INHERIT: {ROOT / 'mkdocs.yml'}\nnav: [index.md]\ntheme: {{custom_dir: docs}}\n"
    )
    for text, ends_well in {
        "# Title\n\n[here](#title)\n": True,
        "# Title\n\n[here](#none)\n": False,
        "# Title\n\n[there](none.md)\n": False,
    }.items():
        (tmp_path / "docs" / "index.md").write_text(text)
        command = [sys.executable, "-m", "zensical", "build", "--strict", "--clean"]
        run = subprocess.run(command, cwd=tmp_path, capture_output=True, check=False)
        assert (run.returncode == 0) is ends_well, text
