from concurrent.futures import ThreadPoolExecutor
from itertools import count

from hmi_marl.people.web import once
from hmi_marl.people.web.once import Once


def test_a_form_sent_by_many_at_once_makes_one_thing():
    made, numbers = Once(), count()
    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(lambda _: made.make("token", lambda: next(numbers)), range(50)))
    assert set(found) == {0}
    assert made.make("other", lambda: next(numbers)) == 1
    assert [made.make("", lambda: next(numbers)) for _ in range(2)] == [2, 3]


def test_what_is_gone_is_made_anew_and_old_tokens_are_forgotten(monkeypatch):
    monkeypatch.setattr(once, "_KNOWN", 2)
    made, numbers = Once(), count()
    assert made.make("a", lambda: next(numbers)) == 0
    made.forget(0)
    assert [made.make(token, lambda: next(numbers)) for token in "abcb"] == [1, 2, 3, 2]
    assert made.make("a", lambda: next(numbers)) == 4


def test_tokens_differ():
    assert len({Once.token() for _ in range(100)}) == 100
