"""What the virtual aircraft does with a command follows from what the command declares."""

from __future__ import annotations

import itertools
import math
from random import Random
from typing import Any

import pytest

from m100link.protocol import (
    PROFILES,
    Activate,
    Command,
    FirmwareProfile,
    GetVersion,
    Move,
    Movement,
    Notification,
    Push,
    Request,
    RequestAuthority,
    Setpoint,
    SystemCode,
    encode_code,
)
from m100link.protocol.codes import MissionCode
from m100link.protocol.command import Address
from m100link.protocol.commands.hotpoint import (
    FollowStart,
    FollowTarget,
    HotpointDownload,
    HotpointSetRadius,
    HotpointSetRate,
    HotpointStop,
)
from m100link.protocol.commands.missions import (
    COMMAND_SET,
    IdleStatus,
    MissionStatus,
    WaypointStatus,
)
from m100link.protocol.commands.registry import COMMANDS
from m100link.protocol.commands.waypoint import (
    IdleSpeedAnswer,
    WaypointDownloadMission,
    WaypointDownloadPoint,
    WaypointGetIdleSpeed,
    WaypointMission,
    WaypointPauseResume,
    WaypointPoint,
    WaypointSetIdleSpeed,
    WaypointStartStop,
)
from m100link.sim.commands import refusal
from tests.sim.host import Host
from tests.sim.vehicle.missions.flights import (
    OK,
    SQUARE,
    begin,
    fly,
    host,
    hotpoint,
    point,
    upload,
    where,
)
from tests.support import load_vectors

# Missions are refused as a whole, in the shape of their acks.
SENT = [
    kind
    for address, kind in COMMANDS.items()
    if not issubclass(kind, Notification) and address.command_set != COMMAND_SET
]
REQUESTS: list[type[Request[Any]]] = [kind for kind in SENT if issubclass(kind, Request)]
UNREADABLE = bytes(101)  # no command takes so many bytes, but those that take any


def code_of(host: Host, kind: type[Command], value: bytes = UNREADABLE) -> int | None:
    """The code of the ack, None when there is no ack."""
    ack = host.ask_raw(bytes(kind.ADDRESS) + value, encrypted=False)
    return None if ack is None else int.from_bytes(ack.data[:2], "little")


@pytest.mark.parametrize("kind", SENT)
@pytest.mark.parametrize("firmware", PROFILES)
def test_every_command_is_known_from_its_firmware_on(firmware: str, kind: type[Command]) -> None:
    host = Host(firmware=firmware)
    host.activate()
    known = host.autopilot._commands.knows(bytes(kind.ADDRESS))
    assert known is kind.is_known_to(host.profile)
    if not known:
        assert code_of(host, kind) == SystemCode.NOT_SUPPORTED


@pytest.mark.parametrize("kind", SENT)
def test_commands_that_need_activation_are_refused_before_it(kind: type[Command]) -> None:
    code = code_of(Host(firmware="3.1"), kind)
    if not issubclass(kind, Request):
        assert code is None
    elif kind is not GetVersion:  # its answer says whether the aircraft is activated
        assert (code == SystemCode.NOT_ACTIVATED) is kind.NEEDS_ACTIVATION


@pytest.mark.parametrize("kind", REQUESTS)
@pytest.mark.parametrize("level", [0, 1, 2])
def test_a_level_below_the_declared_one_is_refused(level: int, kind: type[Request[Any]]) -> None:
    host = Host(firmware="2.3", level=level)
    host.activate(host.aircraft.credentials)
    if kind.is_known_to(host.profile):
        is_refused = code_of(host, kind) == SystemCode.LEVEL_TOO_LOW
        assert is_refused is (level < kind.LEVEL and kind.NEEDS_ACTIVATION)


