"""What a diagnosis and a first contact make of values by hand, stage by stage."""

from __future__ import annotations

import asyncio
import math
import os
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from types import SimpleNamespace
from typing import Any, cast

import pytest

from m100link.apps.doctor import diagnosis, first_contact, line
from m100link.apps.doctor.diagnosis import (
    _acceleration,
    _activation,
    _at_rest,
    _authority,
    _firmware,
    _mode_switch,
    _refused,
    _unanswered,
    _version,
)
from m100link.apps.doctor.first_contact import (
    Contact,
    Topic,
    _lost,
    _Meeting,
    _Point,
    _steepest,
    _Witness,
)
from m100link.apps.doctor.machine import Permission, Process
from m100link.apps.doctor.port import (
    Finding,
    Report,
    Stage,
    Verdict,
    failed,
    look_at_latency,
    look_at_port,
)
from m100link.errors import (
    AckTimeout,
    AuthorityRefused,
    BadURL,
    CommandRefused,
    GuardRefused,
    KeyRejected,
    LinkLost,
    M100Error,
    NoAircraft,
    NotActivated,
    PortBusy,
    UsageError,
)
from m100link.link import Direction
from m100link.link.url import ConnectionString, parse_url
from m100link.protocol.codes import ActivationCode, AuthorityCode
from m100link.protocol.commands.activation import Credentials
from m100link.protocol.firmware import PROFILES
from m100link.protocol.items import BY_RECORD
from m100link.protocol.records import (
    AccelerationMode,
    AngularVelocity,
    Attitude,
    ControlDevice,
    RcMode,
    RemoteControl,
    Velocity,
    quaternion,
)
from m100link.wire import encode_frame
from tests import limits
from tests.apps.doctor.bench import GPS, TELEMETRY, Bench, FakeMachine

pytestmark = pytest.mark.anyio

GOOD, DOUBTFUL, FAILED, SKIPPED = Verdict.GOOD, Verdict.DOUBTFUL, Verdict.FAILED, Verdict.SKIPPED


def an_aircraft(**changes: Any) -> Any:
    """As much of one as a stage looks at; its state has these records."""
    records = {type(one): one for one in changes.pop("records", ())}
    state = SimpleNamespace(fresh=records.get)
    known = {"firmware": PROFILES["3.1"], "telemetry_mismatches": 0, "state": state}
    return SimpleNamespace(**known | changes)


# -- an attitude that turns, and a gyro that feels it ---------------------------------------------


class Turns:
    """Packages in order: time, heading in degrees, and rates about the body axes in °/s."""

    def __init__(self, *rows: tuple[float, float | None, tuple[float, ...] | None]) -> None:
        self._rows = iter(rows)

    def get_nowait(self) -> Any:
        row = next(self._rows, None)
        if row is None:
            return None
        at, yaw, rates = row
        records: dict[Any, Any] = {}
        if yaw is not None:
            records[Attitude] = Attitude(*quaternion(0.0, 0.0, math.radians(yaw)))
        if rates is not None:
            records[AngularVelocity] = AngularVelocity(*map(math.radians, rates))
        return SimpleNamespace(received_at=at, get=records.get)


def turning(degrees: float, felt: float, axis: int = 2) -> Turns:
    """From 170° on, past south, within two seconds; the gyro feels so many degrees of it."""
    rates = [0.0, 0.0, 0.0]
    rates[axis] = felt / 2.0
    return Turns(*((5.0 + n / 10, 170.0 + degrees * n / 20, tuple(rates)) for n in range(21)))


@pytest.mark.parametrize(
    ("turns", "seen"),
    [
        (turning(9.9, 0.0), None),
        (turning(10.1, 0.0), "turned by 10°, of which the gyro felt 0°"),
        (turning(40.0, 19.0), "turned by 40°, of which the gyro felt 19°"),
        (turning(40.0, -19.0, axis=0), "turned by 40°, of which the gyro felt 19°"),
        (turning(40.0, 21.0), None),
        (turning(-60.0, 0.0), "turned by 60°, of which the gyro felt 0°"),
        (Turns((1.0, 0.0, None), (2.0, 90.0, None)), None),  # no gyro arrives
        # The first rate has no time before it; the second holds for a second.
        (Turns((1.0, 0.0, (0.0, 90.0, 0.0)), (2.0, 30.0, (0.0, 0.0, 14.0))), "felt 14°"),
        (Turns(), None),
    ],
)
def test_a_gyro_that_feels_less_than_half_of_ten_degrees_is_a_doubt(
    turns: Turns, seen: str | None
) -> None:
    found = _at_rest(cast(Any, turns))
    assert (found is None) is (seen is None)
    if found is not None and seen is not None:
        assert (found.stage, found.verdict) == (Stage.ACCELERATION, DOUBTFUL)
        assert seen in found.seen


@pytest.mark.parametrize(
    ("arrives", "mode", "seen_mode", "verdict", "seen"),
    [
        (False, None, None, SKIPPED, "does not arrive"),
        (True, None, None, DOUBTFUL, "neither that of a raw nor that of a fused"),
        (True, "fused", "fused", GOOD, "fused: ground axes, m/s²"),
        (True, "raw", "raw", GOOD, "raw: body axes, in g, with gravity; m100link converts it"),
        (True, "raw", None, GOOD, "; forced, and not at rest"),
        (True, "fused", "raw", DOUBTFUL, "it is read as fused, and its values at rest are raw"),
    ],
)
async def test_acceleration_is_raw_or_fused_as_it_is_read_and_seen(
    arrives: bool, mode: str | None, seen_mode: str | None, verdict: Verdict, seen: str
) -> None:
    reader = SimpleNamespace(
        has_arrived=arrives,
        mode=mode and AccelerationMode(mode),
        seen=seen_mode and AccelerationMode(seen_mode),
    )
    found = await _acceleration(an_aircraft(_telemetry=SimpleNamespace(acceleration=reader)))
    assert (found.stage, found.verdict) == (Stage.ACCELERATION, verdict)
    assert seen in found.seen


