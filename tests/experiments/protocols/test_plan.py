import json
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from hmi_marl.agents.catalogue import make_driver_policy, make_hmi
from hmi_marl.agents.learned.policy import read_policy
from hmi_marl.cli import main
from hmi_marl.envs.rewards import DRIVER_TERMS, DRIVING_TERMS, TERMS
from hmi_marl.envs.streams import part_seed
from hmi_marl.experiments.episodes import Episodes, evaluation_seeds, play_episodes
from hmi_marl.experiments.protocols.experiment import ProtocolComparison
from hmi_marl.experiments.protocols.plan import (
    ALL_DRIVERS,
    Pair,
    PlannedRun,
    Sums,
    play_all,
    play_pair,
)
from hmi_marl.training.jobs import train_all
from hmi_marl.training.protocols.registry import compared

PROTOCOLS = tuple(compared())

TINY = ProtocolComparison(
    steps=160,  # of 80 in a batch: two for the driver, one for the HMI
    rounds=1,
    seeds=2,
    episodes=8,
    num_teams=16,
    duration=1.0,
    vehicles=(1, 3),
)
TYPED = (
    "compare --steps 160 --rounds 1 --seeds 2 --episodes 8 --num-teams 16 --duration 1 "
    "--vehicles 1 3 --workers 1"
)


pytestmark = pytest.mark.usefixtures("module_trained_here")


