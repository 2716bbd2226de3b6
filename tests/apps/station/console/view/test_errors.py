"""Errors in the language of whoever looks: every class has a meaning, the original stays beside."""

from __future__ import annotations

import pytest

from m100link import errors
from m100link.apps.agent.lease import LeaseHeld, LeaseRefused
from m100link.apps.station.console.view.errors import problem_text, reason_text
from m100link.apps.station.console.view.units import Language
from m100link.apps.station.console.view.words import Speaker
from m100link.errors import (
    AuthorityLost,
    GuardRefused,
    LossReason,
    M100Error,
    NotActivated,
    PortBusy,
)

ENGLISH, GERMAN = Speaker(), Speaker(Language.GERMAN)

CLASSES = [
    one
    for name in errors.__all__
    if isinstance(one := getattr(errors, name), type) and issubclass(one, M100Error)
]


def made(kind: type[M100Error]) -> M100Error:
    error = kind.__new__(kind)
    M100Error.__init__(error, "it was seen", cause="a cause", remedy="a remedy")
    vars(error)["guard"] = ""
    return error


@pytest.mark.parametrize("kind", [*CLASSES, LeaseRefused, LeaseHeld])
def test_every_class_is_said_in_german_with_its_original(kind: type[M100Error]) -> None:
    error = made(kind)
    assert ENGLISH(problem_text(error)) == str(error)
    assert ENGLISH(reason_text(error)) == "it was seen"
    meaning, _, original = GERMAN(problem_text(error)).partition("\n")
    assert original == str(error)
    assert meaning != ""


@pytest.mark.parametrize(
    ("error", "meaning"),
    [
        (AuthorityLost("gone", reason=LossReason.APP), "Die Steuerung ist verloren"),
        (NotActivated("0xFF01", command="take off", code=0xFF01), "ist nicht aktiviert"),
        (PortBusy("busy"), "Die Leitung zum Fluggerät ist gestört"),  # as its base
        (GuardRefused("far", guard="envelope"), "Die Grenzen erlauben das nicht"),
        (GuardRefused("no", guard="one that is new"), "Abgelehnt, geflogen wurde es nicht"),
        (M100Error("{0} {name}"), "Das ging nicht"),  # no braces are filled in what was seen
    ],
)
def test_the_nearest_meaning_is_said(error: M100Error, meaning: str) -> None:
    assert meaning in GERMAN(problem_text(error))
    assert error.seen in GERMAN(reason_text(error))