@pytest.mark.parametrize(
    ("firmware", "kind"),
    [
        (name, kind)
        for name, firmware in PROFILES.items()
        for kind in REQUESTS
        if kind.is_known_to(firmware) and kind is not GetVersion  # which takes any value
    ],
)
def test_an_unreadable_value_is_answered_as_declared(
    firmware: str, kind: type[Request[Any]]
) -> None:
    host = Host(firmware=firmware).ready()
    assert code_of(host, kind) == kind.unreadable(host.profile)
    assert host.autopilot.received_commands[-1].command is None


@pytest.mark.parametrize("kind", [k for k in SENT if issubclass(k, (Push, Movement))])
@pytest.mark.parametrize("value", [b"", UNREADABLE])
def test_what_has_no_ack_is_never_answered(kind: type[Command], value: bytes) -> None:
    host = Host(firmware="3.1").ready()
    assert code_of(host, kind, value) is None


@pytest.mark.parametrize("kind", REQUESTS)
def test_an_ack_is_encrypted_as_its_request_unless_declared_plain(kind: type[Request[Any]]) -> None:
    host = Host(firmware="3.1").ready()
    ack = host.ask_raw(bytes(kind.ADDRESS) + UNREADABLE, encrypted=True)
    assert ack is not None
    assert ack.encrypted is not kind.ACK_IS_PLAIN


def test_activation_must_come_plain_whatever_it_says() -> None:
    host = Host().ready()
    for value in (UNREADABLE, host.activation().value(host.profile)):
        ack = host.ask_raw(bytes(Activate.ADDRESS) + value, encrypted=True)
        assert ack is not None
        assert ack.data == encode_code(2)


def test_movement_is_read_once_while_it_repeats(monkeypatch: pytest.MonkeyPatch) -> None:
    host = Host().flying()
    read: list[bytes] = []
    parse = Move.parse

    def noted(value: bytes, firmware: FirmwareProfile) -> Move:
        read.append(value)
        return parse(value, firmware)

    monkeypatch.setattr(Move, "parse", noted)
    for command in (Move(0x48, 1.0, 0.0, 0.0, 0.0), Move(0x48, 2.0, 0.0, 0.0, 0.0)):
        for _ in range(10):
            host.send(command.encode(host.profile), session=0, cipher=host.cipher)
    assert len(read) == 2
    assert len(host.autopilot.received_movements) == 20


# -- command set 0x03 over the line: acks to the byte, DJI's dialogues, what is pushed -------------


ROWS = load_vectors("later-commands")
DIALOGUES = [row for row in ROWS if row["kind"] == "dialogue"]
ACKS = {row["name"]: row for row in ROWS if row["kind"] == "ack" and row["set"] == 0x03}
COMMAND_ROWS = [row for row in ROWS if row["kind"] == "command" and row["set"] == 0x03]
NAMED: dict[str, type[Request[Any]]] = {
    kind.NAME: kind
    for kind in COMMANDS.values()
    if kind.ADDRESS.command_set == 0x03 and issubclass(kind, Request)
}
POINTS = [point(index, *place) for index, place in enumerate(SQUARE)]

# --- DJI's own tests ------------------------------------------------------------------------


@pytest.mark.parametrize("in_the_air", [False, True], ids=["on the ground", "in the air"])
@pytest.mark.parametrize("row", DIALOGUES, ids=lambda row: str(row["name"]))
def test_dialogues_of_djis_hardware_tests(row: dict[str, Any], in_the_air: bool) -> None:
    program = Host(firmware="3.1")
    program.activate()
    if row["authority"]:
        program.obtain()
    if in_the_air:
        program.motion.place(0.0, 0.0, 10.0)
        program.vehicle.flight.home = 0.0, 0.0
        program.vehicle.flight.phase = program.vehicle.flight.phase.IN_AIR
    latitude, longitude = map(math.radians, (22.5431, 113.9589))
    for step in row["steps"]:
        fields = dict(step["fields"])
        if "latitude_offset" in fields:
            fields["latitude"] = latitude + fields.pop("latitude_offset")
            fields["longitude"] = longitude + fields.pop("longitude_offset")
        kind = NAMED[step["command"]]
        ack = program.ask_raw(bytes(kind.ADDRESS) + bytes_of(kind, fields))
        assert ack is not None
        assert ack.data[0] == step["code"], (step, ack.data.hex())
        assert len(ack.data) == len(bytes.fromhex(ACKS[step["command"]]["value"]))


