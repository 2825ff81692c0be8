"""Folders with an index of checksums, and their replacement at once."""

import json
from pathlib import Path

import pytest

from hmi_marl.file_index import (
    INDEX,
    check_digests,
    check_files,
    digests,
    put_back,
    read_index,
    replaced,
    write_index,
)

REMEDY = "make it again"


def content_of(folder: Path) -> dict[str, str]:
    return {
        path.relative_to(folder).as_posix(): path.read_text()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def fill(folder: Path, text: str) -> None:
    (folder / "below").mkdir(parents=True)
    (folder / "below" / "a.txt").write_text(text)


def test_a_changed_or_missing_file_is_found(tmp_path: Path) -> None:
    fill(tmp_path, "one")
    path = tmp_path / "below" / "a.txt"
    files = digests([path], tmp_path)
    assert list(files) == ["below/a.txt"]
    check_digests(files)
    write_index(tmp_path, "try 1", {"files": files})
    assert read_index(tmp_path, "try 1", "tries", REMEDY) == {"format": "try 1", "files": files}
    check_files(tmp_path, files, "that was made", REMEDY)
    path.write_text("two")
    with pytest.raises(ValueError, match=r"a\.txt is not the file that was made .*; make it again"):
        check_files(tmp_path, files, "that was made", REMEDY)
    path.unlink()
    with pytest.raises(FileNotFoundError, match=r"a\.txt is missing; make it again"):
        check_files(tmp_path, files, "that was made", REMEDY)


@pytest.mark.parametrize("path", ["", "../a", "/a", "a\\b", "C:a", "a/../../b"])
def test_an_index_names_only_files_in_its_folder(path: str) -> None:
    with pytest.raises(ValueError, match="is no file in the folder of its index"):
        check_digests({path: "0" * 64})


def test_a_checksum_has_64_digits() -> None:
    with pytest.raises(ValueError, match="is no SHA-256 checksum"):
        check_digests({"a": "0" * 63})


def test_an_index_that_was_changed_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        read_index(tmp_path, "try 1", "tries", REMEDY)
    write_index(tmp_path, "try 1", {"files": {}})
    with pytest.raises(ValueError, match=r"is no index of others: format 'try 1'; make it again"):
        read_index(tmp_path, "try 2", "others", REMEDY)
    content = json.loads((tmp_path / INDEX).read_text())
    (tmp_path / INDEX).write_text(json.dumps(content | {"files": {"a": "0" * 64}}))
    with pytest.raises(ValueError, match=r"is damaged \(its checksum differs\); make it again"):
        read_index(tmp_path, "try 1", "tries", REMEDY)
    (tmp_path / INDEX).write_text("{")
    with pytest.raises(ValueError, match=r"is damaged .*; make it again"):
        read_index(tmp_path, "try 1", "tries", REMEDY)


def test_folders_are_replaced_together(tmp_path: Path) -> None:
    old, new = tmp_path / "old", tmp_path / "some" / "new"
    fill(old, "before")
    with replaced(old, new) as made:
        for folder in made:
            assert content_of(folder) == {}
            fill(folder, "after")
        assert content_of(old) == {"below/a.txt": "before"}
        assert not new.exists()
    assert content_of(old) == content_of(new) == {"below/a.txt": "after"}
    assert [path.name for path in sorted(tmp_path.iterdir())] == ["old", "some"]
    assert [path.name for path in new.parent.iterdir()] == ["new"]


@pytest.mark.parametrize("moves", range(5))
def test_an_interrupted_replacement_leaves_all_as_it_was(
    moves: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first folder takes two moves, the second one, the third two: the last one is cut off."""
    first, new, last = (tmp_path / name for name in ("first", "new", "last"))
    fill(first, "first")
    fill(last, "last")
    before = content_of(tmp_path)
    move, done = Path.replace, 0

    def cut_off(path: Path, target: Path) -> Path:
        nonlocal done
        if done == moves:
            done += 1
            raise KeyboardInterrupt
        done += 1
        return move(path, target)

    monkeypatch.setattr(Path, "replace", cut_off)

    def replace() -> None:
        with replaced(first, new, last) as made:
            for folder in made:
                fill(folder, "after")

    with pytest.raises(KeyboardInterrupt):
        replace()
    assert done > moves, "it was cut off"
    assert content_of(tmp_path) == before
    assert {path.name for path in tmp_path.iterdir()} == {"first", "last"}
    replace()
    assert set(content_of(tmp_path).values()) == {"after"}


def test_a_block_that_fails_replaces_nothing(tmp_path: Path) -> None:
    fill(tmp_path / "old", "before")

    def fail() -> None:
        with replaced(tmp_path / "old", tmp_path / "new") as (made, _):
            fill(made, "after")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()
    assert content_of(tmp_path) == {"old/below/a.txt": "before"}
    assert [path.name for path in tmp_path.iterdir()] == ["old"]


def test_what_a_kill_left_aside_is_put_back(tmp_path: Path) -> None:
    aside, folder = tmp_path / ".old-before", tmp_path / "old"
    fill(aside, "before")
    put_back(folder)
    assert content_of(tmp_path) == {"old/below/a.txt": "before"}
    fill(aside, "older")  # whose replacement was done already
    put_back(folder)
    assert content_of(folder) == {"below/a.txt": "before"}
    with replaced(folder) as (made,):
        fill(made, "after")
    assert content_of(tmp_path) == {"old/below/a.txt": "after"}
