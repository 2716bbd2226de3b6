"""Set-ups that are broken, made by script: is the diagnosis the right one?

They are in setups.py, what the port itself may have in test_port.py, some of them over a real
pseudo-terminal in tests/apps/cli/test_connection.py.
"""

from __future__ import annotations

import json
import math
import random
import re
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from m100link import Aircraft, Credentials, connect
from m100link.apps.cli.connection import exit_status
from m100link.apps.doctor import Finding, Stage, Verdict, diagnose
from m100link.apps.doctor.diagnosis import _activation, _firmware
from m100link.apps.doctor.line import look_at_line
from m100link.errors import BadURL, UsageError
from m100link.link.url import parse_url
from m100link.protocol.firmware import PROFILES
from m100link.sim import DEMO_APP_ID, DEMO_KEY, VirtualAircraft
from m100link.sim.orders import perform
from m100link.sim.ports.driver import aircraft_of
from m100link.sim.vehicle.sensors import Sensors
from m100link.wire.frame import encode_frame
from tests.apps.doctor.bench import Bench, FakeMachine
from tests.apps.doctor.setups import APP, OTHER_APP, SET_UPS, diagnosed, on_bench, rows

pytestmark = pytest.mark.anyio

MANUAL = Path(__file__).parents[3] / "docs/reference/diagnoses.md"


