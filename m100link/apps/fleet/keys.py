"""The keys of a fleet: ``m100/<site>/<name>/<what>``, and its tokens, written in one place."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

from m100link.errors import UsageError

DEFAULT_SITE = "site"

LIVE = "m100-live"
"""First word of tokens."""

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,31}")
"""What may be a name in a fleet: of an aircraft, a site, an identity, a certificate."""

_PARTS = re.compile(r"[0-9]+|[^0-9]+")


def check_name(name: str, what: str = "an aircraft") -> str:
    """The name, if it can be a word of a key.

    Raises:
        UsageError: It cannot.
    """
    if not NAME.fullmatch(name):
        raise UsageError(
            f"{name!r} is no name for {what}",
            remedy="use 1 to 32 letters, digits, - and _, and begin with a letter or a digit",
        )
    return name


def in_order(names: Iterable[str]) -> list[str]:
    """Names as people count: a2 before a10."""

    def parts(name: str) -> list[tuple[bool, int, str]]:
        found = _PARTS.findall(name)
        return [(False, int(one), "") if one.isdigit() else (True, 0, one) for one in found]

    return sorted(names, key=parts)


def name_in(key: str) -> str:
    """The name of the aircraft in a key of :class:`Keys`; empty in any other.

    Whoever reaches the router may show a token with any word in that place: it is no aircraft.
    """
    words = key.split("/")
    is_one = (len(words) > 3 and words[0] == "m100") or (len(words) == 4 and words[0] == LIVE)
    is_one = is_one and bool(NAME.fullmatch(words[2]))
    return words[2] if is_one else ""


def session_in(token: str) -> str:
    """Id of the session in a token of :meth:`Keys.live_by`."""
    return token.rpartition("/")[2]


@dataclass(frozen=True, slots=True)
class Keys:
    """The keys of one aircraft, or with ``*`` for its name those of all."""

    site: str = DEFAULT_SITE  # where it flies
    name: str = "*"

    def __post_init__(self) -> None:
        check_name(self.site, "a site")
        if self.name != "*":
            check_name(self.name)

    def of(self, what: str) -> str:
        """The key of one thing of it."""
        return f"m100/{self.site}/{self.name}/{what}"

    @property
    def live(self) -> str:
        """Its tokens: there as long as agents are that have its name, one for each session.

        Not among the other keys: zenoh compares each message with all tokens beside its key that
        whoever hears it watches. Of a thousand aircraft that cost ten times the message itself.
        """
        return f"{LIVE}/{self.site}/{self.name}/*"

    def live_by(self, session: str) -> str:
        """The token that an agent shows; an answer of another session is not the aircraft's."""
        return f"{LIVE}/{self.site}/{self.name}/{session}"

    @property
    def live_beside(self) -> str:
        """A token without session among the other keys, where authors of tools look first."""
        return self.of("live")

    @property
    def telemetry(self) -> str:
        """Every package, as it came; sent while somebody listens."""
        return self.of("tel")

    @property
    def thinned(self) -> str:
        """What suffices for each item five times a second."""
        return self.of("tel/5hz")

    @property
    def state(self) -> str:
        """Where the agent stands: told once a second, and answered."""
        return self.of("state")

    @property
    def event(self) -> str:
        """What happens."""
        return self.of("event")

    @property
    def told(self) -> str:
        """What fronts of the agent hear; sent while somebody listens."""
        return self.of("told")

    @property
    def command(self) -> str:
        """Orders are asked here."""
        return self.of("cmd")

    @property
    def lease(self) -> str:
        """Whatever is wanted of the lease is asked here."""
        return self.of("lease")

    @property
    def revoked(self) -> str:
        """A list of revoked names is brought here, and which one is in force is asked."""
        return self.of("revoked")

    @property
    def setpoint(self) -> str:
        """Setpoints are sent here."""
        return self.of("setpoint")

    @property
    def log(self) -> str:
        """Pieces of flight logs are asked here."""
        return self.of("log")

    @property
    def mission(self) -> str:
        """How far its mission is, is asked here."""
        return self.of("mission")

    @property
    def show(self) -> str:
        """What has to do with a show is asked here."""
        return self.of("show")

    @property
    def place(self) -> str:
        """Where it will be in its show is told here, to the others that fly it."""
        return self.of("place")

    def status(self, identity: str = "*") -> str:
        """What became of an order is asked here."""
        return self.of(f"status/{identity}")
