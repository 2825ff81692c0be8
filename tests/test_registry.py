import pytest

from hmi_marl.registry import Registry, suggest, unknown


@pytest.fixture
def fruit():
    registry = Registry("fruit", "market --help")
    registry.register("apple", "red or green", 1, aliases=("Pomme",))
    registry.register("pear", "green", 2)
    return registry


def test_entries_are_found_by_name_and_alias_whatever_the_case(fruit):
    assert fruit.find("APPLE").value == fruit.find("pomme").value == fruit["Apple"].value == 1
    assert list(fruit) == ["apple", "pear"]
    assert fruit.helps() == {"apple": "red or green", "pear": "green"}
    assert "pomme" in fruit
    assert "plum" not in fruit
    assert 1 not in fruit


def test_an_unknown_name_is_refused_with_the_nearest(fruit):
    with pytest.raises(ValueError, match=r"unknown fruit 'peer'.*pear"):
        fruit.find("peer")


@pytest.mark.parametrize("name", ["pear", "POMME"])
def test_a_name_is_registered_once(fruit, name):
    with pytest.raises(ValueError, match="already a fruit called"):
        fruit.register(name, "again", 3)


@pytest.mark.parametrize("name", ["", "a:b", "a/b"])
def test_names_that_mean_something_else_are_refused(fruit, name):
    with pytest.raises(ValueError, match="a fruit needs a name without"):
        fruit.register(name, "no", 3)


def test_an_entry_can_be_removed_with_its_aliases(fruit):
    fruit.unregister("Pomme")
    assert list(fruit) == ["pear"]
    assert "apple" not in fruit
    fruit.register("pomme", "again", 4)
    with pytest.raises(KeyError):
        fruit.unregister("plum")


def test_a_name_may_be_followed_by_an_argument(fruit):
    fruit.register("tree", "of any height", 5, argument="[:HEIGHT]")
    assert fruit.helps()["tree[:HEIGHT]"] == "of any height"
    assert [fruit.split(text)[1] for text in ("tree", "TREE:3:4", "pear")] == ["", "3:4", ""]
    assert fruit.split("tree:3")[0].value == 5
    with pytest.raises(ValueError, match="fruit 'pear' takes no argument, but got 'pear:3'"):
        fruit.split("pear:3")
    with pytest.raises(ValueError, match=r"unknown fruit 'peer:3'; did you mean pear\?|known: "):
        fruit.split("peer:3")


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