@pytest.fixture(scope="module")
def folder(module_trained_here: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("compare") / "out"
    assert main([*TYPED.split(), "--out", str(out)]) == 0
    return out


@pytest.fixture(scope="module")
def content(folder: Path) -> dict:
    return json.loads((folder / "compare.json").read_text("utf-8"))


def batches(settings: ProtocolComparison, training) -> int:
    return sum(phase.iterations(settings.num_teams) for phase in training.phases())


@pytest.mark.parametrize(
    "settings",
    [
        ProtocolComparison(),
        ProtocolComparison.quick(),
        TINY,
        ProtocolComparison(steps=1),
        ProtocolComparison(steps=1, rounds=1),
        ProtocolComparison(steps=777_777, driver_share=0.37, rounds=3, num_teams=100),
    ],
)
def test_every_run_takes_the_same_number_of_steps(settings: ProtocolComparison) -> None:
    jobs = settings.jobs(Path("out"))
    assert len(jobs) == len(PROTOCOLS) * (settings.seeds + 1)
    taken = {batches(settings, job.settings) for job in jobs}
    assert {count * settings.num_teams * settings.team().horizon for count in taken} == {
        settings.steps_each
    }


def test_the_steps_are_about_those_that_were_asked_for() -> None:
    assert ProtocolComparison().steps_each == 60 * 51_200  # 3 million are 58.6 batches
    assert ProtocolComparison().steps_apart == (48 * 51_200, 12 * 51_200)
    assert ProtocolComparison.quick().steps_each == 24 * 12_800


def test_every_run_has_its_own_folder_seed_and_setting() -> None:
    jobs = {job.folder.name: job.settings for job in replace(TINY, seed=5).jobs(Path("out"))}
    assert len(jobs) == 18
    assert jobs["joint-run0"].seed == 5
    assert jobs["joint-run1"].seed == part_seed(5, 1)
    assert jobs["joint-run1"].end_at_crash
    assert not jobs["joint-run0-standing"].end_at_crash
    assert not jobs["simultaneous-moves-run0"].sequential
    assert jobs["simultaneous-run0"].sequential
    assert "joint-run1-standing" not in jobs
    unchecked = replace(TINY, crash_check=False)
    assert not any("standing" in job.folder.name for job in unchecked.jobs(Path("out")))


def test_the_reward_is_that_of_those_who_learn_together() -> None:
    jobs = {
        job.folder.name: job.settings
        for job in replace(TINY, reward="individual").jobs(Path("out"))
    }
    for protocol in ("joint", "simultaneous", "simultaneous-moves"):
        assert jobs[f"{protocol}-run0"].reward == "individual"
    alternating = jobs["alternating-run0"]
    assert (alternating.driver_reward, alternating.hmi_reward) == ("individual", "individual")
    default = {job.folder.name: job.settings for job in TINY.jobs(Path("out"))}
    assert default["joint-run0"].reward == "team"
    assert default["alternating-run0"].driver_reward == "driving"
    assert TINY.driver_terms("alternating") == DRIVING_TERMS
    assert replace(TINY, reward="team").driver_terms("alternating") == TERMS
    assert jobs["two-stage-run0"].driver_reward == "driving"
    assert TINY.driver_terms("two-stage") == DRIVING_TERMS
    tuned = jobs["fine-tune-run0"]
    assert (tuned.driver_reward, tuned.hmi_reward) == ("driving", "team")
    assert tuned.together_reward == "individual"
    assert TINY.driver_terms("fine-tune") == TERMS  # of the last phase
    assert TINY.driver_terms("simultaneous") == TERMS
    individual = replace(TINY, reward="individual")
    assert individual.driver_terms("alternating") == DRIVER_TERMS
    assert individual.driver_terms("joint") == TERMS  # both agents' together


def test_everybody_plays_with_everybody_of_the_same_seed_and_protocol() -> None:
    pairs = TINY.pairs()
    assert len(pairs) == len(set(pairs))
    # 36 of each seed, 2 across the seeds of each protocol, 2 + 2 x 2 baselines, 2 x 6 standing
    assert len(pairs) == 2 * 36 + 6 * 2 + 6 + 12
    assert Pair("joint-run1", "alternating-run1") in pairs
    assert Pair("joint-run0", "joint-run1") in pairs
    assert Pair("joint-run0", "alternating-run1") not in pairs
    assert Pair("joint-run0-standing", "joint-run0-standing", end_at_crash=False) in pairs
    alone = replace(TINY, protocols=("joint",), seeds=1, crash_check=False)
    assert alone.pairs() == [
        Pair("joint-run0", "joint-run0"),
        Pair("rule", "never"),
        Pair("rule", "when-distracted"),
    ]


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"protocols": ()}, "at least one of two-stage"),
        ({"protocols": "joint"}, "a tuple of at least one"),
        ({"protocols": ("fast",)}, "unknown protocol 'fast'; known: two-stage"),
        ({"protocols": ("joint", "joint")}, "'joint' twice"),
        ({"steps": 0}, "steps lies in 1 to"),
        ({"rounds": 0}, "rounds lies in 1 to"),
        ({"seeds": 0}, "seeds lies in 1 to"),
        ({"episodes": 0}, "episodes lies in 1 to"),
        ({"num_teams": 0}, "teams lies in 1 to"),
        ({"num_teams": 8}, "cannot split 8 teams into 16 mini-batches"),
        ({"driver_share": 0.0}, r"driver_share lies in \(0, 1\)"),
        ({"driver_share": float("nan")}, r"driver_share lies in \(0, 1\)"),
        ({"reward": "driving"}, "reward is one of default, team, individual"),
        ({"seed": -1}, "a seed lies in"),
        ({"drivers": ()}, "at least one name"),
        ({"drivers": "homer"}, "a tuple of at least one name"),
        ({"drivers": ("bob",)}, "unknown driver 'bob'"),
        ({"drivers": ("homer", "Homer")}, "'homer' twice"),
        ({"duration": 0.33}, "whole number of steps"),
        ({"vehicles": (3, 1)}, "vehicles"),
    ],
)
def test_impossible_settings_are_refused(change: dict, told: str) -> None:
    with pytest.raises(ValueError, match=told):
        replace(TINY, **change)


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


def test_a_driver_who_never_came_is_left_open() -> None:
    few = replace(TINY, episodes=1)
    sums = play_pair(few, Path("none"), Pair("rule", "never"))
    assert list(sums) == [ALL_DRIVERS, "lisa", "marge", "bart", "homer"]
    assert sorted(part.episodes for part in sums.values()) == [0, 0, 0, 1, 1]


def test_drivers_share_the_episodes_among_them(folder: Path) -> None:
    sums = play_pair(TINY, folder, Pair("joint-run0", "two-stage-run0"))
    parts = [part for name, part in sums.items() if name != ALL_DRIVERS]
    assert sum(part.episodes for part in parts) == 8
    assert Sums.join(parts).per_episode() == pytest.approx(sums[ALL_DRIVERS].per_episode())


