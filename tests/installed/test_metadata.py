"""What a package page shows of the wheel."""

from __future__ import annotations

import re
import zipfile
from email import message_from_bytes
from email.message import Message
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import urlparse

import markdown
import pytest
from installed.environments import PROJECT, VERSIONS
from pages import README, ROOT, blocks

import hmi_marl

pytestmark = [pytest.mark.wheel, pytest.mark.xdist_group("metadata")]
REPOSITORY = PROJECT["urls"]["Homepage"]


@pytest.fixture(scope="module")
def metadata(wheel: Path) -> Message:
    with zipfile.ZipFile(wheel) as files:
        (place,) = [name for name in files.namelist() if name.endswith(".dist-info/METADATA")]
        return message_from_bytes(files.read(place))


@pytest.fixture(scope="module")
def description(metadata: Message) -> str:
    assert metadata["Description-Content-Type"] == "text/markdown"
    content = metadata.get_payload(decode=True)
    assert isinstance(content, bytes)
    return content.decode("utf-8")


class Addresses(HTMLParser):
    """Where the links and the pictures of a page lead, in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.pictures: list[str] = []
        self.feed(markdown.markdown(text, extensions=["tables", "fenced_code"]))

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        for name, value in attributes:
            if name == "href":
                self.links.append(value or "")
            elif name == "src":
                self.pictures.append(value or "")


def test_every_link_and_picture_of_the_long_description_is_absolute(description: str) -> None:
    found = Addresses(description)
    assert found.pictures
    assert found.links
    for address in found.links + found.pictures:
        assert urlparse(address).scheme == "https", address


def test_the_long_description_is_the_readme_with_the_same_targets(description: str) -> None:
    ours, theirs = Addresses(README.read_text("utf-8")), Addresses(description)
    for kind, ours_of, theirs_of in (
        ("blob", ours.links, theirs.links),
        ("raw", ours.pictures, theirs.pictures),
    ):
        absolute = [
            target if urlparse(target).scheme else f"{REPOSITORY}/{kind}/HEAD/{target}"
            for target in ours_of
        ]
        assert theirs_of == absolute
    for language in ("python", "console"):
        assert blocks(description, language) == blocks(README.read_text("utf-8"), language)


def test_the_metadata_say_what_the_project_says(metadata: Message) -> None:
    assert metadata["Name"] == "hmi-marl"
    assert metadata["Version"] == hmi_marl.__version__
    assert metadata["License-Expression"] == "MIT"
    assert metadata["Keywords"].split(",") == PROJECT["keywords"]
    classifiers = metadata.get_all("Classifier")
    assert [f"Programming Language :: Python :: {version}" for version in VERSIONS] == [
        each for each in classifiers if re.search(r":: 3\.\d+$", each)
    ]
    assert metadata["Requires-Python"] == f">={VERSIONS[0]}"
    addresses = dict(each.split(", ") for each in metadata.get_all("Project-URL"))
    assert addresses == PROJECT["urls"]
    assert {"Homepage", "Documentation", "Changelog", "Issues"} <= set(addresses)
    assert all(address.startswith(REPOSITORY) for address in addresses.values())


def test_pages_that_the_metadata_name_are_in_the_repository() -> None:
    for address in PROJECT["urls"].values():
        _, found, path = address.partition("/blob/HEAD/")
        assert not found or (ROOT / path).is_file(), address


def test_the_citation_names_the_repository() -> None:
    assert f"repository-code: {REPOSITORY}\n" in (ROOT / "CITATION.cff").read_text("utf-8")


def test_the_wheel_holds_the_package_and_nothing_else(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as files:
        names = files.namelist()
    top = {name.split("/")[0] for name in names}
    assert top == {"hmi_marl", f"hmi_marl-{hmi_marl.__version__}.dist-info"}
    ours = {
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / "hmi_marl").rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert {name for name in names if name.startswith("hmi_marl/")} == ours
