"""A tiny comparison, trained and played: its files, runs, pairs and JSON."""

import json
import math
import shutil
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cited import missing_in, reports_written
from comparisons import SMALL

from hmi_marl.agents.catalogue import make_driver_policy, make_hmi
from hmi_marl.agents.learned.policy import load_policy, read_policy
from hmi_marl.cli import main
from hmi_marl.envs.rewards import TERMS
from hmi_marl.experiments.episode_sums import ALL_DRIVERS, Sums
from hmi_marl.experiments.episodes import Episodes, evaluation_seeds, play_episodes
from hmi_marl.experiments.experiment import Place
from hmi_marl.experiments.protocols import playing
from hmi_marl.experiments.protocols.arms import PlannedRun
from hmi_marl.experiments.protocols.kept import FOLDER
from hmi_marl.experiments.protocols.pairs import Pair, all_pairs, own_pair
from hmi_marl.experiments.protocols.playing import (
    Divergence,
    episodes_of,
    play_all,
    play_curves,
    play_pair,
    play_point,
    play_tuning,
    tuning_return,
)
from hmi_marl.experiments.protocols.results import hiding, shortfall
from hmi_marl.experiments.protocols.snapshots import points_of
from hmi_marl.experiments.protocols.tasks import TASKS
from hmi_marl.training.jobs import train_all

TINY = replace(
    SMALL,
    steps=160,
    rounds=1,
    seeds=2,
    few_seeds=1,
    anchor_kls=(0.1,),
    partners=True,
    episodes=16,
    cross_episodes=16,
    duration=1.0,
    vehicles=(1, 3),
)
TYPED = (
    "compare --tasks hidden --protocols two-stage joint simultaneous --steps 160 --budgets "
    "--rounds 1 --seeds 2 --few-seeds 1 --driver-shares 0.5 --anchor-kls 0.1 --snapshots 2 "
    "--episodes 16 --cross-episodes 16 --drivers bart homer --num-teams 16 --duration 1 "
    "--vehicles 1 3 --workers 1"
)
(PLAN,) = TINY.plans()

pytestmark = pytest.mark.usefixtures("module_trained_here")


@pytest.fixture(scope="module")
def written(
    module_trained_here: None, module_undrawn: None, tmp_path_factory: pytest.TempPathFactory
) -> Any:
    out = tmp_path_factory.mktemp("compare") / "out"
    with reports_written() as reports:
        assert main([*TYPED.split(), "--out", str(out)]) == 0
    return out, reports


@pytest.fixture(scope="module")
def folder(written: Any) -> Path:
    return written[0]


def test_every_number_is_where_its_source_says(written: Any) -> None:
    assert [missing_in(report) for report in written[1]] == [[]]


@pytest.fixture(scope="module")
def content(folder: Path) -> dict:
    return json.loads((folder / "compare.json").read_text("utf-8"))


def some_episodes() -> Episodes:
    returns = {name: np.zeros(3) for name in TERMS}
    returns["speed_reward"] = np.array([40.0, 20.0, 30.0])
    returns["distraction"] = np.array([-10.0, -30.0, 0.0])
    return Episodes(
        seeds=np.arange(3, dtype=np.uint64),
        length=np.array([10, 5, 10]),
        crashed=np.array([False, True, False]),
        alerts=np.array([4, 1, 0]),
        distracted=np.zeros(3, np.int64),
        min_time_headway=np.full(3, np.inf),
        median_time_headway=np.array([1.0, np.inf, 3.0]),
        returns=returns,
    )


def test_sums_worked_by_hand() -> None:
    sums = Sums.of(some_episodes(), np.array([True, True, False]), frequency=5.0)
    found = sums.metrics()
    assert found["team_return"] == (60.0 - 40.0) / 2
    assert found["attention_return"] == -20.0
    assert found["driving_return"] == 30.0
    assert found["team_return_per_step"] == pytest.approx(20.0 / 15)
    assert found["crash_rate"] == 0.5
    assert found["alerts_per_minute"] == pytest.approx(5 * 20)  # in 3 s
    assert found["length"] == 7.5
    assert found["time_headway"] == 1.0
    assert set(TERMS) < set(found)


def test_sums_of_parts_make_the_whole() -> None:
    episodes = some_episodes()
    whole = Sums.of(episodes, np.ones(3, np.bool_), 5.0)
    parts = [Sums.of(episodes, np.arange(3) == k, 5.0) for k in range(3)]
    joined = Sums.join(parts)
    assert joined.metrics() == pytest.approx(whole.metrics())
    assert (joined.episodes, joined.crashes, joined.steps) == (3, 1, 25)


