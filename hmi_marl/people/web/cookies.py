"""Signed cookies: a visitor can read their own, but cannot make up another."""

from __future__ import annotations

import hmac
import os
import secrets
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from itsdangerous import BadData, URLSafeTimedSerializer
from starlette.requests import HTTPConnection
from starlette.responses import Response

from hmi_marl.people.web.limits import is_secure
from hmi_marl.people.web.settings import ServerSettings
from hmi_marl.reading import opened

DAYS = 60
"""Days for which a cookie is good."""
_BYTES = 32


def signing_key(database: Path) -> bytes:
    """Return the key in the file NAME.key next to a database NAME, which is made once.

    Its owner alone can read it. Without it, or with another, all cookies become void.

    Raises:
        ValueError: the file holds no key.
        OSError: it cannot be read or made.
    """
    path = _key_path(database)
    if not path.exists():
        part = path.with_name(f".{path.name}-{secrets.token_hex(6)}")
        file = os.open(part, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600)
        try:
            os.write(file, secrets.token_hex(_BYTES).encode())
            os.fsync(file)
            os.close(file)
            with suppress(FileExistsError):  # another server was faster, and its key counts
                os.link(part, path)
        finally:
            part.unlink()
    return _read_key(path)


def check_signing_key(database: Path) -> None:
    """Check the key of a database if there is one, before anything is made.

    Raises:
        ValueError, OSError: see :func:`signing_key`.
    """
    path = _key_path(database)
    if path.exists():
        _read_key(path)


def _key_path(database: Path) -> Path:
    return database.with_name(f"{database.name}.key")


def _read_key(path: Path) -> bytes:
    with opened(path) as stream:
        key: bytes = stream.read(1000)
    if len(key) < 2 * _BYTES:
        raise ValueError(f"{path} holds no key; remove it, and a new one is made")
    return key


class Cookies:
    """One signed cookie of a service.

    Args:
        name: of the cookie, such as hmi-marl-play.
        key: see :func:`signing_key`.
        settings: of the server.
    """

    def __init__(self, name: str, key: bytes, settings: ServerSettings) -> None:
        self._name, self._settings = name, settings
        self._serializer = URLSafeTimedSerializer(key, salt=name)

    def read(self, connection: HTTPConnection) -> Any:
        """Return the JSON content of the cookie; None without one that is signed and in time."""
        value = connection.cookies.get(self._name)
        if value is None:
            return None
        try:
            content, signed = self._serializer.loads(value, return_timestamp=True)
            if not self._as_written(value):
                return None
        except (BadData, ValueError):
            return None
        # one from the future is good too: the server's clock may have been put back
        return content if datetime.now(UTC) - signed <= timedelta(days=DAYS) else None

    def _as_written(self, value: str) -> bool:
        """Whether the signature is letter by letter ours; several texts are the same in base64."""
        content, _, signature = value.rpartition(".")
        signer = self._serializer.make_signer(self._serializer.salt)
        return hmac.compare_digest(signer.get_signature(content), signature.encode())

    def write(self, connection: HTTPConnection, response: Response, content: Any) -> None:
        """Have a response set the cookie to JSON content."""
        value = str(self._serializer.dumps(content))
        response.set_cookie(
            self._name,
            value,
            max_age=DAYS * 24 * 3600,
            path=self._path,
            httponly=True,
            samesite="lax",
            secure=is_secure(connection, self._settings.trust_proxy),
        )

    def clear(self, response: Response) -> None:
        """Have a response remove the cookie."""
        response.delete_cookie(self._name, path=self._path)

    @property
    def _path(self) -> str:
        return self._settings.base_path or "/"
