"""Ratings of a study, from the database or an export's answers.csv.

An answer is one page of a study: its question is ``STUDY:CLIP``, by the study's identity and the
clip's file, and its value the four ratings. Raters who fail the attention check are left out, and
so are those who did not reach it. Simulated raters are named ``simulated-N``; they are never taken
together with people.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hmi_marl.checks import shown
from hmi_marl.files import write_text
from hmi_marl.people.export import ANSWER_COLUMNS
from hmi_marl.people.store import Store, visitor_name
from hmi_marl.people.study.folder import Study
from hmi_marl.people.study.settings import POINTS, RATINGS
from hmi_marl.reading import parse_json, read_bytes

SIMULATED = "simulated-"
"""Beginning of the names of simulated raters."""
_CSV_BYTES = 256 * 2**20


@dataclass(frozen=True)
class LeftOut:
    """Number of raters who are not analysed, by reason."""

    failed: int = 0
    """Failed the attention check."""
    unfinished: int = 0
    """Left before the attention check."""


@dataclass(frozen=True)
class Ratings:
    """N ratings of clips by raters who passed the attention check."""

    raters: tuple[str, ...]
    rater: NDArray[np.int64]
    """Number of the rater, shape (N,)."""
    clip: NDArray[np.int64]
    """Number of the clip in the study, shape (N,)."""
    values: NDArray[np.int64]
    """1 to 7, columns as in ``RATINGS``, shape (N, 4)."""
    simulated: bool
    left_out: LeftOut = field(default_factory=LeftOut)


@dataclass(frozen=True)
class StudyAnswer:
    """One page's answer."""

    rater: str
    session: str
    question: str
    value: Any


def question_of(study: str, clip: str) -> str:
    """Return the name under which an answer about a clip is kept."""
    return f"{study}:{clip}"


def check_value(value: Any) -> dict[str, int]:
    """Return the four ratings of one clip, or raise ValueError."""
    if not isinstance(value, dict) or set(value) != set(RATINGS):
        raise ValueError(f"an answer has the ratings {', '.join(RATINGS)}, not {shown(value)}")
    for name, rating in value.items():
        whole = isinstance(rating, int) and not isinstance(rating, bool)
        if not whole or not 1 <= rating <= POINTS:
            raise ValueError(f"{name} is a whole number from 1 to {POINTS}, not {shown(rating)}")
    return {name: value[name] for name in RATINGS}


def read_ratings(source: Path, study: Study) -> Ratings:
    """Read the ratings of a study.

    Args:
        source: database that hmi-marl study serve wrote, or answers.csv of an export.
        study: the study; answers of other studies are not read.

    Raises:
        OSError, ValueError: it is neither, it is damaged, it has no answer of this study, or it has
            simulated raters among people.
    """
    if source.suffix.lower() == ".csv":
        return ratings_of(_from_csv(source), study, str(source))
    with Store(source, make=False) as store:
        answers = (
            StudyAnswer(visitor_name(each.visitor), each.session, each.question, each.value)
            for each in store.answers()
        )
        return ratings_of(answers, study, str(source))


def ratings_of(answers: Iterable[StudyAnswer], study: Study, source: str) -> Ratings:
    """Take the ratings of a study from answers; see :func:`read_ratings`."""
    places = {clip.name: place for place, clip in enumerate(study.clips)}
    sessions: dict[str, list[tuple[int, list[int]]]] = {}
    names: dict[str, str] = {}
    passed: dict[str, bool] = {}
    others = 0
    for answer in answers:
        identity, _, clip = answer.question.partition(":")
        if identity != study.id:
            others += ":" in answer.question
            continue
        names[answer.session] = answer.rater
        own = sessions.setdefault(answer.session, [])
        if clip == study.check.name:
            value = check_value(answer.value)
            passed[answer.session] = set(value.values()) == {study.check.answer}
        elif clip in places:
            if any(place == places[clip] for place, _ in own):
                raise ValueError(f"{source}: {answer.rater} rated {clip} twice")
            own.append((places[clip], list(check_value(answer.value).values())))
    if not sessions:
        more = f", though {others} of another study" if others else ""
        raise ValueError(f"{source} has no answers of the study {study.id} in {study.folder}{more}")
    simulated = {name.startswith(SIMULATED) for name in names.values()}
    if len(simulated) > 1:
        raise ValueError(f"{source} has simulated raters among people; take them apart")
    good = [session for session in sessions if passed.get(session)]
    rows = [(n, *row) for n, session in enumerate(good) for row in sessions[session]]
    return Ratings(
        tuple(names[session] for session in good),
        np.array([row[0] for row in rows], np.int64),
        np.array([row[1] for row in rows], np.int64),
        np.array([row[2] for row in rows], np.int64).reshape(-1, len(RATINGS)),
        simulated == {True},
        LeftOut(
            sum(not right for right in passed.values()),
            sum(session not in passed for session in sessions),
        ),
    )


def _from_csv(path: Path) -> Iterator[StudyAnswer]:
    try:
        text = read_bytes(path, _CSV_BYTES).decode()
        rows = csv.reader(io.StringIO(text), strict=True)
        if tuple(next(rows, ())) != ANSWER_COLUMNS:
            raise ValueError(f"its columns are not {', '.join(ANSWER_COLUMNS)}")
        for row in rows:
            if len(row) != len(ANSWER_COLUMNS):
                raise ValueError(f"a row has {len(row)} columns")
            rater, session, question, value, _ = row
            if ":" in question:
                yield StudyAnswer(rater, session, question, parse_json(value))
    except (csv.Error, ValueError) as error:
        raise ValueError(f"{path} is no answers.csv of hmi-marl people export: {error}") from None


def write_answers(path: Path, answers: Sequence[StudyAnswer]) -> None:
    """Write answers in the format of an export's answers.csv, without times."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(ANSWER_COLUMNS)
    writer.writerows(
        (each.rater, each.session, each.question, json.dumps(each.value), "") for each in answers
    )
    write_text(path, text.getvalue())
