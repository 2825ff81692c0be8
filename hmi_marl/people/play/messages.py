"""Messages between the page of a trip and the server, as JSON.

From the page:

- ``{"type": "decide", "step": 12, "action": 1, "away": 0}``: the decision for step 12, counted from
  0; ``away`` is d_t, and null in the vehicle AI's seat. It is sent again until a state with a
  higher step acknowledges it; the server takes it once.
- ``{"type": "found", "puzzle": 3, "number": 47}``: the answer to a number search.

From the server: ``hello`` with the road and the state when a connection begins, ``state`` after
every decision, ``puzzle`` after every number search, and ``error``.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, fields
from typing import Annotated, Any

from hmi_marl.checks import Checked, Whole, shown
from hmi_marl.people.play.puzzles import HIGHEST, LOWEST, POINTS, Puzzle
from hmi_marl.people.trip import Moment, Picture, Road
from hmi_marl.reading import parse_json


@dataclass(frozen=True)
class Decide(Checked):
    """Decision for a step.

    Raises:
        ValueError, TypeError: a value out of its range.
    """

    step: Annotated[int, Whole(0, 10**6)]
    action: Annotated[int, Whole(0, 100)]
    away: Annotated[int, Whole(0, 1)] | None


@dataclass(frozen=True)
class Found(Checked):
    """Answer to a number search.

    Raises:
        ValueError, TypeError: a value out of its range.
    """

    puzzle: Annotated[int, Whole(0, 10**6)]
    number: Annotated[int, Whole(LOWEST, HIGHEST)]


_KINDS: dict[str, type[Decide] | type[Found]] = {"decide": Decide, "found": Found}
_FIELDS = {name: {each.name for each in fields(kind)} for name, kind in _KINDS.items()}


def read_message(text: str) -> Decide | Found:
    """Return a message of a page.

    Raises:
        ValueError: it is none; the message says in one line what is wrong.
    """
    content = parse_json(text)
    if not isinstance(content, dict):
        raise ValueError(f"a message is a JSON object, not {shown(content)}")
    kind = content.pop("type", None)
    if not isinstance(kind, str) or kind not in _KINDS:
        raise ValueError(f"type is {' or '.join(_KINDS)}, not {shown(kind)}")
    if odd := _FIELDS[kind] ^ set(content):
        raise ValueError(f"{kind} has not exactly its fields: {shown(sorted(odd))}")
    try:
        return _KINDS[kind](**content)
    except TypeError as error:
        raise ValueError(str(error)) from None


def hello(
    road: Road, seat: str, choices: int, pace: float, puzzle: Puzzle | None, points: int
) -> dict[str, Any]:
    """Return what a page needs once, to which the state is added.

    Args:
        road: to draw.
        seat: of the person.
        choices: number of their actions.
        pace: time between decisions [s].
        puzzle: the number search to begin with; None in the vehicle AI's seat.
        points: won until now.
    """
    return {
        "type": "hello",
        "road": {
            "lanes": road.lanes,
            "width": road.lane_width,
            "length": road.length,
            "ramp": [[_short(x), _short(y)] for x, y in road.ramp],
            "car": [road.car_length, road.car_width],
        },
        "seat": seat,
        "choices": choices,
        "pace": pace,
        "puzzle": None if puzzle is None else puzzle_content(puzzle),
        "points": points,
    }


def state(picture: Picture) -> dict[str, Any]:
    """Return a trip's state; a step of N acknowledges the decisions for 0 to N - 1."""
    return {
        "type": "state",
        "step": picture.step,
        "steps": picture.steps,
        "moments": [moment_content(moment) for moment in picture.moments],
        "lane": picture.lane,
        "target": picture.target_speed,
        "score": round(picture.score, 2),
        "alert": picture.alert,
        "strength": picture.strength,
        "distracted": picture.distracted,
        "left": picture.alert_left,
        "intended": picture.intended,
        "applied": picture.applied,
        "crashed": picture.crashed,
        "over": picture.over,
    }


def moment_content(moment: Moment) -> dict[str, Any]:
    """Return all vehicles, in millimetres' accuracy."""
    return {
        "t": _short(moment.time),
        "x": [round(value, 3) for value in moment.x],
        "y": [round(value, 3) for value in moment.y],
        "h": [round(value, 3) for value in moment.heading],
        "v": [round(value, 3) for value in moment.speed],
        "c": [int(value) for value in moment.crashed],
    }


def puzzle_content(puzzle: Puzzle) -> dict[str, Any]:
    """Return a number search."""
    return {
        "puzzle": puzzle.index,
        "numbers": list(puzzle.numbers),
        "target": puzzle.target,
        "worth": POINTS,
    }


def error(reason: str) -> dict[str, Any]:
    """Return what was wrong with a message."""
    return {"type": "error", "reason": reason}


def written(content: dict[str, Any]) -> str:
    """Return a message as text."""
    return json.dumps(content, allow_nan=False, separators=(",", ":"))


def _short(number: float) -> float:
    return round(number, 3)
