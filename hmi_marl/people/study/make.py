"""Rendering of a study folder, which goes on where it was cut off.

Clips show the road alone: not the driver's name, whether they are distracted, or alerts. A clip's
name is a hash of its settings, so that it does not tell the driver, and a clip that is there
already is kept.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

import hmi_marl
from hmi_marl.agents.catalogue import make_driver_policy, make_hmi
from hmi_marl.envs.render import PANEL_HEIGHT, TeamStatus, Viewer
from hmi_marl.envs.streams import episode_seed, team_seed
from hmi_marl.envs.worlds import Snapshot
from hmi_marl.files import json_digest, json_value, make_folder, sha256_of, write_json, write_text
from hmi_marl.ownership import owned
from hmi_marl.people.study.folder import (
    CLIPS,
    CONSENT,
    MANIFEST,
    CheckClip,
    Study,
    StudyClip,
    plan_of,
    read_consent,
    read_manifest,
    write_manifest,
)
from hmi_marl.people.study.settings import POINTS, Condition, StudySettings
from hmi_marl.reading import read_json
from hmi_marl.reporting.clip import Pictures, check_suffix, episode, frames, write_clip
from hmi_marl.typed_json import read_value

MAKING = "making.json"
"""File with what has been rendered, until all is."""
HOLD = 1.0
"""Time for which a clip stands still at its end [s]."""
_CHECK_SECONDS, _CHECK_FROM = 6.0, 2.0
"""Duration of the attention check, and when its text appears [s]."""
CONSENT_TEXT = """\
You are invited to take part in a study about how people see the driving of others.

You will watch short clips of a simulated car on a motorway, and answer four questions about each. \
There are no right or wrong answers, and nothing in the clips is a real accident.

Your answers are kept without your name. At the beginning you are given a code; with it your \
answers can be deleted at any time. You may stop at any time without giving a reason.

[Name of the institution, the people responsible and how to reach them, payment, ethics approval, \
and how long the data are kept. Replace this paragraph, then run hmi-marl study make again.]
"""


@dataclass(frozen=True)
class _Job:
    """A clip to be rendered."""

    name: str
    condition: Condition
    seed: int


def make_study(
    settings: StudySettings,
    folder: Path,
    consent: Path | None = None,
    progress: Callable[[Sequence[Any]], Iterator[Any]] = iter,
) -> Study:
    """Render all clips of a study that are not there yet, and write the manifest.

    Args:
        settings: of the study.
        folder: of the study; may hold one of the same settings, which is completed.
        consent: file with the text that raters consent to; by default the folder's own, or a
            template.
        progress: receives the clips to be rendered and passes them on, one by one.

    Raises:
        ValueError: an unknown policy, or the folder holds another study.
        RuntimeError: mp4 without the video extra.
        OSError: the folder cannot be written to.
    """
    check_suffix(Path(f"clip.{settings.format}"))
    for condition in settings.conditions:
        team = settings.team(condition)
        make_driver_policy(condition.policy, team)
        make_hmi(condition.hmi, team)
    text = None if consent is None else read_consent_file(consent)
    with owned(folder):
        make_folder(folder / CLIPS)
        done = _done(folder, settings)
        if text is not None or not (folder / CONSENT).exists():
            write_text(folder / CONSENT, CONSENT_TEXT if text is None else text)
        jobs = _jobs(settings)
        for job in progress([job for job in jobs if job.name not in done]):
            done[job.name] = _render(settings, job, folder)
            write_json(folder / MAKING, json_value(list(done.values())))
        clips = tuple(done[job.name] for job in jobs)
        check = _render_check(settings, folder)
        study = Study(folder, settings, settings.intended, clips, check, read_consent(folder))
        _check_same(study)
        write_manifest(study)
        (folder / MAKING).unlink(missing_ok=True)
    return study


def quick(settings: StudySettings) -> StudySettings:
    """Return settings of a tiny study of the same drivers, to look at.

    Raises:
        ValueError: clips, shown or duration are given, which a quick study sets itself.
    """
    default = StudySettings()
    tiny: dict[str, Any] = {"clips": 2, "shown": 1, "duration": 4.0}
    for name in tiny:
        if getattr(settings, name) != getattr(default, name):
            raise ValueError(f"--quick sets --{name} itself; leave one of them out")
    return replace(settings, **tiny)


def read_consent_file(path: Path) -> str:
    """Return the content of a file with a consent text."""
    if not path.is_file():
        raise ValueError(f"--consent: {path} is no file")
    return read_consent(path.parent, path.name)


def _done(folder: Path, settings: StudySettings) -> dict[str, StudyClip]:
    """Clips that are there and whole, by their names.

    Raises:
        ValueError: the folder holds another study.
    """
    made: Sequence[StudyClip] = ()
    if (folder / MANIFEST).exists():
        before, _ = read_manifest(folder)
        if plan_of(before.settings) != plan_of(settings):
            raise ValueError(
                f"{folder} holds a study of other settings; choose another --out, since answers "
                "belong to what was shown"
            )
        made = before.clips
        check = folder / CLIPS / before.check.name
        if check.exists() and sha256_of(check) != before.check.sha256:
            check.unlink()
    elif (folder / MAKING).exists():
        try:
            made = read_value(tuple[StudyClip, ...], read_json(folder / MAKING), MAKING)
        except (TypeError, ValueError):
            made = ()  # all is rendered again
    return {clip.name: clip for clip in made if _is_whole(folder, clip)}


def _is_whole(folder: Path, clip: StudyClip) -> bool:
    path = folder / CLIPS / clip.name
    return path.exists() and sha256_of(path) == clip.sha256


def _check_same(study: Study) -> None:
    """Check that clips that were rendered again are the same as before."""
    if (study.folder / MANIFEST).exists():
        before, _ = read_manifest(study.folder)
        if before.id != study.id:
            raise ValueError(
                f"{study.folder}: clips rendered again differ from those in {MANIFEST}; restore a "
                "copy of the folder, or choose another --out"
            )


def _jobs(settings: StudySettings) -> list[_Job]:
    found = []
    for place, condition in enumerate(settings.conditions):
        series = team_seed(settings.seed, place)
        for number in range(settings.clips):
            seed = int(episode_seed(series, number))
            found.append(_Job(_name(settings, condition, seed), condition, seed))
    return found


def _name(settings: StudySettings, condition: Condition, seed: int, kind: str = "clip") -> str:
    about = {
        "version": hmi_marl.__version__,
        "kind": kind,
        "condition": json_value(condition),
        "seed": seed,
        "duration": settings.duration,
        "vehicles": settings.vehicles,
        "width": settings.width,
        "frames_per_step": settings.frames_per_step,
    }
    return f"{json_digest(about)[:12]}.{settings.format}"


def _render(settings: StudySettings, job: _Job, folder: Path) -> StudyClip:
    moments = list(
        episode(settings.team(job.condition), job.condition.hmi, job.condition.policy, job.seed)
    )
    _write(settings, job, moments, folder / CLIPS / job.name)
    statuses = [status for _, status in moments[1:]]
    return StudyClip(
        job.name,
        job.condition.name,
        job.seed,
        float(statuses[-1].time),
        statuses[-1].crashed,
        float(np.mean([status.distracted for status in statuses])),
        sha256_of(folder / CLIPS / job.name),
    )


def _write(
    settings: StudySettings,
    job: _Job,
    moments: Sequence[tuple[Snapshot, TeamStatus]],
    path: Path,
    change: Callable[[int, NDArray[np.uint8]], NDArray[np.uint8]] = lambda _, picture: picture,
) -> None:
    """Write a clip of the road alone; ``change`` gets the number and content of each picture."""
    config, per_step = settings.team(job.condition), settings.frames_per_step
    viewer = Viewer(config, width=settings.width)
    last = (len(moments) - 1) * per_step

    def pictures() -> Pictures:
        drawn = frames(
            ((snapshot, _hidden(status)) for snapshot, status in moments), viewer, per_step
        )
        for number, picture in enumerate(drawn):
            yield change(number, picture[:-PANEL_HEIGHT])

    write_clip(path, pictures(), config.scene.policy_frequency * per_step, {last: HOLD})


def _hidden(status: TeamStatus) -> TeamStatus:
    """Return a status by which the car's colour does not tell attention."""
    return replace(status, distracted=False)


