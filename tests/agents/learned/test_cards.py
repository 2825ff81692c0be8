"""Cards of any format; test_policy_files.py tests those of policies."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from hmi_marl.agents.learned.cards import CardFormat, find_card

WEIGHTS = {"wide": np.arange(6.0).reshape(2, 3).T, "one": np.array(1 / 3)}


@dataclass(frozen=True)
class Thing:
    size: list[int] = field(default_factory=lambda: [3, 2])
    note: str = ""
    flag: bool = False

    @property
    def shapes(self):
        return {"wide": tuple(self.size), "one": ()}


THINGS = CardFormat("hmi-marl something 1", "thing", Thing)


def test_weights_come_back_in_single_precision_with_their_card(tmp_path):
    path = THINGS.save(tmp_path / "deep" / "thing.json", Thing(), WEIGHTS)
    card, back = THINGS.read(path)
    assert card == Thing([3, 2])
    assert set(back) == set(WEIGHTS)
    for name, values in WEIGHTS.items():  # one of them lies the other way round in memory
        np.testing.assert_array_equal(back[name], values.astype(np.float32))
        assert back[name].dtype == np.float32
        assert back[name].shape == values.shape


def test_a_card_of_another_format_is_refused(tmp_path):
    path = THINGS.save(tmp_path / "thing.json", Thing(), WEIGHTS)
    other = CardFormat("hmi-marl trait model 1", "trait model", Thing)
    with pytest.raises(
        ValueError,
        match=r"thing\.json is no trait model that can be read here: format 'hmi-marl so",
    ):
        other.read(path)
    with pytest.raises(FileNotFoundError):
        THINGS.read(tmp_path / "nothing.json")


def test_a_card_is_found_by_folder_card_or_weights(tmp_path):
    path = THINGS.save(tmp_path / "thing.json", Thing(), WEIGHTS)
    for place in (tmp_path, str(path), path.with_suffix(".safetensors")):
        assert find_card(place, "thing", "thing") == path
    with pytest.raises(FileNotFoundError, match=r"no thing at .*; make one$"):
        find_card(tmp_path / "nowhere", "thing", "thing", "; make one")


def test_shapes_are_checked_by_name():
    THINGS.check(Thing(), WEIGHTS)
    with pytest.raises(ValueError, match="the weights do not fit the thing's card: other, wide"):
        THINGS.check(Thing(), {"other": np.zeros(1), "one": WEIGHTS["one"]})
    with pytest.raises(ValueError, match=r"wide has shape \(3, 2\), but the card says \(2, 3\)"):
        THINGS.check(Thing([2, 3]), WEIGHTS)
    with pytest.raises(ValueError, match="one is not finite everywhere"):
        THINGS.check(Thing(), WEIGHTS | {"one": np.array(np.nan)})


def test_every_byte_of_a_card_and_of_its_weights_is_checked(tmp_path):
    """A flipped bit in it is refused, or reads as the same content: another kind of space."""
    path = THINGS.save(tmp_path / "thing.json", Thing(note="as it was", flag=True), WEIGHTS)
    card, weights = THINGS.read(path)
    for file in (path, path.with_suffix(".safetensors")):
        content, refused = file.read_bytes(), 0
        for at in range(len(content)):
            changed = bytearray(content)
            changed[at] ^= 1 << at % 8
            file.write_bytes(changed)
            try:
                found, numbers = THINGS.read(path)
            except ValueError:
                refused += 1
            else:
                assert found == card, (file.name, at)
                assert all((numbers[name] == weights[name]).all() for name in WEIGHTS)
        assert refused > 0.9 * len(content)
        file.write_bytes(content)


def test_a_card_that_was_changed_by_hand_says_what_to_do(tmp_path):
    path = THINGS.save(tmp_path / "thing.json", Thing(flag=True), WEIGHTS)
    path.write_text(path.read_text().replace('"flag": true', '"flag": false'))
    expected = r"thing\.json is a damaged thing card: its checksum differs; copy it again from"
    with pytest.raises(ValueError, match=expected):
        THINGS.read(path)
