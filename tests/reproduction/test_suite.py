import json
import multiprocessing
import os
import random
import signal
import subprocess
import sys
import time
from functools import cache
from pathlib import Path

import pytest
from browsing import browser, chromium, walk
from stages import Counting

from hmi_marl.experiments.experiment import Place, learned_in
from hmi_marl.files import with_checksum, without_checksum, write_json
from hmi_marl.paper import audit
from hmi_marl.reproduction import report
from hmi_marl.reproduction.report import PAGE, REPORT, full_report
from hmi_marl.reproduction.suite import TIMINGS, is_done, read_timings, run_suite


@pytest.fixture(autouse=True)
def audited_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every report asks for the same exact values, which take most of its time."""
    monkeypatch.setattr(report, "exact_values", EXACT_VALUES)
    for module in (report, audit):
        monkeypatch.setattr(module, "audit", AUDIT)


TESTS = Path(__file__).parents[1]
AUDIT, EXACT_VALUES = cache(report.audit), cache(report.exact_values)
ONE, OTHER = Counting("one"), Counting("other", 2)
TINY = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[2])
from cited import missing_in
from hmi_marl.experiments.adaptation.experiment import Adaptation, AdaptSettings
from hmi_marl.experiments.attentive_drivers import AttentiveDrivers
from hmi_marl.experiments.graded_alerts import GradedAlerts
from hmi_marl.experiments.hidden_attention import HiddenAttention
from hmi_marl.experiments.identification.experiment import DriverIdentification
from hmi_marl.experiments.metrics_table.experiment import MetricsTable
from hmi_marl.experiments.latent_traits.assessment import AssessSettings
from hmi_marl.experiments.latent_traits.experiment import LatentTraits
from hmi_marl.reproduction.report import full_report
from hmi_marl.reproduction.suite import run_suite, shared_driver
from hmi_marl.training.protocols.settings import PPOSettings
from hmi_marl.training.traits.settings import TraitSettings

if __name__ == "__main__":
    learn = TraitSettings(pool=1, latent=2, num_teams=2, ppo=PPOSettings(num_mini_batches=1),
                          steps=1, imitation_updates=1, average_updates=1, encoder_updates=1,
                          device="cpu")
    suite = [
        MetricsTable(1, 1, 4, 16, seeds=1),
        AttentiveDrivers(1, 1, 8, 16, seeds=2),
        HiddenAttention(1, 1, 4, 4, 16, seeds=1),
        LatentTraits(1, 2000, 3, 8, learn, seeds=1, evaluation=AssessSettings(10, 1, 2)),
        Adaptation(320, 1, 40, 6, 1, 4, seeds=1, evaluation=AdaptSettings(4, 2, 1, 2, 2)),
        DriverIdentification(1, 8, 3, 4, 16),
        GradedAlerts(1, 4, 16, seeds=1),
    ]
    folder = Path(sys.argv[1])
    records = run_suite(suite, folder, shared_driver(suite, folder), 2, "hmi-marl reproduce")
    report = full_report(records, "hmi-marl reproduce")
    report.write(folder / "report")
    sys.exit("\\n".join(missing_in(report)) or 0)
"""


def written(folder: Path) -> dict[str, bytes]:
    """All files of a report but those of durations, which no two runs have in common."""
    varying = ("times.html", TIMINGS)
    found = {path.name: path.read_bytes() for path in (folder / REPORT).iterdir()}
    assert set(found) >= {PAGE, "claims.html", "made.html", "reproduce.json", *varying}
    return {name: content for name, content in found.items() if name not in varying}


def reproduce(folder: Path, stages=(ONE, OTHER), said=None) -> dict[str, bytes]:
    """As ``hmi-marl reproduce`` does; returns the report."""
    line = str if said is None else said.append
    records = run_suite(stages, folder, folder, 1, "hmi-marl", line)
    timings = read_timings(folder / TIMINGS)
    full_report(records, "hmi-marl reproduce", timings).write(folder / REPORT)
    return written(folder)


def test_what_is_done_is_skipped_and_said(tmp_path: Path) -> None:
    said: list[str] = []
    first = reproduce(tmp_path, said=said)
    assert said[0] == "stage 1 of 2, one: Counting <to some number>"
    assert said[1].startswith("stage 1 of 2, one: done in")
    times = json.loads((tmp_path / TIMINGS).read_text())
    assert set(times["one"]) == {"this time", "counting"}
    said.clear()
    assert reproduce(tmp_path, said=said) == first
    assert said == ["stage 1 of 2, one: done already", "stage 2 of 2, other: done already"]
    assert json.loads((tmp_path / TIMINGS).read_text()) == times


def test_a_stage_of_other_settings_is_refused_before_anything_is_run(tmp_path: Path) -> None:
    reproduce(tmp_path, [OTHER])
    with pytest.raises(ValueError, match=r"other holds another run \(steps = 2, now 4\)"):
        reproduce(tmp_path, [ONE, Counting("other", 4)])
    assert not (tmp_path / "one").exists()


def test_a_stage_of_another_version_is_refused(tmp_path: Path, monkeypatch) -> None:
    reproduce(tmp_path)
    monkeypatch.setattr("hmi_marl.__version__", "99.0")
    with pytest.raises(ValueError, match=r"version = .* now '99\.0'"):
        reproduce(tmp_path)


