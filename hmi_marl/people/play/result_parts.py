"""Tables of the result: measured traits, HMIs of the trial, and the belief."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hmi_marl.envs.drivers import DRIVERS, PAPER_DRIVERS
from hmi_marl.people.web.pages import Content, Markup, tag
from hmi_marl.people.web.texts import Texts

_SYMBOLS = {"beta": "β", "alpha": "α", "eta": "η"}
_WIDTH, _HEIGHT = 200, 22
"""Size of an interval's picture."""


def traits_table(person: Mapping[str, Any], texts: Texts) -> Markup:
    """Show β, α and η with their 95 % intervals, with those of the four drivers."""
    rows: list[Content] = []
    for trait, symbol in _SYMBOLS.items():
        found = person["estimates"][trait]
        mean, low, high = (float(found[name]) for name in ("mean", "low", "high"))
        rows.append(
            tag(
                "tr",
                tag("th", f"{symbol} – {texts(f'traits.{trait}')}", scope="row"),
                tag("td", f"{mean:.2f}", class_="number"),
                tag("td", f"{low:.2f} – {high:.2f}", class_="number"),
                tag("td", _interval(trait, mean, low, high, texts)),
            )
        )
    head = [texts(f"traits.head.{each}") for each in ("trait", "value", "interval", "picture")]
    return tag(
        "section",
        tag("h2", texts("traits.title")),
        tag("p", texts("traits.about", trips=person["trips"], minutes=f"{person['minutes']:.1f}")),
        _table(head, rows, {1, 2}),
        tag("p", texts("traits.legend"), class_="note"),
    )


def _interval(trait: str, mean: float, low: float, high: float, texts: Texts) -> Markup:
    """Draw an interval within [0, 1], and a line for each of the four drivers."""
    middle = _HEIGHT / 2
    marks = [
        tag("line", x1=_place(value), x2=_place(value), y1=3, y2=_HEIGHT - 3, class_="other")
        for value in (float(getattr(DRIVERS[name], trait)) for name in PAPER_DRIVERS)
    ]
    words = texts("traits.picture", value=f"{mean:.2f}", low=f"{low:.2f}", high=f"{high:.2f}")
    return tag(
        "svg",
        tag("line", x1=_place(0), x2=_place(1), y1=middle, y2=middle, class_="axis"),
        *marks,
        tag("line", x1=_place(low), x2=_place(high), y1=middle, y2=middle, class_="span"),
        tag("circle", cx=_place(mean), cy=middle, r=5, class_="mean"),
        viewBox=f"0 0 {_WIDTH} {_HEIGHT}",
        width=_WIDTH,
        height=_HEIGHT,
        role="img",
        aria_label=words,
        class_="interval",
    )


def _place(value: float) -> float:
    return round(6 + (_WIDTH - 12) * value, 1)


def order_table(
    hmis: Mapping[str, Sequence[Mapping[str, Any]]], order: Sequence[str], texts: Texts
) -> Markup:
    """Show what the visitor did with each HMI, in the order in which they met them."""
    rows = []
    for hmi in order:
        trips = hmis[hmi]
        mean = {
            name: float(np.mean([trip[name] for trip in trips]))
            for name in ("score", "attention", "away", "alerts")
        }
        crashes = sum(trip["crashed"] for trip in trips)
        rows.append(
            tag(
                "tr",
                tag("th", texts(f"hmi.{hmi}"), scope="row"),
                tag("td", f"{mean['attention']:.0f}", class_="number"),
                tag("td", f"{100 * mean['away']:.0f} %", class_="number"),
                tag("td", f"{mean['alerts']:.0f}", class_="number"),
                tag("td", f"{mean['score']:.0f}", class_="number"),
                tag("td", f"{crashes} / {len(trips)}", class_="number"),
            )
        )
    columns = ("hmi", "attention", "away", "alerts", "score", "crashes")
    head = [texts(f"order.head.{each}") for each in columns]
    return tag(
        "section",
        tag("h2", texts("order.title")),
        tag("p", texts("order.about")),
        _table(head, rows, set(range(1, len(head)))),
    )


def belief_table(belief: Mapping[str, float], texts: Texts) -> Markup:
    """Show what an HMI that only watched believes."""
    rows = [
        tag(
            "tr",
            tag("th", name.capitalize(), scope="row"),
            tag("td", f"{100 * p:.0f} %", class_="number"),
            tag("td", tag("meter", f"{100 * p:.0f} %", value=round(p, 4), min=0, max=1)),
        )
        for name, p in belief.items()
    ]
    head = [texts(f"belief.head.{each}") for each in ("driver", "probability", "bar")]
    return tag(
        "section",
        tag("h2", texts("belief.title")),
        tag("p", texts("belief.about")),
        _table(head, rows, {1}),
    )


def _table(head: Sequence[str], rows: Sequence[Content], numbers: set[int]) -> Markup:
    cells = [
        tag("th", title, scope="col", class_="number" if place in numbers else None)
        for place, title in enumerate(head)
    ]
    whole = tag("table", tag("thead", tag("tr", *cells)), tag("tbody", *rows))
    return tag("div", whole, class_="scroll", tabindex=0, role="region", aria_label=head[0])
