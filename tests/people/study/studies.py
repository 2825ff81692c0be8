"""Small studies, without and with real clips, and raters who talk to a server."""

from __future__ import annotations

import http.client
import re
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import urlencode, urlsplit

from hmi_marl.envs.streams import episode_seed, team_seed
from hmi_marl.files import sha256_of, write_bytes, write_text
from hmi_marl.people.store import Store
from hmi_marl.people.study.app import StudyService
from hmi_marl.people.study.folder import (
    CLIPS,
    CONSENT,
    CheckClip,
    Study,
    StudyClip,
    write_manifest,
)
from hmi_marl.people.study.settings import RATINGS, StudySettings
from hmi_marl.people.study.visits import Visits
from hmi_marl.people.web.pages import Site
from hmi_marl.people.web.settings import Limits, ServerSettings
from hmi_marl.people.web.texts import Texts

GIF = (
    b"GIF89a\x01\x00\x01\x00\x80\x00\x00\x64\x64\x64\xff\xff\xff,\x00\x00\x00\x00\x01\x00\x01\x00"
    b"\x00\x02\x02D\x01\x00;"
)
SMALL = {"drivers": ("lisa", "bart"), "controls": (), "clips": 3, "shown": 2, "format": "gif"}


def a_study(folder: Path, **settings) -> Study:
    """A study folder whose clips show a point."""
    chosen = StudySettings(**(SMALL | settings))
    clips = []
    for place, condition in enumerate(chosen.conditions):
        for number in range(chosen.clips):
            name = f"{place:02x}{number:03x}.gif"
            path = folder / CLIPS / name
            write_bytes(path, GIF)
            seed = int(episode_seed(team_seed(chosen.seed, place), number))
            clips.append(StudyClip(name, condition.name, seed, 20.0, False, 0.5, sha256_of(path)))
    write_bytes(folder / CLIPS / "check.gif", GIF)
    check = CheckClip("check.gif", 6, sha256_of(folder / CLIPS / "check.gif"))
    text = "We ask you to rate <clips>.\n\nYou may stop."
    write_text(folder / CONSENT, text)
    study = Study(folder, chosen, chosen.intended, tuple(clips), check, text)
    write_manifest(study)
    return study


def a_service(study: Study, store: Store, most_raters: int = 1000, **settings) -> StudyService:
    """Its web service."""
    limits = {name: settings.pop(name) for name in ("max_visitors",) if name in settings}
    server = ServerSettings(**({"port": 0} | settings))
    site = Site(server, Texts("study"))
    return StudyService(Visits(study, store), site, b"k" * 64, Limits(**limits), most_raters)


@dataclass
class Rater:
    """A rater without a browser, who notes what the server has acknowledged."""

    address: str
    cookie: str = ""
    acknowledged: dict[str, dict[str, int]] = field(default_factory=dict)
    """Ratings by page."""

    def ask(self, path: str = "", form: dict[str, str] | None = None) -> tuple[int, str]:
        """Status and content of a page."""
        parts = urlsplit(self.address)
        connection = http.client.HTTPConnection(parts.hostname, parts.port, timeout=30)
        headers = {"Cookie": self.cookie} if self.cookie else {}
        try:
            if form is None:
                connection.request("GET", parts.path + path, headers=headers)
            else:
                headers["Content-Type"] = "application/x-www-form-urlencoded"
                connection.request("POST", parts.path + path, urlencode(form), headers)
            answer = connection.getresponse()
            content = answer.read().decode("utf-8", "replace")
            for line in answer.msg.get_all("Set-Cookie") or []:
                self.cookie = line.partition(";")[0]
            return answer.status, content
        finally:
            connection.close()

    def consent(self) -> None:
        """Begin, and read the instructions."""
        assert self.ask("consent", {"agree": "yes"})[0] == 303
        assert self.ask("answer", {"page": "instructions"})[0] == 303

    def due(self) -> str | None:
        """Page that is due; None at the end."""
        found = re.search(r'name="page" value="([\w.]+)"', self.ask()[1])
        return found[1] if found else None

    def rate(self, page: str, number: int) -> None:
        """Send ratings that follow from the page and a number."""
        value = {name: 1 + (hash((page, name)) + number) % 7 for name in RATINGS}
        status, _ = self.ask("answer", {"page": page} | {n: str(v) for n, v in value.items()})
        assert status == 303
        self.acknowledged.setdefault(page, value)

    def go_on(self, number: int) -> bool:
        """Rate the clip that is due; False at the end."""
        page = self.due()
        if page is not None:
            self.rate(page, number)
        return page is not None
