"""The study folder: a manifest with checksums, clips, and the texts that raters consent to.

========================  ==========================================================================
``study.json``            the manifest: settings, conditions, contrasts, clips with their seeds and
                          checksums, the attention check
``clips/NAME.mp4``        the clips, whose names do not tell the driver
``consent.txt``           what raters consent to, a paragraph after each empty line
========================  ==========================================================================
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import hmi_marl
from hmi_marl.checks import Check, Checked, Real, Whole
from hmi_marl.envs.streams import Seed
from hmi_marl.files import (
    json_digest,
    json_value,
    sha256,
    sha256_of,
    with_checksum,
    without_checksum,
    write_json,
)
from hmi_marl.people.study.settings import POINTS, Contrast, StudySettings
from hmi_marl.reading import read_bytes, read_json
from hmi_marl.typed_json import read_as, read_value

MANIFEST, CLIPS, CONSENT = "study.json", "clips", "consent.txt"
FORMAT = 1
_CONSENT_BYTES = 100_000
_MOST_VALUES = 300_000
"""Most values in a manifest, which has seven for each of up to 40,000 clips."""
_TEXTS = ("keep_ids", "completion_code", "return_address")
"""Settings that may change in a study, since they change no clip and no order."""


def _check_file(name: str, value: str) -> str:
    stem, dot, suffix = str(value).partition(".")
    if not (stem.isalnum() and stem.isascii() and dot and suffix in ("mp4", "gif")):
        raise ValueError(f"{name} is the name of a clip such as 0a1b2c.mp4, not {value!r}")
    return str(value)


FileName = Annotated[str, Check(_check_file, "letters and digits, .mp4 or .gif")]


@dataclass(frozen=True)
class StudyClip(Checked):
    """One clip, and what happens in it.

    Raises:
        ValueError, TypeError: a value out of its range.
    """

    name: FileName
    condition: str
    """Name of its driver or control."""
    seed: Seed
    """Seed of the episode."""
    seconds: Annotated[float, Real(0.0, 3600.0, "s")]
    """Duration of the episode [s]."""
    crashed: bool
    distracted: Annotated[float, Real(0.0, 1.0)]
    """Share of steps in which the driver was distracted."""
    sha256: str
    """Checksum of the file."""


@dataclass(frozen=True)
class CheckClip(Checked):
    """The attention check: a clip in which a text asks for one answer in all ratings.

    Raises:
        ValueError, TypeError: a value out of its range.
    """

    name: FileName
    answer: Annotated[int, Whole(1, POINTS)]
    sha256: str


@dataclass(frozen=True)
class Study:
    """A study folder that has been read and checked."""

    folder: Path
    settings: StudySettings
    contrasts: tuple[Contrast, ...]
    clips: tuple[StudyClip, ...]
    check: CheckClip
    consent: str
    """Text that raters consent to."""

    @property
    def id(self) -> str:
        """Identity of what is shown, by which answers belong to a study: 12 digits."""
        return study_id(self.settings, self.clips, self.check)

    @property
    def conditions(self) -> tuple[str, ...]:
        """Names of drivers and controls."""
        return tuple(each.name for each in self.settings.conditions)

    def of(self, condition: str) -> tuple[StudyClip, ...]:
        """Clips of a condition."""
        return tuple(clip for clip in self.clips if clip.condition == condition)

    def path(self, clip: str) -> Path | None:
        """Path of a clip by its name; None if there is no such clip."""
        known = {each.name for each in self.clips} | {self.check.name}
        return self.folder / CLIPS / clip if clip in known else None


def plan_of(settings: StudySettings) -> dict[str, Any]:
    """Settings that decide what is shown, as JSON content."""
    return {name: value for name, value in json_value(settings).items() if name not in _TEXTS}


def study_id(settings: StudySettings, clips: Sequence[StudyClip], check: CheckClip) -> str:
    """Return 12 digits that name what a study shows."""
    about = {
        "plan": plan_of(settings),
        "contrasts": [contrast.name for contrast in settings.intended],
        "clips": [[clip.condition, clip.sha256] for clip in clips],
        "check": [check.answer, check.sha256],
    }
    return json_digest(about)[:12]


def write_manifest(study: Study) -> None:
    """Write the manifest of a folder whose clips are all there."""
    content = {
        "format": FORMAT,
        "study": study.id,
        "hmi_marl_version": hmi_marl.__version__,
        "settings": json_value(study.settings),
        "conditions": json_value(study.settings.conditions),
        "contrasts": json_value(study.contrasts),
        "clips": json_value(study.clips),
        "check": json_value(study.check),
        "consent": sha256(study.consent.encode()),
    }
    write_json(study.folder / MANIFEST, with_checksum(content))


def read_manifest(folder: Path) -> tuple[Study, str]:
    """Read a manifest, without looking at the other files.

    Returns:
        The study, without its consent text, and that text's checksum.

    Raises:
        OSError, ValueError: there is none, or it is damaged.
    """
    path = folder / MANIFEST
    if not folder.is_dir() or not path.exists():
        raise FileNotFoundError(
            f"{folder} is no study folder, since it has no {MANIFEST}; make one with "
            "hmi-marl study make"
        )
    try:
        content = without_checksum(read_json(path, most_values=_MOST_VALUES))
        if content.get("format") != FORMAT:
            raise ValueError(f"its format is {content.get('format')!r}, and this reads {FORMAT}")
        settings = read_as(StudySettings, content.get("settings"))
        study = Study(
            folder,
            settings,
            read_value(tuple[Contrast, ...], content.get("contrasts"), "contrasts"),
            read_value(tuple[StudyClip, ...], content.get("clips"), "clips"),
            read_value(CheckClip, content.get("check"), "check"),
            "",
        )
        _check_parts(study, content)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path} does not match: {error}; make the study again") from None
    return study, str(content.get("consent"))


def _check_parts(study: Study, content: Mapping[str, Any]) -> None:
    if study.contrasts != study.settings.intended:
        raise ValueError("its contrasts are others than its settings say")
    wanted = [name for name in study.conditions for _ in range(study.settings.clips)]
    if [clip.condition for clip in study.clips] != wanted:
        raise ValueError("its clips are others than its settings say")
    names = [study.check.name, *(clip.name for clip in study.clips)]
    if len(set(names)) < len(names):
        raise ValueError("two clips have one name")
    if content.get("study") != study.id:
        raise ValueError("its identity is not that of its clips")


def read_study(folder: Path) -> Study:
    """Read a study folder, and check every file by the manifest.

    Raises:
        OSError, ValueError: it is no study folder, or a file differs from the manifest.
    """
    study, consent = read_manifest(folder)
    sums = {clip.name: clip.sha256 for clip in study.clips}
    for name, known in {**sums, study.check.name: study.check.sha256}.items():
        path = folder / CLIPS / name
        if not path.exists() or sha256_of(path) != known:
            raise ValueError(
                f"{path} is missing or differs from {MANIFEST}; run hmi-marl study make again"
            )
    text = read_consent(folder)
    if sha256(text.encode()) != consent:
        raise ValueError(
            f"{folder / CONSENT} differs from {MANIFEST}; if it was edited, run hmi-marl study "
            "make again with the same settings, which keeps the clips"
        )
    return Study(folder, study.settings, study.contrasts, study.clips, study.check, text)


def read_consent(folder: Path, name: str = CONSENT) -> str:
    """Return the consent text of a folder, or another of its files.

    Raises:
        OSError, ValueError: there is none, it is too long, empty, or no UTF-8.
    """
    path = folder / name
    try:
        text = read_bytes(path, _CONSENT_BYTES).decode()
    except UnicodeDecodeError as error:
        raise ValueError(f"{path} is no text in UTF-8: {error.reason}") from None
    if not text.strip():
        raise ValueError(f"{path} is empty; write what raters consent to")
    return text
