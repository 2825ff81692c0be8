"""A server that is killed at a random moment has lost nothing that it acknowledged."""

import json
import math
import random
import re
import subprocess
import sys
import time
from urllib.parse import urlencode
from urllib.request import HTTPCookieProcessor, build_opener

import pytest
from websockets.sync.client import connect

from hmi_marl.people.record import replay
from hmi_marl.people.store import Store

pytestmark = pytest.mark.usefixtures("unmeasured")


class Server:
    """hmi-marl play in a process of its own."""

    def __init__(self, folder):
        command = [sys.executable, "-m", "hmi_marl", "play", "--port", "0", "--duration", "60"]
        command += ["--no-end-at-crash", "--seat", "driver"]
        command += ["--database", str(folder / "people.db")]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        self.address = re.search(r"http://\S+/", self.process.stdout.readline())[0]

    def kill(self):
        self.process.kill()
        self.process.wait()
        self.process.stdout.close()


def begun(server):
    """A visitor's cookie, and the number of their trip."""
    opener = build_opener(HTTPCookieProcessor())
    form = urlencode({"way": "free", "seat": "driver", "partner": "random:0.2"}).encode()
    page = opener.open(f"{server.address}begin", form).read().decode()
    (jar,) = (each.cookiejar for each in opener.handlers if isinstance(each, HTTPCookieProcessor))
    return "; ".join(f"{each.name}={each.value}" for each in jar), re.search(
        r'data-trip="(\d+)"', page
    )[1]


def drive(server, cookie, number, rng, sent, seconds, enough=math.inf):
    """Decide for so long, or until so many steps are acknowledged; then the server is killed.

    Returns the step that was found, and that acknowledged last.
    """
    address = f"{server.address.replace('http', 'ws')}trip/socket?trip={number}"
    killing = time.monotonic() + seconds
    with connect(address, additional_headers={"Cookie": cookie}) as socket:
        assert json.loads(socket.recv())["type"] == "hello"
        state = json.loads(socket.recv())
        found = state["step"]
        while time.monotonic() < killing and not state["over"] and state["step"] < found + enough:
            step = state["step"]
            if step not in sent:
                sent[step] = rng.choice((1, 3, 4)), int(rng.random() < 0.3)
            action, away = sent[step]
            socket.send(
                json.dumps({"type": "decide", "step": step, "action": action, "away": away})
            )
            if time.monotonic() + 0.2 > killing:
                time.sleep(rng.random() * 0.2)  # at any moment of a decision
                break
            state = json.loads(socket.recv())
        server.kill()
    return found, state["step"]


def killed(folder, times):
    """Kill a server so many times within one trip; afterwards drive on."""
    rng, sent, acknowledged = random.Random(times), {}, 0
    server = Server(folder)
    try:
        cookie, number = begun(server)
        for _ in range(times):
            found, step = drive(server, cookie, number, rng, sent, 0.3 + rng.random())
            assert acknowledged <= found <= acknowledged + 1
            acknowledged = step
            with Store(folder / "people.db") as store:
                record = store.trip(int(number)).record
                assert acknowledged <= len(record) <= acknowledged + 1
                kept = zip(record.intents, record.looking_away, strict=True)
                assert list(kept) == [sent[place] for place in range(len(record))]
                replay(record)
            server = Server(folder)
        found, step = drive(server, cookie, number, rng, sent, 20.0, enough=2)
        assert acknowledged <= found < step
    finally:
        server.kill()


@pytest.mark.slow
def test_a_kill_in_mid_trip_loses_nothing_that_was_acknowledged(tmp_path):
    killed(tmp_path, 1)


@pytest.mark.slow
def test_twenty_kills_lose_nothing(tmp_path):
    killed(tmp_path, 20)
