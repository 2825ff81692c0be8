import itertools
import sys
import types
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pygame
import pytest
from numpy.typing import NDArray
from PIL import Image, ImageSequence

from hmi_marl.agents import make_driver_policy, make_hmi
from hmi_marl.agents.rollout import begin
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import DRIVERS, Traits
from hmi_marl.envs.render import TeamStatus, Viewer, between
from hmi_marl.envs.scene import Scene
from hmi_marl.envs.worlds import Snapshot
from hmi_marl.reporting import clip

Moment = tuple[Snapshot, TeamStatus]
CONFIG = TeamConfig(driver="homer", duration=2.0, scene=Scene(vehicles=2))
STEPS = 10


@pytest.fixture(scope="module")
def moments() -> list[Moment]:
    return list(clip.episode(CONFIG, "own", "rule", seed=3))


def never() -> Iterator[Moment]:
    raise AssertionError("this clip should not have been begun")
    yield


def pictures(count: int, fail: bool = False) -> Iterator[NDArray[np.uint8]]:
    for k in range(count):
        picture = np.full((48, 64, 3), 255, np.uint8)
        picture[:, : 4 * (k + 1)] = (200, 20, 20)
        yield picture
    if fail:
        raise RuntimeError("the world broke down")


def test_an_episode_has_a_moment_before_and_after_every_step(moments: list[Moment]) -> None:
    assert len(moments) == STEPS + 1
    times = [snapshot.time for snapshot, _ in moments]
    assert times == pytest.approx([k / 5 for k in range(STEPS + 1)])
    assert [status.time for _, status in moments] == pytest.approx(times)
    assert moments[0][1].intended == "-"
    ahead = [snapshot.position[0, 0] for snapshot, _ in moments]
    assert all(b > a for a, b in itertools.pairwise(ahead))


def test_an_hmi_that_gets_to_know_its_driver_shows_what_it_believes(
    moments: list[Moment],
) -> None:
    config = TeamConfig(driver="bart", duration=2.0, ai_sees_attention=False)
    played = list(clip.episode(config, "adapt:bayes", "random", seed=3))
    beliefs = [dict(status.belief) for _, status in played]
    assert all(list(belief) == ["lisa", "marge", "bart", "homer"] for belief in beliefs)
    assert set(beliefs[0].values()) == {0.25}
    assert [sum(belief.values()) for belief in beliefs] == pytest.approx([1.0] * len(beliefs))
    assert beliefs[-1] != beliefs[0]
    assert {status.belief for _, status in moments} == {()}, "others believe nothing"


def test_where_attention_is_hidden_moments_hold_what_a_h_reveals_and_the_belief(
    moments: list[Moment],
) -> None:
    config = TeamConfig(driver="bart", duration=2.0, ai_sees_attention=False)
    played = [status for _, status in clip.episode(config, "never", "random", seed=3)]
    assert (played[0].distracted_belief, played[0].reveals) == (0.0, False)
    assert (played[1].distracted_belief, played[1].reveals) == (0.8, False), "of v_0 = a^H_0"
    for before, now in itertools.pairwise(played[1:]):
        assert now.reveals == (now.intended != before.applied)
        if now.reveals:
            assert now.distracted_belief == now.distracted == (now.applied != now.intended)
        else:
            # Bart without help: 0.8 to 0.8, and 0 to 0.8 as well
            assert now.distracted_belief == pytest.approx(0.8)
    assert len({now.reveals for now in played[1:]}) == 2
    assert {status.distracted_belief for _, status in moments} == {None}, "attention is seen"
    unknown = clip.episode(config, "adapt:bayes", "random", seed=3)
    assert {status.distracted_belief for _, status in unknown} == {None}, "the driver is not known"


def test_another_driver_may_take_the_wheel_on_the_way() -> None:
    driver, ai = make_driver_policy("rule", CONFIG), make_hmi("never", CONFIG)
    teaming = begin(CONFIG, driver, ai, np.array([3], np.uint64), "highway")
    change = 4, Traits.of([DRIVERS["lisa"]])
    names = [status.driver for _, status in clip.moments(teaming, driver, ai, change)]
    # the moments after each of the first four steps are homer's, as is that before them
    assert names == ["homer"] * 5 + ["lisa"] * 6


