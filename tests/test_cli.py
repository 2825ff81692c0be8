import json
import re
import signal
import subprocess
import sys
from contextlib import redirect_stdout
from functools import cache
from io import StringIO
from pathlib import Path
from urllib.parse import urlparse
from urllib.request import url2pathname

import pytest
from PIL import Image

import hmi_marl
from hmi_marl import interrupts
from hmi_marl.agents.catalogue import known_names
from hmi_marl.cli import main
from hmi_marl.envs.config import DRIVER, VEHICLE_AI
from hmi_marl.envs.drivers import DRIVERS

SMALL = ["--duration", "2", "--vehicles", "1", "3"]
TINY_TABLE = ["--drivers", "homer", "--hmis", "NoHMI", "own", "--episodes", "1", "--workers", "1"]
TINY_TABLE += SMALL


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def file_in_the_way(tmp_path: Path) -> None:
    (tmp_path / "file").touch()


def status_of(arguments: list[str]) -> int:
    """As the shell sees it: what main returns, or what it exits with."""
    try:
        return main(arguments)
    except SystemExit as stop:
        return int(stop.code or 0)


def fails_on_the_way(error: Exception, monkeypatch: pytest.MonkeyPatch) -> int:
    """Status of a command that cannot write what it has found."""

    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr("hmi_marl.commands.oracle.write_json", fail)
    return main(["oracle", "--horizon", "3"])


def words(text: str) -> str:
    """Without the frame and the line ends that tyro puts around errors."""
    return " ".join(re.sub(r"[│╭╮╰╯─]", " ", text).split())


