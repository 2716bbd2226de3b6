"""Flying from the shell over a real pseudo-terminal. Real time."""

from __future__ import annotations

import pytest

from m100link.apps.cli.flight import release
from m100link.apps.cli.outcome import ExitCode
from tests.apps.cli.conftest import CommandLine, Simulator, process

# Several programs in a row fly in real time: more than the usual time-out on a busy machine.
pytestmark = [pytest.mark.pty]


def test_take_off_fly_and_land_from_the_shell(simulator: Simulator, app: list[str]) -> None:
    """Three programs in a row on one aircraft: each obtains control and gives it back."""
    for arguments, what in (
        (("takeoff",), "take off"),
        (("fly", "3", "0", "2"), "fly 3 m north"),
        (("land",), "land"),
    ):
        command, *numbers = arguments
        outcome = process(command, simulator.port, *numbers, "--yes", *app)
        assert outcome.status == 0, outcome
        assert f"done: {what}" in outcome.out
    [line] = process("monitor", simulator.port, "--json", "--duration", "1.2").objects
    assert line["position"]["value"]["height_m"] == pytest.approx(0.0, abs=0.3)
    assert line["flight_status"]["value"] == {"status": 1}


def test_flying_wants_to_be_confirmed(simulator: Simulator, app: list[str]) -> None:
    for verb in ("takeoff", "home"):
        outcome = process(verb, simulator.port, *app)
        assert outcome.status == 2
        assert "was not confirmed" in outcome.err
        assert "--yes" in outcome.err


def test_a_refused_landing_says_why(simulator: Simulator, app: list[str]) -> None:
    outcome = process("land", simulator.port, *app)
    assert outcome.status == 7
    assert "land was refused" in outcome.err
    assert "STANDBY" in outcome.err


def test_release_is_always_possible(simulator: Simulator, app: list[str]) -> None:
    outcome = process("release", simulator.port, *app)
    assert outcome.status == 0
    assert outcome.out == "released\n"


def test_a_release_that_is_not_confirmed_is_not_called_one(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    async def unheard(*_: object) -> bool:
        return False

    monkeypatch.setattr("m100link.aircraft.aircraft.release_authority", unheard)
    assert release("sim://") == ExitCode.TIMEOUT
    assert "did not say that it has control authority back" in capsys.readouterr().err


def test_a_url_of_the_simulator_needs_no_credentials() -> None:
    outcome = process("takeoff", "sim://")
    assert outcome.status == 0
    assert "done: take off" in outcome.out


@pytest.mark.parametrize(
    ("words", "seen"),
    [
        (("2", "0", "x", "sim://"), "'x' is not a number"),
        (("2", "0", "1", "sim://"), "'sim://' is not a number"),
        (("sim://", "2", "0"), "2 numbers were given"),
        ((), "0 numbers were given"),
    ],
)
def test_metres_that_are_none_are_told_before_anything_else(
    cli: CommandLine, words: tuple[str, ...], seen: str
) -> None:
    outcome = cli("fly", *words)
    assert outcome.status == ExitCode.USAGE
    assert seen in outcome.err
    assert "the aircraft first" in outcome.err