def test_no_episodes_come_to_nothing_known() -> None:
    nothing = Sums.of(some_episodes(), np.zeros(3, np.bool_), 5.0)
    assert np.isnan(list(nothing.metrics().values())).all()
    assert np.isnan(Sums.join([nothing, nothing]).time_headway)


def test_drivers_share_the_episodes_among_them(folder: Path) -> None:
    pair = Pair("hidden", "hidden/joint-run0", "hidden/two-stage-run0")
    found = play_pair(PLAN, folder, pair)
    parts = [part for name, part in found.sums.items() if name != ALL_DRIVERS]
    assert sum(part.episodes for part in parts) == 16
    assert Sums.join(parts).per_episode() == pytest.approx(found.sums[ALL_DRIVERS].per_episode())
    assert set(found.scores) == {"bart", "homer"}
    assert found.signals == {} == found.divergence, "only of the own pairs"


def test_a_swapped_pair_plays_as_its_policies_do_elsewhere(folder: Path) -> None:
    swapped = Pair("hidden", "hidden/simultaneous-run1", "hidden/two-stage-run0")
    sums = play_pair(PLAN, folder, swapped).sums[ALL_DRIVERS]
    team = PLAN.team()
    episodes = play_episodes(
        team,
        make_driver_policy(str(folder / swapped.driver), team),
        make_hmi(str(folder / swapped.hmi), team),
        evaluation_seeds(16),
        "batched",
    )
    assert sums.terms == pytest.approx({k: v.sum() for k, v in episodes.returns.items()})
    assert sums.alerts == episodes.alerts.sum()


def test_the_divergence_is_that_of_the_probabilities(folder: Path) -> None:
    found = play_pair(PLAN, folder, own_pair(PlannedRun("hidden", "two-stage", 1)))
    assert set(found.divergence.values()) == {0.0}, "from itself"
    other = play_pair(PLAN, folder, own_pair(PlannedRun("hidden", "simultaneous", 0)))
    assert min(other.divergence.values()) > 0.0
    team = PLAN.team()
    policies = [
        load_policy(folder / "hidden" / f"{name}-run0", "driver", team)
        for name in ("simultaneous", "two-stage")
    ]
    watched = Divergence(*policies)
    hmi = make_hmi(str(folder / "hidden/simultaneous-run0"), team)
    seeds = evaluation_seeds(1)
    seen = []
    acting = load_policy(folder / "hidden/simultaneous-run0", "driver", team)
    act = acting.act
    acting.act = lambda observations: (seen.append(observations.copy()), act(observations))[1]
    episodes = play_episodes(team, acting, hmi, seeds, "batched", observers=[watched])
    by_hand = 0.0
    for observations in seen:
        p, q = (policy.probabilities(observations)[0] for policy in policies)
        by_hand += sum(a * math.log(a / b) for a, b in zip(p, q, strict=True))
    assert watched.mean(np.ones(1, np.bool_)) == pytest.approx(by_hand / int(episodes.length[0]))


@pytest.mark.slow
@pytest.mark.usefixtures("unmeasured")
def test_results_do_not_depend_on_the_workers(folder: Path, tmp_path: Path) -> None:
    pairs = all_pairs(PLAN)[:6]
    heard: list[int] = []
    one, other = (shutil.copytree(folder, tmp_path / name) for name in ("one", "other"))
    for each in (one, other):
        shutil.rmtree(each / FOLDER)
    together = play_all(PLAN, pairs, one, 2, heard.append)
    assert heard == [1] * 6
    assert list(together) == pairs
    assert to_the_byte(together) == to_the_byte(play_all(PLAN, pairs, other, 1))


def to_the_byte(result: Any) -> Any:
    """A result with arrays as bytes, by which it can be compared; NaN equals itself."""
    if is_dataclass(result):
        named = {each.name: to_the_byte(getattr(result, each.name)) for each in fields(result)}
        return type(result).__name__, named
    if isinstance(result, Mapping):
        return {name: to_the_byte(value) for name, value in result.items()}
    if isinstance(result, np.ndarray):
        return result.dtype, result.shape, result.tobytes()
    return type(result), repr(result)


