"""Set-ups that are broken, made by script: is the diagnosis the right one?

Those of the port itself are in test_port.py, the rest of them over a real pseudo-terminal in
tests/cli/test_doctor.py.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import pytest

from m100link import Credentials
from m100link.doctor import Finding, Report, Stage, Verdict, diagnose
from m100link.errors import BadURL
from m100link.sim import DEMO_APP_ID, DEMO_KEY, VirtualAircraft
from m100link.sim.orders.actions import perform
from m100link.sim.ports.url import aircraft_of
from tests.doctor.conftest import Speak
from tests.doctor.test_listening import CONSOLE, GPS, mavlink

pytestmark = pytest.mark.anyio

APP = Credentials(DEMO_APP_ID, DEMO_KEY)
OTHER_KEY = Credentials(DEMO_APP_ID, "11" * 32)
OTHER_APP = Credentials(4242, DEMO_KEY)


@dataclass
class Broken:
    """A set-up, and what is to be said of it.

    Attributes:
        url: The aircraft and what is wrong with its line.
        stage: At which it ends; None where it does not fail.
        seen: A part of what is seen there.
        cause: A part of the likeliest cause.
        app: Whose app it is.
        arguments: Of the diagnosis.
        doubts: Stages that are doubtful before it.
    """

    url: str
    stage: Stage | None
    seen: str = ""
    cause: str = ""
    app: Credentials | None = None
    arguments: dict[str, Any] = field(default_factory=dict)
    doubts: tuple[Stage, ...] = ()


SET_UPS = {
    "nothing is wrong": Broken("sim://?seed=1", None, app=APP, arguments={"authority": True}),
    "no byte arrives": Broken(
        "sim://?mute=1", Stage.BYTES, "no answer to two version queries", "TX and RX are swapped"
    ),
    "both wires are broken": Broken("sim://?mute=1&deaf=1", Stage.BYTES, "not one byte", "TX"),
    "levels are inverted": Broken(
        "sim://?inverted=1", Stage.FRAMES, "whose levels are inverted", "an adapter for RS-232"
    ),
    "nearly everything is damaged": Broken(
        "sim://?damage=0.97&seed=3", Stage.FRAMES, "part of no frame", "noise"
    ),
    "a part of it is damaged": Broken(
        "sim://?damage=0.08&seed=3", None, app=APP, doubts=(Stage.FRAMES,)
    ),
    "the aircraft hears nothing": Broken(
        "sim://?deaf=1", Stage.VERSION, "no answer to a version query", "the wire from our TX"
    ),
    "another firmware is forced": Broken(
        "sim://?firmware=3.1",
        Stage.FIRMWARE,
        "do not fit firmware 1.0",
        "another firmware than the one that was forced",
        arguments={"firmware": "1.0"},
    ),
    "nobody has activated it": Broken(
        "sim://", Stage.ACTIVATION, "it is not activated", "nobody activated it"
    ),
    "no app answers": Broken(
        "sim://?cold=1", Stage.ACTIVATION, "the DJI app does not answer", "no mobile device", APP
    ),
    "the app id is not registered": Broken(
        "sim://", Stage.ACTIVATION, "code 6", "app id", OTHER_APP
    ),
    "the key may be another": Broken("sim://", None, app=OTHER_KEY, doubts=(Stage.KEY,)),
    "the key is another": Broken(
        "sim://",
        Stage.AUTHORITY,
        "no usable answer, while plain requests are answered",
        "the key of this program is not the one",
        OTHER_KEY,
        {"authority": True},
        (Stage.KEY,),
    ),
    "the switch is not in F": Broken(
        "sim://?cold=1&activated=1", Stage.MODE_SWITCH, "it is in P", "stands in P"
    ),
}


async def diagnosed(broken: Broken) -> Report:
    return await diagnose(broken.url, credentials=broken.app, **broken.arguments)


@pytest.mark.parametrize("name", SET_UPS)
async def test_the_diagnosis_is_right(name: str) -> None:
    broken = SET_UPS[name]
    report = await diagnosed(broken)
    failure = report.failure
    assert (None if failure is None else failure.stage) is broken.stage
    assert tuple(one.stage for one in report.doubts) == broken.doubts
    if failure is not None:
        assert failure is report.findings[-1]
        assert broken.seen in failure.seen
        assert broken.cause in failure.causes[0]
        assert failure.commands
    stages = [one.stage for one in report.findings]
    assert stages == sorted(stages, key=list(Stage).index)
    json.dumps(report.to_json())


@pytest.mark.parametrize(
    ("said", "name"),
    [
        (CONSOLE, "text"),
        (GPS, "a GPS receiver"),
        (mavlink(0xFD, 12), "MAVLink"),
        (bytes(50), "held low"),
        (b"U" * 50, "one value"),
    ],
)
async def test_somebody_else_is_on_the_line(speak: Speak, said: bytes, name: str) -> None:
    speak(said)
    report = await diagnose("sim://")
    assert report.failure is not None
    assert report.failure.stage is Stage.FRAMES
    assert report.failure.details["likeness"] in {name, "text"}


async def test_both_wires_of_the_adapter_are_joined(speak: Speak) -> None:
    speak(b"", lambda heard: heard)
    report = await diagnose("sim://")
    assert report.failure is not None
    assert report.failure.seen == "what was sent comes back, and nothing else"
    assert "adapter and cable are good" in report.failure.causes[0]


async def test_a_computer_that_listens_without_an_aircraft(speak: Speak) -> None:
    speak(b"")
    report = await diagnose("tcp://127.0.0.1:7000")
    assert report.failure is not None
    assert "the program that listens there has no aircraft" in report.failure.causes[0]


@pytest.fixture
def ordered(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Has orders be given to each virtual aircraft that a URL makes."""

    def give(*orders: str) -> None:
        def made(url: str) -> VirtualAircraft:
            aircraft = aircraft_of(url)
            for order in orders:
                perform(aircraft, order.split())
            return aircraft

        monkeypatch.setattr("m100link.sim.ports.driver.aircraft_of", made)

    return give