def _render_check(settings: StudySettings, folder: Path) -> CheckClip:
    """Render the attention check, unless it is there."""
    rng = np.random.default_rng([settings.seed, POINTS])
    answer = int(rng.choice([1, 2, 6, 7]))
    condition = settings.conditions[0]
    seed = int(episode_seed(team_seed(settings.seed, len(settings.conditions)), 0))
    job = _Job(_name(settings, condition, seed, f"check {answer}"), condition, seed)
    path = folder / CLIPS / job.name
    if not path.exists():
        moments = list(episode(settings.team(condition), condition.hmi, condition.policy, seed))
        frequency = settings.team(condition).scene.policy_frequency
        moments = moments[: round(_CHECK_SECONDS * frequency) + 1]
        first = min(round(_CHECK_FROM * frequency), len(moments) - 1) * settings.frames_per_step
        text = f"Attention check: please choose {answer}\nin each of the four questions."
        change = partial(_with_text, text=text, first=first)
        _write(settings, job, moments, path, change)
    return CheckClip(job.name, answer, sha256_of(path))


def _with_text(number: int, picture: NDArray[np.uint8], text: str, first: int) -> NDArray[np.uint8]:
    """Write a text over a picture, from the picture ``first`` on."""
    if number < first:
        return picture
    image = Image.fromarray(picture)
    draw, (width, height) = ImageDraw.Draw(image), image.size
    size = 40
    while True:
        font = ImageFont.load_default(size)
        left, top, right, bottom = draw.multiline_textbbox((0, 0), text, font=font, align="center")
        if size <= 8 or (right - left <= 0.9 * width and bottom - top <= 0.8 * height):
            break
        size -= 2
    corner = ((width - right - left) / 2, (height - bottom - top) / 2)
    draw.rectangle((0, 0, width, height), fill=(255, 255, 255))
    draw.multiline_text(corner, text, fill=(20, 20, 20), font=font, align="center")
    return np.asarray(image)
