"""Errors of this package, said to whoever looks at the page.

English is what the error says itself, so that a log, a page and a report agree. Other languages
have the meaning of its class before that.
"""

from __future__ import annotations

from m100link.apps.station.console.view.catalogue import CATALOGUE
from m100link.apps.station.console.view.words import Text
from m100link.errors import GuardRefused, M100Error

__all__ = ["problem_text", "reason_text"]


def problem_text(error: M100Error) -> Text:
    """The error with its cause and its remedy."""
    return Text(_key(error), {"original": str(error)})


def reason_text(error: M100Error) -> Text:
    """What was observed, where the remedy is told otherwise."""
    return Text(_key(error), {"original": error.seen})


def _key(error: M100Error) -> str:
    if isinstance(error, GuardRefused):
        key = f"errors.guard_refused.{error.guard}"
        if key in CATALOGUE:
            return key
    codes = (kind.error_code for kind in type(error).__mro__ if issubclass(kind, M100Error))
    names = (code.removeprefix("M100-").lower().replace("-", "_") for code in codes)
    return next(key for name in names if (key := f"errors.{name}") in CATALOGUE)
