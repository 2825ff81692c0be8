"""The site: its code runs, its commands are understood, its pages are all there, and it builds."""

import re
import subprocess
import sys

import pytest
import yaml
from fresh import run
from pages import DOCS, PAGES, ROOT, blocks, commands, hook
from trait_models import untrained

from hmi_marl.agents.learned.trait_model import save_traits
from hmi_marl.demonstrations.dataset import observed_layout
from hmi_marl.demonstrations.parquet import write_demonstrations
from hmi_marl.demonstrations.recording import CollectSettings, collect
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.observations import vehicle_ai_layout

HOOK = hook()
TEXTS = {page.relative_to(DOCS).as_posix(): HOOK.fill(page.read_text()) for page in PAGES}
"""Every page as it is on the site, what is made from the code included."""


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


@pytest.mark.parametrize("page", [page for page, text in TEXTS.items() if "```python" in text])
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
sys.path[:0] = [{str(ROOT / "tests")!r}]
from hmi_marl.extras import EXTRAS
sys.modules.update(dict.fromkeys(sum(EXTRAS.values(), ())))
from pages import hook
print(hook().settings())
"""


def test_the_page_of_settings_is_whole_where_only_the_extra_of_the_site_is_installed():
    assert run("-c", WITHOUT_EXTRAS) == HOOK.settings() + "\n"
    assert "training.protocols.settings.PPOSettings" in HOOK.settings()


@pytest.mark.parametrize("page", [page for page, text in TEXTS.items() if "```python" in text])
def test_the_code_of_a_page_imports_from_two_levels_at_most(page):
    for name in re.findall(r"^(?:from|import) (hmi_marl[\w.]*)", TEXTS[page], re.MULTILINE):
        assert name.count(".") <= 2, name


def test_what_is_prepared_is_for_pages_that_are_there():
    assert set(BEFORE) <= set(TEXTS)


@pytest.mark.parametrize("page", [page for page, text in TEXTS.items() if commands(text)])
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
    assert sorted(nav) == sorted(TEXTS)


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
    page = HOOK.fill(f"{part}\nbetween\n\n{part}")
    assert page.count("import ray") == 2
    assert "\nbetween\n" in page


@pytest.mark.parametrize(
    "wrong", ["<!-- made: nothing -->\n<!-- end -->", "<!-- made: layouts -->\n", "<!-- made: -->"]
)
def test_a_made_part_that_is_none_is_refused(wrong):
    with pytest.raises(ValueError, match=r"made part|unknown part"):
        HOOK.fill(f"# Title\n\n{wrong}\n")


def test_the_site_builds_without_a_warning_and_needs_nothing_from_the_net(tmp_path):
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    built = {page.relative_to(tmp_path).as_posix() for page in tmp_path.rglob("*.html")}
    assert {page.removesuffix(".md") + ".html" for page in TEXTS} <= built
    assert (tmp_path / "search" / "search_index.json").is_file()
    elsewhere = r"[\"']?(?:https?:)?//"
    for page in built:
        text = (tmp_path / page).read_text()
        assert not re.search(rf"\ssrc={elsewhere}|<link[^>]+href={elsewhere}", text), page
    for style in tmp_path.rglob("*.css"):
        assert not re.search(rf"(?:@import|url\()\s*{elsewhere}", style.read_text()), style
