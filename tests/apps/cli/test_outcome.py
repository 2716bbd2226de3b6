"""How a command ends: its exit status by what went wrong, and JSON that every reader takes."""

from __future__ import annotations

import json

import pytest

from m100link import errors
from m100link.apps.cli.outcome import _TYPED, complain, exit_code, print_json
from tests.test_house import programs


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (errors.UsageError("x"), 2),
        (errors.BadURL("x"), 2),
        (errors.BadKey("x"), 2),
        (errors.PortNotFound("x"), 3),
        (errors.PortPermissionDenied("x"), 3),
        (errors.PortBusy("x"), 3),
        (errors.PortFailed("x"), 3),
        (errors.SilentLine("x"), 4),
        (errors.NoValidFrame("x"), 4),
        (errors.NoAnswer("x"), 4),
        (errors.LinkLost("x"), 4),
        (errors.ActivationRefused("x"), 5),
        (errors.NotActivated("x"), 5),
        (errors.LevelTooLow("x"), 5),
        (errors.KeyRejected("x"), 5),
        (errors.AuthorityRefused("x"), 6),
        (errors.AuthorityLost("x"), 6),
        (errors.NoAuthority("x"), 6),
        (errors.TaskRefused("x"), 7),
        (errors.TaskFailed("x"), 7),
        (errors.GuardRefused("x"), 7),
        (errors.CommandNotSupported("x"), 7),
        (errors.AckTimeout("x"), 8),
        (errors.NotObserved("x"), 8),
        (errors.TelemetryStalled("x"), 8),
        (errors.BadAck("x"), 1),
        (errors.TelemetryOverflow("x"), 1),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, Exception) else "",
)
def test_each_class_of_error_has_its_exit_status(error: Exception, status: int) -> None:
    """2 usage, 3 port, 4 no link, 5 activation, 6 authority, 7 refused, 8 time, 1 the rest."""
    assert exit_code(error) == status


def test_an_error_is_told_on_standard_error_as_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    assert complain(errors.BadURL("[bold]x[/]", remedy="write y")) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err == "error: [bold]x[/]\n  what to do:   write y\n  code:         M100-BAD-URL\n"


def test_a_remedy_for_programs_is_told_as_what_is_typed(
    capsys: pytest.CaptureFixture[str],
) -> None:
    complain(errors.UsageError("x", remedy="take off first: await control.take_off()"))
    assert "take off first: m100link takeoff\n" in capsys.readouterr().err


@pytest.mark.parametrize("written", _TYPED)
def test_what_is_told_otherwise_is_what_the_library_says(written: str) -> None:
    sources = "".join(path.read_text() for path in programs("m100link") if "cli" not in path.parts)
    assert written in sources


def test_json_has_no_number_that_json_does_not_know(capsys: pytest.CaptureFixture[str]) -> None:
    print_json({"a": float("nan"), "b": [float("-inf"), 1.5], "c": {"d": (float("inf"),)}})
    told = json.loads(capsys.readouterr().out)
    assert told == {"a": "nan", "b": ["-inf", 1.5], "c": {"d": ["inf"]}}