@pytest.mark.parametrize("firmware", ["1.0", "2.3", "3.1"])
@pytest.mark.parametrize(
    ("order", "seen", "cause"),
    [
        ("api off", "the switch is in F", "API control is not enabled"),
        ("ioc on", "", ""),
    ],
)
async def test_control_is_refused(
    ordered: Callable[..., None], firmware: str, order: str, seen: str, cause: str
) -> None:
    ordered(order)
    report = await diagnose(f"sim://?firmware={firmware}", credentials=APP, authority=True)
    if order == "ioc on" and firmware == "3.1":
        assert report.failure is None  # which it does not mind
        return
    assert report.failure is not None
    assert report.failure.stage is Stage.AUTHORITY
    assert seen in report.failure.seen
    assert cause in report.failure.causes[0]
    assert report.failure.commands


@pytest.mark.parametrize("authority", [False, True])
async def test_control_is_not_asked_of_an_aircraft_in_the_air(
    ordered: Callable[..., None], authority: bool
) -> None:
    ordered("take-off")
    report = await diagnose("sim://", credentials=APP, authority=authority)
    last = report.findings[-1]
    assert (last.stage, last.verdict) == (Stage.AUTHORITY, Verdict.SKIPPED)
    assert last.seen == "it is not seen standing on the ground with its motors off"
    assert last.details == {"may_be_tried": False}


async def test_nobody_takes_control_unasked() -> None:
    report = await diagnose("sim://", credentials=APP)
    last = report.findings[-1]
    assert (last.verdict, last.details) == (Verdict.SKIPPED, {"may_be_tried": True})


async def test_telemetry_may_be_off(ordered: Callable[..., None]) -> None:
    items = "time quaternion acceleration velocity angular_velocity position magnetometer rc gimbal"
    rates = " ".join(f"{item}=0" for item in [*items.split(), "flight_status", "battery"])
    ordered(f"rates {rates} control_device=0")
    report = await diagnose("sim://", credentials=APP)
    verdicts = {one.stage: one.verdict for one in report.findings}
    assert report.failure is None
    assert verdicts[Stage.TELEMETRY] is Verdict.DOUBTFUL
    assert verdicts[Stage.MODE_SWITCH] is Verdict.SKIPPED


async def test_it_is_told_stage_by_stage_and_ends_with_the_first_failure() -> None:
    told: list[Finding] = []
    report = await diagnose("sim://?deaf=1", tell=told.append)
    assert tuple(told) == report.findings
    assert [one.verdict for one in told].count(Verdict.FAILED) == 1


async def test_no_secret_is_in_a_report() -> None:
    key = "5a" * 32
    url = f"sim://?app-id=777777&key={key}"
    report = await diagnose(url, credentials=Credentials(777_777, key), authority=True)
    assert report.failure is None
    text = json.dumps(report.to_json()) + repr(report)
    assert key not in text
    assert key.upper() not in text
    assert "777777" not in text


async def test_what_is_no_connection_string_is_said_at_once() -> None:
    with pytest.raises(BadURL):
        await diagnose("ttyUSB0")
