"""Options of ``train`` by name, and lists and ranges of their values as they are typed.

``NAME=VALUE,VALUE`` is a list, ``NAME=FROM..TO/COUNT`` a range with equal steps and
``NAME=FROM..TO/COUNT/log`` one with equal ratios, both ends included. Options of a group are named
as in ``ppo.learning_rate``; the parts of an option that takes several are joined by ``+``. A comma
before a digit is part of a text, as in ``homer,fast:0.1,0.5,0.01,1.5``. ``PROTOCOL:NAME=...`` is
for one protocol alone.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from hmi_marl.checks import Whole, check_choice
from hmi_marl.registry import unknown
from hmi_marl.training.protocols.registry import PROTOCOLS
from hmi_marl.training.protocols.settings import Budget, TrainSettings

STEPS, DRIVER_SHARE = "steps", "driver_share"
"""Options that every protocol has which shares out its steps, see :func:`make_settings`."""
DEFAULT_SHARE = 0.8
"""Share of the steps in which the driver learns."""
_OF_STAGES = ("driver_steps", "hmi_steps", "together_steps")
"""Settings that say how many steps each stage of a protocol takes."""
_NOT_SWEPT = {
    "seed": "seeds are set by --seed and --seeds",
    "threads": "a run of a sweep has one thread; see --workers",
}
_RANGE = re.compile(r"(?P<low>[^/]+?)\.\.(?P<high>[^/]+)/(?P<count>\d+)(?P<log>/log)?")
_COUNT = Whole(2, 1000)
_HINTS: Mapping[str, Any] = {STEPS: int, DRIVER_SHARE: float}


@dataclass(frozen=True)
class Swept:
    """An option with the values that it takes."""

    name: str
    values: tuple[Any, ...]
    protocol: str | None = None
    """The only protocol that it is for; None for all."""


def read_swept(text: str, protocols: Sequence[str]) -> Swept:
    """Read an option with its values.

    Args:
        text: see the module.
        protocols: registered names of the protocols that are swept.

    Raises:
        ValueError: no such option of these protocols, or values of another type; in one line.
    """
    typed, equals, values = text.partition("=")
    if not equals or not values:
        raise ValueError(
            f"an option is swept as in steps=1e6,2e6 or ppo.gamma=0.9..0.99/4, not {text!r}"
        )
    only, colon, name = typed.rpartition(":")
    name = name.replace("-", "_")
    if colon and only not in protocols:
        raise ValueError(unknown("protocol of this sweep", only, protocols, "hmi-marl sweep"))
    if name in _NOT_SWEPT:
        raise ValueError(f"cannot sweep {name}: {_NOT_SWEPT[name]}")
    named = [only] if colon else list(protocols)
    hints = {each: options_of(PROTOCOLS[each].value) for each in named}
    lacking = [each for each in named if name not in hints[each]]
    if lacking and len(lacking) < len(named):
        having = next(each for each in named if each not in lacking)
        raise ValueError(
            f"{lacking[0]} has no option {name}; {having}:{text} sweeps it for {having} alone"
        )
    if lacking:
        known, see = hints[lacking[0]], f"hmi-marl train {lacking[0]} --help"
        raise ValueError(unknown(f"option of {lacking[0]}", name, known, see))
    found = _values(name, hints[named[0]][name], values)
    for number, value in enumerate(found):
        if value in found[:number]:
            raise ValueError(f"{name} takes {written(value)} twice in {text!r}")
    return Swept(name, tuple(found), only or None)


def options_of(protocol: type[TrainSettings]) -> dict[str, Any]:
    """Return the types of a protocol's options by name, those of a group as GROUP.NAME."""
    found = dict(_options(protocol))
    shares = protocol.for_comparison.__func__ is not TrainSettings.for_comparison.__func__  # type: ignore[attr-defined]
    if STEPS not in found and shares:
        found |= _HINTS
    return {name: hint for name, hint in found.items() if name not in _NOT_SWEPT}


def _options(kind: type[Any], prefix: str = "") -> list[tuple[str, Any]]:
    hints = get_type_hints(kind, include_extras=True)
    found = []
    for field in fields(kind):
        hint = hints[field.name]
        if isinstance(hint, type) and is_dataclass(hint):
            found += _options(hint, f"{prefix}{field.name}.")
        else:
            found.append((prefix + field.name, hint))
    return found