def bytes_of(kind: type[Any], fields: dict[str, Any]) -> bytes:
    """The value of a command, legal or not."""
    value: bytes = kind.LAYOUT.write(kind(**fields))
    return value


@pytest.mark.parametrize("field", ["max_speed", "idle_speed", "finish_action", "repeat", "count"])
def test_nonsense_in_a_mission_is_e0_and_then_nothing_may_start(field: str) -> None:
    program = host()
    upload(program, POINTS)
    fields = {"count": 3, "max_speed": 10.0, "idle_speed": 5.0} | {field: 0}
    if field.endswith("speed"):
        fields[field] = 99.0
    if field == "finish_action":
        fields[field] = 5
    value = bytes_of(WaypointMission, fields)
    ack = program.ask_raw(b"\x03\x10" + value)
    assert ack is not None
    assert ack.data == b"\xe0"
    assert program.ask(WaypointStartStop(0)) == MissionCode.NO_POINTS
    assert program.ask(POINTS[0]).code == MissionCode.NO_MISSION


# --- the shape of the answers ---------------------------------------------------------------


@pytest.mark.parametrize("row", COMMAND_ROWS, ids=lambda row: f"{row['name']}-{row['value'][:8]}")
def test_acks_have_the_size_that_djis_programs_check(row: dict[str, Any]) -> None:
    program = host()
    data = bytes((0x03, row["id"])) + bytes.fromhex(row["value"])
    ack = program.ask_raw(data, encrypted=False)
    if (
        row["name"] in ("hotpoint_set_rate", "hotpoint_set_radius", "hotpoint_reset_yaw")
        or row["name"] == "follow_target"
    ):
        assert ack is None
    else:
        assert ack is not None
        assert len(ack.data) == len(bytes.fromhex(ACKS[row["name"]]["value"]))


@pytest.mark.parametrize("level", [None, 1], ids=["not activated", "level 1"])
@pytest.mark.parametrize("name", NAMED)
def test_two_bytes_stand_for_the_code_before_activation_or_below_level_2(
    name: str, level: int | None
) -> None:
    program = Host(firmware="3.1", level=level or 2)
    if level is not None:
        program.activate()
    row = next(row for row in COMMAND_ROWS if row["name"] == name)
    ack = program.ask_raw(bytes((0x03, row["id"])) + bytes.fromhex(row["value"]), encrypted=False)
    assert ack is not None
    assert ack.data == (b"\x01\xff" if level is None else b"\x02\xff")
    assert ack.data[0] != 0  # what DJI's programs look at, and take for success when it is 0
    code = program.autopilot.received_commands[-1].code
    assert code == (0xFF01 if level is None else 0xFF02)


@pytest.mark.parametrize("name", NAMED)
def test_a_wrong_length_is_bad_parameters(name: str) -> None:
    program = host()
    ack = program.ask_raw(bytes(NAMED[name].ADDRESS) + bytes(7))
    assert ack is not None
    assert ack.data[0] == MissionCode.BAD_PARAMETERS
    assert len(ack.data) == len(bytes.fromhex(ACKS[name]["value"]))


@pytest.mark.parametrize("number", [0x12, 0x13, 0x22, 0x32])
@pytest.mark.parametrize("value", [2, 255])
def test_a_wrong_value_is_f4(number: int, value: int) -> None:
    ack = host().ask_raw(bytes((0x03, number, value)))
    assert ack is not None
    assert ack.data == b"\xf4"


def test_hotpoint_updates_are_answered_only_where_that_is_chosen() -> None:
    program = host(hotpoint_acks=True)
    change = bytes(HotpointSetRadius.ADDRESS) + bytes_of(HotpointSetRadius, {"radius": 20.0})
    ack = program.ask_raw(change)
    assert ack is not None
    assert ack.data == b"\xd4"


