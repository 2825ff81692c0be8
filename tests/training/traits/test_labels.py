import json

import numpy as np
import pytest
from demonstrations import made_up

from hmi_marl.envs.drivers import TRAIT_NAMES
from hmi_marl.training.traits.episodes import Episodes
from hmi_marl.training.traits.windows import choose_labelled, make_labels, read_preferences

NAMES = ("ada", "bob")
DRIVER = [0, 1, 0, 1, 0, 0, -1, 0]


DATA = made_up([4] * 8, driver=DRIVER, names=NAMES)
EPISODES = Episodes.of(DATA.observed)
ETA = DATA.truth.traits[:, TRAIT_NAMES.index("eta")]


def test_a_share_of_every_drivers_windows_is_labelled():
    driver = np.repeat([0, 1, -1], [50, 10, 40])
    marked = choose_labelled(driver, 0.2, np.random.default_rng(0))
    assert marked[driver == 0].sum() == 10
    assert marked[driver == 1].sum() == 2
    assert not marked[driver == -1].any()


def test_at_least_one_window_is_labelled():
    assert choose_labelled(np.array([0, 0, 0]), 0.01, np.random.default_rng(0)).sum() == 1


def test_nothing_is_labelled_without_supervision():
    assert np.isnan(make_labels(EPISODES, "none", 0.5, np.random.default_rng(0))).all()


def test_labels_of_identity_are_who_drives():
    labels = make_labels(EPISODES, "id", 1.0, np.random.default_rng(0))
    np.testing.assert_array_equal(labels, [0, 1, 0, 1, 0, 0, np.nan, 0])


def test_labels_of_preference_are_eta_of_labelled_windows_alone():
    labels = make_labels(EPISODES, "preference", 0.4, np.random.default_rng(0), eta=ETA)
    known = ~np.isnan(labels)
    assert known.sum() == 3  # 2 of 5, and 1 of 2
    np.testing.assert_array_equal(labels[known], ETA[known])


def test_people_can_answer():
    answers = {"ada": 0.25, "bob": 1.0}
    labels = make_labels(EPISODES, "preference", 1.0, np.random.default_rng(0), answers)
    np.testing.assert_array_equal(labels, [0.25, 1, 0.25, 1, 0.25, 0.25, np.nan, 0.25])


def test_which_windows_are_labelled_follows_from_the_generator():
    one, two, other = (
        make_labels(EPISODES, "id", 0.5, np.random.default_rng(seed)) for seed in (0, 0, 3)
    )
    np.testing.assert_array_equal(one, two)
    assert not np.array_equal(np.isnan(one), np.isnan(other))


@pytest.mark.parametrize(
    ("answers", "message"),
    [
        (None, "give the drivers' answers with --preferences"),
        ({"ada": 0.5}, "preferences lack bob"),
        ({"ada": 0.5, "bob": 1.5}, r"lies in \[0, 1\]"),
        ({"ada": 0.5, "bob": float("nan")}, r"lies in \[0, 1\]"),
    ],
)
def test_preferences_that_are_not_known_are_refused(answers, message):
    with pytest.raises(ValueError, match=message):
        make_labels(EPISODES, "preference", 1.0, np.random.default_rng(0), answers)


def test_preferences_come_from_a_file(tmp_path):
    path = tmp_path / "answers.json"
    path.write_text(json.dumps({"ada": 1, "bob": 0.5}))
    assert read_preferences(path) == {"ada": 1.0, "bob": 0.5}


@pytest.mark.parametrize("text", ["[1]", '{"ada": "yes"}', '{"ada": true}'])
def test_other_files_are_no_preferences(text, tmp_path):
    path = tmp_path / "answers.json"
    path.write_text(text)
    with pytest.raises(ValueError, match="does not contain"):
        read_preferences(path)
    path.write_bytes(b"\xff{")
    with pytest.raises(ValueError, match="is no JSON file"):
        read_preferences(path)


def test_labels_that_are_all_the_same_are_refused():
    answers = dict.fromkeys(NAMES, 0.5)
    with pytest.raises(ValueError, match="all labels are the same"):
        make_labels(EPISODES, "preference", 1.0, np.random.default_rng(0), answers)