@pytest.mark.parametrize("name", SET_UPS)
async def test_the_diagnosis_is_right(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[Aircraft] = []

    async def noted(*given: Any, **named: Any) -> Aircraft:
        opened.append(await connect(*given, **named))
        return opened[-1]

    monkeypatch.setattr("m100link.apps.doctor.diagnosis.connect", noted)
    set_up = SET_UPS[name]
    report = await diagnosed(set_up)
    failure = report.failure
    assert not any(one.is_connected for one in opened), "the port is free again, whatever was found"
    assert (None if failure is None else failure.stage) is set_up.stage
    assert tuple(one.stage for one in report.doubts) == set_up.doubts
    assert exit_status(report) == set_up.status
    if failure is not None:
        assert failure is report.findings[-1]
        assert set_up.seen in failure.seen
        assert set_up.cause in failure.causes[0]
        assert failure.commands
    stages = [one.stage for one in report.findings]
    assert stages == sorted(stages, key=list(Stage).index)
    assert all(one.causes and one.commands for one in report.doubts)
    commands = " ".join(command for one in report.findings for command in one.commands)
    assert " PORT" not in commands, "a command is typed as it stands"
    text = json.dumps(report.to_json()) + repr([one.details for one in report.findings])
    for secret in (DEMO_KEY.reveal().hex(), str(DEMO_APP_ID), "11" * 32, str(OTHER_APP.app_id)):
        # As a word: other numbers, such as those of processes, may have these digits in them.
        assert re.search(rf"(?<![\w.]){secret}(?!\w)", text.lower()) is None


def test_every_stage_that_can_fail_has_a_set_up_or_a_test_of_its_own() -> None:
    failing = {one.stage for one in SET_UPS.values()} | {
        stage for one in SET_UPS.values() for stage in one.doubts
    }
    assert set(Stage) - failing == {Stage.LATENCY}  # which is in test_port.py


async def test_the_table_of_the_manual_is_what_they_say() -> None:
    written = MANUAL.read_text(encoding="utf-8").splitlines()
    assert [line for line in written if line.startswith("|")] == await rows()


@pytest.mark.parametrize(
    ("felt_deg_s", "is_named"), [(0.0, True), (5.0, True), (14.0, False), (20.0, False)]
)
async def test_an_imu_that_feels_the_attitude_turn_is_none_of_a_simulator(
    monkeypatch: pytest.MonkeyPatch, felt_deg_s: float, is_named: bool
) -> None:
    """The nose turns by 20° a second."""
    with on_bench(SET_UPS["the simulator of the PC assistant flies it"]):
        gyro = (0.0, 0.0, math.radians(felt_deg_s))
        monkeypatch.setattr(Sensors, "_read_angular_velocity", lambda _: gyro)
        report = await diagnose("sim://?firmware=3.1", credentials=APP)
    assert (Stage.ACCELERATION in [one.stage for one in report.doubts]) is is_named


async def test_it_is_reported_stage_by_stage_and_ends_with_the_first_failure() -> None:
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


@pytest.mark.parametrize("url", ["ttyUSB0", "sim://?firmware=9", "sim://?nonsense=1"])
async def test_what_is_no_connection_string_is_said_at_once(url: str) -> None:
    with pytest.raises(BadURL):
        await diagnose(url)


async def test_a_firmware_that_does_not_exist_is_said_and_not_taken_for_a_fault() -> None:
    with pytest.raises(UsageError, match="no firmware profile is called '9'"):
        await diagnose("sim://", firmware="9")


FRAME = encode_frame(bytes([2, 0, *range(1, 47)]), session=0, sequence=7)
"""64 bytes of telemetry."""

DAMAGED = FRAME[:-1] + bytes([FRAME[-1] ^ 0xFF])


def noise(count: int) -> bytes:
    """So many bytes that begin no frame."""
    return bytes(one for one in random.Random(5).randbytes(2 * count + 9) if one != 0xAA)[:count]


@pytest.mark.parametrize(
    ("said", "stage", "verdict", "seen"),
    [
        # Three damaged frames are what opening a port in the middle of one makes.
        (FRAME * 100 + DAMAGED * 3, Stage.FRAMES, Verdict.GOOD, "100 frames"),
        (
            FRAME * 100 + DAMAGED * 4,
            Stage.FRAMES,
            Verdict.DOUBTFUL,
            "100 frames with good",
        ),
        # Of more frames, two of a hundred.
        (FRAME * 300 + DAMAGED * 6, Stage.FRAMES, Verdict.GOOD, "300 frames"),
        (FRAME * 300 + DAMAGED * 7, Stage.FRAMES, Verdict.DOUBTFUL, "and 7 damaged ones"),
        # One byte of twenty may be part of none.
        (FRAME * 95 + noise(320), Stage.FRAMES, Verdict.GOOD, "95 frames"),
        (FRAME * 95 + noise(321), Stage.FRAMES, Verdict.DOUBTFUL, "321 of 6401 bytes"),
        # Few frames among more noise may be older than the line.
        (FRAME * 10 + noise(640), Stage.FRAMES, Verdict.DOUBTFUL, "640 of 1280 bytes"),
        (
            FRAME * 10 + noise(641),
            Stage.FRAMES,
            Verdict.FAILED,
            "may have waited in the port",
        ),
        (
            FRAME * 128 + noise(9000),
            Stage.FRAMES,
            Verdict.FAILED,
            "the 128 that are valid",
        ),
        (FRAME * 129 + noise(9000), Stage.FRAMES, Verdict.DOUBTFUL, "129 frames"),
        (FRAME + noise(100), Stage.FRAMES, Verdict.FAILED, "the 1 that are valid"),
        # A wire that is joined to nothing picks up little.
        (
            noise(199),
            Stage.FRAMES,
            Verdict.FAILED,
            "199 bytes, and not one valid frame: an aircraft",
        ),
        (noise(200), Stage.FRAMES, Verdict.FAILED, "200 bytes, and not one valid frame"),
        (FRAME * 5, Stage.TELEMETRY, Verdict.GOOD, "5 packages of telemetry"),
        (
            encode_frame(bytes([0, 0]), session=2, sequence=9, is_ack=True),
            Stage.TELEMETRY,
            Verdict.DOUBTFUL,
            "answers come, and no telemetry",
        ),
        (
            encode_frame(bytes([5, 1]), session=2, sequence=9) * 3,
            Stage.TELEMETRY,
            Verdict.DOUBTFUL,
            "3 frames, and among them neither",
        ),
    ],
)
async def test_how_much_damage_is_a_doubt_and_how_much_a_failure(
    monkeypatch: pytest.MonkeyPatch,
    machine: FakeMachine,
    said: bytes,
    stage: Stage,
    verdict: Verdict,
    seen: str,
) -> None:
    once = iter([said])
    Bench(monkeypatch, machine, "").speak(b"", lambda _: next(once, b""))
    findings = await look_at_line(parse_url("tcp://127.0.0.1:7000"))
    assert findings[1].seen == f"{len(said)} bytes in 2 s"
    [found] = [one for one in findings if one.stage is stage]
    assert found.verdict is verdict
    assert seen in found.seen
    assert (len(said) == 199) is ("an aircraft sends far more" in found.seen)
    assert "rates_tried" not in found.details, "the number behind a host is no baud rate"


# -- what the aircraft answers, and what becomes of it: activation, key, switch, authority ---------


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


@pytest.mark.parametrize(("mismatches", "verdict"), [(2, Verdict.GOOD), (3, Verdict.FAILED)])
def test_three_packages_that_do_not_fit_are_another_firmware(
    mismatches: int, verdict: Verdict
) -> None:
    """Two may be what a line spoils: one in 65,536 damaged frames has a right checksum."""
    aircraft = SimpleNamespace(firmware=PROFILES["2.3"], telemetry_mismatches=mismatches)
    version = SimpleNamespace(profile=PROFILES["2.3"])
    told = _firmware(cast(Any, aircraft), cast(Any, version), is_forced=True)
    assert (told.stage, told.verdict) == (Stage.FIRMWARE, verdict)


@pytest.mark.parametrize(
    ("is_activated", "verdict"), [(True, Verdict.GOOD), (False, Verdict.FAILED)]
)
async def test_without_credentials_the_version_answer_says_whether_it_is_activated(
    is_activated: bool, verdict: Verdict
) -> None:
    version = SimpleNamespace(is_activated=is_activated)
    told = await _activation(cast(Any, SimpleNamespace()), cast(Any, version), None)
    assert (told.stage, told.verdict) == (Stage.ACTIVATION, verdict)
