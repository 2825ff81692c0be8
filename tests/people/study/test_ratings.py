"""Ratings of a study, from the database and from an export."""

import json

import pytest
from people.study.studies import a_study

from hmi_marl.people.export import export
from hmi_marl.people.store import Store
from hmi_marl.people.study.ratings import (
    StudyAnswer,
    check_value,
    question_of,
    ratings_of,
    read_ratings,
    write_answers,
)
from hmi_marl.people.study.settings import RATINGS, Plan
from hmi_marl.people.study.simulated import simulated_answers
from hmi_marl.people.study.visits import Visits


@pytest.fixture
def study(tmp_path):
    return a_study(tmp_path / "study")


def value(*points):
    return dict(zip(RATINGS, points, strict=True))


def fill(store, study, wrong=(), stop=()):
    """Five raters; some fail the attention check, some leave after two clips."""
    visits = Visits(study, store)
    for number in range(1, 6):
        visitor, session = visits.begin({})
        visit = visits.find(session)
        for place, page in enumerate(visit.pages[:3] if number in stop else visit.pages):
            if page == "instructions":
                given = True
            elif page == study.check.name:
                right = study.check.answer
                given = value(right, right, right, right - (number in wrong))
            else:
                given = value(1 + place % 7, number, 3, 4)
            store.answer(session, question_of(study.id, page), given)
        assert visitor.number == number


def test_the_database_and_its_export_give_the_same_ratings(tmp_path, study):
    with Store(tmp_path / "people.db") as store:
        fill(store, study, wrong=(2,), stop=(4,))
        store.answer(store.new_session(1, "play"), "how-was-it", "=1+1")
        export(store, tmp_path / "out", ["csv"])
    ours = read_ratings(tmp_path / "people.db", study)
    again = read_ratings(tmp_path / "out" / "answers.csv", study)
    assert ours.raters == ("visitor-1", "visitor-3", "visitor-5")
    assert (ours.left_out.failed, ours.left_out.unfinished) == (1, 1)
    assert ours.values.shape == (3 * 4, 4)
    assert not ours.simulated
    # in the export, rows may come in another order
    assert sorted(again.raters) == sorted(ours.raters)
    rows = {
        (name.raters[r], int(c), *map(int, v))
        for name in (ours,)
        for r, c, v in zip(name.rater, name.clip, name.values, strict=True)
    }
    assert rows == {
        (again.raters[r], int(c), *map(int, v))
        for r, c, v in zip(again.rater, again.clip, again.values, strict=True)
    }
    assert {row[3] for row in rows if row[0] == "visitor-3"} == {3}


def test_answers_of_another_study_are_not_taken(tmp_path, study):
    other = a_study(tmp_path / "other", seed=1)
    with Store(tmp_path / "people.db") as store:
        fill(store, other)
    with pytest.raises(ValueError, match=f"no answers of the study {study.id}.*30 of another"):
        read_ratings(tmp_path / "people.db", study)


def test_simulated_raters_are_marked_and_never_taken_among_people(tmp_path, study):
    answers = simulated_answers(study, 8, Plan(careless=0.4), seed=1)
    write_answers(tmp_path / "answers.csv", answers)
    found = read_ratings(tmp_path / "answers.csv", study)
    assert found.simulated
    assert len(found.raters) + found.left_out.failed == 8
    assert 0 < found.left_out.failed < 8
    person = StudyAnswer(
        "visitor-1", "s", question_of(study.id, study.clips[0].name), value(1, 2, 3, 4)
    )
    with pytest.raises(ValueError, match="simulated raters among people"):
        ratings_of([*answers, person], study, "here")


@pytest.mark.parametrize(
    "odd",
    [
        None, 3, [1, 2, 3, 4], {}, value(1, 2, 3, 0), value(1, 2, 3, 8), value(1, 2, 3, 4.0),
        value(1, 2, 3, True), value(1, 2, 3, "4"), value(1, 2, 3, 4) | {"more": 1},
    ],
)  # fmt: skip
def test_odd_values_are_refused(study, odd):
    with pytest.raises(ValueError, match=r"whole number from 1 to 7|has the ratings safe"):
        check_value(odd)
    answer = StudyAnswer("visitor-1", "s", question_of(study.id, study.clips[0].name), odd)
    with pytest.raises(ValueError, match=r"whole number from 1 to 7|has the ratings safe"):
        ratings_of([answer], study, "here")


def test_a_clip_rated_twice_is_refused(study):
    answer = StudyAnswer(
        "visitor-1", "s", question_of(study.id, study.clips[0].name), value(1, 2, 3, 4)
    )
    with pytest.raises(ValueError, match=r"visitor-1 rated 00000\.gif twice"):
        ratings_of([answer, answer], study, "here")


@pytest.mark.parametrize(
    "content",
    [
        "", "a,b\n", "visitor,session,question,value,made\n1,2,a:b\n",
        "visitor,session,question,value,made\n1,2,a:b,{,\n",
        'visitor,session,question,value,made\n"1',
    ],
)  # fmt: skip
def test_other_files_are_refused_in_one_line(tmp_path, study, content):
    path = tmp_path / "answers.csv"
    path.write_text(content)
    with pytest.raises(ValueError, match=r"answers\.csv is no answers\.csv of") as error:
        read_ratings(path, study)
    assert "\n" not in str(error.value)


def test_answers_written_are_those_of_an_export(tmp_path, study):
    answers = simulated_answers(study, 3, Plan())
    write_answers(tmp_path / "answers.csv", answers)
    first, *rows = (tmp_path / "answers.csv").read_text().splitlines()
    assert first == "visitor,session,question,value,made"
    assert len(rows) == 3 * 5
    assert json.loads(rows[0].split('"', 1)[1].rpartition('"')[0].replace('""', '"'))