def test_a_stage_whose_weights_changed_is_done_again(tmp_path: Path) -> None:
    first = reproduce(tmp_path)
    place = Place(tmp_path / "one", tmp_path)
    assert is_done(ONE, place, tmp_path)
    (tmp_path / "one" / "count.safetensors").write_bytes(b"12")
    assert not is_done(ONE, place, tmp_path)
    said: list[str] = []
    assert reproduce(tmp_path, said=said) == first
    assert said[0] == "stage 1 of 2, one: once more, since one/count.safetensors has changed"
    assert said[-1] == "stage 2 of 2, other: done already"


def test_a_record_of_an_earlier_format_is_made_again(tmp_path: Path) -> None:
    first = reproduce(tmp_path)
    record = tmp_path / "stages" / "one.json"
    content = without_checksum(json.loads(record.read_text()))
    write_json(record, with_checksum({n: content[n] for n in content if n != "format"}))
    assert not is_done(ONE, Place(tmp_path / "one", tmp_path), tmp_path)
    said: list[str] = []
    assert reproduce(tmp_path, said=said) == first
    assert said[0] == "stage 1 of 2, one: once more, since the format of records has changed"


def test_results_of_an_earlier_format_are_made_again_from_what_is_learned(tmp_path: Path) -> None:
    first = reproduce(tmp_path)
    learned = (tmp_path / "one" / "count.safetensors").stat().st_mtime_ns
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Counting, "results_format", 2)
        assert not is_done(ONE, Place(tmp_path / "one", tmp_path), tmp_path)
        said: list[str] = []
        assert reproduce(tmp_path, said=said) == first
        why = "once more, since the format of its results has changed"
        assert said[0] == f"stage 1 of 2, one: {why}"
        assert is_done(ONE, Place(tmp_path / "one", tmp_path), tmp_path)
    assert (tmp_path / "one" / "count.safetensors").stat().st_mtime_ns == learned


def test_a_record_without_a_format_of_results_has_the_first(tmp_path: Path) -> None:
    reproduce(tmp_path)
    record = tmp_path / "stages" / "one.json"
    content = without_checksum(json.loads(record.read_text()))
    write_json(record, with_checksum({n: content[n] for n in content if n != "results_format"}))
    assert is_done(ONE, Place(tmp_path / "one", tmp_path), tmp_path)


def test_a_damaged_record_is_said(tmp_path: Path) -> None:
    reproduce(tmp_path)
    record = tmp_path / "stages" / "one.json"
    content = json.loads(record.read_text())
    for damaged in (
        {name: content[name] for name in content if name != "numbers"},
        content | {"numbers": {"count": 2}},
        content | {"blocks": []},
    ):
        record.write_text(json.dumps(damaged))
        with pytest.raises(ValueError, match=r"one\.json is damaged \(its checksum differs\)"):
            reproduce(tmp_path)
    record.write_text("{")
    with pytest.raises(ValueError, match=r"one\.json is damaged .*remove it"):
        reproduce(tmp_path)


def test_weights_and_demonstrations_are_what_results_depend_on(tmp_path: Path) -> None:
    for name in (
        "b.parquet",
        "a.safetensors",
        "checkpoint.safetensors",
        "card.json",
        ".left.parquet",
    ):
        (tmp_path / "run").mkdir(exist_ok=True)
        (tmp_path / "run" / name).touch()
    assert [path.name for path in learned_in(tmp_path)] == ["a.safetensors", "b.parquet"]


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork, to be fast")
@pytest.mark.parametrize("seed", range(3))
def test_killed_three_times_at_random_it_ends_with_the_same_report(tmp_path: Path, seed) -> None:
    slow = [Counting(name, 12, pause=0.01) for name in ("one", "other", "third")]
    straight = reproduce(tmp_path / "straight", [Counting(s.name, s.steps) for s in slow])
    cut, rng, killed = tmp_path / "cut", random.Random(seed), 0
    while killed < 3:
        process = multiprocessing.get_context("fork").Process(target=reproduce, args=(cut, slow))
        process.start()
        time.sleep(rng.uniform(0.02, 0.2))
        os.kill(process.pid, signal.SIGKILL)
        process.join()
        killed += 1
        if (cut / REPORT / PAGE).is_file():
            break  # it was done before
    assert killed
    assert reproduce(cut, slow) == straight


def started(folder: Path) -> subprocess.Popen:
    script = folder.with_suffix(".py")
    script.write_text(TINY)
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    return subprocess.Popen([sys.executable, script, folder, TESTS], env=environment, **quiet)


def files_in(folder: Path) -> int:
    return sum(len(files) for _, _, files in os.walk(folder))


@pytest.mark.long
def test_a_whole_reproduction_killed_three_times_ends_with_the_same_report(tmp_path: Path) -> None:
    pytest.importorskip("torch")
    straight, cut, rng = tmp_path / "straight", tmp_path / "cut", random.Random(0)
    assert started(straight).wait() == 0
    whole = files_in(straight)
    for number in range(3):  # in each third of what there is to do, on a machine of any speed
        killed_at = rng.uniform(number, number + 0.9) / 3 * whole
        process = started(cut)
        while files_in(cut) < killed_at and process.poll() is None:
            time.sleep(0.02)
        time.sleep(rng.uniform(0, 1))
        process.kill()
        assert process.wait() != 0, "it was done before it was killed"
    assert started(cut).wait() == 0
    assert written(cut) == written(straight)
    if chromium():
        with browser() as opened:
            found = walk(opened, cut, sorted((cut / REPORT).glob("*.html")))
        assert not found.problems
        assert not found.dead_links()
