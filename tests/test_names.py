import pytest

from hmi_marl.names import suggest, unknown


def test_the_nearest_names_are_suggested_best_first():
    known = ["two-stage", "joint", "simultaneous", "alternating"]
    assert unknown("protocol", "two-stge", known, "the list") == (
        "unknown protocol 'two-stge'; did you mean two-stage? the list lists all"
    )
    assert suggest("homer2", ["home", "homer", "zzz"], "x").startswith(
        "did you mean homer or home?"
    )


def test_case_does_not_matter_and_names_are_suggested_as_they_are_spelt():
    assert "did you mean NoHMI?" in suggest("nohmy", ["NoHMI", "own"])


def test_short_lists_are_given_whole_where_nothing_is_near():
    assert suggest("moe", ["lisa", "bart"]) == "known: lisa, bart (see hmi-marl --help)"


@pytest.mark.parametrize("known", [[], [f"name-{i}" for i in range(100)]])
def test_a_message_stays_a_line(known):
    message = unknown("driver", "q", known)
    assert len(message) < 160
    assert "\n" not in message