def test_oracle_prints_the_optimum_and_the_audit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["oracle", "--driver", "homer", "--horizon", "100", "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr()
    rows = {line.split()[0]: line.split()[1:] for line in printed.out.splitlines() if line.strip()}
    # Homer alone is distracted with p = 0.8 in every step
    assert rows["never"][1:] == ["-800.00", "0.00"]
    assert rows["always"][1:] == ["0.00", "100.00"]
    assert rows["optimal"] == rows["when-distracted"]
    assert float(rows["optimal"][1]) == pytest.approx(-125.98, abs=0.01)
    assert "-800.00 to 0.00" in printed.out
    assert printed.out.count("OUT OF REACH") == 2
    assert printed.err == ""


def test_oracle_writes_what_it_prints(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--driver", "bart", "--window", "3", "--horizon", "5", "--out", str(tmp_path)]
    assert main(["oracle", *arguments]) == 0
    path = tmp_path / "bart-window3-horizon5.json"
    assert [path] == list(tmp_path.iterdir())
    assert f"written: {path}" in capsys.readouterr().out
    content = json.loads(path.read_text())
    assert content["driver"]["name"] == "bart"
    assert (content["window"], content["horizon"]) == (3, 5)
    # η = 0.01: p(d = 1) is 0.79 in every step of an alert, else 0.8
    assert content["returns"]["never"]["distraction_return"] == pytest.approx(-40.0)
    assert content["returns"]["always"]["distraction_return"] == pytest.approx(-39.5)
    # no alert is worth 10 in each step after an attentive one: 10 (1 + 4 x 0.2) - 40
    assert content["returns"]["never"]["total_return"] == pytest.approx(-22.0)
    # one that brings attention back is worth 30: 30 x 4 x 0.79 x 0.21 - 39.5
    assert content["returns"]["always"]["total_return"] == pytest.approx(-19.592)
    assert content["returns"]["always"]["alerts"] == 5.0
    best = content["returns"]["optimal"]["total_return"]
    assert best == max(row["total_return"] for row in content["returns"].values())
    reachable = content["reachable_distraction_return"]
    assert reachable == {"least": pytest.approx(-40.0), "most": pytest.approx(-39.5)}
    verdicts = {(cell["hmi"], cell["driver"]): cell["reachable"] for cell in content["audit"]}
    assert [key for key, reached in verdicts.items() if not reached] == [
        ("own", "lisa"),
        ("own", "bart"),
    ]


@pytest.fixture(scope="module")
def table_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    # a folder whose name needs care in an address
    return tmp_path_factory.mktemp("cli") / "a table"


@pytest.fixture(scope="module")
def table_printed(table_folder: Path) -> str:
    arguments = ["table", *TINY_TABLE, "--out", str(table_folder)]
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(StringIO()) as printed:
        patch.setattr(sys, "argv", ["hmi-marl", *arguments])
        assert main() == 0
    return printed.getvalue()


def test_table_writes_all_its_files(table_printed: str, table_folder: Path) -> None:
    assert {path.name for path in table_folder.iterdir()} == {
        "table.txt",
        "table.csv",
        "table.json",
        "table.png",
        "clip.gif",
        "index.html",
    }
    with Image.open(table_folder / "clip.gif") as clip:
        assert clip.n_frames == 2 * 10 + 1


def test_table_prints_what_it_writes(table_printed: str, table_folder: Path) -> None:
    parts = (table_folder / "table.txt").read_text("utf-8").strip().split("\n\n")
    assert len(parts) > 8
    for part in parts:  # but for headings, and the number of cells
        assert part.rpartition(" each. ")[2] in table_printed or part.endswith("===")
    assert "95 % intervals" in table_printed


def test_table_prints_the_pages_address(table_printed: str, table_folder: Path) -> None:
    (address,) = re.findall(r"file://\S+", table_printed)
    assert Path(url2pathname(urlparse(address).path)) == table_folder / "index.html"


def test_table_writes_cells_as_promised(table_printed: str, table_folder: Path) -> None:
    content = json.loads((table_folder / "table.json").read_text())
    assert [(cell["hmi"], cell["driver"]) for cell in content["cells"]] == [
        ("NoHMI", "homer"),
        ("own", "homer"),
    ]
    assert content["cells"][0]["exact_distraction_return"] == pytest.approx(-80.0)
    assert content["cells"][0]["alerts"] == 0.0
    assert content["settings"]["vehicles"] == [1, 3]


def test_the_page_says_how_to_make_it_again(table_printed: str, table_folder: Path) -> None:
    page = (table_folder / "index.html").read_text("utf-8")
    assert "hmi-marl table --drivers homer --hmis NoHMI own --episodes 1" in page


@pytest.mark.usefixtures("undrawn")
def test_the_page_says_how_main_was_called(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["my_script.py", "--unrelated"])
    assert main(["table", *TINY_TABLE, "--no-clip", "--out", str(tmp_path)]) == 0
    page = (tmp_path / "index.html").read_text("utf-8")
    assert "hmi-marl table --drivers homer" in page


@pytest.mark.usefixtures("undrawn")
def test_table_without_a_clip(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["table", *TINY_TABLE, "--no-clip", "--out", str(tmp_path)]) == 0
    assert not (tmp_path / "clip.gif").exists()
    assert (tmp_path / "index.html").exists()
    printed = capsys.readouterr()
    assert "2/2" in printed.err, "the bar ran to its end"
    assert "episodes/s" not in printed.out


def test_watch_writes_a_clip(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "clip.gif"
    assert main(["watch", "--driver", "marge", *SMALL, "--out", str(path)]) == 0
    with Image.open(path) as clip:
        assert clip.n_frames == 21
    printed = capsys.readouterr()
    assert printed.out == f"written: {path}\n"
    assert "21/21" in printed.err, "the bar ran to its end"


@cache
def clip_of(*arguments: str) -> bytes:
    """The clip that a command leaves in this folder."""
    assert main([*arguments, "--out", "watched.gif"]) == 0
    return Path("watched.gif").read_bytes()


@pytest.mark.parametrize(
    "option", [["--perceived"], ["--seed", "3"], ["--driver", "bart"], ["--policy", "random"]]
)
def test_what_is_watched_depends_on_the_options(option: list[str]) -> None:
    watch = ["watch", "--duration", "1", "--vehicles", "9", "9"]
    assert clip_of(*watch) != clip_of(*watch, *option)


@pytest.mark.parametrize("option", [["--alert-window", "1"], ["--no-end-at-crash"]])
def test_what_is_watched_depends_on_the_rules(option: list[str]) -> None:
    watch = ["watch", "--duration", "2", "--vehicles", "20", "20", "--seed", "5"]
    watch += ["--policy", "random", "--hmi", "random"]  # crashes within two seconds
    assert clip_of(*watch) != clip_of(*watch, *option)


def test_watch_works_with_hidden_attention(tmp_path: Path) -> None:
    path = tmp_path / "clip.gif"
    arguments = ["watch", *SMALL, "--duration", "1", "--no-ai-sees-attention", "--out", str(path)]
    assert main(arguments) == 0
    assert path.stat().st_size > 0


def test_hidden_attention_reaches_the_hmi(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["watch", "--hmi", "when-distracted", "--no-ai-sees-attention", "--out", "clip.gif"]
    assert main(arguments) == 2
    assert "ai_sees_attention=False hides" in capsys.readouterr().err


def test_watch_without_a_display_gives_advice(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("hmi_marl.envs.render.has_display", lambda: False)
    assert main(["watch", *SMALL]) == 2
    printed = capsys.readouterr()
    assert printed.err.startswith("hmi-marl: there is no display")
    assert "--out clip.gif" in printed.err
    assert printed.err.count("\n") == 1


BAD_NAMES = [
    (["oracle", "--driver", "moe"], "unknown driver 'moe'", list(DRIVERS)),
    (["watch", "--driver", "moe", "--out", "clip.gif"], "unknown driver 'moe'", list(DRIVERS)),
    (["watch", "--hmi", "siren", "--out", "clip.gif"], "unknown HMI 'siren'", []),
    (["watch", "--hmi", "hmi/x", "--out", "clip.gif"], "no policy for the seat of vehicle_ai", []),
    (["watch", "--policy", "ace", "--out", "clip.gif"], "unknown driver policy", ["rule"]),
]
BAD_NAMES_IN_TABLE = [
    (["table", "--drivers", "moe"], "unknown driver 'moe'", list(DRIVERS)),
    (["table", "--hmis", "siren"], "unknown HMI 'siren'", []),
    (["table", "--driver-policy", "ace"], "unknown driver policy", ["rule"]),
]


@pytest.mark.parametrize(("arguments", "message", "known"), BAD_NAMES + BAD_NAMES_IN_TABLE)
def test_an_unknown_name_is_reported_with_the_known_ones(
    arguments: list[str],
    message: str,
    known: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert status_of(arguments) == 2
    printed = capsys.readouterr()
    error = words(printed.err)
    assert message in error
    for name in known:
        assert name in error
    assert "Traceback" not in error
    assert printed.out == ""
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "arguments",
    [arguments for arguments, _, _ in BAD_NAMES + BAD_NAMES_IN_TABLE]
    + [
        ["oracle", "--window", "0"],
        ["oracle", "--horizon", "0"],
        ["watch", "--seed", "-1", "--out", "clip.gif"],
        ["watch", "--duration", "0.3", "--out", "clip.gif"],
        ["watch", "--vehicles", "3", "1", "--out", "clip.gif"],
        ["watch", "--alert-window", "0", "--out", "clip.gif"],
        ["watch", *SMALL, "--out", "clip.txt"],
        ["table", "--episodes", "0"],
        ["table", "--seed", "-1"],
        ["table", "--workers", "0"],
        ["table", "--world", "moon"],
        ["table", "--drivers", "Homer", "homer"],
        ["table", "--out", "file"],
        ["table", "--out", "file/below"],
        ["watch", *SMALL, "--out", "file/clip.gif"],
        ["oracle", "--horizon", "3", "--out", "file"],
    ],
)
@pytest.mark.usefixtures("file_in_the_way")
def test_bad_input_is_reported_in_one_line(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    assert re.fullmatch(r"hmi-marl: [^\n]+\n", capsys.readouterr().err)


@pytest.mark.parametrize(
    "error", [MemoryError(), OSError(28, "No space left"), OverflowError("no")]
)
def test_what_fails_on_the_way_is_reported_in_one_line(
    error: Exception, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert fails_on_the_way(error, monkeypatch) == 2
    printed = capsys.readouterr()
    assert re.fullmatch(r"hmi-marl: [^\n]+\n", printed.err)
    assert printed.out == ""


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (OSError(28, "No space left"), "No space left"),
        (FileNotFoundError(2, "No such file", "a b"), "a b: No such file"),
        (OSError(5, "Input/output error", 3), "Input/output error"),  # 3: an open file's number
        (OSError("no errno"), "no errno"),
    ],
)
def test_an_error_of_the_system_begins_with_its_file(
    error: Exception,
    message: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert fails_on_the_way(error, monkeypatch) == 2
    assert capsys.readouterr().err == f"hmi-marl: {message}\n"


@pytest.mark.parametrize("part", [["export"], ["delete"], ["traits"]])
def test_a_missing_database_is_named(part: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["people", *part, "none.db", *(["A" * 16] if part == ["delete"] else [])]
    assert main(arguments) == 2
    assert capsys.readouterr().err == "hmi-marl: none.db: No such file or directory\n"


def test_an_interrupt_is_reported_in_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("hmi_marl.commands.oracle.alert_problem", interrupt)
    assert main(["oracle"]) == 130
    assert capsys.readouterr().err == "hmi-marl: interrupted\n"


def test_an_interrupt_that_a_library_turns_into_another_error_is_reported_in_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupt(*_: object) -> None:
        interrupts._received.append(signal.SIGTERM)
        raise SystemError("returned a result with an exception set")

    monkeypatch.setattr(interrupts, "_received", [])
    monkeypatch.setattr("hmi_marl.commands.oracle.alert_problem", interrupt)
    assert main(["oracle"]) == 143
    assert capsys.readouterr().err == "hmi-marl: terminated\n"


@pytest.mark.parametrize("arguments", [["--help"], ["oracle", "--horizon", "3"]])
def test_a_reader_who_goes_away_is_no_error(arguments: list[str]) -> None:
    command = [sys.executable, "-m", "hmi_marl", *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.close()
        assert process.stderr is not None
        assert process.stderr.read() == b""
    assert process.returncode == 141


def test_the_module_is_the_command() -> None:
    command = [sys.executable, "-m", "hmi_marl", "--version"]
    run = subprocess.run(command, capture_output=True, text=True, check=True)
    assert run.stdout == f"hmi-marl {hmi_marl.__version__}\n"


@pytest.mark.parametrize("arguments", [["fly"], ["oracle", "--horizon", "many"]])
def test_a_command_that_cannot_be_parsed_exits_with_2(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert status_of(arguments) == 2
    printed = capsys.readouterr()
    assert re.fullmatch(r"hmi-marl: [^\n]*hmi-marl[\w ]* --help[^\n]*\n", printed.err)
    assert printed.out == ""


@pytest.mark.parametrize("command", [[], ["oracle"], ["table"], ["watch"]])
def test_help_exits_with_0_and_gives_an_example(
    command: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stop:
        main([*command, "--help"])
    assert stop.value.code == 0
    printed = capsys.readouterr()
    assert f"Example: hmi-marl {' '.join(command) or 'oracle'}" in words(printed.out)
    assert printed.err == ""


def test_without_a_command_the_help_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    printed = []
    for arguments in ([], ["--help"]):
        assert status_of(arguments) == 0
        printed.append(capsys.readouterr().out)
    assert printed[0] == printed[1]
    assert "--version" in printed[0]


def test_help_lists_the_known_names(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--help"])
    printed = capsys.readouterr().out
    known = (*known_names(VEHICLE_AI), *known_names(DRIVER))
    for name in (*DRIVERS, *known, "rule", "random", "oracle", "table", "watch"):
        assert re.search(rf"(?m)^\W*{re.escape(name)} ", printed), name


def test_a_shells_completions_are_printed(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["watch", "--tyro-print-completion", "bash"])
    printed = capsys.readouterr()
    assert (stop.value.code or 0, printed.err) == (0, "")
    assert "hmi-marl watch" in printed.out
    assert "--perceived" in printed.out
