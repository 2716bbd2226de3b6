"""The keys of a fleet: ``m100/<site>/<name>/<what>``, and its tokens, written in one place."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache

from m100link.errors import UsageError

DEFAULT_SITE = "site"

LIVE = "m100-live"
"""First word of tokens."""

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,31}")
"""The form of names in a fleet: of an aircraft, a site, an identity, a certificate."""

_PARTS = re.compile(r"[0-9]+|[^0-9]+")


def check_name(name: str, what: str = "an aircraft") -> str:
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


@lru_cache(maxsize=4096)  # each message of each aircraft asks, and there are a thousand of them
def name_in(key: str) -> str:
    """The name of the aircraft in a key of :class:`Keys`; empty in any other.

    Any client of the router may show a token with another word in that place: no aircraft.
    """
    words = key.split("/")
    is_one = (len(words) > 3 and words[0] == "m100") or (len(words) == 4 and words[0] == LIVE)
    is_one = is_one and bool(NAME.fullmatch(words[2]))
    return words[2] if is_one else ""


def session_in(token: str) -> str:
    """Id of the session in a token of :meth:`Keys.live_by`."""
    return token.rpartition("/")[2]


class _Key:
    """One key of an aircraft, by the words behind its name."""

    def __init__(self, words: str) -> None:
        self.words = words

    def __get__(self, keys: Keys, _owner: type[Keys] | None = None) -> str:
        return keys.of(self.words)


@dataclass(frozen=True, slots=True)
class Keys:
    """The keys of one aircraft, or with ``*`` for its name those of all."""

    site: str = DEFAULT_SITE  # where it flies
    name: str = "*"

    telemetry = _Key("tel")  # every package, as it came; sent while somebody listens
    thinned = _Key("tel/5hz")  # what suffices for each item five times a second
    state = _Key("state")  # where the agent stands: sent once a second, and answered
    event = _Key("event")  # what happens
    told = _Key("told")  # what fronts of the agent hear; sent while somebody listens
    place = _Key("place")  # where it will be in its show, for the others that fly it
    setpoint = _Key("setpoint")  # setpoints are sent here
    # Here is asked: orders; whatever is wanted of the lease; pieces of flight logs; how far its
    # mission is; what has to do with a show; a list of revoked names is brought, and which one is
    # in force is asked.
    command = _Key("cmd")
    lease = _Key("lease")
    log = _Key("log")
    mission = _Key("mission")
    show = _Key("show")
    revoked = _Key("revoked")
    # A token without session among the other keys, where authors of tools look first.
    live_beside = _Key("live")

    def __post_init__(self) -> None:
        check_name(self.site, "a site")
        if self.name != "*":
            check_name(self.name)

    def of(self, what: str) -> str:
        return f"m100/{self.site}/{self.name}/{what}"

    @property
    def live(self) -> str:
        """Its tokens: there as long as agents are that have its name, one for each session.

        Not among the other keys: zenoh compares each message with all tokens beside its key that
        its receiver watches. Of a thousand aircraft that cost ten times the message itself.
        """
        return self.live_by("*")

    def live_by(self, session: str) -> str:
        """The token that an agent shows; an answer of another session is not the aircraft's."""
        return f"{LIVE}/{self.site}/{self.name}/{session}"

    def status(self, identity: str = "*") -> str:
        return self.of(f"status/{identity}")