# -- what the aircraft answers --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("is_slow", "crc_matches", "verdict"),
    [(False, True, GOOD), (False, False, DOUBTFUL), (True, True, DOUBTFUL)],
)
def test_a_version_is_good_unless_it_is_late_or_its_checksum_another(
    is_slow: bool, crc_matches: bool, verdict: Verdict
) -> None:
    class Latency(SimpleNamespace):
        def __str__(self) -> str:
            return "0.9 s there and back"

    version = SimpleNamespace(name="SDK-v1.0 M100", crc_matches=crc_matches)
    found = _version(cast(Any, version), cast(Any, Latency(is_slow=is_slow, round_trip_s=0.9)))
    assert (found.stage, found.verdict) == (Stage.VERSION, verdict)
    assert ("0.9 s there and back" in found.seen) is is_slow
    assert ("checksum" in found.seen) is (not is_slow and not crc_matches)


@pytest.mark.parametrize(
    ("mismatches", "is_known", "is_forced", "verdict", "command"),
    [
        (2, True, False, GOOD, ""),
        (2, False, True, GOOD, ""),
        (2, False, False, DOUBTFUL, "if you know that it fits: --firmware 3.1"),
        (3, True, True, FAILED, "leave --firmware out"),
        (3, True, False, FAILED, "m100link doctor PORT --firmware 1.0"),
    ],
)
def test_a_firmware_is_known_forced_or_another(
    mismatches: int, is_known: bool, is_forced: bool, verdict: Verdict, command: str
) -> None:
    version = SimpleNamespace(name="v", profile=PROFILES["3.1"] if is_known else None)
    aircraft = an_aircraft(telemetry_mismatches=mismatches)
    found = _firmware(aircraft, cast(Any, version), is_forced=is_forced)
    assert (found.stage, found.verdict) == (Stage.FIRMWARE, verdict)
    assert found.commands[:1] == ((command,) if command else ())
    assert not any("--firmware 3.1" in one for one in found.commands if "PORT" in one)
    assert ("(forced)" in found.seen) is (verdict is GOOD and is_forced)


P, A, F = -8000, 0, 8000


@pytest.mark.parametrize(
    ("channels", "verdict", "seen"),
    [
        (None, SKIPPED, "does not arrive"),
        ((0, 0, 0, 0, 0, 0), FAILED, "is not heard"),
        ((0, 0, 0, 0, F, -4545), GOOD, "F"),
        ((0, 0, 0, 0, A, -4545), FAILED, "it is in A"),
        ((9, 0, 0, 0, P, -10_000), FAILED, "it is in P"),
    ],
)
def test_the_mode_switch_is_in_f(
    channels: tuple[int, ...] | None, verdict: Verdict, seen: str
) -> None:
    records = [] if channels is None else [RemoteControl(*channels)]
    found = _mode_switch(an_aircraft(records=records))
    assert (found.stage, found.verdict) == (Stage.MODE_SWITCH, verdict)
    assert seen in found.seen


@pytest.mark.parametrize(
    ("code", "mode", "holder", "firmware", "seen"),
    [
        (AuthorityCode.NOT_IN_F, F, 0, "3.1", "the switch is in F"),
        (AuthorityCode.NOT_CHANGED, F, 0, "1.0", "the switch is in F"),
        (AuthorityCode.NOT_CHANGED, F, 0, "3.1", "it goes on being in progress"),
        (AuthorityCode.NOT_CHANGED, F, 1, "3.1", "the mobile app controls the aircraft"),
        (AuthorityCode.NOT_IN_F, F, 1, "1.0", "the mobile app controls the aircraft"),
        (AuthorityCode.NOT_IN_F, P, 1, "3.1", ""),
        (AuthorityCode.IOC_ON, F, 1, "3.1", ""),
    ],
)
def test_a_refusal_of_control_is_read_with_the_switch_and_the_holder(
    code: AuthorityCode, mode: int, holder: int, firmware: str, seen: str
) -> None:
    error = AuthorityRefused("refused", code=code)
    records = [RemoteControl(0, 0, 0, 0, mode, -4545), ControlDevice(holder, None)]
    found = _refused(an_aircraft(records=records, firmware=PROFILES[firmware]), error)
    assert (found.stage, found.verdict, found.error) == (Stage.AUTHORITY, FAILED, error)
    assert found.seen.startswith("refused")
    assert (seen in found.seen) if seen else (found.seen == "refused")


