"""What test_policy_files.py does not show: other formats, and how numbers are kept."""

import numpy as np
import pytest

from hmi_marl.agents.learned.cards import check_shapes, read_card, read_weights, write_card

FORM = "hmi-marl something 1"
WEIGHTS = {"wide": np.arange(6.0).reshape(2, 3).T, "one": np.array(1 / 3)}


def test_weights_come_back_in_single_precision_with_their_card(tmp_path):
    path = write_card(tmp_path / "deep" / "thing.json", FORM, {"size": [3, 2]}, WEIGHTS)
    card = read_card(path, FORM, "thing")
    assert card.pop("format") == FORM
    back = read_weights(path, card.pop("sha256"))
    assert card == {"size": [3, 2]}
    assert set(back) == set(WEIGHTS)
    for name, values in WEIGHTS.items():  # one of them lies the other way round in memory
        np.testing.assert_array_equal(back[name], values.astype(np.float32))
        assert back[name].dtype == np.float32
        assert back[name].shape == values.shape


def test_a_card_of_another_format_is_told_by_what_was_asked_for(tmp_path):
    path = write_card(tmp_path / "thing.json", FORM, {}, WEIGHTS)
    with pytest.raises(
        ValueError,
        match=r"thing\.json is not a trait model that can be read here: format 'hmi-marl so",
    ):
        read_card(path, "hmi-marl trait model 1", "trait model")
    with pytest.raises(FileNotFoundError):
        read_card(tmp_path / "nothing.json", FORM, "thing")


def test_shapes_are_checked_by_name():
    shapes = {"wide": (3, 2), "one": ()}
    check_shapes(shapes, WEIGHTS, "thing")
    with pytest.raises(ValueError, match="the weights do not fit the thing's card: other, wide"):
        check_shapes({"other": (1,), "one": ()}, WEIGHTS, "thing")
    with pytest.raises(ValueError, match=r"wide has shape \(3, 2\), but the card says \(2, 3\)"):
        check_shapes(shapes | {"wide": (2, 3)}, WEIGHTS, "thing")
    with pytest.raises(ValueError, match="one is not finite everywhere"):
        check_shapes(shapes, WEIGHTS | {"one": np.array(np.nan)}, "thing")
