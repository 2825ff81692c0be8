import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
TEXTS = (README, *(path.read_text() for path in (ROOT / "docs").glob("*.md")))
BLOCKS = re.findall(r"```python\n(.*?)```", README, re.DOTALL)


@pytest.mark.parametrize("block", BLOCKS, ids=lambda block: block.strip().splitlines()[-1][:40])
def test_the_code_of_the_readme_runs(block, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exec(compile(block, "README.md", "exec"), {"__name__": "readme"})


def test_there_is_code_to_run():
    assert len(BLOCKS) >= 4


def test_what_the_readme_links_to_is_there():
    for target in re.findall(r"\]\((?!https?:)([^)#]+)", README):
        assert (ROOT / target).exists(), target


def test_the_command_lines_of_the_readme_are_understood():
    from hmi_marl.cli import parse

    lines = [
        line.split("#")[0].split()[1:]
        for text in TEXTS
        for line in text.splitlines()
        if line.startswith("hmi-marl ")
    ]
    assert len(lines) >= 4
    for arguments in lines:
        parse(arguments)  # exits where it does not understand