@pytest.mark.parametrize(
    ("has_key", "is_seen", "is_wanted", "why", "may_be"),
    [
        (False, True, True, "no app id and key were given", False),
        (True, False, True, "it is not seen standing", False),
        (True, None, True, "it is not seen standing", False),
        (True, True, False, "it was not to be tried", True),
    ],
)
async def test_control_is_asked_for_with_a_key_on_the_ground_and_when_it_is_wanted(
    has_key: bool,
    is_seen: bool | None,
    is_wanted: bool,
    why: str,
    may_be: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def stands(_state: object) -> bool | None:
        return is_seen

    monkeypatch.setattr(diagnosis, "stands", stands)
    key: Any = object() if has_key else None
    found = await _authority(an_aircraft(), key, authority=is_wanted)
    assert (found.verdict, found.details) == (SKIPPED, {"may_be_tried": may_be})
    assert why in found.seen


@pytest.mark.parametrize(
    ("bytes_later", "seen"), [(0, "fallen silent"), (1, "has answered 3 of 5")]
)
async def test_an_aircraft_that_does_not_answer_is_silent_or_loses_frames(
    bytes_later: int, seen: str
) -> None:
    counts = iter((700, 700 + bytes_later))

    def statistics() -> Any:
        counters = {"acks": 3, "expired": 2, "repeats": 4, "late_acks": 1}
        return SimpleNamespace(bytes_received=next(counts), **counters)

    aircraft = an_aircraft(statistics=statistics, link=SimpleNamespace(latency="0.2 s"))
    found = await _unanswered(Stage.KEY, aircraft, AckTimeout("no answer"))
    assert (found.stage, found.verdict) == (Stage.KEY, FAILED)
    assert seen in found.seen
    wanted = {"acks": 3, "repeats": 4, "late_acks": 1} if bytes_later else {}
    assert found.details == wanted


@pytest.mark.parametrize(("frames", "seen"), [(7, "heard 7"), (0, "fallen silent")])
async def test_an_aircraft_that_never_answered_was_heard_or_not(
    frames: int, seen: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def connect(_url: str, **_options: object) -> None:
        raise NoAircraft(f"heard {frames}", frames_received=frames, bytes_received=10 * frames)

    monkeypatch.setattr(diagnosis, "connect", connect)
    nothing: dict[str, Any] = dict.fromkeys(
        ("baud_rate", "firmware", "credentials", "acceleration", "authority")
    )
    talk = diagnosis.look_at_aircraft("sim://", **nothing)
    [found] = [one async for one in talk]
    assert (found.stage, found.verdict) == (Stage.VERSION, FAILED)
    assert seen in found.seen
    if frames:
        assert found.details == {"bytes": 70, "frames": 7}


class Talk(SimpleNamespace):
    """An aircraft that answers all a diagnosis asks, but for the calls that raise an error."""

    def __init__(self, met: dict[str, Exception]) -> None:
        reader = SimpleNamespace(
            has_arrived=True, mode=AccelerationMode.FUSED, seen=AccelerationMode.FUSED
        )
        super().__init__(
            met=met,
            closed=0,
            bytes_received=0,
            firmware=PROFILES["3.1"],
            telemetry_mismatches=0,
            _telemetry=SimpleNamespace(acceleration=reader),
            link=SimpleNamespace(
                latency=SimpleNamespace(is_slow=False, round_trip_s=0.01, slack_s=0.0)
            ),
            state=SimpleNamespace(fresh={RemoteControl: held()}.get),
        )

    def _asked(self, name: str) -> None:
        if name in self.met:
            raise self.met[name]

    @asynccontextmanager
    async def telemetry(self, *_: object, **__: object) -> AsyncIterator[Any]:
        yield None

    def statistics(self) -> Any:
        self.bytes_received += 5
        return SimpleNamespace(
            bytes_received=self.bytes_received, acks=3, expired=2, repeats=4, late_acks=1
        )

    async def version(self) -> Any:
        self._asked("version")
        profile = self.firmware
        return SimpleNamespace(name="M100", crc_matches=True, profile=profile, is_activated=True)

    async def activate(self, _: object, *, timeout: float) -> None:
        self._asked("activate")

    async def execute(self, what: object, *, encrypted: bool, tries: int) -> None:
        assert (type(what).__name__, encrypted, tries) == ("GetVersion", True, 2)
        self._asked("execute")

    @asynccontextmanager
    async def control(self) -> AsyncIterator[None]:
        self._asked("control")
        yield

    async def aclose(self) -> None:
        self.closed += 1


TALKED = [Stage.VERSION, Stage.FIRMWARE, Stage.ACCELERATION, Stage.ACTIVATION, Stage.KEY]
TALKED += [Stage.MODE_SWITCH, Stage.AUTHORITY]
COUNTERS = "m100link info PORT shows the counters of the line"


@pytest.mark.parametrize(
    ("met", "stage", "verdict", "seen", "command"),
    [
        ({}, "AUTHORITY", GOOD, "obtained, and given back at once", ""),
        ({"connect": PortBusy("in use")}, "VERSION", FAILED, "in use", ""),
        ({"version": LinkLost("gone")}, "VERSION", FAILED, "gone", "dmesg | tail"),
        ({"version": M100Error("odd")}, "VERSION", FAILED, "odd", COUNTERS),
        ({"version": AckTimeout("none")}, "VERSION", FAILED, "has answered 3 of 5", "check plugs"),
        ({"activate": LinkLost("gone")}, "ACTIVATION", FAILED, "gone", "dmesg | tail"),
        ({"activate": AckTimeout("none")}, "ACTIVATION", FAILED, "answered 3 of 5", "check plugs"),
        ({"execute": LinkLost("gone")}, "KEY", FAILED, "gone", "dmesg | tail"),
        ({"execute": KeyRejected("no")}, "KEY", DOUBTFUL, "got no usable answer", "compare the"),
        ({"control": LinkLost("gone")}, "AUTHORITY", FAILED, "gone", "dmesg | tail"),
        ({"control": NotActivated("not")}, "AUTHORITY", FAILED, "not", ""),
        ({"control": KeyRejected("no")}, "AUTHORITY", FAILED, "no", ""),
        ({"control": GuardRefused("no")}, "AUTHORITY", FAILED, "no", COUNTERS),
    ],
)
async def test_an_error_of_a_stage_is_its_finding_and_the_aircraft_is_let_go(
    met: dict[str, Exception],
    stage: str,
    verdict: Verdict,
    seen: str,
    command: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    talk = Talk(met)

    async def connect(url: str, **_: object) -> Any:
        assert url == "tcp://h:1"
        talk._asked("connect")
        return talk

    async def stands(_: object) -> bool:
        return True

    monkeypatch.setattr(diagnosis, "connect", connect)
    monkeypatch.setattr(diagnosis, "stands", stands)
    monkeypatch.setattr(diagnosis, "_at_rest", lambda _: None)
    how: dict[str, Any] = {"baud_rate": None, "firmware": None, "acceleration": None}
    key = Credentials(777_777, "5a" * 32)
    looked = diagnosis.look_at_aircraft("tcp://h:1", **how, credentials=key, authority=True)
    all_found = [one async for one in looked]
    found = next(one for one in all_found if one.stage is Stage[stage])
    assert (found.verdict, seen in found.seen) == (verdict, True)
    assert not command or any(command in one for one in found.commands)
    is_end = verdict is FAILED
    ends_at = TALKED.index(Stage[stage]) + 1 if is_end else len(TALKED)
    assert [one.stage for one in all_found] == TALKED[:ends_at]
    assert talk.closed == ("connect" not in met)


async def test_what_cannot_be_asked_of_the_aircraft_is_no_finding(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def connect(_: str, **__: object) -> Any:
        raise UsageError("no such firmware")

    monkeypatch.setattr(diagnosis, "connect", connect)
    nothing: dict[str, Any] = dict.fromkeys(
        ("baud_rate", "firmware", "credentials", "acceleration", "authority")
    )
    with pytest.raises(UsageError, match="no such firmware"):
        _ = [one async for one in diagnosis.look_at_aircraft("sim://", **nothing)]


# -- the port -------------------------------------------------------------------------------------


def test_who_has_the_device_open_and_who_holds_the_other_end(machine: FakeMachine) -> None:
    """The master of a pseudo-terminal is its other end, and this program is no other one."""

    def opens(pid: int, *files: str) -> None:
        machine.run(pid, f"/usr/bin/program{pid}")
        folder = machine.root / f"proc/{pid}/fd"
        folder.mkdir(parents=True)
        for number, name in enumerate(files):
            (folder / str(number)).symlink_to(name)

    opens(11, "/dev/null", "/dev/pts/913")
    opens(12, "/dev/pts/913", "/dev/ptmx")
    opens(13, "/dev/zero")
    opens(os.getpid(), "/dev/pts/913", "/dev/null")
    machine.run(14, "/usr/bin/secret")  # nobody may look into it
    assert machine.holders("/dev/pts/913") == (Process(11, "program11"),)
    assert machine.holders("/dev/zero") == (Process(13, "program13"),)
    opens(15, "/dev/zero", "/dev/ptmx")
    assert [one.pid for one in machine.holders("/dev/zero")] == [13, 15], "that is no terminal"
    assert machine.holders("/dev/full") == ()


@pytest.mark.parametrize(
    ("mode", "is_granted"), [(0o600, True), (0o400, False), (0o200, False), (0o000, False)]
)
def test_a_port_is_to_be_read_and_written(
    mode: int, is_granted: bool, machine: FakeMachine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As somebody else than root, who may do all."""
    port = machine.write("port", "")
    bits = {os.R_OK: 0o400, os.W_OK: 0o200}

    def access(path: str, wanted: int) -> bool:
        assert path == str(port)
        return all(mode & bit for flag, bit in bits.items() if wanted & flag)

    monkeypatch.setattr("m100link.apps.doctor.machine.os.access", access)
    assert machine.permission(str(port)).is_granted is is_granted


@pytest.mark.parametrize(
    ("group", "is_member", "cause", "command"),
    [
        ("dialout", True, "after you logged in", "log out and in again"),
        ("root", False, "no rule gives the device", "m100link udev --install"),
        ("0", False, "no rule gives the device", "m100link udev --install"),
        ("dialout", False, "not in the group dialout", "sudo usermod -aG dialout $USER"),
    ],
)
def test_what_may_not_be_opened_has_its_cause_by_the_group(
    group: str,
    is_member: bool,
    cause: str,
    command: str,
    machine: FakeMachine,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    refused = Permission("crw-rw----", "root", group, is_granted=False, is_member=is_member)
    monkeypatch.setattr(machine, "permission", lambda _: refused)
    *_, found = look_at_port("/dev/null", machine)
    assert (found.stage, found.verdict) == (Stage.PERMISSION, FAILED)
    assert cause in found.causes[0]
    assert found.commands[0] == command
    assert found.details == {"mode": "crw-rw----", "owner": "root", "group": group}


@pytest.mark.parametrize(
    ("latency", "verdict"), [(None, GOOD), (1, GOOD), (4, GOOD), (5, DOUBTFUL), (16, DOUBTFUL)]
)
def test_an_adapter_may_collect_for_four_milliseconds(
    latency: int | None, verdict: Verdict, machine: FakeMachine
) -> None:
    machine.plug_in("ttyUSB9", latency=latency)
    found = look_at_latency("/dev/ttyUSB9", machine)
    assert (found.stage, found.verdict) == (Stage.LATENCY, verdict)
    assert found.details == ({"latency_ms": latency} if verdict is DOUBTFUL else {})


def test_a_report_fails_at_its_first_failure() -> None:
    doubt = Stage.BYTES.doubtful("a", ("b",), ("c",), {"d": 1})
    first, second = Stage.FRAMES.failed("e"), Stage.KEY.failed("f")
    report = Report("sim://", (doubt, first, second))
    assert (report.failure, report.doubts) == (first, (doubt,))
    told = report.to_json()
    assert (told["ok"], told["failed"]) == (False, "frames")
    assert told["stages"][0] == {
        **{"stage": "bytes", "asked": "bytes arrive", "verdict": "doubtful", "seen": "a"},
        **{"causes": ["b"], "commands": ["c"], "details": {"d": 1}},
    }
    assert Report("sim://", (doubt,)).to_json()["ok"] is True
    error = UsageError("seen", cause="cause", remedy="remedy")
    told_of = failed(Stage.KEY, error, "then this")
    assert (told_of.seen, told_of.causes, told_of.commands) == (
        *("seen", ("cause",)),
        ("remedy", "then this"),
    )
    assert told_of.to_json()["error"] == "UsageError"
    assert (failed(Stage.KEY, UsageError("seen"), "then this").causes) == ()
    assert Finding(Stage.KEY, GOOD, "x").to_json().keys() == {"stage", "asked", "verdict", "seen"}


# -- the line -------------------------------------------------------------------------------------


async def test_other_rates_are_tried_by_how_often_they_are_met_and_the_own_one_is_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tried: list[int | None] = []
    closed: list[int | None] = []

    class Deaf:
        lost, is_lost, data = None, False, bytearray()

        async def listen(self, seconds: float) -> None:
            assert seconds in (line.SCAN_S, line.ANSWER_S)

        def say(self, data: bytes) -> None:
            assert data[:1] == b"\xaa"

        async def close(self) -> None:
            closed.append(tried[-1])  # before the next rate

    async def open_ear(address: ConnectionString) -> Deaf:
        tried.append(address.number)
        return Deaf()

    monkeypatch.setattr(line, "open_ear", open_ear)
    place = parse_url("serial:///dev/ttyUSB9:115200")
    assert await line._scan(place) is None
    assert tried == closed == [230_400, 921_600, 460_800, 1_000_000, 57_600]
    found = await line._no_frames(place, line.hear(b"\x91\x37" * 200))
    assert found.details["rates_tried"] == tried[:5]
    assert "at 115200 baud, nor at any other usual rate" in found.seen


@pytest.mark.parametrize(
    ("data", "is_echo"),
    [
        (line._QUERY, True),
        (line._QUERY * 2, True),
        (line._QUERY + TELEMETRY, False),
        (TELEMETRY, False),
        (b"", False),
        (encode_frame(b"\x00\x00\x00", session=2, sequence=0xD0C, is_ack=True), False),
        (encode_frame(b"\x00\x00\x00", session=2, sequence=0xD0D), False),
        (encode_frame(b"\x00\x00\x00", session=1, sequence=0xD0C), False),
        (encode_frame(b"\x00\x00\x01", session=2, sequence=0xD0C), False),
    ],
)
def test_an_echo_is_the_own_questions_and_nothing_else(data: bytes, is_echo: bool) -> None:
    assert line._is_echo(line.hear(data)) is is_echo


ACK = encode_frame(b"\x00\x01", session=2, sequence=0xD0C, is_ack=True)
NOISE = b"\x91\x37\x05" * 40


@pytest.mark.parametrize(
    ("url", "said", "answer", "closes", "stage", "verdict", "seen", "cause"),
    [
        ("/dev/ttyUSB9", b"", b"", False, "BYTES", FAILED, "not one byte in 2 s", "TX and RX are"),
        ("tcp://h:1", b"", b"", False, "BYTES", FAILED, "it is open, and not", "the program that"),
        ("udp://h:1", b"", b"", False, "BYTES", FAILED, "not one byte in 2 s", "TX and RX are"),
        (
            "/dev/ttyUSB9",
            NOISE,
            b"",
            True,
            "BYTES",
            FAILED,
            "the port went away",
            "the adapter was",
        ),
        ("tcp://h:1", NOISE, b"", True, "BYTES", FAILED, "other end closed", "the program that"),
        ("/dev/ttyUSB9", b"", line._QUERY, False, "FRAMES", FAILED, "comes back", "TX and RX of"),
        ("tcp://h:1", GPS, b"", False, "FRAMES", FAILED, "it is NMEA text", "a GPS receiver"),
        ("tcp://h:1", NOISE, b"", False, "FRAMES", FAILED, "not one valid frame", "noise: no"),
        ("tcp://h:1", TELEMETRY, b"", False, "TELEMETRY", GOOD, "packages of telemetry", ""),
        (
            "/dev/ttyUSB9",
            b"",
            ACK,
            False,
            "TELEMETRY",
            DOUBTFUL,
            "answers come, and",
            "all telemetry",
        ),
        ("tcp://h:1", line._QUERY, ACK, False, "TELEMETRY", DOUBTFUL, "answers", "all"),
    ],
)
async def test_a_line_is_judged_by_the_first_stage_that_fails(
    url: str,
    said: bytes,
    answer: bytes,
    closes: bool,
    stage: str,
    verdict: Verdict,
    seen: str,
    cause: str,
    machine: FakeMachine,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[bytes] = []

    def answered(question: bytes) -> bytes:
        asked.append(question)
        return answer

    Bench(monkeypatch, machine, url).speak(said, answered, closes=closes)
    *before, found = await line.look_at_line(parse_url(url))
    order = [Stage.OPENING, Stage.BYTES, Stage.FRAMES, Stage.TELEMETRY]
    assert [one.stage for one in before] == order[: order.index(Stage[stage])]
    assert (found.stage, found.verdict) == (Stage[stage], verdict)
    assert all(one.verdict in (GOOD, DOUBTFUL) for one in before)
    assert seen in found.seen
    assert "".join(found.causes[:1]).startswith(cause)
    assert closes or asked[:2] == [line._QUERY] * 2, "the version is asked for twice"


@pytest.mark.parametrize(
    ("error", "stage"), [(PortBusy("in use", remedy="end it"), Stage.OPENING), (BadURL("no"), None)]
)
async def test_a_line_that_does_not_open_is_a_finding_but_for_a_wrong_request(
    error: M100Error, stage: Stage | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def open_ear(_: ConnectionString) -> Any:
        raise error

    monkeypatch.setattr(line, "open_ear", open_ear)
    if stage is None:
        with pytest.raises(BadURL):
            await line.look_at_line(parse_url("tcp://h:1"))
        return
    [found] = await line.look_at_line(parse_url("tcp://h:1"))
    assert (found.stage, found.verdict, found.seen, found.error) == (stage, FAILED, "in use", error)
    assert (found.causes, found.commands) == ((), ("end it",))


# -- first contact --------------------------------------------------------------------------------


def test_pushes_are_counted_by_their_address_and_acks_are_none() -> None:
    witness = _Witness()
    push = encode_frame(b"\x02\x03" + bytes(6), session=0, sequence=1)
    ack = encode_frame(b"\x02\x03", session=2, sequence=1, is_ack=True)
    witness.tap(Direction.RECEIVED, push + ack + push, 1.0)
    witness.tap(Direction.SENT, push, 2.0)
    witness.tap(Direction.RECEIVED, encode_frame(b"\x02\x01\x04", session=2, sequence=2), 3.0)
    assert witness.pushes == {b"\x02\x03": 2, b"\x02\x01": 1}


@pytest.mark.parametrize(
    ("rows", "found"),
    [
        # Time, altitude and way: the greatest rise within six seconds, and the way meanwhile.
        ([(0.0, 10.0, 0.0), (1.0, 10.5, 0.25), (2.0, 11.25, 1.0)], (1.25, 1.0)),
        ([(0.0, 10.0, 0.0), (3.0, 9.0, 0.5), (5.0, 9.75, -0.25)], (0.75, -0.75)),
        ([(0.0, 10.0, 0.0), (6.0, 11.0, 2.0)], (1.0, 2.0)),
        ([(0.0, 10.0, 0.0), (6.5, 11.0, 2.0)], (0.0, 0.0)),  # a barometer that drifts
        ([(0.0, 10.0, 0.0), (1.0, 9.0, -1.0)], (0.0, 0.0)),
    ],
)
def test_a_lift_is_the_greatest_rise_in_six_seconds(
    rows: list[tuple[float, float, float]], found: tuple[float, float]
) -> None:
    assert _steepest([_Point(*row) for row in rows]) == pytest.approx(found)


def held(yaw: int = -9000, mode: int = F, roll: int = 0, gear: int | None = -4545) -> RemoteControl:
    return RemoteControl(roll, 0, yaw, 0, mode, gear)


@pytest.mark.parametrize(
    ("did", "before", "late", "found"),
    [
        (False, held(), [held()], ""),
        (True, None, [held()], ""),
        (True, held(yaw=-4999), [held()], ""),
        (True, held(yaw=-5000), [], "silent"),
        (True, held(yaw=5000), [], "silent"),
        (True, held(), [held(roll=0), held(roll=301)], ""),  # of 10000: somebody moves it
        (True, held(), [held(yaw=-9000), held(yaw=-8699)], ""),
        (True, held(), [held(roll=0), held(roll=300)], "kept"),
        (True, held(), [RemoteControl(0, 0, 0, 0, 0, 0)], "zeros"),
        (True, held(), [RemoteControl(0, 0, 0, 0, 0, None)], "zeros"),
        (True, held(), [held(yaw=-8700)], "kept"),
        (True, held(), [held(yaw=-8699)], "other"),
        (True, held(), [held(mode=P)], "other"),
        (True, held(), [held(yaw=0)], "centred"),
        (True, held(), [held(yaw=0, mode=P)], "other"),
        (True, held(), [held(yaw=0, gear=-10_000)], "other"),
    ],
)
def test_the_channels_of_a_remote_that_is_off(
    did: bool, before: RemoteControl | None, late: list[RemoteControl], found: str
) -> None:
    assert _lost(did, before, late)[0] == found


@pytest.mark.parametrize(
    ("rate", "count", "nearest"),
    [
        *((100.0, 500, 100), (70.0, 500, 50), (71.0, 500, 100), (30.0, 60, 50), (22.0, 60, 10)),
        *((3.2, 9, 10), (3.1, 9, 1), (0.4, 3, 1), (None, 1, 1), (None, 0, 0), (0.2, 3, 0)),
    ],
)
def test_a_rate_is_the_nearest_that_the_assistant_has(
    rate: float | None, count: int, nearest: int
) -> None:
    state = SimpleNamespace(statistics=lambda _: SimpleNamespace(rate_hz=rate, count=count))
    meeting = SimpleNamespace(_aircraft=SimpleNamespace(state=state))
    assert _Meeting._rate_of(cast(Any, meeting), Velocity) == nearest


def test_stages_have_their_order() -> None:
    names = [one.name for one in Stage]
    assert names == [
        *("PORT", "PERMISSION", "OWNER", "INTERFERENCE", "LATENCY", "OPENING", "BYTES", "FRAMES"),
        *("TELEMETRY", "VERSION", "FIRMWARE", "ACCELERATION", "ACTIVATION", "KEY"),
        *("MODE_SWITCH", "AUTHORITY"),
    ]


@pytest.mark.parametrize(
    ("code", "seen"),
    [
        (ActivationCode.LEVEL_TOO_HIGH, "activation was refused"),
        (ActivationCode.NEW_DEVICE, "activation was refused; so for 20 s"),
    ],
)
async def test_whose_app_it_is_stands_in_no_finding(
    code: ActivationCode, seen: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The error of a program names the app; a report is given to others."""
    waits: list[float] = []

    async def stands(_state: object) -> bool:
        return True

    async def activate(_credentials: object, *, timeout: float) -> None:
        waits.append(timeout)
        raise CommandRefused("activation of app 777777 was refused", code=code)

    link = SimpleNamespace(latency=SimpleNamespace(slack_s=0.75))
    aircraft = an_aircraft(activate=activate, link=link)
    key = Credentials(777_777, "5a" * 32)
    found = await _activation(aircraft, cast(Any, None), key)
    assert (found.stage, found.verdict) == (Stage.ACTIVATION, FAILED)
    assert found.seen.startswith(seen)
    assert "777777" not in str(found.to_json())
    meeting: Any = SimpleNamespace(_aircraft=aircraft, _asked=yes)
    aircraft._requests = SimpleNamespace(knows_firmware=True)
    monkeypatch.setattr(first_contact, "stands", stands)
    assert "777777" not in await _Meeting._obstacle(meeting, key)
    assert waits == [20.0 + 2 * 0.75, 20.0]  # a slow line adds two answers


async def yes(_text: str) -> bool:
    return True


@pytest.mark.parametrize(
    ("seen", "arrives", "firmware", "pushes", "told"),
    [
        ("raw", True, "3.1", 3, [("raw", "shown by its values at rest"), ("sent", "3 pushes")]),
        (None, True, "3.1", 0, [("", "its values at rest are neither"), ("not sent", "0 pushes")]),
        (
            None,
            False,
            "2.3",
            3,
            [("", "it does not arrive"), ("", "this firmware has no missions")],
        ),
    ],
)
async def test_at_rest_acceleration_and_mission_status_show_themselves(
    seen: str | None, arrives: bool, firmware: str, pushes: int, told: list[tuple[str, str]]
) -> None:
    """Of the pushes only those that come meanwhile count."""
    clock = asyncio.get_running_loop().time
    seen_of: list[tuple[Topic, str, str]] = []
    witness = _Witness()
    witness.pushes[b"\x02\x03"] = 7

    def rates() -> None:
        witness.pushes[b"\x02\x03"] += pushes

    meeting: Any = SimpleNamespace(
        **{"_witness": witness, "_clock": clock, "_rates": rates},
        _reader=SimpleNamespace(has_arrived=arrives, seen=seen),
        _aircraft=SimpleNamespace(firmware=PROFILES[firmware]),
        _see=lambda *found: seen_of.append(found),
    )
    began = clock()
    await _Meeting._at_rest(meeting)
    # Two seconds at least; six in which acceleration that arrives shows nothing.
    waits = 6.0 if arrives and seen is None else 2.0
    assert waits <= clock() - began < waits + 1.2
    assert [topic for topic, *_ in seen_of] == [Topic.ACCELERATION, Topic.MISSION_STATUS]
    for (_, found, figures), (wanted, words) in zip(seen_of, told, strict=True):
        assert (found, words in figures) == (wanted, True)
    assert firmware == "2.3" or seen_of[-1][2] == f"{pushes} pushes in {clock() - began:.1f} s"


@pytest.mark.parametrize(("firmware", "twice"), [("1.0", False), ("2.3", True), ("3.1", True)])
def test_code_3_means_in_progress_since_2_3(firmware: str, twice: bool) -> None:
    meeting: Any = SimpleNamespace(_aircraft=SimpleNamespace(firmware=PROFILES[firmware]))
    asks = _Meeting.__dict__["_asks_twice"]
    assert asks.fget(meeting) is twice


def meeting(**parts: Any) -> tuple[Any, list[tuple[Any, ...]]]:
    """A first contact with these parts, and what it sees."""
    seen: list[tuple[Any, ...]] = []
    one: Any = SimpleNamespace(
        contact=SimpleNamespace(is_given_back=None, get=lambda _: None),
        **{"_see": lambda *found: seen.append(found), "_witness": _Witness(), **parts},
    )
    return one, seen


SLOW = "250 ms in the median, 250 ms at most"


@pytest.mark.parametrize(
    ("answers_s", "found", "seen"),
    [
        ([0.1] * 20, "within 0.1 s", "100 ms in the median, 100 ms at most"),
        ([0.02] * 19 + [0.4], "within 0.1 s", "20 ms in the median, 400 ms at most"),
        ([0.25] * 15 + [None] * 5, "0.2 s", f"{SLOW}; 5 of 20 not at all"),
        ([None] * 20, "", "none of 20 version queries was answered"),
    ],
)
async def test_answers_have_their_median_and_their_longest_in_milliseconds(
    answers_s: list[float | None], found: str, seen: str
) -> None:
    now, answers = 10.0, iter(answers_s)

    async def version() -> None:
        nonlocal now
        took = next(answers)
        now += took or 1.0
        if took is None:
            raise AckTimeout("no answer")

    one, told = meeting(_clock=lambda: now, _aircraft=SimpleNamespace(version=version))
    await _Meeting._latency(one)
    [(topic, what, figures)] = told
    assert (topic, what) == (Topic.LATENCY, found)
    assert figures == seen
    assert next(answers, "asked twenty times") == "asked twenty times"


@pytest.mark.parametrize(
    ("known", "crc", "found", "seen"),
    [
        (True, True, "of a known firmware", "'M100', read as firmware 3.1"),
        (False, False, "unknown", "'M100', read as firmware 3.1; its own checksum is another"),
    ],
)
async def test_a_version_of_a_first_contact(known: bool, crc: bool, found: str, seen: str) -> None:
    async def version() -> Any:
        return SimpleNamespace(
            profile=PROFILES["3.1"] if known else None, crc_matches=crc, name="M100"
        )

    aircraft = SimpleNamespace(version=version, firmware=PROFILES["3.1"])
    one, told = meeting(_aircraft=aircraft)
    await _Meeting._version(one)
    assert told == [(Topic.VERSION, found, seen)]
    assert one.contact.firmware == "3.1"


NO_F, RELEASED, OBTAINED, SAME, GOING = AuthorityCode(0), *map(AuthorityCode, (1, 2, 3, 4))


@pytest.mark.parametrize(
    ("answers", "is_wanted", "codes", "error"),
    [
        ([OBTAINED], True, [2], ""),
        ([SAME, SAME, OBTAINED], True, [3, 3, 2], ""),
        ([SAME] * 9, True, [3] * 6, ""),  # six requests at most
        ([NO_F, OBTAINED], True, [0], ""),  # a refusal is not asked again
        ([RELEASED, OBTAINED], True, [1], ""),
        ([RELEASED], False, [1], ""),
        ([GOING, RELEASED], False, [4, 1], ""),
        ([SAME, AckTimeout("no answer")], True, [3], "no answer"),
    ],
)
async def test_authority_is_asked_for_until_it_is_so_or_refused(
    answers: list[Any], is_wanted: bool, codes: list[int], error: str
) -> None:
    asked: list[bool] = []
    loop = asyncio.get_running_loop()
    began = loop.time()

    async def execute(request: Any, *, timeout: float, tries: int, refusal: type) -> Any:
        assert (timeout, tries, refusal) == (1.0, 2, AuthorityRefused)
        asked.append(request.obtain)
        answer = answers[len(asked) - 1]
        if isinstance(answer, Exception):
            raise answer
        return answer

    one, _ = meeting(_aircraft=SimpleNamespace(execute=execute), _is_asking=False)
    found: list[int] = []
    assert await _Meeting._requested(one, found, is_wanted=is_wanted) == error
    assert found == codes
    assert asked == [is_wanted] * (len(codes) + bool(error))
    assert one._is_asking is bool(error), "it may have it by now"
    assert loop.time() - began == pytest.approx(0.1 * (len(asked) - 1), abs=0.01)


@pytest.mark.parametrize(
    ("answers", "holder", "pushes", "is_held", "back", "seen"),
    [
        (
            [1],
            0,
            2,
            True,
            True,
            [
                (Topic.RELEASE, "released", "1"),
                (Topic.OWN_RELEASE, "sent", "2 notifications in 2 s"),
            ],
        ),
        (
            [3, 3],
            2,
            0,
            True,
            False,
            [
                (Topic.RELEASE, "not released", "3, 3"),
                (Topic.OWN_RELEASE, "none", "0 notifications in 2 s"),
            ],
        ),
        ([1], 2, 0, False, False, []),  # the aircraft says that a computer has it
        ([1], None, 0, False, True, []),
    ],
)
async def test_control_is_given_back_when_the_aircraft_says_so(
    answers: list[int], holder: int | None, pushes: int, is_held: bool, back: bool, seen: list[Any]
) -> None:
    said: list[str] = []

    async def requested(codes: list[int], *, is_wanted: bool) -> str:
        assert is_wanted is False
        codes += answers
        one._witness.pushes[b"\x02\x01"] += pushes
        return ""

    device = None if holder is None else ControlDevice(holder, None)
    state = SimpleNamespace(fresh=lambda _: device)
    one, told = meeting(
        _requested=requested, _aircraft=SimpleNamespace(state=state), _say=said.append
    )
    await _Meeting._give_back(one, is_held=is_held)
    assert one.contact.is_given_back is back
    assert said == [
        "control authority is given back"
        if back
        else "the aircraft may still have it with this program: put the switch to P"
    ]
    assert told == seen


@pytest.mark.parametrize("way", ["ends", "is cut off", "fails", "is cancelled"])
async def test_however_a_first_contact_ends_it_is_kept_and_the_aircraft_closed(
    way: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    steps: list[str] = []

    async def hold(one: Any, _credentials: object) -> None:
        one.contact.firmware = "3.1"
        if way == "is cut off":
            raise LinkLost("serial:///dev/ttyUSB7 went away")
        if way == "fails":
            raise ZeroDivisionError
        try:
            await asyncio.sleep(0.0 if way == "ends" else 60.0)
        except asyncio.CancelledError:
            await asyncio.sleep(2.0)  # control goes back first
            steps.append("given back")
            raise

    async def aclose() -> None:
        steps.append("closed")

    async def open_aircraft(_: object) -> Any:
        link = SimpleNamespace(clock=asyncio.get_running_loop().time)
        return SimpleNamespace(
            link=link, _telemetry=SimpleNamespace(acceleration=None), aclose=aclose
        )

    async def ask(_: str) -> bool:
        return True

    kept: list[Contact] = []
    monkeypatch.setattr(_Meeting, "hold", hold)
    meet = asyncio.ensure_future(
        first_contact.first_contact(
            "tcp://h:1", ask=ask, open_aircraft=open_aircraft, keep=kept.append
        )
    )
    await asyncio.sleep(0.1)
    if way == "is cancelled":
        meet.cancel()
    await asyncio.wait([meet])
    assert steps == (["given back", "closed"] if way == "is cancelled" else ["closed"])
    assert [one.firmware for one in kept] == ["3.1"]
    assert meet.cancelled() is (way == "is cancelled")
    ended = {"is cancelled": "it was interrupted", "is cut off": "the line went away (LinkLost)"}
    assert (kept[0].ended_by, kept[0].is_cut_off) == (ended.get(way, ""), way == "is cut off")
    if way in ("ends", "is cut off"):
        assert meet.result() is kept[0]
    elif way == "fails":
        assert isinstance(meet.exception(), ZeroDivisionError)


@pytest.mark.parametrize(
    ("rates", "has_accelerated", "found", "seen"),
    [
        ({}, True, "as in the document", ""),
        ({"battery": 0, "rc": 100}, True, "rc 100, battery 0", "rc 100"),
        # Values that cannot be read yet are in no sample.
        ({"acceleration": 0}, True, "as in the document", ""),
        ({"acceleration": 0}, False, "acceleration 0", ""),
        (
            dict.fromkeys((one.name for one in BY_RECORD.values()), 0),
            False,
            None,
            "no item arrives",
        ),
    ],
)
def test_items_that_come_at_another_rate_are_named_and_absent_ones_are_not_listed(
    rates: dict[str, int], has_accelerated: bool, found: str | None, seen: str
) -> None:
    usual = {one.name: one.rate_hz for one in BY_RECORD.values()}
    one, told = meeting(
        _aircraft=SimpleNamespace(firmware=PROFILES["1.0"]),
        _reader=SimpleNamespace(has_arrived=has_accelerated),
        _rate_of=lambda record: (usual | rates)[BY_RECORD[record].name],
    )
    _Meeting._rates(one)
    [(topic, what, figures)] = told
    assert topic is Topic.ITEM_RATES
    assert found is None or sorted(what.split(", ")) == sorted(found.split(", "))
    here = {name: rate for name, rate in (usual | rates).items() if rate}
    assert figures == (", ".join(f"{name} {rate}" for name, rate in here.items()) or seen)


@pytest.mark.parametrize(
    ("has_key", "knows", "is_there", "agrees", "met", "why"),
    [
        (False, True, True, True, None, "no app id and key were given"),
        (True, False, True, True, None, "its firmware is unknown: nothing is asked of it"),
        (True, True, False, True, None, "it is not seen standing with its motors off"),
        (True, True, None, True, None, "it is not seen standing with its motors off"),
        (True, True, True, False, None, "the person did not want it"),
        (True, True, True, True, CommandRefused("refused", code=1), "refused"),
        (True, True, True, True, None, ""),
    ],
)
async def test_control_is_asked_of_an_aircraft_that_stands_with_the_word_of_its_person(
    has_key: bool,
    knows: bool,
    is_there: bool | None,
    agrees: bool,
    met: Exception | None,
    why: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    steps: list[str] = []

    async def stands(_: object) -> bool | None:
        return is_there

    async def asked(text: str) -> bool:
        assert text.startswith("May I ask the aircraft for control authority")
        steps.append("asked")
        return agrees

    async def activate(_: object, *, timeout: float) -> None:
        steps.append("activated")
        if met is not None:
            raise met

    monkeypatch.setattr(first_contact, "stands", stands)
    there = SimpleNamespace(
        state=None, activate=activate, _requests=SimpleNamespace(knows_firmware=knows)
    )
    one, _ = meeting(_aircraft=there, _asked=asked)
    key = Credentials(777_777, "5a" * 32) if has_key else None
    assert await _Meeting._obstacle(one, key) == why
    wanted = ["asked", "activated"] if has_key and knows and is_there else []
    assert steps == (wanted if agrees else wanted[:1])


@pytest.mark.parametrize("what", ["_obstacle", "_latency"])
async def test_a_line_that_goes_is_no_answer_of_the_aircraft(
    what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def stands(_: object) -> bool:
        return True

    async def gone(*_: object, **__: object) -> Any:
        raise LinkLost("gone")

    monkeypatch.setattr(first_contact, "stands", stands)
    requests = SimpleNamespace(knows_firmware=True)
    there = SimpleNamespace(state=None, activate=gone, version=gone, _requests=requests)
    one, told = meeting(_aircraft=there, _asked=yes, _clock=lambda: 0.0)
    key = [Credentials(777_777, "5a" * 32)] if what == "_obstacle" else []
    with pytest.raises(LinkLost):
        await getattr(_Meeting, what)(one, *key)
    assert told == []


@pytest.mark.parametrize(
    ("switch", "is_there", "codes", "error", "twice", "found", "seen", "back"),
    [
        (None, True, [2], "", True, "", "the switch is not told", None),
        (A, True, [2], "", True, "", "the switch is in A", None),
        (F, False, [2], "", True, "", "it is not seen standing with its motors off", None),
        (F, True, [3, 2], "", True, "obtained", "3, 2", True),
        (F, True, [0], "", True, "refused", "0", None),
        (F, True, [201], "", True, "refused", "201", None),  # a mode of flight of the remote
        (F, True, [3, 3], "", True, "in progress for ever", "3, 3", False),
        (F, True, [3, 3], "", False, "refused", "3, 3", None),
        (F, True, [], "no answer", True, "", "none; no answer", False),
        (F, True, [0], "no answer", True, "refused", "0; no answer", False),
    ],
)
async def test_what_was_asked_for_goes_back_unless_it_was_refused(
    switch: int | None,
    is_there: bool,
    codes: list[int],
    error: str,
    twice: bool,
    found: str,
    seen: str,
    back: bool | None,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A refusal says nothing of a later request that has no answer. ``back``: held, or None."""
    given: list[bool] = []
    steps: list[str] = []

    async def stands(_: object) -> bool:
        return is_there

    async def requested(into: list[int], *, is_wanted: bool) -> str:
        assert is_wanted
        into += codes
        one._is_asking = bool(error)
        return error

    async def give_back(*, is_held: bool) -> None:
        given.append(is_held)

    async def again() -> None:
        steps.append("again")

    monkeypatch.setattr(first_contact, "stands", stands)
    rc = None if switch is None else held(mode=switch)
    one, told = meeting(
        _aircraft=SimpleNamespace(state=SimpleNamespace(fresh=lambda _: rc)),
        **{"_asked": yes, "_say": steps.append, "_again": again, "_asks_twice": twice},
        **{"_requested": requested, "_give_back": give_back, "_is_asking": False},
    )
    await _Meeting._obtain_in(one, Topic.OBTAIN_F, RcMode.F)
    assert told == [(Topic.OBTAIN_F, found, seen)]
    assert given == ([] if back is None else [back])
    assert (len(steps) == 2 and steps[-1] == "again") is (found == "obtained")


def test_each_limit_is_as_agreed() -> None:
    assert limits.differences("apps/doctor") == []