# --- what the handlers do -------------------------------------------------------------------


def test_a_download_gives_back_what_was_uploaded_and_nothing_after_the_end() -> None:
    program = host()
    nothing = program.ask(WaypointDownloadMission())
    assert (nothing.code, nothing.mission.count) == (MissionCode.NO_MISSION, 0)
    begin(program, POINTS, idle_speed=7.5)
    there = program.ask(WaypointDownloadMission())
    assert (there.code, there.mission.count, there.mission.idle_speed) == (OK, 4, 7.5)
    assert [program.ask(WaypointDownloadPoint(index)).point for index in range(4)] == [
        WaypointPoint.parse(bytes_of(WaypointPoint, _fields(each)), program.profile)
        for each in POINTS
    ]
    missing = program.ask(WaypointDownloadPoint(4))
    assert (missing.code, missing.point.latitude) == (MissionCode.NO_POINTS, 0.0)
    assert program.ask(WaypointStartStop(1)) == OK
    assert program.ask(WaypointDownloadMission()).mission.count == 0
    assert program.ask(WaypointStartStop(0)) == MissionCode.NO_POINTS


def _fields(each: WaypointPoint) -> dict[str, Any]:
    return each.raw()


def test_idle_speed_is_reported_and_changed_in_flight() -> None:
    program = host()
    assert program.ask(WaypointGetIdleSpeed()) == IdleSpeedAnswer(MissionCode.NO_MISSION, 0.0)
    assert program.ask(WaypointSetIdleSpeed(3.0)).code == MissionCode.NO_MISSION
    begin(program, [point(0, 0, 0, 10), point(1, 200, 0, 10)])
    program.wait(25.0)
    assert program.motion.velocity_north == pytest.approx(5.0, abs=0.1)
    assert program.ask(WaypointSetIdleSpeed(10.5)) == IdleSpeedAnswer(MissionCode.BAD_SPEED, 5.0)
    assert program.ask(WaypointSetIdleSpeed(8.0)) == IdleSpeedAnswer(OK, 8.0)
    assert program.ask(WaypointGetIdleSpeed()) == IdleSpeedAnswer(OK, 8.0)
    program.wait(4.0)
    assert program.motion.velocity_north == pytest.approx(8.0, abs=0.1)


def test_movement_commands_are_ignored_and_counted_while_a_mission_runs_or_is_paused() -> None:
    program = host()
    begin(program, POINTS)
    program.wait(12.0)
    before = program.autopilot.counters.ignored_movements
    program.fly(Setpoint.velocity(north=0, east=-9, up=0, yaw_rate_deg_s=0), 1.0)
    assert program.motion.east > -0.5
    assert program.autopilot.counters.ignored_movements == before + 50
    assert program.ask(WaypointPauseResume(0)) == OK
    at = where(program)
    program.fly(Setpoint.velocity(north=0, east=-9, up=0, yaw_rate_deg_s=0), 2.0)
    assert math.dist(at, where(program)) < 5.0  # it has braked
    assert program.autopilot.counters.ignored_movements == before + 150
    program.ask(WaypointStartStop(1))
    program.fly(Setpoint.velocity(north=0, east=-9, up=0, yaw_rate_deg_s=0), 2.0)
    assert program.motion.velocity_east < -5.0


def test_a_mission_flies_on_without_a_word_from_the_program() -> None:
    program = host()
    begin(program, POINTS)
    sent = len(program.autopilot.received_commands)
    track = fly(program)
    assert len(program.autopilot.received_commands) == sent
    assert math.dist(track[-1], SQUARE[-1]) < 0.5


# --- what is pushed -------------------------------------------------------------------------


def statuses(program: Host) -> list[tuple[float, Any]]:
    return [
        (time, MissionStatus.parse(frame.data[2:], program.profile).status)
        for time, frame in program.pushes(0x03)
    ]


