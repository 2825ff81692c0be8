"""Blocks of a report's first page: outcomes counted, and a card for each main result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

from hmi_marl.reporting.blocks import OUTCOME_CLASSES, Block, Figure
from hmi_marl.reporting.sources import Citation
from hmi_marl.reporting.verdicts import Outcome
from hmi_marl.text import in_html


@dataclass(frozen=True)
class Tally(Block):
    """Number of statements of each outcome."""

    counts: Mapping[Outcome, int]
    what: str
    """Name of the statements."""
    page: str
    """Address of the page that has them."""
    sources: Sequence[str] = ()
    kind: ClassVar = "tally"

    def as_text(self) -> str:
        """Render for a terminal."""
        counts = ", ".join(f"{count} {outcome}" for outcome, count in self.counts.items())
        return f"{sum(self.counts.values())} {self.what}: {counts}"

    def as_html(self) -> str:
        """Render for a page, outcomes coloured."""
        counts = "".join(
            f'<span><b class="{OUTCOME_CLASSES[outcome]}">{count}</b> {outcome}</span>'
            for outcome, count in self.counts.items()
        )
        all_of_them = f"{sum(self.counts.values())} {in_html(self.what)}"
        link = f'<a href="{in_html(self.page)}">{all_of_them}</a>'
        return f'<div class="tally"><span>{link}:</span>{counts}</div>'


@dataclass(frozen=True)
class Card:
    """One main result."""

    title: str
    value: str
    """Its number, with an interval."""
    sentence: str
    """Explanation of the number."""
    figure: Figure
    page: str
    """Address of the page with all of it."""
    cited: Citation
    sources: Sequence[str]
    """JSON pointers to the number, as :attr:`Block.sources`."""


@dataclass(frozen=True)
class Cards(Block):
    """Cards, each with a number, a sentence and a small figure, which lead to their pages."""

    cards: Sequence[Card]
    kind: ClassVar = "cards"

    def as_text(self) -> str:
        """Render for a terminal."""
        return "\n\n".join(
            f"{card.title}\n  {card.value}\n  {card.sentence}" for card in self.cards
        )

    def as_html(self) -> str:
        """Render for a page, three in a row where there is room."""
        return f'<div class="cards">{"".join(_card(card) for card in self.cards)}</div>'


def _card(card: Card) -> str:
    return (
        f'<section class="card"><h2><a href="{in_html(card.page)}">{in_html(card.title)}</a></h2>'
        f'{card.figure.picture()}<p class="value">{in_html(card.value)}</p>'
        f"<p>{in_html(card.sentence)}</p>{card.cited.as_html(card.sources)}</section>\n"
    )
