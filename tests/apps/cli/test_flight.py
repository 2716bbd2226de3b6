"""Flying from the shell over a real pseudo-terminal. Real time."""

from __future__ import annotations

from typing import Any

import pytest

from m100link.apps.cli.terminal import ExitCode
from tests.apps.cli.conftest import CommandLine, Simulator, process

# Several programs in a row fly in real time: more than the usual time-out on a busy machine.


@pytest.mark.pty
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
        assert f'"done": "{what}' in outcome.out
    [line] = process("monitor", simulator.port, "--json", "--duration", "1.2").objects
    assert line["position"]["value"]["height_m"] == pytest.approx(0.0, abs=0.3)
    assert line["flight_status"]["value"] == {"status": 1}


@pytest.mark.pty
def test_flying_wants_to_be_confirmed(simulator: Simulator, app: list[str]) -> None:
    for verb in ("takeoff", "home"):
        outcome = process(verb, simulator.port, *app)
        assert outcome.status == 2
        assert "was not confirmed" in outcome.err
        assert "--yes" in outcome.err


@pytest.mark.pty
def test_a_refused_landing_says_why(simulator: Simulator, app: list[str]) -> None:
    outcome = process("land", simulator.port, *app)
    assert outcome.status == 7
    assert "land was refused" in outcome.err
    assert "STANDBY" in outcome.err


@pytest.mark.pty
def test_release_is_always_possible(simulator: Simulator, app: list[str]) -> None:
    outcome = process("release", simulator.port, *app)
    assert outcome.status == 0
    assert outcome.out == '{"done": "release"}\n'


def test_a_release_that_is_not_confirmed_is_not_called_one(
    cli: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def unheard(*_: object) -> bool:
        return False

    monkeypatch.setattr("m100link.aircraft.aircraft.release_authority", unheard)
    outcome = cli("release", "sim://")
    assert outcome.status == ExitCode.TIMEOUT
    assert "did not report that it has control authority back" in outcome.err


@pytest.mark.pty
def test_a_url_of_the_simulator_needs_no_credentials() -> None:
    outcome = process("takeoff", "sim://")
    assert outcome.status == 0
    assert '"done": "take off"' in outcome.out


@pytest.mark.parametrize(
    ("words", "seen"),
    [
        (("2", "0", "x", "sim://"), "'x' is not a number"),
        (("2", "0", "1", "sim://"), "'sim://' is not a number"),
        (("sim://", "2", "0"), "2 numbers were given"),
        ((), "0 numbers were given"),
    ],
)
def test_metres_that_are_none_are_reported_before_anything_else(
    cli: CommandLine, words: tuple[str, ...], seen: str
) -> None:
    outcome = cli("fly", *words)
    assert outcome.status == ExitCode.USAGE
    assert seen in outcome.err
    assert "the aircraft first" in outcome.err


# -- gimbal, camera and rates from the shell, at a virtual aircraft in the same process ------------


SIM = "sim://?firmware=3.1"


@pytest.mark.parametrize(
    ("options", "shown"),
    [
        ((), {"yaw_deg": 0.0, "pitch_deg": 0.0}),
        (
            ("--pitch", "-45", "--yaw", "20", "--seconds", "0.5"),
            {"yaw_deg": 20.0, "pitch_deg": -45.0},
        ),
        (("--pitch=-10", "--relative", "--seconds", "0.3"), {"pitch_deg": -10.0, "roll_deg": 0.0}),
        (("--yaw", "30", "--rates", "--seconds", "0.5"), {"yaw_deg": 15.0}),
    ],
)
def test_the_gimbal_is_pointed_and_shown(
    cli: CommandLine, options: tuple[str, ...], shown: dict[str, float]
) -> None:
    outcome = cli("gimbal", SIM, *options)
    assert outcome.status == 0, outcome
    [described] = outcome.objects
    assert set(described) == {"yaw_deg", "pitch_deg", "roll_deg", "limits"}
    tolerance = 8.0 if "--rates" in options else 2.0
    assert {name: described[name] for name in shown} == pytest.approx(shown, abs=tolerance)


@pytest.mark.parametrize("action", ["photo", "start-video", "stop-video"])
@pytest.mark.parametrize("place", ["argument", "option", "environment"])
def test_the_camera_is_ordered_and_nobody_confirms(
    cli: CommandLine, monkeypatch: pytest.MonkeyPatch, action: str, place: str
) -> None:
    words = {"argument": (SIM, action), "option": ("--url", SIM, action), "environment": (action,)}
    if place == "environment":
        monkeypatch.setenv("M100LINK_URL", SIM)
    outcome = cli("camera", *words[place])
    assert outcome.status == 0, outcome
    assert outcome.objects == [{"sent": action, "confirmed": None}]


def test_rates_are_shown_and_set(cli: CommandLine) -> None:
    outcome = cli("rates", SIM)
    assert outcome.status == 0, outcome
    [shown] = outcome.objects
    assert shown["rates_hz"]["velocity"] == pytest.approx(100, rel=0.3)
    assert shown["rates_hz"]["control_device"] == 0
    outcome = cli("rates", SIM, "attitude=10", "control_device=50", "rc=0")
    assert outcome.status == 0, outcome
    [shown] = outcome.objects
    seen = {name: shown["rates_hz"][name] for name in ("quaternion", "control_device", "rc")}
    assert seen == pytest.approx({"quaternion": 10, "control_device": 50, "rc": 0}, rel=0.3)


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        (("gimbal", SIM, "--pitch", "45"), ExitCode.USAGE, "pitch 45"),
        (("gimbal", SIM, "--rates"), ExitCode.USAGE, "--rates has no axis"),
        (("gimbal", "sim://", "--pitch", "-45"), ExitCode.REFUSED, "firmware 1.0 does not know"),
        (("camera", SIM), ExitCode.USAGE, "photo, start-video, stop-video"),
        (("camera", SIM, "explode"), ExitCode.USAGE, "no action 'explode'"),
        (("camera", SIM, "photo", "photo"), ExitCode.USAGE, "2 actions were given"),
        (("camera", "photo", SIM), ExitCode.USAGE, "is not an aircraft and an action"),
        (("camera",), ExitCode.USAGE, "no action was given"),
        (("camera", "sim://", "photo"), ExitCode.REFUSED, "nothing was sent"),
        (("rates", SIM, "attitude=20"), ExitCode.USAGE, "cannot be sent at 20 Hz"),
        (("rates", SIM, "attitude=fast"), ExitCode.USAGE, "'attitude=fast' is not a rate"),
        (("rates", SIM, "attitude=1", "attitude=1"), ExitCode.USAGE, "two rates"),
        (("rates", SIM, "fuel=1"), ExitCode.USAGE, "no telemetry item is called 'fuel'"),
        (("rates", "sim://?firmware=2.3", "rc=1"), ExitCode.REFUSED, "nothing was sent"),
        (("rates",), ExitCode.USAGE, "no URL says where"),
    ],
)
def test_what_cannot_be_asked_says_why(
    cli: CommandLine, arguments: tuple[str, ...], status: Any, words: str
) -> None:
    outcome = cli(*arguments)
    assert (outcome.status, outcome.out) == (status, "")
    assert words in outcome.err
