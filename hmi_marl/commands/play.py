"""``hmi-marl play``."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from hmi_marl.envs.config import TeamSettings
from hmi_marl.people.play.settings import PlaySettings
from hmi_marl.people.record import SEATS, Seat
from hmi_marl.people.web.settings import Limits, ServerSettings

_PLAY, _SERVER, _LIMITS = PlaySettings(), ServerSettings(), Limits()


@dataclass(frozen=True)
class Play:
    """Drive with an HMI, or be one, in the browser.

    Starts a server and prints the address to open. A visitor takes either seat with any policy in
    the other; or drives a calibration, from which their traits are measured, and then with the HMI
    that is best for them, that for the average driver, and none, in blinded order. Every decision
    is kept in a database; hmi-marl people exports, measures and deletes. Ctrl-C ends it.

    Example: hmi-marl play --open

    Behind a reverse proxy: hmi-marl play --port 8000 --base-path /hmi --trust-proxy
    """

    team: tyro.conf.OmitArgPrefixes[TeamSettings] = field(default_factory=TeamSettings)
    """Settings of the teams."""
    database: Path = Path("people.db")
    """Database, which is made if there is none. The key of the cookies lies next to it, in
    people.db.key."""
    host: str = _SERVER.host
    """Address to listen at. The default is reached from this machine alone; 0.0.0.0 opens the
    server to the network."""
    port: int = _SERVER.port
    """Port; 0 takes a free one."""
    base_path: str = _SERVER.base_path
    """Path of all pages behind a reverse proxy, such as /hmi."""
    trust_proxy: bool = _SERVER.trust_proxy
    """Believe X-Forwarded-For, -Proto and -Host, which a reverse proxy sets."""
    seat: Annotated[tuple[Seat, ...], tyro.conf.arg(metavar="{driver,vehicle_ai} ...")] = SEATS
    """Seats that visitors can choose. Without driver there is no calibration."""
    hmis: tuple[str, ...] = _PLAY.hmis
    """HMIs that visitors who drive can choose as their partner: names that hmi-marl --help lists,
    or folders of training runs."""
    driver_policies: tuple[str, ...] = _PLAY.driver_policies
    """Driver policies that visitors in the vehicle AI's seat can choose as their partner."""
    drivers: tuple[str, ...] = _PLAY.drivers
    """Drivers that these visitors can choose, whose traits draw the attention."""
    trips: int = _PLAY.calibration_trips
    """Trips of a calibration."""
    trial_trips: int = _PLAY.trial_trips
    """Trips with each of the three HMIs after it."""
    seed: int = _PLAY.seed
    """Seed of the traffic and of the orders of HMIs."""
    max_visitors: int = _LIMITS.max_visitors
    """Visitors on a trip at once."""
    open: bool = False
    """Also open the page in this machine's browser."""

    def run(self, command_line: str) -> None:
        """Check, serve until a signal, and say what was stored."""
        settings = PlaySettings(
            self.team, self.seat, self.hmis, self.driver_policies, self.drivers,
            self.trips, self.trial_trips, self.seed,
        )  # fmt: skip
        server = ServerSettings(self.host, self.port, self.base_path, self.trust_proxy)
        limits = Limits(max_visitors=self.max_visitors)
        settings.check()
        self._serve(settings, server, limits)

    def _serve(self, settings: PlaySettings, server: ServerSettings, limits: Limits) -> None:
        from hmi_marl.people.play.app import Play as Service
        from hmi_marl.people.play.warm import warm
        from hmi_marl.people.store import Store
        from hmi_marl.people.web.cookies import check_signing_key, signing_key
        from hmi_marl.people.web.server import listening, serve

        check_signing_key(self.database)
        listening(server).close()  # an address in use is said before the database is made
        warm(settings)
        with Store(self.database) as store:
            service = Service(store, signing_key(self.database), settings, server, limits)
            serve(service.app(), server, self._ready)
            stored = store.counts()
        print(
            f"stored in {self.database}: {stored['visitors']} visitors, {stored['trips']} "
            f"trips with {stored['decisions']} decisions; hmi-marl people export {self.database}"
        )

    def _ready(self, address: str) -> None:
        print(f"open {address} in a browser; Ctrl-C ends the server", flush=True)
        if self.host in ("0.0.0.0", "::"):
            print("this server is reached from the whole network", flush=True)
        if self.open:
            import threading
            import webbrowser

            threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()
