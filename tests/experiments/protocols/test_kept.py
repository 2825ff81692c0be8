"""Results of playing that are kept, and found again as long as nothing they depend on changes."""

import math
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hmi_marl.experiments.protocols import kept
from hmi_marl.experiments.protocols.kept import Kept, play_once, weights_key


@dataclass(frozen=True)
class Part:
    count: int
    mean: float
    missing: float | None


@dataclass(frozen=True)
class Whole:
    name: str
    parts: Mapping[str, Part]
    values: NDArray[np.float64]
    counts: NDArray[np.int64]


RESULT = Whole(
    "hidden",
    {"lisa": Part(3, 0.1, None), "bart": Part(0, math.nan, -math.inf)},
    np.array([[0.1, np.nan], [np.inf, -1e-300]]),
    np.zeros(0, np.int64),
)
KEY = {"driver": "a", "episodes": [3, 1]}


def test_what_is_kept_is_found_to_the_bit(tmp_path: Path) -> None:
    place = Kept(tmp_path / "played", Whole)
    assert place.find(KEY) is None
    place.keep(KEY, RESULT)
    found = place.find(dict(reversed(KEY.items())))
    assert str(found) == str(RESULT)  # NaN equals no other
    assert found.values.tobytes() == RESULT.values.tobytes()
    assert (found.counts.dtype, found.counts.shape) == (np.int64, (0,))
    assert found.parts["bart"].missing == -math.inf


def test_numbers_and_mappings_are_kept_too(tmp_path: Path) -> None:
    for kind, value in ((float, 0.1 + 0.2), (dict[str, float], {"a": 1.0, "b": math.inf})):
        place = Kept(tmp_path, kind)
        place.keep({"kind": str(kind)}, value)
        assert place.find({"kind": str(kind)}) == value


def test_nothing_is_found_where_anything_has_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = Kept(tmp_path, Whole)
    place.keep(KEY, RESULT)
    assert place.find(KEY | {"episodes": [3, 2]}) is None
    assert place.find({"driver": "a"}) is None
    monkeypatch.setattr(kept, "code_digest", lambda: "0" * 64)
    assert place.find(KEY) is None


@pytest.mark.parametrize("damage", [b"", b"{}", "cut", "changed"])
def test_a_damaged_file_is_as_none(damage: bytes | str, tmp_path: Path) -> None:
    place = Kept(tmp_path, Whole)
    place.keep(KEY, RESULT)
    (file,) = tmp_path.rglob("*.played")
    content = file.read_bytes()
    others = {"cut": content[:-3], "changed": content.replace(b"0.1", b"0.7")}
    file.write_bytes(others[damage] if isinstance(damage, str) else damage)
    assert file.read_bytes() != content
    assert place.find(KEY) is None
    place.keep(KEY, RESULT)
    assert str(place.find(KEY)) == str(RESULT)


def test_a_file_of_another_key_is_as_none(tmp_path: Path) -> None:
    place, other = Kept(tmp_path, float), {"driver": "b"}
    place.keep(KEY, 1.0)
    (file,) = tmp_path.rglob("*.played")
    place.keep(other, 2.0)
    (place_of_other,) = set(tmp_path.rglob("*.played")) - {file}
    shutil.copy(file, place_of_other)
    assert place.find(other) is None
    with pytest.raises(ValueError, match="is of another key"):
        place.read(other)


@pytest.mark.parametrize(
    ("kind", "value", "other"),
    [
        (float, 1.5, Whole),
        (float, 1.5, dict[str, float]),
        (float, 1.5, int),
        (int, 1, float),
        (dict[str, float], {"a": 1.0}, float),
        (dict[str, float], {"a": 1.0}, Part),
        (Part, Part(1, 2.0, None), Whole),
        (str, "a", float),
        (str, "a", NDArray[np.int64]),
    ],
)
def test_a_file_of_another_kind_is_as_none(kind: Any, value: Any, other: Any, tmp_path: Path):
    Kept(tmp_path, kind).keep(KEY, value)
    assert Kept(tmp_path, kind).find(KEY) == value
    assert Kept(tmp_path, other).find(KEY) is None


@pytest.mark.parametrize("value", [[1.0], (1, 2), {1: 2.0}, True, {1.0}, Path("a")])
def test_what_could_not_be_read_again_is_not_kept(value: Any, tmp_path: Path) -> None:
    with pytest.raises(TypeError, match="is not kept"):
        Kept(tmp_path, Any).keep(KEY, value)
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_kept_by_code_that_was_edited_since_it_was_loaded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = Kept(tmp_path, float)
    place.keep(KEY, 1.0)
    monkeypatch.setattr(kept, "_digest_of_code", lambda: "edited")
    place.keep(KEY, 2.0)
    assert place.find(KEY) == 1.0


def half(number: int) -> float:
    if number == 13:
        raise ValueError("unlucky")
    return number / 2


def test_only_what_is_missing_is_played_and_all_of_it_is_kept_at_once(tmp_path: Path) -> None:
    place, heard = Kept(tmp_path, float), []

    def heard_half(number: int) -> float:
        heard.append(number)
        return half(number)

    def played(*tasks: int) -> list[float]:
        keys = [{"number": task} for task in tasks]
        return list(play_once(place, heard_half, tasks, keys, workers=1))

    with pytest.raises(ValueError, match="unlucky"):
        played(1, 2, 13, 4)
    assert played(4, 2, 1, 6) == [2.0, 1.0, 0.5, 3.0]
    assert heard == [1, 2, 13, 4, 6]
    assert played() == []


def test_weights_are_known_by_their_content(tmp_path: Path) -> None:
    for name, content in (("one", "a"), ("same", "a"), ("other", "b")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "driver.json").write_text("{}")
        (tmp_path / name / "driver.safetensors").write_text(content)
    one, same, other = (
        weights_key(str(tmp_path / name), "driver") for name in ("one", "same", "other")
    )
    assert one == same != other
    assert weights_key("trained:driver", "driver") != "trained:driver"
    assert weights_key("belief:average:0.214", "vehicle_ai") == "belief:average:0.214"
    with pytest.raises(ValueError, match="several files"):
        weights_key("mixture:rule,random", "driver")
    with pytest.raises(FileNotFoundError):
        weights_key(str(tmp_path / "none"), "driver")
