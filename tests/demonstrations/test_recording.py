import hashlib
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from demonstrations import assert_same_observed, assert_same_truth
from numpy.typing import NDArray

from hmi_marl import merge_v0
from hmi_marl.agents.catalogue import make_driver_policy, make_hmi
from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.agents.learned.policy import load_policy, make_card, save_policy
from hmi_marl.agents.memory import Memoryless
from hmi_marl.demonstrations import recording as collecting
from hmi_marl.demonstrations.dataset import Demonstrations, Observed, Truth
from hmi_marl.demonstrations.parquet import (
    OBSERVED,
    read_demonstrations,
    read_observed,
    write_demonstrations,
)
from hmi_marl.demonstrations.recording import CollectSettings, Summary, collect
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import TRAIT_NAMES, TRAIT_RANGES
from hmi_marl.envs.observations import FASTEST, one_hot
from hmi_marl.envs.scene import LANE_WIDTH, Scene
from hmi_marl.envs.worlds import make_world

CRASHING: dict[str, Any] = {"driver_policy": "random", "vehicles": (20, 20), "duration": 4.0}
NOBODYS = "mona:0.4,0.3,0.5,2"


def tiny(**settings: Any) -> CollectSettings:
    small = {"drivers": ("homer", "lisa"), "steps": 40, "duration": 2.0, "vehicles": (1, 5)}
    return CollectSettings(**{**small, **settings})


def whole(settings: CollectSettings) -> Demonstrations:
    (chunk,) = collect(replace(settings, num_teams=10_000))
    return chunk


