import pytest

from hmi_marl.people.play.messages import Decide, Found, read_message
from hmi_marl.people.play.puzzles import NUMBERS, puzzle


def test_messages_are_read():
    text = '{"type": "decide", "step": 3, "action": 1, "away": null}'
    assert read_message(text) == Decide(3, 1, None)
    assert read_message('{"number": 47, "puzzle": 0, "type": "found"}') == Found(0, 47)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "."),
        ("rubbish", "."),
        ("[" * 5000, "."),
        ("[]", "a message is a JSON object"),
        ("17", "a message is a JSON object"),
        ("{}", "type is decide or found, not None"),
        ('{"type": ["decide"]}', "type is decide or found"),
        ('{"type": "decide"}', r"exactly its fields: \['action', 'away', 'step'\]"),
        ('{"type": "decide", "step": 1, "action": 1, "away": 0, "x": 1}', r"fields: \['x'\]"),
        ('{"type": "decide", "step": -1, "action": 1, "away": 0}', "step lies in 0"),
        ('{"type": "decide", "step": true, "action": 1, "away": 0}', "step is a whole number"),
        ('{"type": "decide", "step": 1e999, "action": 1, "away": 0}', "."),
        ('{"type": "decide", "step": 1.5, "action": 1, "away": 0}', "step is a whole number"),
        ('{"type": "decide", "step": 1, "action": "1", "away": 0}', "action is a whole number"),
        ('{"type": "decide", "step": 1, "action": 1, "away": 2}', "away lies in 0 to 1"),
        ('{"type": "decide", "step": 1, "action": NaN, "away": 0}', "."),
        ('{"type": "found", "puzzle": 0, "number": 9}', "number lies in 10 to 99"),
    ],
)
def test_rubbish_is_refused_in_one_line(text, reason):
    with pytest.raises(ValueError, match=reason) as error:
        read_message(text)
    assert "\n" not in str(error.value)
    assert 0 < len(str(error.value)) < 300


def test_number_searches_have_one_right_number_and_follow_from_the_seed():
    one = puzzle(5, 0)
    assert one == puzzle(5, 0)
    assert len({puzzle(5, index).numbers for index in range(20)}) == 20
    assert puzzle(6, 0) != one
    for index in range(50):
        found = puzzle(2**63, index)
        assert len(set(found.numbers)) == NUMBERS
        assert found.numbers.count(found.target) == 1
        assert all(10 <= number <= 99 for number in found.numbers)
