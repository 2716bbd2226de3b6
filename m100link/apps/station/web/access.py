"""The token, and what stands for it in a browser: a cookie, and codes that work once."""

from __future__ import annotations

import hashlib
import hmac
import secrets
import time
from collections.abc import Callable

__all__ = ["CODE_LIFETIME", "COOKIE", "Access"]

COOKIE = "m100link_token"
"""The cookie that stands for the token in a browser; under TLS it begins with ``__Host-``."""

CODE_LIFETIME = 600.0
"""Seconds in which a code has to be used."""

_MAX_CODES = 16


class Access:
    """What clients may show to get in.

    A program shows the token. A browser is sent to an address with a *code* instead: addresses
    stand in histories, and on command lines that everybody on the machine can read. A code works
    once; what the browser keeps then is a cookie from which the token cannot be found.

    Args:
        token: What clients have to know.
        clock: Seconds of a clock that never goes back.
    """

    def __init__(self, token: str, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._token, self._clock = token, clock
        self._codes: dict[str, float] = {}

    @property
    def cookie(self) -> str:
        """Value of the cookie. Every port of the station knows it: cookies do not tell ports."""
        return hmac.new(self._token.encode(), b"m100link cookie", hashlib.sha256).hexdigest()

    def cookie_name(self, *, is_secure: bool) -> str:
        """Its name; one that begins with ``__Host-`` cannot be set by other names of a domain."""
        return f"__Host-{COOKIE}" if is_secure else COOKIE

    def set_cookie(self, *, is_secure: bool) -> str:
        """The ``Set-Cookie`` header."""
        more = "; Secure" if is_secure else ""
        name = self.cookie_name(is_secure=is_secure)
        return f"{name}={self.cookie}; HttpOnly; SameSite=Strict; Path=/{more}"

    def is_token(self, given: str) -> bool:
        """Whether this is the token."""
        return secrets.compare_digest(given.encode(), self._token.encode())

    def has_cookie(self, header: str, *, is_secure: bool) -> bool:
        """Whether a ``Cookie`` header has the right one, whatever stands beside it."""
        wanted = self.cookie_name(is_secure=is_secure)
        pairs = (part.partition("=") for part in header.split(";"))
        values = [value.strip() for name, _, value in pairs if name.strip() == wanted]
        return any(secrets.compare_digest(one.encode(), self.cookie.encode()) for one in values)

    def new_code(self) -> str:
        """A code that works once, within :data:`CODE_LIFETIME`."""
        while len(self._codes) >= _MAX_CODES:
            del self._codes[next(iter(self._codes))]
        code = secrets.token_urlsafe(16)
        self._codes[code] = self._clock() + CODE_LIFETIME
        return code

    def redeem(self, code: str) -> bool:
        """Use a code up; False if there is no such code in force."""
        ends_at = self._codes.pop(code, None)
        return ends_at is not None and self._clock() < ends_at
