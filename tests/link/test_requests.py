"""What may go down the road, and what a type checker and the road itself refuse."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any, assert_type, cast

import pytest

from m100link import (
    Aircraft,
    BadAck,
    CommandNotSupported,
    Credentials,
    KeyRejected,
    LevelTooLow,
    LineBlocked,
    SilentLine,
    UsageError,
)
from m100link.link.requests import Requests
from m100link.protocol import (
    ActivationCode,
    ArmCode,
    AuthorityChanged,
    GetVersion,
    Move,
    Request,
    RequestAuthority,
    TaskResultCode,
    Version,
)
from m100link.protocol.codes import VersionCode
from m100link.protocol.commands.control import Arm, QueryTask
from m100link.protocol.commands.gimbal import GimbalAngle, TakePhoto
from m100link.protocol.commands.hotpoint import (
    FollowPauseResume,
    FollowStart,
    FollowStop,
    HotpointAutoRadius,
    HotpointPauseResume,
    HotpointStart,
    HotpointStop,
)
from m100link.protocol.commands.virtual_rc import VirtualRcSettings
from m100link.protocol.commands.waypoint import (
    WaypointDownloadMission,
    WaypointPauseResume,
    WaypointSetIdleSpeed,
    WaypointStartStop,
)
from m100link.protocol.firmware import PROFILES
from m100link.sim import VirtualClockEventLoop
from tests.rig import FIRMWARES, rig

pytestmark = pytest.mark.anyio

MOVE = Move(0x4B, 1.0, 0.0, 0.0, 0.0)


@pytest.fixture
def anyio_backend() -> object:
    return "asyncio", {"loop_factory": VirtualClockEventLoop}


@pytest.mark.parametrize("firmware", FIRMWARES)
async def test_an_answer_is_what_its_request_declares(firmware: str) -> None:
    async with rig(firmware=firmware) as flown:
        version = await flown.aircraft.execute(GetVersion())
        assert isinstance(version, Version)
        assert version.is_activated
        result = await flown.aircraft.execute(QueryTask(0))
        assert type(result) is TaskResultCode


async def test_a_version_answer_of_an_aircraft_that_is_not_activated_is_an_answer() -> None:
    async with rig(activated=False) as flown:
        version = await flown.aircraft.execute(GetVersion())
        assert not version.is_activated
        assert version.name == flown.virtual.autopilot.profile.version_name


async def test_a_movement_is_neither_executed_nor_pushed_past_the_control_block() -> None:
    """Executed, it would have been repeated twice: nothing ever answers it."""
    async with rig() as flown, flown.aircraft.control():
        with pytest.raises(UsageError, match="no ack"):
            await flown.aircraft.execute(cast("Any", MOVE))
        with pytest.raises(UsageError, match="cannot be pushed") as caught:
            flown.aircraft.push(cast("Any", MOVE))
        assert "control" in caught.value.remedy
        assert not flown.moves


IN_MOTION = [
    WaypointStartStop(stop=0),
    WaypointStartStop(stop=7),
    WaypointPauseResume(resume=1),
    WaypointSetIdleSpeed(5.0),
    HotpointStart(0.9, 0.1, altitude=20.0, radius=30.0, angular_rate=5.0),
    HotpointPauseResume(resume=1),
    HotpointAutoRadius(enable=1),
    FollowStart(0.9, 0.1),
    FollowPauseResume(resume=1),
]
AT_REST = [
    WaypointStartStop(stop=1),
    WaypointPauseResume(resume=0),
    WaypointDownloadMission(),
    HotpointStop(),
    HotpointPauseResume(resume=0),
    FollowStop(),
    FollowPauseResume(resume=0),
]


@pytest.mark.parametrize("request_", IN_MOTION, ids=repr)
async def test_no_mission_is_started_past_the_control_block(request_: Request[Any]) -> None:
    async with rig(firmware="3.1") as flown:
        before = len(flown.virtual.autopilot.received_commands)
        with pytest.raises(UsageError, match="in motion; nothing was sent") as caught:
            await flown.aircraft.execute(request_)
        assert "control" in caught.value.remedy
        assert len(flown.virtual.autopilot.received_commands) == before


@pytest.mark.parametrize("request_", AT_REST, ids=repr)
async def test_every_connected_program_may_stop_or_ask_for_a_mission(
    request_: Request[Any],
) -> None:
    async with rig(firmware="3.1") as flown:
        await flown.aircraft.execute(request_)
        [*_, command] = flown.virtual.autopilot.received_commands
        assert command.address == request_.ADDRESS


async def test_a_request_is_not_pushed() -> None:
    async with rig() as flown:
        with pytest.raises(UsageError, match="cannot be pushed"):
            flown.aircraft.push(cast("Any", RequestAuthority(obtain=True)))


@pytest.mark.parametrize("firmware", FIRMWARES)
async def test_what_the_firmware_does_not_know_is_refused_here(firmware: str) -> None:
    """A push would vanish in silence, and 0xFF00 does not tell an old firmware from a wrong key."""
    async with rig(firmware=firmware) as flown:
        profile = flown.aircraft.firmware
        before = len(flown.virtual.autopilot.received_commands)
        if TakePhoto.is_known_to(profile):
            assert flown.aircraft.push(TakePhoto())
        else:
            with pytest.raises(CommandNotSupported, match="take_photo"):
                flown.aircraft.push(TakePhoto())
        if not Arm.is_known_to(profile):
            with pytest.raises(CommandNotSupported, match="arm") as caught:
                await flown.aircraft.execute(Arm(on=True))
            assert "3.1" in caught.value.cause
        await asyncio.sleep(0.1)
        commands = list(flown.virtual.autopilot.received_commands)[before:]
        assert [type(c.command) for c in commands] == [TakePhoto] * (firmware != "1.0")
        assert flown.virtual.vehicle.camera.photos == (firmware != "1.0")


async def test_gimbal_and_camera_are_sent_encrypted_and_plain_without_a_key() -> None:
    async with rig(firmware="3.1") as flown:
        flown.aircraft.push(GimbalAngle(pitch_deg=-45.0, duration_s=0.5))
        await asyncio.sleep(1.0)
        [command] = [c for c in flown.virtual.autopilot.received_commands if c.address == (1, 0x1B)]
        assert command.encrypted
        assert flown.virtual.vehicle.gimbal.pitch == pytest.approx(-45.0)
        async with flown.virtual.connect() as other:
            other.push(TakePhoto())
            await asyncio.sleep(0.1)
        command = flown.virtual.autopilot.received_commands[-1]
        assert (type(command.command), command.encrypted) == (TakePhoto, False)


@pytest.mark.parametrize(("level", "goes"), [(0, False), (1, True), (2, True)])
async def test_the_level_that_the_camera_takes_is_enough(level: int, goes: bool) -> None:
    """Level 1 watches and moves camera and gimbal (document 2.1)."""
    async with rig(firmware="2.3", activated=False) as flown:
        known = flown.virtual.credentials
        await flown.aircraft.activate(Credentials(known.app_id, known.key, level=level))
        if goes:
            await flown.aircraft._requests.send(TakePhoto())
        else:
            with pytest.raises(LevelTooLow, match="take_photo was not sent"):
                await flown.aircraft._requests.send(TakePhoto())
        await asyncio.sleep(0.1)
        assert flown.virtual.vehicle.camera.photos == int(goes)


async def test_a_command_that_the_line_did_not_take_is_reported() -> None:
    async with rig(firmware="3.1") as flown:
        link = flown.aircraft.link
        link.pause_writing()  # as the transport says it
        with pytest.raises(LineBlocked, match="take_photo was not sent"):
            await flown.aircraft._requests.send(TakePhoto())
        link.resume_writing()
        await flown.aircraft._requests.send(TakePhoto())
        await asyncio.sleep(0.1)
        assert flown.virtual.vehicle.camera.photos == 1


@pytest.mark.parametrize("payload", [b"", b"\x07"])
async def test_what_a_wrong_key_makes_of_an_ack_is_reported_as_a_wrong_key(
    payload: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def scrambled(*_: object, **__: object) -> bytes:
        return payload

    async with rig() as flown:
        monkeypatch.setattr(flown.aircraft.link, "request", scrambled)
        with pytest.raises(KeyRejected):
            await flown.aircraft.execute(RequestAuthority(obtain=False))
        with pytest.raises(BadAck):
            await flown.aircraft.execute(GetVersion())


async def test_activation_travels_plain_even_with_a_key() -> None:
    async with rig() as flown:
        await flown.aircraft.activate(flown.virtual.credentials)
        commands = flown.virtual.autopilot.received_commands
        last = [command for command in commands if command.address == (0x00, 0x01)][-1]
        assert (last.encrypted, last.code) == (False, ActivationCode.SUCCESS)


async def what_mypy_allows(aircraft: Aircraft, requests: Requests) -> None:
    """Never called: the types of the answers are what is tested."""
    assert_type(await aircraft.execute(GetVersion()), Version)
    assert_type(await aircraft.execute(Arm(on=True)), ArmCode)
    assert_type(await requests.execute(QueryTask(1)), TaskResultCode)
    assert_type(aircraft.push(TakePhoto()), bool)
    assert_type(requests.push(MOVE), bool)


async def what_mypy_refuses(aircraft: Aircraft, requests: Requests) -> None:
    """Never called: where mypy has nothing against a line, it complains of an unused ignore."""
    await aircraft.execute(MOVE)  # type: ignore[arg-type]  # no ack: it would be repeated
    await requests.execute(MOVE)  # type: ignore[arg-type]  # the same
    await aircraft.execute(AuthorityChanged())  # type: ignore[arg-type]  # not ours to send
    aircraft.push(MOVE)  # type: ignore[arg-type]  # flies past the control block
    aircraft.push(VirtualRcSettings(is_on=True))  # type: ignore[arg-type]  # the same
    aircraft.push(GetVersion())  # type: ignore[arg-type]  # its answer would be lost
    requests.push(Arm(on=True))  # type: ignore[arg-type]  # the same
    requests.push(AuthorityChanged())  # type: ignore[arg-type]  # not ours to send


async def test_no_version_answer_changes_the_firmware_that_flies() -> None:
    """The newest one chooses again when the control block has ended."""
    requests = Requests(cast(Any, SimpleNamespace()))
    for firmware in ("3.1", "2.3"):
        profile = PROFILES[firmware]
        serial = "041" if profile.has_serial else None
        requests.version = Version(VersionCode.ACTIVATED, 0, profile.version_name, serial)
        requests._choose_firmware(requests.version)
        assert requests.firmware is PROFILES["3.1"]
        requests.fix_firmware()
    requests.free_firmware()
    assert requests.firmware is PROFILES["2.3"]


@pytest.mark.parametrize(("is_serial", "seconds"), [(True, 3.0), (False, 8.0)])
async def test_an_aircraft_that_is_not_heard_is_waited_for_longer_on_a_network(
    monkeypatch: pytest.MonkeyPatch, is_serial: bool, seconds: float
) -> None:
    heard = SimpleNamespace(bytes_received=0, frames_received=0, discarded_bytes=0)
    link = SimpleNamespace(is_serial=is_serial, name="line", statistics=lambda: heard)
    requests = Requests(cast(Any, link))

    async def unanswered(**_: object) -> Version:
        await asyncio.sleep(60.0)
        raise AssertionError

    monkeypatch.setattr(requests, "query_version", unanswered)
    loop = asyncio.get_running_loop()
    begun_at = loop.time()
    with pytest.raises(SilentLine):
        await requests.find_aircraft(None)
    assert loop.time() - begun_at == pytest.approx(seconds, abs=0.1)