def test_an_aircraft_without_a_mission_pushes_that_it_has_none() -> None:
    """As an owner of a Matrice 100 with 3.1.10 reports (Onboard-SDK 293)."""
    program = host(status_when_idle=False)
    program.wait(5.0)
    assert program.pushes(0x03) == program.pushes(0x04) == []
    older = Host(firmware="2.3")
    older.wait(5.0)
    assert older.pushes(0x03) == [], "which knows no missions"
    chatty = host()
    chatty.wait(5.05)
    assert len(statuses(chatty)) == pytest.approx(50, abs=1)
    assert {status for _, status in statuses(chatty)} == {IdleStatus()}


@pytest.mark.parametrize("rate", [1.0, 10.0, 50.0])
def test_the_status_comes_at_its_rate(rate: float) -> None:
    program = host(status_hz=rate)
    begin(program, POINTS)
    program.wait(10.0)
    times = [time for time, _ in statuses(program)]
    gaps = [later - earlier for earlier, later in itertools.pairwise(times)]
    assert len(times) == pytest.approx(10.0 * rate, abs=2)
    assert max(gaps) == pytest.approx(1.0 / rate, abs=0.011)


def test_a_box_that_is_not_ticked_keeps_everything_back() -> None:
    program = host(status_hz=0.0)
    begin(program, POINTS)
    fly(program)
    assert program.pushes(0x03) == program.pushes(0x04) == []


def test_the_status_tells_the_target_and_then_how_it_ended() -> None:
    program = host()
    begin(program, POINTS)
    fly(program)
    program.wait(0.3)
    told = [status for _, status in statuses(program)]
    waypoint = [status for status in told if isinstance(status, WaypointStatus)]
    assert [status.index for status in waypoint] == sorted(status.index for status in waypoint)
    assert {status.index for status in waypoint} == {0, 1, 2, 3}
    assert {status.status for status in waypoint} == {0, 1, 5, 6}
    assert told[-1] == IdleStatus(last_mission=1, flags=0, reason=0)


# --- hotpoint and follow over the line ------------------------------------------------------


def flying(program: Host, height: float = 15.0) -> Host:
    program.take_off()
    program.motion.place(*where(program)[:2], height)
    return program


def test_a_hotpoint_is_started_changed_downloaded_and_stopped() -> None:
    program = flying(host())
    answer = program.ask(hotpoint())
    assert (answer.code, answer.largest_radius) == (OK, 500.0)
    down = program.ask(HotpointDownload())
    assert (down.code, down.hotpoint.radius) == (OK, 10.0)
    assert program.ask(HotpointSetRate(0, 5.0)) is None
    assert program.ask(HotpointStop()) == OK
    assert program.ask(HotpointDownload()).code == MissionCode.NOT_RUNNING


def test_follow_takes_targets_without_an_answer() -> None:
    program = flying(host())
    here = hotpoint()
    assert program.ask(FollowStart(here.latitude, here.longitude)) == OK
    assert program.ask(FollowTarget(here.latitude, here.longitude)) is None


def test_every_command_of_the_set_is_carried_out() -> None:
    program = host()
    known = {kind.ADDRESS for kind in COMMANDS.values() if kind.ADDRESS.command_set == 0x03}
    assert len(known) == 20
    for row in COMMAND_ROWS:
        address = Address(0x03, row["id"])
        program.send(bytes(address) + bytes.fromhex(row["value"]))
        last = program.autopilot.received_commands[-1]
        assert last.address == address
        known.discard(address)
    assert known == set()


# --- firmware that knows no missions --------------------------------------------------------


@pytest.mark.parametrize("row", COMMAND_ROWS, ids=lambda row: f"{row['name']}-{row['value'][:16]}")
def test_a_refusal_is_as_long_as_the_ack(row: dict[str, Any]) -> None:
    payload = refusal(bytes((row["set"], row["id"])) + bytes.fromhex(row["value"]))
    if row["name"] == "follow_target":
        assert payload is None
        return
    assert payload is not None
    assert len(payload) == len(bytes.fromhex(ACKS[row["name"]]["value"]))
    assert payload[0] == 0xC8
    if row["name"] == "waypoint_point":
        assert payload[1] == row["fields"]["index"]


