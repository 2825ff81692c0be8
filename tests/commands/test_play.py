"""The command starts, is reached, ends at a signal, and says what was stored."""

import re
import signal
import subprocess
import sys
import urllib.request

import pytest

from hmi_marl.cli import main
from hmi_marl.people.store import Store

pytestmark = pytest.mark.usefixtures("unmeasured")


@pytest.mark.parametrize(
    "number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)]
)
def test_a_signal_ends_it_well(number, tmp_path):
    command = [sys.executable, "-m", "hmi_marl", "play", "--port", "0", "--duration", "1"]
    command += ["--seat", "driver", "--base-path", "/hmi", "--database", "people.db"]
    server = subprocess.Popen(
        command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        line = server.stdout.readline()
        address = re.fullmatch(
            r"open (http://127\.0\.0\.1:\d+/hmi/) in a browser; Ctrl-C ends the server\n", line
        )[1]
        form = b"way=free&seat=driver&partner=never"
        opener = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())
        page = opener.open(f"{address}begin", form).read().decode()
        assert 'data-trip="1"' in page
        server.send_signal(number)
        printed, errors = server.communicate(timeout=60)
    finally:
        server.kill()
    assert printed == (
        "stored in people.db: 1 visitors, 1 trips with 0 decisions; "
        "hmi-marl people export people.db\n"
    )
    assert errors == ""
    assert server.returncode == 0
    assert {path.name for path in tmp_path.iterdir()} == {"people.db", "people.db.key"}
    with Store(tmp_path / "people.db") as store:
        assert not store.trip(1).record.finished


def test_a_database_of_another_program_is_refused(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "notes.txt").write_text("mine")
    assert main(["play", "--database", "notes.txt", "--port", "0"]) == 2
    assert "notes.txt is damaged, or no database of hmi-marl" in capsys.readouterr().err
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_open_opens_the_browser(monkeypatch, tmp_path, capsys):
    import threading
    import webbrowser

    from hmi_marl.commands.play import Play

    opened, done = [], threading.Event()
    monkeypatch.setattr(webbrowser, "open", lambda url: (opened.append(url), done.set()))
    Play(open=True, host="0.0.0.0")._ready("http://127.0.0.1:1/")
    assert done.wait(10)
    assert opened == ["http://127.0.0.1:1/"]
    assert "reached from the whole network" in capsys.readouterr().out
