"""Parts of the page of a trip: the road, numbers, and what is pressed."""

from __future__ import annotations

from hmi_marl.people.record import TripRecord
from hmi_marl.people.web.pages import Markup, Site, tag
from hmi_marl.people.web.texts import Texts


def stage(site: Site) -> Markup:
    """Return the road with what lies over it."""
    texts = site.texts
    return tag(
        "div",
        tag("canvas", id="road", role="img", aria_label=texts("trip.canvas")),
        tag("div", id="task", hidden=True, role="group", aria_label=texts("trip.task.title")),
        tag("div", id="banner", aria_hidden="true", hidden=True),
        tag(
            "div",
            tag("p", texts("trip.connecting"), id="message", aria_live="polite"),
            tag("button", texts("trip.start"), id="start", class_="primary", hidden=True),
            tag("a", texts("trip.on"), id="on", class_="button primary", hidden=True,
                href=site.url("/next")),
            id="cover",
        ),
        tag("p", id="alert-text", role="alert", class_="hidden-label"),
        tag("p", id="status", role="status", class_="hidden-label"),
        class_="stage",
    )  # fmt: skip


def facts(texts: Texts, driving: bool) -> Markup:
    """Return the numbers at the side of the road."""
    names = ["speed", "lane", "time", "score", *(["points"] if driving else [])]
    if not driving:
        names += ["eyes", "intent", "effect"]
    facts = [
        tag("div", tag("dt", texts(f"trip.fact.{name}")), tag("dd", "–", id=f"fact-{name}"))
        for name in names
    ]
    return tag("dl", *facts, class_="facts")


def driver_pad(texts: Texts) -> Markup:
    """Return what a person who drives presses."""
    buttons = [
        tag(
            "button",
            tag("span", arrow, aria_hidden="true"),
            tag("span", texts(f"trip.action.{action}")),
            type="button",
            data_action=number,
            class_=f"pad-{action}",
        )
        for action, number, arrow in (
            ("speed_up", 3, "▲"),
            ("move_left", 0, "◀"),
            ("move_right", 2, "▶"),
            ("slow_down", 4, "▼"),
        )
    ]
    task = tag(
        "button", texts("trip.task.open"), type="button", id="task-button",
        aria_expanded="false", aria_controls="task",
    )  # fmt: skip
    return tag(
        "div",
        tag("div", *buttons, class_="pad", role="group", aria_label=texts("trip.pad")),
        task,
        tag("p", texts("trip.keys.driver"), class_="note keys"),
    )


def alert_pad(texts: Texts, record: TripRecord) -> Markup:
    """Return what a person in the vehicle AI's seat presses."""
    strengths = record.config.alert_strengths
    buttons = [
        tag(
            "button",
            texts("trip.alert.give")
            if len(strengths) == 1
            else texts("trip.alert.strength", percent=f"{100 * strength:g}"),
            type="button",
            data_action=number,
            class_="primary alert-button",
        )
        for number, strength in enumerate(strengths, start=1)
    ]
    return tag("div", *buttons, tag("p", texts("trip.keys.vehicle_ai"), class_="note keys"))