@pytest.mark.parametrize("data", [b"\x03\x11", b"\x03\x40abc", b"\x03\xff", b"\x03"])
def test_whatever_comes_the_first_byte_is_not_success(data: bytes) -> None:
    payload = refusal(data)
    assert payload is not None
    assert payload[0] == 0xC8


# --- anything -------------------------------------------------------------------------------

ODD = (math.nan, math.inf, -1.0, 0.0, 300.0, 1e30)


def _random_fields(kind: Any, random: Random) -> dict[str, Any]:
    """Mostly what flies, sometimes what nobody should send."""
    fields: dict[str, Any] = kind.from_wire(bytes(kind.LAYOUT.size)).raw()
    latitude, longitude = map(math.radians, (22.5431, 113.9589))
    index = random.randrange(3)
    offset = 3e-6 * index
    usual: dict[str, Any] = {
        **{"latitude": latitude + offset, "longitude": longitude - offset, "count": 3},
        **{"index": index, "altitude": random.choice((0, 8, 20)), "repeat": 1},
        **{"max_speed": 10.0, "idle_speed": random.choice((5.0, 0.0, -3.0)), "damping": 2.0},
        **{"radius": 10.0, "angular_rate": 15.0, "action_time_limit": 20},
    }
    for name, value in fields.items():
        if isinstance(value, list):
            fields[name] = tuple(random.randrange(6) for _ in value)
        elif name.endswith(("_mode", "_action")) or name in ("clockwise", "stop", "start_point"):
            fields[name] = random.choice((0, 0, 0, 1, 1, 9))
        elif name in usual and random.random() < 0.97:
            fields[name] = usual[name] if isinstance(value, float) else int(usual[name])
        elif isinstance(value, float):
            fields[name] = random.choice(ODD)
        else:
            fields[name] = random.choice((0, 0, 1, 1, 2, 3, 9))
    return fields


def _disturbed(seed: int) -> set[str]:
    """Send anything while anything happens; the kinds of missions that were flown."""
    random = Random(seed)
    program = host(leaving_f_pauses=seed % 2 == 0, hotpoint_acks=seed % 3 == 0)
    kinds: list[Any] = [kind for kind in COMMANDS.values() if kind.ADDRESS.command_set == 0x03]
    often = {"waypoint_point": 20, "waypoint_start_stop": 4}
    weights = [often.get(kind.NAME, 1) for kind in kinds]
    pilot = program.aircraft
    if seed % 2:
        program.take_off()
        program.motion.place(0.0, 0.0, 12.0)
    seen = set()
    for _ in range(250):
        (kind,) = random.choices(kinds, weights)
        value = kind.LAYOUT.write(kind(**_random_fields(kind, random)))
        if random.random() < 0.05:
            value = random.randbytes(random.randrange(100))
        program.send(bytes(kind.ADDRESS) + value, session=random.choice((0, 2)))
        if random.random() < 0.3:
            program.wait(random.choice((0.05, 1.0, 4.0)), 0.05)
        if random.random() < 0.02:
            random.choice((pilot.leave_f, pilot.rc_lost, pilot.pilot_lands))()
            program.wait(random.choice((0.05, 4.0)), 0.05)
        elif random.random() < 0.1:
            pilot.return_to_f()
            pilot.rc_back()
            program.ask(RequestAuthority(True))
        assert all(map(math.isfinite, where(program)))
        seen.add(program.vehicle.missions.name)
    return seen


def test_whatever_is_sent_and_whatever_happens_nothing_raises() -> None:
    seen = set().union(*map(_disturbed, range(8)))
    assert seen == {"no", "waypoint", "hotpoint", "follow"}
