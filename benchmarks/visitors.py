"""Load on hmi-marl play: scripted visitors who all drive at once, over WebSockets.

    python benchmarks/visitors.py --minutes 2

Starts a server in a process of its own, and N visitors in this one. Each drives trip after trip,
with a new key every 1/5 s by its own clock, and notes when the state that the key has led to comes
back. In the end every decision that was acknowledged is compared with the database, and every trip
is replayed to its last bit. Prints JSON: decisions, those lost or changed, percentiles of the time
from key to server state, and the server's processor time for each decision, start included.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import random
import re
import resource
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import urlencode, urlsplit

import numpy as np

PACE = 0.2
"""Time between decisions [s]."""


@dataclass
class Tally:
    """What visitors saw."""

    delays: list[float] = field(default_factory=list)
    """Time from key to state [s]."""
    acknowledged: dict[int, list[tuple[int, int]]] = field(default_factory=dict)
    """Action and d_t of each acknowledged decision, by trip."""
    finished: int = 0
    trouble: list[str] = field(default_factory=list)


class Web:
    """Requests of one visitor, who keeps their cookie."""

    def __init__(self, address: str) -> None:
        self.parts = urlsplit(address)
        self.cookie = ""

    async def ask(self, path: str, form: dict[str, str] | None = None) -> tuple[int, str]:
        """Return the status and the body."""
        reader, writer = await asyncio.open_connection(self.parts.hostname, self.parts.port)
        body = urlencode(form or {})
        lines = [
            f"{'GET' if form is None else 'POST'} {path} HTTP/1.1",
            f"Host: {self.parts.netloc}",
            "Connection: close",
        ]
        if self.cookie:
            lines.append(f"Cookie: {self.cookie}")
        if form is not None:
            lines += ["Content-Type: application/x-www-form-urlencoded"]
            lines += [f"Content-Length: {len(body)}"]
        writer.write(("\r\n".join(lines) + "\r\n\r\n" + body).encode())
        answer = (await reader.read()).decode("utf-8", "replace")
        writer.close()
        if found := re.search(r"set-cookie: ([^;]+)", answer, re.IGNORECASE):
            self.cookie = found[1]
        return int(answer.split()[1]), answer


async def visit(address: str, end: float, tally: Tally, seed: int) -> None:
    """Drive trip after trip until the time is over, then end the trip under way as it is."""
    rng, web = random.Random(seed), Web(address)
    await asyncio.sleep(rng.random() * 5)
    form = {"way": "free", "seat": "driver", "partner": "average"}
    status, _ = await web.ask("/begin", form)
    while time.monotonic() < end:
        if status != 303:
            tally.trouble.append(f"begin: {status}")
            return
        _, page = await web.ask("/trip")
        found = re.search(r'data-trip="(\d+)"', page)
        if found is None:
            tally.trouble.append(f"no trip: {page[:200]}")
            return
        await drive(web, int(found[1]), end, tally, rng)
        await asyncio.sleep(rng.random())
        status, _ = await web.ask("/trips", {})


async def drive(web: Web, trip: int, end: float, tally: Tally, rng: random.Random) -> None:
    """Drive one trip."""
    from websockets.asyncio.client import connect

    kept = tally.acknowledged.setdefault(trip, [])
    url = f"ws://{web.parts.netloc}/trip/socket?trip={trip}"
    async with connect(url, additional_headers={"Cookie": web.cookie}, compression=None) as socket:
        state = await next_state(socket)
        due = time.monotonic()
        while not state["over"] and time.monotonic() < end:
            due = max(due + PACE, time.monotonic())
            await asyncio.sleep(max(0.0, due - time.monotonic()))
            away = int(rng.random() < 0.2)
            action = rng.choice((1, 1, 1, 3, 4))
            decision = {"type": "decide", "step": state["step"], "action": action, "away": away}
            begun = time.monotonic()
            await socket.send(json.dumps(decision))
            state = await next_state(socket)
            tally.delays.append(time.monotonic() - begun)
            if state["step"] != decision["step"] + 1:
                tally.trouble.append(f"step {state['step']} after {decision['step']}")
            kept.append((action, away))
        tally.finished += state["over"]


async def next_state(socket) -> dict:
    """Wait for a state."""
    while True:
        message = json.loads(await asyncio.wait_for(socket.recv(), 30))
        if message["type"] == "state":
            return message
        if message["type"] == "error":
            raise RuntimeError(message["reason"])


async def crowd(address: str, visitors: int, minutes: float) -> Tally:
    """Let all visitors drive."""
    tally, end = Tally(), time.monotonic() + 60 * minutes
    tasks = [visit(address, end, tally, number) for number in range(visitors)]
    for outcome in await asyncio.gather(*tasks, return_exceptions=True):
        if isinstance(outcome, BaseException):
            tally.trouble.append(repr(outcome))
    return tally


def compare(database: Path, tally: Tally) -> dict[str, int]:
    """Compare what was acknowledged with what is stored, and replay every trip."""
    from hmi_marl.people.record import replay
    from hmi_marl.people.store import Store

    lost = other = replayed = stored = 0
    with Store(database, make=False) as store:
        for trip in store.trips():
            record = trip.record
            away = record.looking_away or ()
            kept = list(zip(record.intents, away, strict=True))
            stored += len(kept)
            sent = tally.acknowledged.get(trip.number, [])
            lost += max(0, len(sent) - len(kept))
            other += sum(one != two for one, two in zip(sent, kept, strict=False))
            replay(record)
            replayed += 1
    return {"stored": stored, "lost": lost, "changed": other, "trips_replayed": replayed}


def main() -> None:
    """Start, drive, compare and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--visitors", type=int, default=50)
    parser.add_argument("--minutes", type=float, default=2.0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        database = Path(folder) / "people.db"
        command = [sys.executable, "-m", "hmi_marl", "play", "--port", "0"]
        command += ["--database", str(database), "--max-visitors", str(options.visitors)]
        server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        try:
            address = re.search(r"http://\S+", server.stdout.readline())[0]
            tally = asyncio.run(crowd(address, options.visitors, options.minutes))
        finally:
            server.send_signal(signal.SIGINT)
            server.wait(30)
        found = compare(database, tally)
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    decisions = sum(map(len, tally.acknowledged.values()))
    delays = 1000 * np.array(tally.delays)
    report = {
        "visitors": options.visitors,
        "minutes": options.minutes,
        "decisions_acknowledged": decisions,
        **found,
        "in_flight_at_the_end": found["stored"] - decisions,
        "trips_finished": tally.finished,
        "key_to_state_ms": {
            str(share): round(float(np.percentile(delays, share)), 1) for share in (50, 95, 99, 100)
        },
        "server_ms_per_decision": round(1000 * (spent.ru_utime + spent.ru_stime) / decisions, 2),
        "trouble": tally.trouble[:5],
    }
    print(json.dumps(report, indent=2))


if __name__ == "__main__":
    main()
