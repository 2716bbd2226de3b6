"""Errors of this package as values, so that a front raises what the agent met."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from m100link import errors
from m100link.apps.agent.lease import LeaseHeld, LeaseRefused
from m100link.errors import LinkError, LinkLost, M100Error


class MessageError(
    M100Error,
    code="M100-MESSAGE",
    cause="a front and an agent of different versions",
    remedy="run both from the same installation",
):
    """Bytes that are not a message, or a message that cannot be sent."""


_ERRORS: dict[str, type[M100Error]] = {
    name: found
    for name in vars(errors)["__all__"]
    if isinstance(found := getattr(errors, name), type) and issubclass(found, M100Error)
} | {kind.__name__: kind for kind in (LeaseRefused, LeaseHeld, MessageError)}

_TOLD = ("seen", "cause", "remedy")


@dataclass(frozen=True, slots=True)
class Fault:
    """An error of this package on its way."""

    kind: str  #: name of its class
    seen: str  #: what was observed
    cause: str = ""  #: the most likely cause
    remedy: str = ""  #: what to do about it
    #: Its other attributes that are texts, numbers, truth values or None.
    details: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, error: M100Error) -> Fault:
        """The error as a value."""
        known = next(kind for kind in type(error).__mro__ if _ERRORS.get(kind.__name__) is kind)
        details = {
            name: _plain(value)
            for name, value in vars(error).items()
            if name not in _TOLD and isinstance(value, str | int | float | None)
        }
        return cls(known.__name__, error.seen, error.cause, error.remedy, details)

    def error(self) -> M100Error:
        """The error again: an object of its class, or of the base when the class is unknown."""
        kind = _ERRORS.get(self.kind, M100Error)
        error = kind(self.seen, cause=self.cause, remedy=self.remedy)
        # What every error has stays as it is, whatever details somebody tells.
        for name, value in self.details.items():
            if name in kind.own or not hasattr(error, name):
                vars(error)[name] = value  # no descriptor of the class, such as OSError's, is asked
        return error


def fault_of(error: M100Error | None) -> Fault | None:
    """The error as a value, None for none."""
    return None if error is None else Fault.of(error)


def _plain(value: object) -> object:
    return value.value if isinstance(value, Enum) else value


def agent_gone(reason: str) -> LinkError:
    """What is raised when the agent has gone for good."""
    why = f": {reason}" if reason else ""
    return LinkError(
        f"the agent that owns the aircraft has gone{why}",
        remedy="start it again; until then nothing here is up to date",
    )


def agent_lost(reason: str) -> LinkLost:
    """What is raised when the agent goes before it has said what became of a question."""
    gone = agent_gone(reason)
    return LinkLost(
        f"{gone.seen}; it had been asked, and may have done it",
        cause="it was ended or killed, or the way to it was cut",
        remedy="look at the aircraft, and start the agent again",
    )
