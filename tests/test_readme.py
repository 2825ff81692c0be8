import re
import runpy

import pytest
from pages import README, ROOT, blocks, commands

TEXT = README.read_text()
BLOCKS = blocks(TEXT, "python")


@pytest.mark.parametrize("block", BLOCKS, ids=lambda block: block.strip().splitlines()[-1][:40])
def test_the_code_of_the_readme_runs_and_prints_something(block, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    exec(compile(block, "README.md", "exec"), {"__name__": "readme"})
    lines = capsys.readouterr().out.splitlines()
    assert 1 <= len(lines) <= 20, "a few lines, not a wall of numbers"
    assert all(re.search("[a-z]{3}", line) for line in lines), "every number is named"
    assert any(re.search("[0-9]", line) for line in lines)


def test_there_is_code_to_run():
    assert len(BLOCKS) >= 4
    assert len(BLOCKS) == TEXT.count("```python")


def test_what_the_readme_links_to_is_there():
    for target in re.findall(r"\]\((?!https?:)([^)#]+)", TEXT):
        assert (ROOT / target).exists(), target


def test_the_command_lines_of_the_readme_are_understood():
    from hmi_marl.cli import parse

    lines = commands(TEXT)
    assert len(lines) >= 4
    for arguments in lines:
        parse(arguments)  # exits where it does not understand


def test_the_ten_minutes_are_commands_with_times() -> None:
    from hmi_marl.cli import parse

    path = ROOT / "benchmarks" / "ten_minutes.py"
    found = runpy.run_path(str(path))["commands"](TEXT)
    makefile = (ROOT / "Makefile").read_text("utf-8")
    assert len(found) >= 6
    for command in found:
        tool, *arguments = command.split()
        if tool == "hmi-marl":
            parse(arguments)  # exits where it does not understand
        else:
            assert tool in (".", "make")
            assert tool == "." or f"\n{arguments[0]}:" in makefile
    rows = [
        row for row in TEXT.partition("## Ten minutes")[2].splitlines() if row.startswith("| `")
    ]
    assert len(rows) == len(found)
    for row in rows[:1] + [row for row in rows if row.startswith("| `hmi-marl")]:
        assert re.search(r"\| \d+(\.\d)? (s|min) \|", row), f"no time: {row}"


def test_a_readme_without_that_section_is_refused() -> None:
    path = ROOT / "benchmarks" / "ten_minutes.py"
    with pytest.raises(ValueError, match="no section"):
        runpy.run_path(str(path))["commands"]("# hmi-marl")
