"""A rater's visit: which page comes next, by what has been answered alone.

Nothing of a visit is in the server's memory. The order follows from the rater's number, and the
page that is due is the first one without an answer in the database: a reload, the back button,
another server process or a kill change nothing, and an answer that is sent twice is kept once.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from hmi_marl.people.store import Store, Visitor
from hmi_marl.people.study.folder import Study
from hmi_marl.people.study.order import CHECK, order
from hmi_marl.people.study.ratings import question_of
from hmi_marl.people.study.settings import POINTS, RATINGS

KIND = "study"
"""Kind of sessions in the database."""
INSTRUCTIONS = "instructions"
PANEL_IDS = ("PROLIFIC_PID", "STUDY_ID", "SESSION_ID")
"""Names of a panel's ids in the address of the first page."""
_ID = re.compile(r"[A-Za-z0-9_-]{1,64}")


@dataclass(frozen=True)
class Visit:
    """A rater's session in the database."""

    session: str
    visitor: int
    pages: tuple[str, ...]
    """Instructions, then clips by their names, the attention check among them."""
    answered: frozenset[str]

    @property
    def due(self) -> str | None:
        """Page that is due; None at the end."""
        return next((page for page in self.pages if page not in self.answered), None)

    @property
    def clips(self) -> int:
        """Number of clips, the attention check included."""
        return len(self.pages) - 1

    @property
    def done(self) -> int:
        """Number of clips answered."""
        return len(self.answered - {INSTRUCTIONS})


class Visits:
    """Visits of a study in a database."""

    def __init__(self, study: Study, store: Store) -> None:
        self.study, self._store = study, store

    def begin(self, ids: Mapping[str, str]) -> tuple[Visitor, str]:
        """Note a rater who has consented, and return them with the id of their session.

        Args:
            ids: of a panel; kept where the study asks for them.
        """
        kept = {name: ids[name] for name in PANEL_IDS if _ID.fullmatch(ids.get(name, ""))}
        state: dict[str, Any] = {"study": self.study.id}
        if self.study.settings.keep_ids:
            state["ids"] = kept
        visitor = self._store.new_visitor()
        return visitor, self._store.new_session(visitor.number, KIND, state)

    def raters(self) -> int:
        """Return the number of raters who have consented to this study."""
        return sum(self._is_own(session) for session in self._store.sessions())

    def find(self, session: Any) -> Visit | None:
        """Return a visit by the id of its session; None if there is none of this study."""
        found = self._store.session(session) if isinstance(session, str) else None
        if found is None or not self._is_own(found):
            return None
        pages = self.pages(found.visitor)
        names = {question_of(self.study.id, page): page for page in pages}
        answered = {
            names[answer.question]
            for answer in self._store.answers(session=found.id)
            if answer.question in names
        }
        return Visit(found.id, found.visitor, pages, frozenset(answered))

    def pages(self, visitor: int) -> tuple[str, ...]:
        """Return the pages of a rater by their number in the database."""
        settings = self.study.settings
        places = order(
            visitor - 1, len(settings.conditions), settings.clips, settings.shown, settings.seed
        )
        clips = self.study.clips
        return (
            INSTRUCTIONS,
            *(
                self.study.check.name
                if place == CHECK
                else clips[place.condition * settings.clips + place.clip].name
                for place in places
            ),
        )

    def answer(self, visit: Visit, page: str, form: Mapping[str, str]) -> tuple[str, ...]:
        """Keep the answer to the page that is due; the first answer to a page stays.

        Returns:
            What is missing or wrong in the form, in which case nothing is kept.

        Raises:
            ValueError: the page is not the rater's, or not due yet.
        """
        if page not in visit.pages:
            raise ValueError("this page is not one of yours")
        if page in visit.answered:
            return ()
        if page != visit.due:
            raise ValueError("this page is not due yet")
        question = question_of(self.study.id, page)
        if page == INSTRUCTIONS:
            self._store.answer(visit.session, question, True)
            return ()
        points = [str(point) for point in range(1, POINTS + 1)]
        wrong = tuple(name for name in RATINGS if form.get(name) not in points)
        if not wrong:
            value = {name: int(form[name]) for name in RATINGS}
            self._store.answer(visit.session, question, value)
        return wrong

    def delete(self, code: str) -> bool:
        """Delete everything of the person with a code; False if there is none."""
        if self._store.find_visitor(code) is None:
            return False
        self._store.delete_visitor(code)
        return True

    def _is_own(self, session: Any) -> bool:
        state = session.state
        return (
            session.kind == KIND and isinstance(state, dict) and state.get("study") == self.study.id
        )
