"""Visitors of hmi-marl play in tests: through starlette's client, and of a server of its own."""

import re

from starlette.testclient import TestClient

from hmi_marl.envs.config import TeamSettings
from hmi_marl.people.play.app import Play
from hmi_marl.people.play.settings import PlaySettings

KEY = b"k" * 64
SHORT = TeamSettings(duration=1.0, vehicles=(3, 3))


def settings(duration=1.0, **more):
    team = TeamSettings(duration=duration, vehicles=(3, 3))
    return PlaySettings(**({"team": team, "calibration_trips": 2} | more))


def service(store, server=None, limits=None, **more):
    return Play(store, KEY, settings(**more), server, limits)


def client(app):
    """A browser without a cookie; the server ends with the block."""
    return TestClient(app, "http://testserver", follow_redirects=True)


def another(browser):
    """Another browser of the same server."""
    found = client(browser.app)
    found.portal = browser.portal  # its event loop
    return found


def begin(browser, **form):
    """Begin a free trip, or the calibration, and return the page."""
    free = {"way": "free", "seat": "driver", "partner": "average"}
    return browser.post("/begin", data=free | form)


def trip_number(page):
    return int(re.search(r'data-trip="(\d+)"', page.text)[1])


class Wheel:
    """The connection of a trip's page."""

    def __init__(self, socket):
        self.socket = socket
        self.hello = self.next()
        assert self.hello["type"] == "hello", self.hello
        self.state = self.next()

    def next(self):
        return self.socket.receive_json()

    def decide(self, action=1, away=0, step=None):
        step = self.state["step"] if step is None else step
        self.socket.send_json({"type": "decide", "step": step, "action": action, "away": away})
        answer = self.next()
        if answer["type"] == "state":
            self.state = answer
        return answer

    def drive(self, away=lambda step: 0):
        while not self.state["over"]:
            self.decide(away=away(self.state["step"]))


def drive(browser, page=None, away=lambda step: int(step % 3 == 2)):
    """Drive the trip that is under way to its end; its number."""
    number = trip_number(page if page is not None else browser.get("/trip"))
    with browser.websocket_connect(f"/trip/socket?trip={number}") as socket:
        Wheel(socket).drive(away)
    return number
