import stat
import time

import pytest
from starlette.requests import HTTPConnection
from starlette.responses import Response

from hmi_marl.people.web.cookies import DAYS, Cookies, check_signing_key, signing_key
from hmi_marl.people.web.settings import ServerSettings

_LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_"


def connection(cookie=None, scheme="http", **headers):
    pairs = [(name.replace("_", "-").encode(), value.encode()) for name, value in headers.items()]
    if cookie:
        pairs.append((b"cookie", cookie.encode()))
    return HTTPConnection(
        {"type": "http", "headers": pairs, "scheme": scheme, "server": ("h", 80), "path": "/"}
    )


def written(cookies, content, **about):
    response = Response()
    cookies.write(connection(**about), response, content)
    return response.headers["set-cookie"]


def test_the_key_is_made_once_for_its_owner_alone(tmp_path):
    key = signing_key(tmp_path / "people.db")
    assert signing_key(tmp_path / "people.db") == key
    assert signing_key(tmp_path / "other.db") != key
    assert stat.S_IMODE((tmp_path / "people.db.key").stat().st_mode) == 0o600
    assert {path.name for path in tmp_path.iterdir()} == {"people.db.key", "other.db.key"}


def test_a_file_without_a_key_is_refused(tmp_path):
    (tmp_path / "people.db.key").write_text("short")
    with pytest.raises(ValueError, match=r"people\.db\.key holds no key; remove it"):
        signing_key(tmp_path / "people.db")


def test_a_cookie_comes_back_and_one_made_up_does_not():
    cookies = Cookies("play", b"k" * 64, ServerSettings())
    line = written(cookies, {"session": "s"})
    assert "HttpOnly" in line
    assert "SameSite=lax" in line
    assert "Path=/;" in line
    assert "Secure" not in line
    value = line.partition(";")[0]
    assert cookies.read(connection(value)) == {"session": "s"}
    assert cookies.read(connection()) is None
    last = _LETTERS[_LETTERS.index(value[-1]) ^ 1]  # a bit that base64 does not use here
    for odd in (
        value[:-1] + last,
        value[:-2] + "xx",
        "play=rubbish",
        "play=",
        "play=é",
        value.replace("play", "x"),
    ):
        assert cookies.read(connection(odd)) is None
    for other in (
        Cookies("play", b"x" * 64, ServerSettings()),
        Cookies("study", b"k" * 64, ServerSettings()),
    ):
        assert other.read(connection(value.replace("play=", f"{other._name}="))) is None


def test_its_path_is_the_base_path_and_https_makes_it_secure():
    trusting = ServerSettings(base_path="/hmi/", trust_proxy=True)
    line = written(Cookies("play", b"k" * 64, trusting), 1, x_forwarded_proto="https")
    assert "Path=/hmi;" in line
    assert "Secure" in line
    doubting = Cookies("play", b"k" * 64, ServerSettings())
    assert "Secure" not in written(doubting, 1, x_forwarded_proto="https")
    assert "Secure" in written(doubting, 1, scheme="https")


def test_a_clock_that_is_put_back_voids_no_cookie_and_age_does(monkeypatch):
    cookies = Cookies("name", b"k" * 64, ServerSettings())
    now = time.time()
    for then, kept in ((now + 3600, {"a": 1}), (now - (DAYS + 1) * 86400, None)):
        with monkeypatch.context() as patched:
            patched.setattr(time, "time", lambda then=then: then)
            cookie = written(cookies, {"a": 1}).partition(";")[0]
        assert cookies.read(connection(cookie)) == kept


def test_a_bad_key_is_seen_before_anything_is_made(tmp_path):
    check_signing_key(tmp_path / "people.db")
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "people.db.key").write_text("short")
    with pytest.raises(ValueError, match=r"people\.db\.key holds no key"):
        check_signing_key(tmp_path / "people.db")
