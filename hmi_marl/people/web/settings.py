"""Settings of a web service. This module imports nothing that an extra brings."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Annotated

from hmi_marl.checks import Check, Checked, Real, Whole, shown

LOOPBACK = ("127.0.0.1", "::1", "localhost")
"""Hosts that only this machine reaches."""


def check_base_path(name: str, value: str) -> str:
    """Return a path such as /hmi, without a slash at its end; empty for the root.

    Raises:
        TypeError, ValueError: it is something else.
    """
    if not isinstance(value, str):
        raise TypeError(f"{name} is a path such as /hmi, not {shown(value)}")
    path = value.rstrip("/")
    if path and not re.fullmatch(r"(/[A-Za-z0-9_~-][A-Za-z0-9._~-]*)+", path):
        raise ValueError(f"{name} is a path such as /hmi, not {shown(value)}")
    return path


def check_host(name: str, value: str) -> str:
    """Return a host's name or address.

    Raises:
        TypeError, ValueError: it is something else.
    """
    if not isinstance(value, str):
        raise TypeError(f"{name} is a host's name or address, not {shown(value)}")
    if not re.fullmatch(r"[A-Za-z0-9._:-]{1,253}", value):
        raise ValueError(f"{name} is a host's name or address, not {shown(value)}")
    return value


@dataclass(frozen=True)
class ServerSettings(Checked):
    """Address of a web service, and what stands before it.

    Raises:
        ValueError, TypeError: a value out of its range; the message names it.
    """

    host: Annotated[str, Check(check_host)] = "127.0.0.1"
    """Host name or address to listen at. The default is reached from this machine alone; 0.0.0.0
    listens at every address."""
    port: Annotated[int, Whole(0, 65535)] = 8000
    """Port; 0 takes a free one."""
    base_path: Annotated[str, Check(check_base_path)] = ""
    """Path of all pages behind a reverse proxy, such as /hmi."""
    trust_proxy: bool = False
    """Whether a reverse proxy passes all requests on, so that X-Forwarded-For, -Proto and -Host
    are its own words."""

    def address(self, port: int) -> str:
        """Return the address of the first page, given the port that was taken."""
        host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(self.host, self.host)
        shown_host = f"[{host}]" if ":" in host else host
        return f"http://{shown_host}:{port}{self.base_path}/"


@dataclass(frozen=True)
class Limits(Checked):
    """Limits that keep one visitor from harming others.

    Raises:
        ValueError, TypeError: a value out of its range; the message names it.
    """

    max_visitors: Annotated[int, Whole(1, 10_000)] = 100
    """Visitors at once."""
    requests: Annotated[float, Real(0.1, 1e6, "1/s")] = 50.0
    """Requests per second from one address, of which 10 seconds' worth may come at once."""
    messages: Annotated[float, Real(0.1, 1e6, "1/s")] = 20.0
    """Messages per second of one connection, of which 3 seconds' worth may come at once."""
    message_size: Annotated[int, Whole(64, 1_000_000, "bytes")] = 4096
    """Largest message and form."""
