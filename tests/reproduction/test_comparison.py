"""A tiny finished comparison ships whole, and the shipped one is of the shipped pairs."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from comparisons import SMALL
from trait_models import save_driver

from hmi_marl.agents.learned.cards import INDEX_FORMAT, find_shipped, shipped_agents
from hmi_marl.agents.learned.policy import load_policy
from hmi_marl.cli import main
from hmi_marl.experiments.experiment import Agent, Place, conduct
from hmi_marl.file_index import INDEX, write_index
from hmi_marl.files import sha256_of, write_json
from hmi_marl.reporting.report import index_report
from hmi_marl.reproduction import comparison
from hmi_marl.reproduction.comparison import check_shipped, find_comparison, ship_comparison
from hmi_marl.reproduction.shipping import ship_more

TINY = replace(
    SMALL,
    protocols=("two-stage", "simultaneous"),
    steps=160,
    rounds=1,
    seeds=1,
    few_seeds=1,
    anchor_kls=(),
    crash_check=False,
    snapshots=1,
    episodes=8,
    cross_episodes=8,
    duration=0.4,
    vehicles=(1, 1),
)
PAIRS = [f"hidden-{name}-{role}" for name in TINY.protocols for role in ("driver", "hmi")]
SHIPPED = Path(__file__).parents[2] / "docs" / "compare"


@pytest.fixture(scope="module")
def finished(
    module_trained_here: None, module_undrawn: None, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    folder = tmp_path_factory.mktemp("finished") / "compare"
    command = f"hmi-marl compare --out {folder}"
    conduct(TINY, Place(folder, folder, command_line=command))
    return folder


@pytest.fixture
def run(finished: Path, tmp_path: Path) -> Path:
    """A copy, which may be changed."""
    return Path(shutil.copytree(finished, tmp_path / "run"))


@pytest.fixture
def trained(tmp_path: Path) -> Path:
    """Shipped agents of another run."""
    folder = tmp_path / "trained"
    folder.mkdir()
    write_index(folder, INDEX_FORMAT, {"version": "1", "agents": {}})
    card = save_driver(tmp_path / "learned") / "driver.json"
    ship_more([Agent("mine", card, "drives")], folder)
    return folder


def content_of(*folders: Path) -> dict[Path, bytes]:
    found = [path for folder in folders for path in folder.rglob("*") if path.is_file()]
    return {path: path.read_bytes() for path in found}


def test_a_finished_comparison_ships_whole(run: Path, trained: Path, tmp_path: Path) -> None:
    report, mine = tmp_path / "docs", (trained / "mine" / "driver.json").read_bytes()
    command = ["reproduce", "ship", "--compare", str(run), "--out", str(trained)]
    assert main([*command, "--report", str(report)]) == 0
    assert sorted(shipped_agents(trained)) == sorted(["mine", *PAIRS])
    assert (trained / "mine" / "driver.json").read_bytes() == mine
    team = TINY.plans()[0].team()
    load_policy(find_shipped(f"trained:{PAIRS[0]}", "driver", trained), "driver", team)
    written = {path.name for path in run.iterdir() if path.is_file()}
    assert {"compare.txt", "hidden-curves.png", "hidden-simultaneous.gif"} < written
    assert {path.name for path in report.iterdir()} == written - {"index.html"}
    for name in written - {"index.html", "compare.json", INDEX}:
        assert (report / name).read_bytes() == (run / name).read_bytes()
    content, own = (json.loads((each / "compare.json").read_text()) for each in (report, run))
    assert content.pop("command") == "hmi-marl compare --out compare", "no places of this machine"
    del own["command"]
    assert content == own
    assert check_shipped(report, trained) == PAIRS


def test_the_json_names_the_checksums_of_all_weights(finished: Path) -> None:
    learned = json.loads((finished / "compare.json").read_text())["tasks"]["hidden"]["training"]
    assert set(learned) == {run.name for plan in TINY.plans() for run in plan.runs}
    for run, training in learned.items():
        assert training["weights"] == {
            seat: sha256_of(finished / run / f"{seat}.safetensors")
            for seat in ("driver", "vehicle_ai")
        }


def test_a_later_comparison_takes_the_place_of_the_earlier(
    run: Path, trained: Path, tmp_path: Path
) -> None:
    report = tmp_path / "docs"
    (report / "below").mkdir(parents=True)
    for name in ("compare.json", "compare.txt", "seen.txt", "below/more.txt"):
        (report / name).write_text("shipped by hand")
    ship_comparison(run, trained, report)
    check_shipped(report, trained)
    kept = {path.name for path in report.rglob("*.txt")} - {"compare.txt"}
    assert kept == {"seen.txt", "more.txt"}, "other files stay"
    (report / "hidden-sweep.png").write_bytes(b"of the earlier one")
    drawn = [path.name for path in report.glob("hidden-*.*")]
    index_report(report, "compare", ["compare.txt", "compare.json", *drawn])
    ship_comparison(run, trained, report)
    assert not (report / "hidden-sweep.png").exists()
    assert check_shipped(report, trained) == PAIRS


@pytest.mark.parametrize("name", ["compare.txt", "compare.json", "hidden-cross.png"])
def test_a_changed_file_is_found(name: str, run: Path, trained: Path, tmp_path: Path) -> None:
    report = tmp_path / "docs"
    ship_comparison(run, trained, report)
    before = (report / name).read_bytes()
    (report / name).write_bytes(before + b" ")
    with pytest.raises(ValueError, match=f"{name} is not the file that was shipped .*; ship the"):
        check_shipped(report, trained)
    (report / name).unlink()
    with pytest.raises(FileNotFoundError, match=f"{name} is missing; ship the comparison anew"):
        check_shipped(report, trained)
    (report / name).write_bytes(before)
    assert check_shipped(report, trained) == PAIRS


def test_pairs_of_another_comparison_are_found(run: Path, trained: Path, tmp_path: Path) -> None:
    report = tmp_path / "docs"
    ship_comparison(run, trained, report)
    other = save_driver(tmp_path / "other", 5) / "driver.json"
    ship_more([Agent(PAIRS[0], other, "drives in its place")], trained)
    with pytest.raises(ValueError, match=f"{PAIRS[0]} in .* is not of the comparison that"):
        check_shipped(report, trained)
    ship_comparison(run, trained)
    assert check_shipped(report, trained) == PAIRS
    ship_more([Agent("hidden-joint-driver", other, "is of another run")], trained)
    message = (
        "has hidden-joint-driver, which is of another comparison; ship one of all of two-stage"
    )
    with pytest.raises(ValueError, match=message):
        check_shipped(report, trained)
    with pytest.raises(ValueError, match=message):
        ship_comparison(run, trained, report)


@pytest.mark.parametrize("where", ["fill", "_copy_report", "index_report"])
def test_an_interrupted_ship_leaves_the_old_files(
    where: str, run: Path, trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    report = tmp_path / "docs"
    report.mkdir()
    for name in ("compare.json", "compare.txt"):
        (report / name).write_text("the old one")
    before, names = content_of(trained, report), set(tmp_path.iterdir())
    work = getattr(comparison, where)

    def cut_off(*arguments: object) -> None:
        work(*arguments)
        raise KeyboardInterrupt

    monkeypatch.setattr(comparison, where, cut_off)
    with pytest.raises(KeyboardInterrupt):
        ship_comparison(run, trained, report)
    assert content_of(trained, report) == before
    assert set(tmp_path.iterdir()) == names, "nothing is left over"
    monkeypatch.undo()
    ship_comparison(run, trained, report)
    check_shipped(report, trained)


def unfinished(run: Path) -> None:
    (run / INDEX).unlink()


def written_in_part(run: Path) -> None:
    (run / "compare.txt").write_text("of a later one, whose figures were not drawn")


def trained_on(run: Path) -> None:
    save_driver(run / "hidden" / "two-stage-run0", 7)


def cleared(run: Path) -> None:
    (run / "hidden" / "simultaneous-run0" / "vehicle_ai.safetensors").unlink()


def of_another_report(run: Path) -> None:
    index_report(run, "table", ["compare.txt"])


def of_before(run: Path) -> None:
    """As comparisons were written before, but with an index."""
    content = json.loads((run / "compare.json").read_text())
    for training in content["tasks"]["hidden"]["training"].values():
        del training["weights"]
    write_json(run / "compare.json", content)
    index_report(run, "compare", ["compare.json", "compare.txt"])


WRONG = [
    (unfinished, "has no INDEX.json of a whole report; run its hmi-marl compare to the end"),
    (written_in_part, r"compare\.txt is not the file that its report was written with"),
    (trained_on, r"two-stage-run0.driver\.safetensors has changed since compare\.json was written"),
    (cleared, r"simultaneous-run0.vehicle_ai\.safetensors is missing"),
    (of_another_report, "holds the report 'table', not compare"),
    (of_before, "is no comparison with the checksums of its weights"),
]


@pytest.mark.parametrize(("change", "message"), WRONG, ids=[change.__name__ for change, _ in WRONG])
def test_unfinished_and_foreign_folders_are_refused_at_the_door(
    change, message: str, run: Path, trained: Path, tmp_path: Path
) -> None:
    find_comparison(run)
    change(run)
    before = content_of(tmp_path)
    for report in (None, tmp_path / "docs"):
        with pytest.raises((ValueError, FileNotFoundError), match=message):
            ship_comparison(run, trained, report)
    assert content_of(tmp_path) == before
    assert not (tmp_path / "docs").exists()


def test_a_report_goes_to_no_folder_of_other_things(
    run: Path, trained: Path, tmp_path: Path
) -> None:
    precious = tmp_path / "precious"
    precious.mkdir()
    (precious / "thesis.txt").touch()
    another = shutil.copytree(run, tmp_path / "another")
    before = content_of(tmp_path)
    for report, message in (
        (precious, "holds other things than a shipped comparison; choose another --report"),
        (another, "holds other things than a shipped comparison"),
        (run, "overlaps with"),
        (run / "docs", "overlaps with"),
        (trained, "overlaps with"),
        (tmp_path, "overlaps with"),
        (precious / "thesis.txt", "is not a folder"),
    ):
        with pytest.raises((ValueError, OSError), match=message):
            ship_comparison(run, trained, report)
    with pytest.raises(FileNotFoundError, match="no trained agents"):
        ship_comparison(run, precious, tmp_path / "docs")
    assert content_of(tmp_path) == before


def test_the_shipped_comparison_is_of_the_shipped_pairs() -> None:
    if not (SHIPPED / INDEX).is_file():
        pytest.skip("it was shipped by hand, before comparisons had an index")
    assert len(check_shipped(SHIPPED)) == 6