def true(data: Demonstrations) -> Truth:
    assert data.truth is not None
    return data.truth


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A driver that reads the traits, with weights as they come."""
    folder = tmp_path_factory.mktemp("trained")
    card = make_card("driver", TeamConfig(), NetworkConfig((8,)), knows_traits=True)
    rng = np.random.default_rng(0)
    weights = {name: rng.standard_normal(s).astype(np.float32) for name, s in card.shapes.items()}
    save_policy(folder, card, weights)
    return folder


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"drivers": ("moe",)}, "unknown driver 'moe'"),
        ({"drivers": ()}, "there is no driver"),
        ({"drivers": ("homer", "Homer")}, "two drivers have the name 'homer'"),
        ({"drivers": ("homer", "homer:0,1,0,1")}, "two drivers have the name 'homer'"),
        ({"drivers": ("population-0:0,1,0,1",), "population": 1}, "the name 'population-0'"),
        ({"steps": 0}, "steps lies in 1 to .*, but got 0"),
        ({"population": -1}, "population lies in 0 to .*, but got -1"),
        ({"windows": 0}, "windows lies in 1 to"),
        ({"num_teams": 0}, "teams lies in 1 to"),
        ({"alert_rate": 1.5}, r"alert_rate lies in \[0, 1\], but got 1\.5"),
        ({"seed": -1}, "a seed lies in"),
        ({"duration": 0.3}, "not a whole number of steps"),
        ({"vehicles": (5, 1)}, "runs backwards"),
        ({"alert_window": 0}, "alert_window lies in 1 to"),
    ],
)
def test_errors_are_reported_at_the_door(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        tiny(**settings)


@pytest.mark.parametrize("settings", [{"drivers": "homer"}, {"steps": 2.5}, {"num_teams": True}])
def test_values_of_another_kind_are_reported_at_the_door(settings: dict[str, Any]) -> None:
    with pytest.raises(TypeError, match=r"takes a tuple|is a whole number"):
        tiny(**settings)


def test_a_policy_that_is_not_there_is_reported_before_anything_is_played() -> None:
    with pytest.raises(ValueError, match="unknown driver policy 'autopilot'"):
        collect(tiny(driver_policy="autopilot"))
    with pytest.raises(FileNotFoundError, match="no policy for the seat of driver"):
        collect(tiny(driver_policy="runs/nowhere"))


def test_by_default_the_papers_drivers_drive_as_long_as_the_papers() -> None:
    settings = CollectSettings()
    assert [(d.name, windows) for d, windows in settings.cast()] == [
        (name, 3000) for name in ("lisa", "marge", "bart", "homer")
    ]
    assert settings.total_steps == 4 * 300_000
    assert settings.hmi_name == "random:0.2"


def test_steps_are_rounded_up_to_whole_windows() -> None:
    settings = tiny(steps=31)
    assert [windows for _, windows in settings.cast()] == [4, 4]
    assert whole(settings).observed.length.tolist() == [10] * 8


@pytest.mark.parametrize("policy", ["rule", "trained"])
def test_what_is_recorded_is_what_stepping_by_hand_gives(policy: str, trained: Path) -> None:
    name = str(trained) if policy == "trained" else policy
    settings = tiny(drivers=("homer", NOBODYS), driver_policy=name, alert_rate=0.4)
    data = whole(settings)
    observed, truth = data.observed, true(data)
    assert observed.labels() == ["homer"] * 4 + ["mona"] * 4
    assert observed.seeds is not None
    drivers = [driver for driver, _ in settings.cast()]
    for k in (0, 3, 5):
        driver = drivers[observed.driver[k]]
        scene, seed = Scene(vehicles=(1, 5)), observed.seeds[k : k + 1]
        config = TeamConfig(driver=driver, duration=2.0, end_at_crash=False, scene=scene)
        env = merge_v0.raw_env(
            driver=driver, duration=2.0, end_at_crash=False, scene=scene, world="batched"
        )
        seats = make_driver_policy(name, config), make_hmi("random:0.4", config)
        if policy == "trained":
            seats = load_policy(trained, "driver", config, greedy=False), seats[1]
        env.reset(seed=int(seed[0]))
        for seat in seats:
            seat.reset(seed)
        for t in range(10):
            shown = env.observe("vehicle_ai")
            for part in observed.layout.slices:
                expected = env.layout("vehicle_ai").get(shown, part)
                given = observed.layout.get(observed.states[k, t], part)
                np.testing.assert_array_equal(given, expected, err_msg=part)
            intended = int(seats[0].act(env.observe("driver")[None])[0])
            env.step(intended)
            alert = int(seats[1].act(env.observe("vehicle_ai")[None])[0])
            env.step(alert)
            info = env.infos["driver"]
            assert observed.actions[k, t] == info["applied_action"]
            assert observed.alerts[k, t] == alert
            assert truth.intended[k, t] == intended
            assert truth.distracted[k, t] == info["distracted"]
            assert truth.accepted[k, t] == info["accepted"]
            assert truth.counter[k, t] == info["counter"]
        assert tuple(truth.traits[k]) == driver.traits
        assert observed.crashed[k] == info["crashed"]


@pytest.mark.parametrize("teams", [1, 3, 5, 512])
def test_the_data_do_not_depend_on_the_chunks(tmp_path: Path, teams: int, trained: Path) -> None:
    settings = tiny(population=2, windows=2, driver_policy=str(trained))
    expected = whole(settings)
    chunks = list(collect(replace(settings, num_teams=teams)))
    assert [len(chunk) for chunk in chunks[:-1]] == [teams] * (len(chunks) - 1)
    write_demonstrations(tmp_path, iter(chunks))
    read = read_demonstrations(tmp_path)
    assert_same_observed(read.observed, expected.observed)
    assert_same_truth(replace(true(read), about={}), replace(true(expected), about={}))


def test_a_drivers_series_does_not_depend_on_who_else_drives() -> None:
    alone, among = whole(tiny(drivers=("lisa",))), whole(tiny(drivers=("bart", "lisa")))
    lisas = among.take(among.observed.driver == 1)
    renamed = replace(lisas.observed, names=("lisa",), driver=np.zeros(4, np.int64))
    assert_same_observed(renamed, alone.observed)
    assert len(set(among.observed.seeds.tolist())) == 8  # type: ignore[union-attr]
    assert among.observed.number.tolist() == [0, 1, 2, 3] * 2


def test_more_steps_begin_with_the_same_windows() -> None:
    few, many = whole(tiny(drivers=("lisa",))), whole(tiny(drivers=("lisa",), steps=70))
    assert_same_observed(many.take(range(4)).observed, few.observed)


def test_another_seed_is_other_data() -> None:
    one, other = whole(tiny()).observed, whole(tiny(seed=1)).observed
    assert (one.seeds != other.seeds).all()
    assert (one.states != other.states).any(axis=(1, 2)).mean() > 0.5
    assert (one.alerts != other.alerts).any()


def test_a_population_is_of_drivers_never_seen_before() -> None:
    data = whole(tiny(drivers=(), population=30, windows=2))
    observed, truth = data.observed, true(data)
    assert observed.names == tuple(f"population-{k}" for k in range(30))
    assert observed.driver.tolist() == np.repeat(np.arange(30), 2).tolist()
    np.testing.assert_array_equal(truth.traits[::2], truth.traits[1::2])
    for name, values in zip(TRAIT_NAMES, truth.traits[::2].T, strict=True):
        low, high = TRAIT_RANGES[name].low, TRAIT_RANGES[name].high
        high = min(high, 9)
        assert ((values >= low) & (values <= high)).all()
        assert len(set(values)) == 30
        assert abs(values.mean() - (low + high) / 2) < 0.3 * (high - low)
    again = true(whole(tiny(population=2, windows=1)))
    np.testing.assert_array_equal(again.traits[-2:], truth.traits[[0, 2]])


def test_alerts_come_at_their_rate_whatever_happens() -> None:
    settings = tiny(drivers=("bart",), steps=4000, alert_rate=0.3)
    data = whole(settings)
    alerts, distracted = data.observed.alerts, true(data).distracted
    assert abs(alerts.mean() - 0.3) < 0.03  # four deviations: 0.029
    before = distracted[:, :-1] == 1
    assert abs(alerts[:, 1:][before].mean() - alerts[:, 1:][~before].mean()) < 0.07


def test_a_crashed_car_stands_until_the_window_is_over() -> None:
    many = tiny(**CRASHING, steps=400)
    standing, ending = (whole(replace(many, end_at_crash=e)).observed for e in (False, True))
    assert 0 < standing.crashed.sum() < len(standing)
    assert set(standing.length) == {20}
    np.testing.assert_array_equal(ending.crash_step, standing.crash_step)
    np.testing.assert_array_equal(ending.length, standing.driven)
    np.testing.assert_array_equal(ending.driven, standing.driven)
    speed = standing.layout.scalar(standing.states, "speed")
    for k in np.flatnonzero(standing.crashed):
        end = standing.crash_step[k] + 1
        np.testing.assert_array_equal(ending.states[k, :end], standing.states[k, :end])
        np.testing.assert_array_equal(ending.actions[k, :end], standing.actions[k, :end])
        assert (speed[k, end + 1 :] == 0).all()


def test_a_window_is_driven_again_from_its_seed_and_what_was_applied() -> None:
    settings = tiny()
    observed, scene = whole(settings).observed, settings.team("homer").scene
    assert not observed.crashed.any()
    assert observed.seeds is not None
    everywhere = np.ones(len(observed), np.bool_)
    world = make_world("batched", scene, len(observed))
    world.reset(observed.seeds, np.full(len(observed), 9.0), everywhere)
    for t in range(10):
        ego, lidar = world.ego(), world.lidar(inflated=False)
        parts = {
            "lidar": (lidar / np.float32(scene.lidar_range)).reshape(len(lidar), -1),
            "speed": ego.speed[:, None] / FASTEST,
            "target_speed": ego.target_speed[:, None] / FASTEST,
            "heading": ego.heading[:, None] / np.pi,
            "lateral": ego.lateral[:, None] / LANE_WIDTH,
            "lane": one_hot(ego.lane, scene.lanes + 1),
            "position": ego.x[:, None] / scene.length,
        }
        assert set(parts) == set(observed.layout.slices)
        for part, value in parts.items():
            seen = observed.layout.get(observed.states[:, t], part)
            np.testing.assert_array_equal(seen, value.astype(np.float32))
        world.step(observed.actions[:, t], everywhere)


def test_by_default_a_trained_driver_draws(trained: Path) -> None:
    drawn = true(whole(tiny(driver_policy=str(trained))))
    greedy = true(whole(tiny(driver_policy=str(trained), greedy=True)))
    assert (drawn.intended != greedy.intended).any()


def test_a_policy_that_reads_the_traits_is_shown_them(trained: Path) -> None:
    one, other = (
        true(whole(tiny(drivers=(f"mona:0,1,{eta},1",), driver_policy=str(trained), steps=400)))
        for eta in (0, 1)  # which changes nothing else, as no driver is distracted
    )
    assert (one.intended != other.intended).any()


# Nothing hidden: what is applied being the same, all that is observed must be the same.


class Scripted(Memoryless):
    """Intends what a function of the step says."""

    def __init__(self, intended: Callable[[int], int]) -> None:
        self._intended, self._step = intended, 0

    def act(self, observations: NDArray[np.float32]) -> NDArray[np.int64]:
        action = self._intended(self._step)
        self._step += 1
        return np.full(len(observations), action)


def scripted(
    monkeypatch: pytest.MonkeyPatch, driver: str, intended: Callable[[int], int]
) -> Demonstrations:
    monkeypatch.setattr(collecting, "make_driver_policy", lambda *_: Scripted(intended))
    return whole(tiny(drivers=(driver,), vehicles=(10, 20), duration=8.0))


def test_no_trait_and_no_state_of_mind_shows_in_what_is_observed(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    files, hidden = [], []
    for number, driver in enumerate(("mona:0,1,0,1", "mona:0.9,0.1,1,9")):
        data = scripted(monkeypatch, driver, lambda _: 1)
        write_demonstrations(tmp_path / str(number), data)
        files.append((tmp_path / str(number) / OBSERVED).read_bytes())
        hidden.append(true(data))
    assert (hidden[0].distracted != hidden[1].distracted).any()
    assert files[0] == files[1]


def test_what_was_intended_but_not_done_does_not_show(monkeypatch: pytest.MonkeyPatch) -> None:
    always_distracted = "mona:1,0,0,1"
    one = scripted(monkeypatch, always_distracted, lambda step: 3)
    other = scripted(monkeypatch, always_distracted, lambda step: 3 if step == 0 else step % 5)
    assert (true(one).intended != true(other).intended).any()
    assert_same_observed(one.observed, other.observed)


def test_the_lidar_is_not_the_inflated_one(monkeypatch: pytest.MonkeyPatch) -> None:
    observed = scripted(monkeypatch, "mona:0,1,0,9", lambda _: 1).observed
    scene = Scene(vehicles=(10, 20))
    env = merge_v0.raw_env(driver="homer", duration=8.0, scene=scene, world="batched")
    assert observed.seeds is not None
    env.reset(seed=int(observed.seeds[0]))
    perceived = env.layout("driver").get(env.observe("driver"), "lidar")
    recorded = observed.layout.get(observed.states[0, 0], "lidar")
    true_sizes = env.layout("vehicle_ai").get(env.observe("vehicle_ai"), "lidar")
    assert (perceived != recorded).any()  # homer's inflation is 9 as well
    np.testing.assert_array_equal(recorded, true_sizes)


def test_the_observed_file_shows_nothing_of_the_drivers_but_their_names(tmp_path: Path) -> None:
    settings = tiny(drivers=("mona:0.4321,0.3217,0.5678,2.3456",), population=2, windows=1)
    write_demonstrations(tmp_path, collect(settings, command_line=f"collect {settings.drivers[0]}"))
    observed = read_observed(tmp_path)
    text = json.dumps(observed.about)
    assert not [word for word in ("4321", "mona", *TRAIT_NAMES) if word in text]
    content = (tmp_path / OBSERVED).read_bytes()
    words = (b"4321", b"3217", b"5678", b"3456", b"beta", b"inflation", b"distracted", b"intended")
    assert not [word for word in words if word in content]
    assert b"mona" in content
    assert about_of(observed)["team"].keys() >= {"alert_window", "scene", "end_at_crash"}
    hidden = true(read_demonstrations(tmp_path)).about
    assert hidden["drivers"][0]["beta"] == 0.4321
    assert hidden["command"] == "collect mona:0.4321,0.3217,0.5678,2.3456"
    assert [driver["name"] for driver in hidden["drivers"]] == [
        "mona",
        "population-0",
        "population-1",
    ]


def about_of(observed: Observed) -> dict[str, Any]:
    return dict(observed.about)


def test_who_drove_and_who_alerted_is_stamped(trained: Path) -> None:
    about = about_of(whole(tiny(driver_policy=str(trained), alert_rate=0.25, seed=7)).observed)
    digest = hashlib.sha256((trained / "driver.safetensors").read_bytes()).hexdigest()
    assert about["driver_policy"] == {"name": str(trained), "greedy": False, "sha256": digest}
    assert about["hmi"] == "random:0.25"
    assert about["seed"] == 7
    assert about["environment"] == "merge_v0"
    assert about["team"]["duration"] == 2.0
    rule = about_of(whole(tiny()).observed)["driver_policy"]
    assert rule == {"name": "rule", "greedy": False}
    mixture = f"mixture:{trained},rule"
    mixed = about_of(whole(tiny(driver_policy=mixture)).observed)["driver_policy"]
    parts = [{"name": str(trained), "sha256": digest}, {"name": "rule"}]
    assert mixed == {"name": mixture, "greedy": False, "mixture": parts}


def test_the_learned_drivers_of_a_mixture_draw_too(trained: Path) -> None:
    mixture = f"mixture:{trained},{trained}"
    for greedy in (False, True):
        mixed = true(whole(tiny(driver_policy=mixture, greedy=greedy)))
        alone = true(whole(tiny(driver_policy=str(trained), greedy=greedy)))
        np.testing.assert_array_equal(mixed.intended, alone.intended)


def test_progress_and_summary_count_all_steps() -> None:
    settings = tiny(**CRASHING, population=3, windows=2, num_teams=3, end_at_crash=True)
    progress: list[int] = []
    summary = Summary(settings)
    chunks = list(summary.counting(collect(settings, progress.append)))
    observed = [chunk.observed for chunk in chunks]
    rows = {row["driver"]: row for row in summary.as_json()}
    assert list(rows) == ["homer", "lisa", "population"]
    assert sum(progress) == sum(int(o.length.sum()) for o in observed)
    assert sum(progress) == sum(row["steps"] for row in rows.values())
    assert [row["episodes"] for row in rows.values()] == [2, 2, 6]
    homers = whole(replace(settings, drivers=("homer",), population=0))
    steps = int(homers.observed.length.sum())
    assert rows["homer"]["crash_rate"] == homers.observed.crashed.mean()
    per_minute = homers.observed.alerts.sum() / (steps / 5 / 60)
    assert rows["homer"]["alerts_per_minute"] == pytest.approx(per_minute)
    assert rows["homer"]["share_distracted"] == true(homers).distracted.sum() / steps
    lines = summary.as_text().splitlines()
    assert len(lines) == 4
    assert lines[1].split()[:3] == ["homer", "2", str(steps)]


@pytest.mark.parametrize("alerts", [{"alert_strengths": (0.5, 1.0)}, {"fatigue": (10, 2, 0.5)}])
def test_demonstrations_are_of_one_bit(alerts):
    with pytest.raises(ValueError, match="a dataset of demonstrations is for alerts of one streng"):
        CollectSettings(**alerts)