def make_settings(protocol: str, options: Mapping[str, Any], seed: int) -> TrainSettings:
    """Make the settings of one run.

    Where a protocol has no ``steps`` of its own they are those of all its stages together, of which
    the driver learns in ``driver_share``, rounded to batches as ``compare`` does.

    Raises:
        TypeError, ValueError: a value out of its range, or options that exclude each other.
    """
    kind = PROTOCOLS[protocol].value
    given = dict(options)
    shared_out = STEPS in given and STEPS not in dict(_options(kind))
    if not shared_out and DRIVER_SHARE in given:
        raise ValueError(f"{DRIVER_SHARE} shares out {STEPS}; sweep these, too, or a single value")
    steps = given.pop(STEPS) if shared_out else 0
    share = given.pop(DRIVER_SHARE, DEFAULT_SHARE) if shared_out else DEFAULT_SHARE
    apart = [name for name in given if name in _OF_STAGES]
    if shared_out and apart:
        raise ValueError(f"{STEPS} and {apart[0]} exclude each other")
    own = _grouped(kind, given)
    settings = kind(seed=seed, **own)
    if not shared_out:
        return settings
    if getattr(settings, "driver_policy", None) is not None:
        raise ValueError(f"a driver_policy leaves no {STEPS} to share out; sweep hmi_steps")
    own.pop("rounds", None)  # part of the budget
    batch = settings.num_teams * settings.team(settings.drivers).horizon
    budget = Budget.shared_out(steps, share, batch, getattr(settings, "rounds", 1))
    return kind.for_comparison(budget, seed=seed, **own)


def _grouped(kind: type[TrainSettings], options: Mapping[str, Any]) -> dict[str, Any]:
    """Return options as arguments of a protocol, those of a group as its dataclass."""
    hints, arguments = get_type_hints(kind), dict[str, Any]()
    groups: dict[str, dict[str, Any]] = {}
    for name, value in options.items():
        group, dot, within = name.partition(".")
        if dot:
            groups.setdefault(group, {})[within] = value
        else:
            arguments[name] = value
    return arguments | {group: hints[group](**values) for group, values in groups.items()}


def written(value: Any) -> str:
    """Write a value as it is typed."""
    if isinstance(value, tuple):
        return "+".join(written(part) for part in value)
    if value is None or isinstance(value, bool):
        return str(value).lower()
    return f"{value:.12g}" if isinstance(value, float) else str(value)


def _values(name: str, hint: Any, text: str) -> list[Any]:
    ranged = _RANGE.fullmatch(text)
    if ranged and not _is_text(hint):
        return _spaced(name, hint, ranged)
    parts = re.split(r",(?![\d.])" if _is_text(hint) else ",", text)
    return [_value(name, hint, part) for part in parts]


def _spaced(name: str, hint: Any, ranged: re.Match[str]) -> list[Any]:
    low, high = (_number(name, ranged[end]) for end in ("low", "high"))
    count = _COUNT(f"the number of values of {name}", int(ranged["count"]))
    shares = [place / (count - 1) for place in range(count)]
    if ranged["log"]:
        if not (low > 0 and high > 0):
            raise ValueError(f"{name} has equal ratios only above 0, not from {low:g} to {high:g}")
        found = [low * (high / low) ** share for share in shares]
    else:
        found = [low + (high - low) * share for share in shares]
    found = [float(f"{value:.12g}") for value in found]  # ends as typed, and 0.1 where it is meant
    return [_value(name, hint, repr(value)) for value in found]


def _value(name: str, hint: Any, text: str) -> Any:
    """Read one value of a type; ranges are checked by the settings."""
    kind, parts = get_origin(hint), get_args(hint)
    if kind is Annotated:
        return _value(name, parts[0], text)
    if kind in (Union, UnionType):
        if NoneType in parts and text.lower() == "none":
            return None
        return _value(name, next(part for part in parts if part is not NoneType), text)
    if kind is Literal:
        return check_choice(name, text, parts)
    if kind is tuple:
        words = text.split("+")
        if parts[-1] is Ellipsis:
            return tuple(_value(f"each of {name}", parts[0], word) for word in words)
        if len(words) != len(parts):
            form = "+".join(["..."] * len(parts))
            raise ValueError(f"{name} takes {len(parts)} parts, {form}, not {text!r}")
        return tuple(_value(name, part, word) for part, word in zip(parts, words, strict=True))
    if hint is bool:
        return check_choice(name, text.lower(), ("true", "false")) == "true"
    if hint is int:
        number = _number(name, text)
        if number != int(number):
            raise ValueError(f"{name} is a whole number, not {text}")
        return int(number)
    if hint is float:
        return float(_number(name, text))
    if not text:
        raise ValueError(f"{name} has an empty value")
    return text


def _number(name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise ValueError(f"{name} is a number, not {text!r}") from None
    if not math.isfinite(value):
        raise ValueError(f"{name} is a finite number, not {text!r}")
    return value


def _is_text(hint: Any) -> bool:
    """Whether values of a type are free texts, or hold some."""
    return hint is str or any(_is_text(part) for part in get_args(hint) if part is not hint)
