"""Conditions, contrasts and what cannot be."""

import pytest

from hmi_marl.people.study.settings import PowerSettings, StudySettings


def test_contrasts_follow_from_the_traits():
    names = {contrast.name for contrast in StudySettings().intended}
    assert names == {
        "distracted:bart>lisa", "distracted:bart>marge",
        "distracted:homer>lisa", "distracted:homer>marge",
        "safe:marge>lisa", "safe:homer>bart", "safe:lisa>lisa@random",
        "risky:lisa>marge", "risky:bart>homer", "risky:lisa@random>lisa",
    }  # fmt: skip
    claims = {contrast.claim for contrast in StudySettings().intended}
    assert "raters see bart as more distracted than lisa" in claims
    assert "raters see marge as safer than lisa" in claims


def test_drivers_of_equal_traits_imply_nothing_and_named_contrasts_do():
    same = {"drivers": ("a:0.2,0.8,0,3", "b:0.2,0.8,0,4"), "controls": ()}
    with pytest.raises(ValueError, match="contrasts: these drivers' traits imply none"):
        StudySettings(**same)
    study = StudySettings(**same, contrasts=("own:a>b",))
    assert study.intended[0].claim == "raters see a as more similar to their own driving than b"


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"drivers": ()}, "drivers: name at least one"),
        ({"drivers": ("lisa",), "controls": ()}, "at least two to compare"),
        ({"drivers": ("lisa", "lisa")}, "different names"),
        ({"drivers": ("moe",)}, "unknown driver 'moe'"),
        ({"controls": ("lisa@",)}, "DRIVER or DRIVER@POLICY"),
        ({"clips": 2, "shown": 3}, "a rater cannot see 3 of 2 clips"),
        ({"contrasts": ("safe:lisa",)}, "RATING:MORE>LESS"),
        ({"contrasts": ("calm:lisa>bart",)}, "the rating is one of safe"),
        ({"contrasts": ("safe:lisa>moe",)}, "the driver is one of lisa"),
        ({"contrasts": ("safe:lisa>lisa",)}, "compare two drivers"),
        ({"contrasts": ("safe:lisa>bart", "safe:lisa>bart")}, "named twice"),
        ({"return_address": "http://panel.org"}, "begins with https://"),
        ({"return_address": "javascript:alert(1)"}, "begins with https://"),
        ({"return_address": "https://[::1"}, "begins with https://"),
        ({"completion_code": "a b"}, "completion_code has up to 40 letters"),
        ({"duration": 0.3}, "not a whole number of steps"),
    ],
)
def test_what_cannot_be_is_refused_in_words(settings, message):
    with pytest.raises(ValueError, match=message):
        StudySettings(**settings)


def test_numbers_of_raters_rise():
    with pytest.raises(ValueError, match="the numbers rise"):
        PowerSettings(raters=(50, 20))
    with pytest.raises(ValueError, match="name at least one number"):
        PowerSettings(raters=())
