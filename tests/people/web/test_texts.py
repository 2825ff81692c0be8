"""Every text that is used exists, and every text is used."""

import json
import re
from pathlib import Path

import pytest

import hmi_marl.people
from hmi_marl.people.web.texts import FOLDER, SHARED, Texts, languages, placeholders

PEOPLE = Path(hmi_marl.people.__file__).parent
SECTIONS = json.loads((FOLDER / "en.json").read_text("utf-8"))
SERVICES = [name for name in SECTIONS if name != SHARED]
KEY = re.compile(r"""(?:\b|_)(?:texts?|t)\(\s*(f?)["'`]([\w.]+?\.?)(?:["'`]|\$?\{)""")
"""A call such as texts("a.b") or, of any key that begins so, texts(f"a.{b}") or t(`a.${b}`)."""


def used(folder):
    """Keys that sources of a folder use, and beginnings of keys."""
    whole, beginnings = set(), set()
    for path in [*folder.rglob("*.py"), *folder.rglob("*.js")]:
        for _, key in KEY.findall(path.read_text("utf-8")):
            (beginnings if key.endswith(".") else whole).add(key)
    return whole, beginnings


@pytest.mark.parametrize("service", SERVICES)
def test_texts_of_a_service_are_those_that_it_uses(service):
    texts = Texts(service)
    whole, beginnings = used(PEOPLE / service)
    shared = used(PEOPLE / "web")[0]
    assert sorted(key for key in whole | shared if key not in texts) == []
    unused = {key for key in SECTIONS[service] if not key.startswith(tuple(beginnings) or ("\n",))}
    assert unused - whole - shared == set()
    for beginning in beginnings:
        assert any(key.startswith(beginning) for key in SECTIONS[service])


def test_shared_texts_are_used():
    everywhere = used(PEOPLE)[0]
    assert set(SECTIONS[SHARED]) - everywhere == set()


def test_texts_are_filled_in():
    texts = Texts("play")
    assert texts("skip") == SECTIONS[SHARED]["skip"]
    assert placeholders("{a} of {b}") == {"a", "b"}
    with pytest.raises(KeyError):
        texts("no such text")
    with pytest.raises(ValueError, match="no section 'x'"):
        Texts("x")
    with pytest.raises(ValueError, match="texts are in en, not in 'xx'"):
        Texts("play", "xx")


def test_other_languages_have_the_same_keys_and_placeholders():
    for language in languages():
        sections = json.loads((FOLDER / f"{language}.json").read_text("utf-8"))
        assert set(sections) == set(SECTIONS)
        for name, texts in sections.items():
            assert set(texts) == set(SECTIONS[name])
            for key, text in texts.items():
                assert placeholders(text) == placeholders(SECTIONS[name][key])