def test_an_episode_ends_with_the_crash() -> None:
    config = TeamConfig(driver="homer", duration=2.0, scene=Scene(vehicles=20))
    played = list(clip.episode(config, "always", "random", seed=5))
    assert len(played) <= STEPS
    assert [status.crashed for _, status in played] == [False] * (len(played) - 1) + [True]


def test_the_hmi_of_an_episode_is_the_one_asked_for() -> None:
    for hmi, alerts in (("always", {True}), ("never", {False})):
        played = clip.episode(CONFIG, hmi, "rule", seed=3)
        assert {status.alert for _, status in itertools.islice(played, 1, None)} == alerts


@pytest.mark.parametrize(
    ("hmi", "policy", "seed", "message"),
    [
        ("siren", "rule", 0, "unknown HMI 'siren'; hmi-marl --help lists all"),
        ("own", "autopilot", 0, "unknown driver policy 'autopilot'; known: rule"),
        ("own", "rule", -1, "a seed lies in"),
    ],
)
def test_bad_names_and_seeds_are_refused_before_the_first_moment(
    hmi: str, policy: str, seed: int, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        clip.episode(CONFIG, hmi, policy, seed)  # not even one next()


@pytest.mark.parametrize("per_step", [1, 2, 3])
def test_there_is_one_frame_more_than_per_step_times_steps(
    moments: list[Moment], per_step: int
) -> None:
    assert len(list(clip.frames(iter(moments), Viewer(CONFIG), per_step))) == per_step * STEPS + 1


def test_frames_in_between_lie_between_the_moments(moments: list[Moment]) -> None:
    viewer = Viewer(CONFIG)
    finer = list(clip.frames(iter(moments), viewer, 2))
    coarse = list(clip.frames(iter(moments), viewer, 1))
    for fine, picture in zip(finer[::2], coarse, strict=True):
        np.testing.assert_array_equal(fine, picture)
    for (before, _), (after, status), middle in zip(
        moments, moments[1:], finer[1::2], strict=False
    ):
        half_way = viewer.draw(between(before, after, 0.5), status)
        np.testing.assert_array_equal(middle, half_way)
        assert (middle != viewer.draw(after, status)).any()


def test_the_same_seed_gives_the_same_frames(moments: list[Moment]) -> None:
    first, again, other = (
        np.stack(list(clip.frames(episode, Viewer(CONFIG), 1)))
        for episode in (
            iter(moments),
            clip.episode(CONFIG, "own", "rule", seed=3),
            clip.episode(CONFIG, "random", "random", seed=4),
        )
    )
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


def test_a_gif_has_every_frame_at_its_size(tmp_path: Path, moments: list[Moment]) -> None:
    path = tmp_path / "clips" / "episode.gif"
    clip.record(path, CONFIG, iter(moments), per_step=2)
    first = Viewer(CONFIG).draw(*moments[0])
    with Image.open(path) as image:
        assert image.format == "GIF"
        assert image.n_frames == 2 * STEPS + 1
        assert image.size == (first.shape[1], first.shape[0])
        assert image.info["duration"] == 100  # [ms], ten frames a second
        assert image.info["loop"] == 0
        shown = [
            np.asarray(frame.convert("RGB"), np.int64) for frame in ImageSequence.Iterator(image)
        ]
    assert np.abs(shown[0] - first).mean() < 4, "only the number of colours is lost"
    assert (shown[0] != shown[-1]).any()
    assert [p.name for p in path.parent.iterdir()] == ["episode.gif"]


def test_an_mp4_has_every_frame_at_its_size(tmp_path: Path, moments: list[Moment]) -> None:
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    path = tmp_path / "episode.MP4"
    clip.record(path, CONFIG, iter(moments), per_step=2)
    assert path.stat().st_size > 1000
    count, seconds = ffmpeg.count_frames_and_secs(str(path))
    assert count == 2 * STEPS + 1
    assert seconds == pytest.approx(2.1, abs=0.05)
    reader = ffmpeg.read_frames(str(path))
    height, width, _ = Viewer(CONFIG).draw(*moments[0]).shape
    assert tuple(next(reader)["size"]) == (width, height)
    reader.close()


def test_a_gif_stands_still_where_it_is_asked_to(tmp_path: Path, moments: list[Moment]) -> None:
    path = tmp_path / "episode.gif"
    clip.record(path, CONFIG, iter(moments), per_step=2, holds={3: 1.5, 4: 0.7})
    with Image.open(path) as image:
        pauses = [frame.info["duration"] for frame in ImageSequence.Iterator(image)]
    wanted = [100] * (2 * STEPS + 1)
    wanted[6], wanted[8] = 1500, 700
    assert pauses == wanted


def test_an_mp4_stands_still_where_it_is_asked_to(tmp_path: Path) -> None:
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    clip.write_clip(tmp_path / "clip.mp4", pictures(5), 10.0, holds={2: 1.0})
    assert ffmpeg.count_frames_and_secs(str(tmp_path / "clip.mp4"))[0] == 4 + 10


def test_recording_goes_through_progress_picture_by_picture(
    tmp_path: Path, moments: list[Moment]
) -> None:
    seen = []

    def progress(pictures: clip.Pictures) -> clip.Pictures:
        for picture in pictures:
            seen.append(picture.shape)
            yield picture

    clip.record(tmp_path / "episode.gif", CONFIG, iter(moments), 1, progress=progress)
    assert len(seen) == STEPS + 1


def test_a_clip_may_show_perceived_sizes(tmp_path: Path, moments: list[Moment]) -> None:
    sizes = []
    for perceived in (False, True):
        path = tmp_path / f"{perceived}.gif"
        clip.record(path, CONFIG, iter(moments[:2]), 1, perceived=perceived)
        sizes.append(path.read_bytes())
    assert sizes[0] != sizes[1]


@pytest.mark.parametrize("name", ["clip.png", "clip", "clip.gif.txt"])
def test_a_clip_of_another_kind_is_refused_before_it_is_begun(tmp_path: Path, name: str) -> None:
    with pytest.raises(ValueError, match=r"a clip is a \.gif or \.mp4 file, not 'clip"):
        clip.record(tmp_path / name, CONFIG, never(), 1)
    assert list(tmp_path.iterdir()) == []


def test_mp4_without_the_video_extra_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(RuntimeError, match=r"pip install 'hmi-marl\[video\]'; or write a \.gif"):
        clip.record(tmp_path / "clip.mp4", CONFIG, never(), 1)


@pytest.mark.parametrize("suffix", [".gif", ".mp4"])
def test_a_clip_that_fails_half_way_leaves_the_old_one(tmp_path: Path, suffix: str) -> None:
    if suffix == ".mp4":
        pytest.importorskip("imageio_ffmpeg")
    path = tmp_path / f"clip{suffix}"
    path.write_bytes(b"old")
    with pytest.raises(RuntimeError, match="the world broke down"):
        clip.write_clip(path, pictures(8, fail=True), 10.0)
    assert path.read_bytes() == b"old"


def test_a_gif_that_fails_half_way_leaves_no_litter(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="the world broke down"):
        clip.write_clip(tmp_path / "clip.gif", pictures(1, fail=True), 10.0)
    assert list(tmp_path.iterdir()) == []


def test_ffmpeg_is_stopped_before_the_litter_is_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file_was_there_at_the_stop = []

    def write_frames(path: str, size: tuple[int, int], **_: object) -> Iterator[None]:
        try:
            while True:
                yield
        finally:
            file_was_there_at_the_stop.append(Path(path).exists())

    ffmpeg = types.SimpleNamespace(write_frames=write_frames)
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", ffmpeg)
    with pytest.raises(RuntimeError, match="the world broke down"):
        clip.write_clip(tmp_path / "clip.mp4", pictures(1, fail=True), 10.0)
    assert file_was_there_at_the_stop == [True]


def test_a_slow_clip_is_paced_slowly(tmp_path: Path) -> None:
    path = tmp_path / "clip.gif"
    clip.write_clip(path, pictures(4), frequency=5)
    with Image.open(path) as image:
        assert image.n_frames == 4
        assert image.info["duration"] == 200


def test_a_window_without_a_display_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hmi_marl.envs.render.has_display", lambda: False)
    with pytest.raises(RuntimeError, match="record a clip instead"):
        clip.show(CONFIG, never(), 1)


def test_a_show_ends_when_the_window_is_closed(
    moments: list[Moment], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hmi_marl.envs.render.has_display", lambda: True)
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    seen = []

    def watched() -> Iterator[Moment]:
        for k, moment in enumerate(moments):
            if k == 3:
                pygame.event.post(pygame.Event(pygame.QUIT))
            seen.append(moment)
            yield moment

    clip.show(CONFIG, watched(), per_step=50)
    assert len(seen) == 4
    assert not pygame.event.get(pygame.QUIT), "the event was taken off the queue"
