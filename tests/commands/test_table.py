import json
from pathlib import Path

import pytest

from hmi_marl.cli import main
from hmi_marl.reporting import highlight

TINY = "table --drivers homer --hmis NoHMI when-distracted own --episodes 3 --duration 4"


@pytest.mark.usefixtures("undrawn")
def test_the_last_lines_say_what_came_out_where_it_is_and_what_to_try_next(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = [*TINY.split(), "--world", "batched", "--workers", "1", "--out", str(tmp_path)]
    assert main(arguments) == 0
    content = json.loads((tmp_path / "table.json").read_text("utf-8"))
    *sentences, page, clip, caption = [
        line for line in capsys.readouterr().out.splitlines()[-8:] if line
    ]
    said = [f"{r['title']}: {r['text'].replace('`', '')}" for r in content["in_short"]]
    assert sentences[-len(said) :] == said
    assert [r["title"] for r in content["in_short"]] == ["Why rows are alike", "What to try next"]
    assert page == f"the page: {(tmp_path / 'index.html').resolve().as_uri()}"
    assert clip == f"the clip: {tmp_path / 'clip.gif'}"
    assert caption.strip() == content["clip"]
    assert "the HMI alerts" in caption


@pytest.mark.usefixtures("undrawn")
def test_without_a_clip_none_is_spoken_of(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = [*TINY.split(), "--world", "batched", "--workers", "1", "--no-clip"]
    assert main([*arguments, "--out", str(tmp_path)]) == 0
    assert "the clip" not in capsys.readouterr().out
    assert json.loads((tmp_path / "table.json").read_text("utf-8"))["clip"] == ""


def test_a_clip_that_fails_loses_no_results(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise ValueError("no clip today")

    monkeypatch.setattr(highlight, "record", fail)
    arguments = [*TINY.split(), "--world", "batched", "--workers", "1", "--out", str(tmp_path)]
    assert main(arguments) == 2
    shown = capsys.readouterr()
    assert "hmi-marl: no clip today" in shown.err
    assert "when-distracted" in shown.out
    assert {path.name for path in tmp_path.iterdir()} == {"table.csv", "table.json", "table.txt"}