def test_what_is_kept_is_what_was_played(folder: Path) -> None:
    pairs = [own_pair(PLAN.runs_of("joint")[0]), *all_pairs(PLAN)[-3:]]
    known = play_all(PLAN, pairs, folder, 1)  # kept by the comparison that wrote the folder
    for pair in pairs:
        assert to_the_byte(known[pair]) == to_the_byte(play_pair(PLAN, folder, pair))
    point = points_of(PLAN.runs_of("joint")[0].folder(folder), PLAN.settings.snapshots)[0]
    (curve, *_) = play_curves(PLAN, PLAN.runs_of("joint"), folder, 1).values()
    assert to_the_byte(curve[0][1]) == to_the_byte(play_point(PLAN, folder, point))


def test_what_was_played_is_not_played_again_unless_weights_or_settings_change(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    copy = shutil.copytree(folder, tmp_path / "copy")
    pairs, runs = all_pairs(PLAN)[:3], PLAN.runs_of("joint")

    def refuse(*_: object) -> None:
        raise AssertionError("played again")

    for name in ("play_pair", "play_point"):
        monkeypatch.setattr(playing, name, refuse)
    known = play_all(PLAN, pairs, folder, 1), play_curves(PLAN, runs, folder, 1)
    again = play_all(PLAN, pairs, copy, 1), play_curves(PLAN, runs, copy, 1)
    assert to_the_byte(again[0]) == to_the_byte(known[0])
    assert again[1] == known[1]
    (other,) = replace(TINY, episodes=15).plans()
    with pytest.raises(AssertionError, match="played again"):
        play_all(other, pairs, copy, 1)
    snapshot = next(runs[0].folder(copy).glob("snapshots/*/driver.safetensors"))
    for weights in (snapshot, runs[0].folder(copy) / "vehicle_ai.safetensors"):
        weights.write_bytes(weights.read_bytes()[:-1] + b"?")
    with pytest.raises(AssertionError, match="played again"):
        play_all(PLAN, [own_pair(runs[0])], copy, 1)
    with pytest.raises(AssertionError, match="played again"):
        play_curves(PLAN, runs, copy, 1)


def test_what_tried_out_a_share_is_played_once(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried = replace(TINY, driver_shares=(0.25, 0.75), steps=320)
    (plan,) = tried.plans()
    trained = PLAN.runs_of("two-stage")
    for run, one in zip(plan.tuning_runs, trained, strict=True):
        shutil.copytree(one.folder(folder), run.folder(tmp_path))
    known = list(play_tuning(plan, tmp_path, 1))
    assert known == [tuning_return(plan, tmp_path, run) for run in plan.tuning_runs]
    monkeypatch.setattr(playing, "tuning_return", lambda *_: math.nan)
    assert list(play_tuning(plan, tmp_path, 1)) == known


def test_runs_are_trained_as_the_plan_says(folder: Path) -> None:
    for run in PLAN.runs:
        card = read_policy(run.folder(folder) / "driver.json")[0] if run.arm != "robust" else None
        if run.arm != "no-traits":
            hmi = read_policy(run.folder(folder) / "vehicle_ai.json")[0]
            assert hmi.network.rnn_hidden_dim == 32
            assert "distracted" not in dict(hmi.reads)
            assert hmi.by_intent == (run.arm == "joint")
        else:
            assert "traits" not in dict(card.reads)


def test_a_second_call_trains_nothing_and_another_comparison_is_refused(folder: Path) -> None:
    jobs = PLAN.jobs(folder, PLAN.runs)
    paths = [job.folder / "checkpoint.safetensors" for job in jobs]
    before = [path.stat().st_mtime_ns for path in paths]
    (other,) = replace(TINY, drivers=("homer",)).plans()
    last = other.jobs(folder, other.runs_of("joint"))[-1]
    with pytest.raises(ValueError, match=r"joint-run1 holds another run \(drivers = "):
        train_all([*jobs, last], 1, quiet=True)
    assert [path.stat().st_mtime_ns for path in paths] == before


def test_other_partners_are_refused_before_anything_is_trained(folder: Path) -> None:
    PLAN.check_partners(folder)
    fewer = replace(TINY, protocols=("two-stage", "simultaneous"))
    with pytest.raises(ValueError, match=r"robust-run0 has learned with the drivers .*joint-run0"):
        fewer.run(Place(folder, folder))
    replace(fewer, partners=False).plans()[0].check_partners(folder)


def test_points_of_a_curve_have_what_each_seat_had_learned(folder: Path) -> None:
    run = folder / "hidden" / "two-stage-run0"
    first, last = points_of(run, 2)
    assert (first.steps, last.steps) == (80, 160)
    assert first.hmi == "never", "the driver learned first"
    assert first.driver == str(run / "snapshots" / "80")
    assert last.driver == last.hmi == str(run)
    together = points_of(folder / "hidden" / "joint-run0", 2)[0]
    assert together.driver == together.hmi


def test_the_command_writes_everything(folder: Path, content: dict) -> None:
    files = {path.name for path in folder.iterdir() if path.is_file()}
    pictures = {f"hidden-{kind}.png" for kind in ("curves", "cross", "sweep", "profile")}
    clips = {"hidden-two-stage.gif", "hidden-simultaneous.gif"}
    assert files == {"compare.txt", "compare.json", "index.html", "INDEX.json"} | pictures | clips
    assert content["command"].startswith("hmi-marl compare --tasks hidden")
    assert content["workers"] == 1


def test_curves_end_where_the_tables_do(content: dict) -> None:
    hidden = content["tasks"]["hidden"]
    drawn = hidden["pairs"][0]["by_driver"]
    assert drawn["bart"]["episodes"] != drawn["homer"]["episodes"], "they count the same"
    for metric in ("team_return", "attention_return"):
        ends = [hidden["curves"][f"hidden/joint-run{k}"][-1][metric] for k in (0, 1)]
        table = hidden["arms"]["joint"]["over_runs"][metric]["mean"]
        assert np.mean(ends) == pytest.approx(table)


def test_json_holds_every_pair(content: dict) -> None:
    hidden = content["tasks"]["hidden"]
    found = {(p["driver"], p["hmi"], p["end_at_crash"]) for p in hidden["pairs"]}
    wanted = {(p.driver, p.hmi, p.end_at_crash) for p in all_pairs(PLAN)}
    assert wanted < found, "and those with the HMI for the average driver"
    assert {hmi for _, hmi, _ in found - wanted} <= {
        pair["hmi"] for pair in hidden["pairs"] if pair["hmi"].startswith("belief:average:")
    }
    assert len(hidden["curves"]["hidden/joint-run1"]) == 2
    assert {run["steps"] for run in hidden["training"].values()} == {160, 80}


def test_trained_pairs_of_the_first_seed_ship(folder: Path) -> None:
    agents = TINY.agents(Place(folder, folder))
    assert [agent.name for agent in agents] == [
        f"hidden-{name}-{role}" for name in PLAN.protocols for role in ("driver", "hmi")
    ]
    assert all(agent.card.is_file() for agent in agents)


def test_help_gives_an_example(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["compare", "--help"])
    assert stop.value.code == 0
    assert "Example: hmi-marl compare --tasks hidden" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize("task", list(TASKS))
def test_every_task_plays_known_policies_and_scores_them(task: str, tmp_path: Path) -> None:
    """No run is needed: references, signals and both kinds of episodes work on every task."""
    (plan,) = replace(TINY, tasks=(task,), episodes=24).plans()
    hmis = ["when-distracted"] if not plan.task.hidden else ["belief:average:0.3"]
    for hmi in ("never", *hmis):
        pair = Pair(task, "rule", hmi)
        found = play_pair(plan, tmp_path, pair)
        assert found.sums[ALL_DRIVERS].episodes == episodes_of(plan, pair) == 24
        assert sum(part.episodes for part in found.shared.values()) == 16
        for name in TINY.driver_names:
            known = found.scores[name].references
            assert (known.filter is None) == (task in ("seen", "graded", "fatigue"))
            assert np.isfinite(shortfall(found, name).mean)
            assert hiding(found, name) >= 0.0


def test_alerts_gain_nothing_for_a_driver_who_is_never_distracted(tmp_path: Path) -> None:
    (plan,) = replace(TINY, drivers=("bart", "awake:0,0.5,1,1")).plans()
    found = play_pair(plan, tmp_path, Pair("hidden", "rule", "never"))
    assert math.isnan(found.scores["awake"].score.mean)
    assert math.isfinite(found.scores["bart"].score.mean)


def test_pairs_share_the_first_episodes(folder: Path) -> None:
    (plan,) = replace(TINY, cross_episodes=12).plans()
    own = play_pair(plan, folder, own_pair(PlannedRun("hidden", "joint", 0)))
    (few,) = replace(TINY, episodes=12).plans()
    again = play_pair(few, folder, own_pair(PlannedRun("hidden", "joint", 0)))
    assert {n: s.terms for n, s in own.shared.items()} == {
        n: again.sums[n].terms for n in TINY.driver_names
    }