def test_a_swapped_pair_plays_as_anybody_would_play_it(folder: Path) -> None:
    swapped = Pair("alternating-run1", "simultaneous-moves-run1")
    sums = play_pair(TINY, folder, swapped)[ALL_DRIVERS]
    team = TINY.team()
    seeds = evaluation_seeds(8)
    episodes = play_episodes(
        team,
        make_driver_policy(str(folder / swapped.driver), team),
        make_hmi(str(folder / swapped.hmi), team),
        seeds,
        "batched",
    )
    assert sums.terms == pytest.approx({k: v.sum() for k, v in episodes.returns.items()})
    assert sums.alerts == episodes.alerts.sum()


@pytest.mark.slow
@pytest.mark.usefixtures("unmeasured")
def test_results_do_not_depend_on_the_workers(folder: Path) -> None:
    few = replace(TINY, protocols=("two-stage",), seeds=1, crash_check=False)
    heard: list[int] = []
    together = play_all(few, folder, 2, heard.append)
    assert heard == [8] * len(few.pairs())
    assert list(together) == few.pairs()
    assert str(together) == str(play_all(few, folder, 1))  # NaN equals no other


def test_runs_are_trained_as_their_protocols_say(folder: Path) -> None:
    cards = {run: read_policy(folder / run.name / "vehicle_ai.json")[0] for run in TINY.main_runs}
    for run, card in cards.items():
        assert card.sequential == (run.protocol != "simultaneous-moves")
        assert card.by_intent == (run.protocol == "joint")
        assert card.training["steps"] == TINY.steps_each
    standing = read_policy(folder / PlannedRun("joint", 0, standing=True).name / "driver.json")[0]
    assert standing.training["team"]["end_at_crash"] is False


def test_a_second_call_trains_nothing_and_another_comparison_is_refused(folder: Path) -> None:
    few = replace(TINY, protocols=("two-stage", "joint"), crash_check=False)
    jobs = few.jobs(folder)
    paths = [job.folder / "checkpoint.safetensors" for job in jobs]
    before = [path.stat().st_mtime_ns for path in paths]
    other = replace(few, drivers=("homer",)).jobs(folder)[-1]
    with pytest.raises(ValueError, match=r"joint-run1 holds another run \(drivers = "):
        train_all([*jobs, other], 1, quiet=True)
    assert [path.stat().st_mtime_ns for path in paths] == before


def test_curves_reach_the_last_step(folder: Path) -> None:
    curves = {job.folder.name: job.curve() for job in TINY.jobs(folder)}
    assert set(curves) == {run.name for run in TINY.runs}
    assert {rows[-1]["steps"] for rows in curves.values()} == {TINY.steps_each}


def test_the_command_writes_everything(folder: Path) -> None:
    files = {path.name for path in folder.iterdir() if path.is_file()}
    pictures = {"curves.png", "swap.png", "terms.png"}
    assert files == {"compare.txt", "compare.json", "index.html"} | pictures


def test_json_holds_every_seeds_numbers(content: dict) -> None:
    assert content["steps_each"] == TINY.steps_each == 240
    assert content["workers"] == 1
    assert content["settings"]["protocols"] == list(PROTOCOLS)
    assert content["command"].startswith(f"hmi-marl {TYPED} --out ")
    assert set(content["training_seconds"]) == {run.name for run in TINY.runs}
    found = {(p["driver"], p["hmi"], p["end_at_crash"]): p["by_driver"] for p in content["pairs"]}
    assert len(found) == len(TINY.pairs())
    for k, (i, a), (j, b) in product(range(2), enumerate(PROTOCOLS), enumerate(PROTOCOLS)):
        pair = found[f"{a}-run{k}", f"{b}-run{k}", True]
        matrix = content["swap_matrix"]["team_return_by_seed_driver_hmi"]
        assert matrix[k][i][j] == pytest.approx(pair[ALL_DRIVERS]["team_return"])
    assert set(content["findings"]) == set(PROTOCOLS)
    assert content["findings"]["two-stage"] == "reference"
    claims = [verdict["claim"].split(":")[0] for verdict in content["verdicts"]]
    assert claims == [name for name in PROTOCOLS if name != "two-stage"]
    assert {len(curve["mean"]) for curve in content["curves"]["joint"].values()} == {3}


def test_help_gives_an_example(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["compare", "--help"])
    assert stop.value.code == 0
    assert "Example: hmi-marl compare --protocols" in " ".join(capsys.readouterr().out.split())
