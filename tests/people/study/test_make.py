"""Rendering of a study folder: it goes on where it was cut off, and tampering is noticed."""

import json

import numpy as np
import pytest
from people.study.studies import a_study
from PIL import Image

from hmi_marl.files import with_checksum, write_json
from hmi_marl.people.study import make
from hmi_marl.people.study.folder import read_study
from hmi_marl.people.study.make import MAKING, make_study, quick
from hmi_marl.people.study.settings import StudySettings

SETTINGS = StudySettings(
    drivers=("lisa", "bart"), controls=("bart@random",), policy="rule", clips=2, shown=1,
    duration=1.0, format="gif", width=320, frames_per_step=1, vehicles=(3, 3),
)  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made") / "study"
    make_study(SETTINGS, folder)
    return folder


def copy_of(folder, tmp_path):
    for path in folder.rglob("*"):
        if path.is_file():
            place = tmp_path / "study" / path.relative_to(folder)
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_bytes(path.read_bytes())
    return tmp_path / "study"


def test_clips_show_the_road_and_tell_nothing(folder):
    study = read_study(folder)
    assert [clip.condition for clip in study.clips] == ["lisa"] * 2 + ["bart"] * 2 + [
        "bart@random"
    ] * 2
    assert len({clip.seed for clip in study.clips}) == 6
    names = {path.name for path in (folder / "clips").iterdir()}
    assert names == {clip.name for clip in study.clips} | {study.check.name}
    for path in (folder / "clips").iterdir():
        assert not any(name.encode() in path.read_bytes() for name in ("lisa", "bart"))
        with Image.open(path) as clip:
            assert clip.size == (320, 154), "without the panel, which names the driver"
            pixels = {
                tuple(pixel) for pixel in np.asarray(clip.convert("RGB")).reshape(-1, 3).tolist()
            }
            assert (240, 170, 30) not in pixels, "amber would say that the driver is distracted"
    assert (folder / "consent.txt").exists()
    assert not (folder / MAKING).exists()
    assert study.check.answer in (1, 2, 6, 7)


def test_the_check_asks_in_its_second_half(folder):
    study = read_study(folder)
    with Image.open(folder / "clips" / study.check.name) as clip:
        last = clip.n_frames - 1
        light = []
        for frame in (0, last):
            clip.seek(frame)
            light.append(np.asarray(clip.convert("L")).mean())
    assert light[0] < 150 < light[1]


def test_what_is_there_is_kept_and_what_was_cut_off_goes_on(folder, tmp_path, monkeypatch):
    copy = copy_of(folder, tmp_path)
    study = read_study(copy)
    rendered = []
    render = make._render

    def counted(settings, job, where):
        rendered.append(job.name)
        if len(rendered) == 2 and stop:
            raise KeyboardInterrupt
        return render(settings, job, where)

    monkeypatch.setattr(make, "_render", counted)
    stop = True
    assert make_study(SETTINGS, copy).id == study.id
    assert rendered == []
    (copy / "study.json").unlink()
    for clip in study.clips:
        (copy / "clips" / clip.name).unlink()
    with pytest.raises(KeyboardInterrupt):
        make_study(SETTINGS, copy)
    assert (copy / MAKING).exists()
    with pytest.raises(FileNotFoundError, match="is no study folder"):
        read_study(copy)
    stop, rendered[:] = False, []
    assert make_study(SETTINGS, copy).id == study.id
    assert rendered == [clip.name for clip in study.clips[1:]]
    # a damaged clip is rendered again
    (copy / "clips" / study.clips[3].name).write_bytes(b"GIF")
    (copy / "clips" / study.check.name).write_bytes(b"GIF")
    rendered[:] = []
    assert make_study(SETTINGS, copy).id == study.id
    assert rendered == [study.clips[3].name]
    assert read_study(copy).clips == study.clips


def test_texts_may_change_and_what_is_shown_may_not(folder, tmp_path):
    copy = copy_of(folder, tmp_path)
    study = read_study(copy)
    (copy / "consent.txt").write_text("Our own words.")
    with pytest.raises(
        ValueError, match=r"consent\.txt differs from study\.json; if it was edited"
    ):
        read_study(copy)
    coded = StudySettings(**{**vars(SETTINGS), "completion_code": "C0DE"})
    assert make_study(coded, copy).id == study.id
    assert read_study(copy).consent == "Our own words."
    assert read_study(copy).settings.completion_code == "C0DE"
    text = tmp_path / "text.txt"
    text.write_text("Other words.")
    assert make_study(coded, copy, text).consent == "Other words."
    with pytest.raises(ValueError, match="holds a study of other settings"):
        make_study(StudySettings(**{**vars(SETTINGS), "seed": 1}), copy)
    with pytest.raises(ValueError, match=r"none\.txt is no file"):
        make_study(coded, copy, tmp_path / "none.txt")


def test_another_file_or_manifest_is_refused(tmp_path):
    study = a_study(tmp_path / "study")
    folder = study.folder
    assert read_study(folder) == study
    path = folder / "clips" / study.clips[0].name
    whole = path.read_bytes()
    path.write_bytes(whole + b"x")
    with pytest.raises(ValueError, match="is missing or differs"):
        read_study(folder)
    path.write_bytes(whole)
    content = json.loads((folder / "study.json").read_text())
    content["clips"][0]["condition"] = "bart"
    (folder / "study.json").write_text(json.dumps(content))
    with pytest.raises(ValueError, match="does not match: its checksum differs"):
        read_study(folder)
    content.pop("sha256")
    write_json(folder / "study.json", with_checksum(content))
    with pytest.raises(ValueError, match="its clips are others than its settings say"):
        read_study(folder)
    content["clips"][0]["condition"] = "lisa"
    for name, value, message in (
        ("study", "0" * 12, "its identity is not that of its clips"),
        ("contrasts", [], "its contrasts are others"),
        ("format", 2, "its format is 2"),
        ("settings", {}, "it lacks drivers"),
        ("clips", [{"name": "../x"}], "clips"),
    ):
        write_json(folder / "study.json", with_checksum({**content, name: value}))
        with pytest.raises(ValueError, match=message):
            read_study(folder)


def test_bad_input_is_refused_before_there_is_a_folder(tmp_path):
    for settings, message in (
        ({"policy": "nope"}, "unknown driver policy"),
        ({"hmi": "siren"}, "unknown HMI"),
        ({"controls": ("lisa@nope",)}, "unknown driver policy"),
    ):
        with pytest.raises(ValueError, match=message):
            make_study(StudySettings(**{**vars(SETTINGS), **settings}), tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_quick_sets_sizes_itself():
    tiny = quick(StudySettings())
    assert (tiny.clips, tiny.shown, tiny.duration) == (2, 1, 4.0)
    with pytest.raises(ValueError, match="--quick sets --clips itself"):
        quick(StudySettings(clips=7))
