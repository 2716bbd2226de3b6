"""Camera and gimbal over MAVLink: signs, units and frames are those of the definitions."""

from __future__ import annotations

import math
from collections.abc import AsyncIterator
from itertools import pairwise
from random import Random
from typing import Any

import anyio
import pytest

from m100link.apps.agent import orders
from m100link.apps.mavlink.translator.codec import LAYOUTS
from m100link.apps.mavlink.translator.numbers import MavCommand, MavResult
from m100link.apps.mavlink.translator.telemetry import STREAMS
from m100link.geodesy import normalize_degrees
from m100link.protocol.commands.gimbal import GimbalAngle, GimbalSpeed
from m100link.sim.line import LineFaults
from m100link.sim.vehicle.gimbal import GimbalMount
from m100link.sim.vehicle.settings import AircraftSettings
from tests.apps.mavlink.conftest import Ground, Rig

pytestmark = pytest.mark.anyio

CAMERA, AUTOPILOT = 100, 1
NAN = math.nan
ACCEPTED, REJECTED, DENIED = MavResult.ACCEPTED, MavResult.TEMPORARILY_REJECTED, MavResult.DENIED
UNSUPPORTED = MavResult.UNSUPPORTED
CAMERAS = ("CAMERA_INFORMATION", "CAMERA_SETTINGS", "STORAGE_INFORMATION", "CAMERA_CAPTURE_STATUS")
GIMBALS = ("GIMBAL_MANAGER_INFORMATION", "GIMBAL_DEVICE_INFORMATION", "GIMBAL_MANAGER_STATUS")
ATTITUDE = "GIMBAL_DEVICE_ATTITUDE_STATUS"

# GIMBAL_MANAGER_FLAGS
RETRACT, NEUTRAL, ROLL_LOCK, PITCH_LOCK, LOCK, OF_NOSE, OF_NORTH = 1, 2, 4, 8, 16, 32, 64

PHOTO, NO_PHOTOS = MavCommand.IMAGE_START_CAPTURE, MavCommand.IMAGE_STOP_CAPTURE
VIDEO, NO_VIDEO = MavCommand.VIDEO_START_CAPTURE, MavCommand.VIDEO_STOP_CAPTURE
POINT, CONFIGURE = MavCommand.DO_GIMBAL_MANAGER_PITCHYAW, MavCommand.DO_GIMBAL_MANAGER_CONFIGURE
LOOK, LOOK_AWAY = MavCommand.DO_SET_ROI_LOCATION, MavCommand.DO_SET_ROI_NONE


@pytest.fixture
async def rig() -> AsyncIterator[Rig]:
    nose = AircraftSettings(heading_deg=25.0)  # where frames differ
    async with Rig(firmware="3.1", settings=nose).running() as one:
        await one.until(lambda: bool(one.ground.cameras))
        await one.client.ask(orders.Activate())
        yield one


@pytest.mark.parametrize("firmware", ["2.3", "3.1"])
async def test_the_first_orders_are_accepted_and_activate_the_aircraft(firmware: str) -> None:
    """At once: it takes longer than MAVSDK waits, which takes IN_PROGRESS for a failure."""
    async with Rig(firmware=firmware).running() as rig:
        ground = rig.ground
        ground.command(POINT, -30, 0, NAN, NAN, 0, NAN, 1)
        for _ in range(3):
            ground.command(PHOTO, 0, 2, 2, 0, component=CAMERA)
        await anyio.sleep(0.1)
        assert [one["result"] for one in ground.all("COMMAND_ACK")] == [ACCEPTED] * 4
        assert photos(rig) == 0
        await anyio.sleep(6.0)
        assert rig.client.state.is_activated
        assert not rig.client.has_authority
        assert looks(rig)[0] == pytest.approx(-30.0, abs=0.2)
        assert photos(rig) == 2
        assert len(ground.all("COMMAND_ACK")) == 4


async def test_a_first_order_that_comes_to_nothing_says_why() -> None:
    async with Rig(firmware="3.1").running() as rig:
        rig.aircraft.unplug()
        rig.ground.command(PHOTO, 0, 0, 1, 1, component=CAMERA)
        await anyio.sleep(20.0)
        assert "camera: " in rig.ground.texts
        # Without an aircraft there is no component of that number, and no gimbal.
        rig.ground.command(PHOTO, 0, 0, 1, 2, component=CAMERA)
        assert await rig.ground.ask(POINT, -30, 0, NAN, NAN, LOCK, NAN, 1) is UNSUPPORTED
        assert photos(rig) == 0


async def test_an_aircraft_that_falls_silent_takes_no_orders(rig: Rig, ground: Ground) -> None:
    rig.aircraft.set_faults(LineFaults(loss=1.0))
    await rig.until(lambda: not rig.client.view.is_heard)
    assert await ground.ask(PHOTO, 0, 0, 1, 2, component=CAMERA) is REJECTED
    assert await ground.ask(POINT, -30, 0, NAN, NAN, LOCK, NAN, 1) is REJECTED
    await rig.until(lambda: "gimbal: the aircraft is not heard" in ground.texts)
    assert "camera: the aircraft is not heard" in ground.texts


def number(name: str) -> int:
    return LAYOUTS[name].number


def mount(rig: Rig) -> GimbalMount:
    return rig.aircraft.vehicle.gimbal


def photos(rig: Rig) -> int:
    return rig.aircraft.vehicle.camera.photos


def is_recording(rig: Rig) -> bool:
    return rig.aircraft.vehicle.camera.is_recording


def looks(rig: Rig) -> tuple[float, float]:
    """Where the camera looks: pitch, up is positive, and degrees clockwise from north."""
    flight = rig.aircraft.vehicle.flight
    yaw = normalize_degrees(math.degrees(flight.dynamics.yaw) + mount(rig).yaw)
    return mount(rig).pitch, yaw


def heading(rig: Rig) -> float:
    return math.degrees(rig.aircraft.vehicle.flight.dynamics.yaw)


async def shown(rig: Rig, ground: Ground, name: str) -> dict[str, Any]:
    """A message by request, from the component that has it."""
    component = STREAMS[name].component
    asked = MavCommand.REQUEST_MESSAGE, number(name)
    assert await ground.ask(*asked, component=component) is ACCEPTED
    assert ground.last(name).component == component
    return dict(ground.last(name).fields)


# -- what is said ----------------------------------------------------------------------------------


async def test_the_camera_is_a_component_with_a_heartbeat_of_its_own(
    rig: Rig, ground: Ground
) -> None:
    known = len(ground.cameras)
    await anyio.sleep(5.0)
    assert len(ground.cameras) - known == pytest.approx(5, abs=1)
    beat = ground.cameras[-1]
    # MAV_COMP_ID_CAMERA, MAV_TYPE_CAMERA, MAV_AUTOPILOT_INVALID
    assert (beat.component, beat["type"], beat["autopilot"]) == (100, 30, 8)
    assert {one.component for one in ground.all("HEARTBEAT")} == {1}


async def test_frames_of_each_component_are_counted_alone(rig: Rig, ground: Ground) -> None:
    rig.sent.clear()
    await anyio.sleep(3.0)
    counts: dict[int, list[int]] = {}
    for data, _ in rig.sent:
        at = 0
        while at < len(data):
            counts.setdefault(data[at + 6], []).append(data[at + 4])
            at += 10 + data[at + 1] + 2
    assert set(counts) == {1, 100}
    for found in counts.values():
        assert {(after - before) & 0xFF for before, after in pairwise(found)} == {1}


async def test_what_nobody_knows_of_the_camera_is_unknown_by_the_definition(
    rig: Rig, ground: Ground
) -> None:
    camera = await shown(rig, ground, "CAMERA_INFORMATION")
    assert bytes(camera["vendor_name"]).rstrip(b"\0") == b"DJI"
    assert all(
        math.isnan(camera[one]) for one in ("focal_length", "sensor_size_h", "sensor_size_v")
    )
    unknown = ("firmware_version", "resolution_h", "resolution_v", "lens_id", "camera_device_id")
    assert [camera[one] for one in unknown] == [0] * 5
    # Video, images; no modes (4), no zoom (64), no focus (128), no stream (256).
    assert camera["flags"] == 1 | 2 | 16
    assert (camera["gimbal_device_id"], camera["cam_definition_uri"]) == (1, "")
    settings = await shown(rig, ground, "CAMERA_SETTINGS")
    assert math.isnan(settings["zoomLevel"])
    assert math.isnan(settings["focusLevel"])
    storage = await shown(rig, ground, "STORAGE_INFORMATION")
    assert (storage["storage_id"], storage["storage_count"], storage["status"]) == (1, 1, 3)
    status = await shown(rig, ground, "CAMERA_CAPTURE_STATUS")
    assert math.isnan(status["available_capacity"])
    zeros = ("image_status", "video_status", "image_interval", "recording_time_ms", "image_count")
    assert [status[one] for one in zeros] == [0] * 5


@pytest.mark.parametrize("name", CAMERAS)
async def test_the_older_commands_ask_for_the_same(ground: Ground, name: str) -> None:
    assert await ground.ask(MavCommand[f"REQUEST_{name}"], 1, component=CAMERA) is ACCEPTED
    assert ground.last(name).component == CAMERA


@pytest.mark.parametrize("name", [*CAMERAS, *GIMBALS, ATTITUDE])
async def test_each_component_has_its_messages_and_no_others(ground: Ground, name: str) -> None:
    other = CAMERA if STREAMS[name].component == AUTOPILOT else AUTOPILOT
    asked = MavCommand.REQUEST_MESSAGE, number(name)
    assert await ground.ask(*asked, component=other) is UNSUPPORTED


@pytest.mark.parametrize(
    "command",
    [MavCommand.COMPONENT_ARM_DISARM, MavCommand.NAV_TAKEOFF, MavCommand.NAV_LAND, POINT, 530, 531],
)
async def test_the_camera_neither_flies_nor_has_modes(ground: Ground, command: int) -> None:
    assert await ground.ask(command, 1, component=CAMERA) is UNSUPPORTED


async def test_of_firmware_1_there_is_neither_camera_nor_gimbal() -> None:
    async with Rig(firmware="1.0").running() as one:
        ground = one.ground
        for name in (*GIMBALS, ATTITUDE):
            asked = MavCommand.REQUEST_MESSAGE, number(name)
            assert await ground.ask(*asked) is UNSUPPORTED
        assert await ground.ask(POINT, -30, 0, NAN, NAN, 0, NAN, 1) is UNSUPPORTED
        assert await ground.ask(PHOTO, 0, 0, 1) is UNSUPPORTED
        ground.command(MavCommand.REQUEST_MESSAGE, number("CAMERA_INFORMATION"), component=CAMERA)
        ground.send("GIMBAL_MANAGER_SET_PITCHYAW", target_system=1, pitch=-0.5)
        await anyio.sleep(3.0)
        assert ground.cameras == ground.all("GIMBAL_MANAGER_STATUS") == ground.all(ATTITUDE) == []


# -- the camera ------------------------------------------------------------------------------------


async def test_one_photo_is_taken_once_however_often_it_is_asked_for(
    rig: Rig, ground: Ground
) -> None:
    assert await ground.ask(PHOTO, 0, 0, 1, 1, component=CAMERA) is ACCEPTED
    assert photos(rig) == 1
    await anyio.sleep(1.5)
    assert await ground.ask(PHOTO, 0, 0, 1, 1, component=CAMERA) is ACCEPTED  # sent again
    assert photos(rig) == 1
    assert await ground.ask(PHOTO, 0, 0, 1, 2, component=CAMERA) is ACCEPTED
    assert photos(rig) == 2
    await anyio.sleep(4.0)
    assert await ground.ask(PHOTO, 0, 0, 1, 2, component=CAMERA) is ACCEPTED  # of a later program
    assert photos(rig) == 3


async def test_copies_of_a_photo_that_come_at_once_are_one_photo_and_one_answer(
    rig: Rig, ground: Ground
) -> None:
    for _ in range(5):
        ground.command(PHOTO, 0, 0, 1, 7, component=CAMERA)
    await anyio.sleep(2.0)
    answers = [one for one in ground.all("COMMAND_ACK") if one["command"] == PHOTO]
    assert [one["result"] for one in answers] == [ACCEPTED]
    assert photos(rig) == 1
    await anyio.sleep(2.0)
    for _ in range(5):
        ground.command(PHOTO, 0, 3, 2, 0, component=CAMERA)
    await anyio.sleep(8.0)
    answers = [one for one in ground.all("COMMAND_ACK") if one["command"] == PHOTO]
    assert [one["result"] for one in answers] == [ACCEPTED, ACCEPTED]
    assert photos(rig) == 3


async def test_photos_are_taken_at_an_interval_until_their_number(rig: Rig, ground: Ground) -> None:
    assert await ground.ask(PHOTO, 0, 2.0, 3, 0, component=CAMERA) is ACCEPTED
    status = await shown(rig, ground, "CAMERA_CAPTURE_STATUS")
    assert (status["image_status"], status["image_interval"]) == (2, 2.0)
    for after, count in ((1.0, 1), (1.5, 2), (2.0, 3), (6.0, 3)):
        await anyio.sleep(after)
        assert photos(rig) == count
    assert ground.last("CAMERA_CAPTURE_STATUS")["image_status"] == 0, "everybody hears its end"


async def test_photos_hold_their_interval_and_none_that_was_missed_is_made_up(
    rig: Rig, ground: Ground, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each 2 s: late by less than that, the next one is on time; a camera takes no burst."""
    assert await ground.ask(PHOTO, 0, 2.0, 0, 0, component=CAMERA) is ACCEPTED
    await anyio.sleep(0.5)
    payload, taken, after = rig.vehicle._payload, list[float](), 0.0
    monkeypatch.setattr(payload, "_use", lambda *_: taken.append(after))
    assert payload._interval is not None
    assert payload._interval.due_at is not None
    first_at = payload._interval.due_at
    for after in (0.0, 1.9, 3.5, 3.9, 4.0, 16.0, 16.1, 17.9, 18.0, 20.0):
        payload.advance(first_at + after, lambda *_: False, ())
    assert taken == [0.0, 3.5, 4.0, 16.0, 18.0, 20.0]


async def test_photos_without_a_number_are_taken_until_they_are_stopped(
    rig: Rig, ground: Ground
) -> None:
    assert await ground.ask(PHOTO, 0, 1.5, 0, 0, component=CAMERA) is ACCEPTED
    await anyio.sleep(9.2)
    assert photos(rig) == 7
    assert await ground.ask(PHOTO, 0, 0, 1, 9, component=CAMERA) is REJECTED
    await rig.until(lambda: "interval" in ground.texts)
    assert await ground.ask(NO_PHOTOS, 0, component=CAMERA) is ACCEPTED
    await anyio.sleep(5.0)
    assert photos(rig) == 7
    assert await ground.ask(NO_PHOTOS, 0, component=CAMERA) is ACCEPTED


@pytest.mark.parametrize(
    ("parameters", "text"),
    [
        ((0, 0, 0, 0), "a photo every 0 s; 1 s is the least"),
        ((0, 1e-9, 0, 0), "1e-09 s"),
        ((0, -1, 5, 0), "-1 s"),
        ((0, NAN, 5, 0), "nan s"),
        ((0, 2, NAN, 0), "number of photos"),
        ((0, 2, -1, 0), "number of photos"),
        ((7, 0, 1, 1), "no camera 7"),
        ((0, math.inf, 0, 0), "not finite"),
        ((0, 2, math.inf, 0), "not finite"),
    ],
)
async def test_photos_that_cannot_be_are_denied_with_the_reason(
    rig: Rig, ground: Ground, parameters: tuple[float, ...], text: str
) -> None:
    assert await ground.ask(PHOTO, *parameters, component=CAMERA) is DENIED
    await rig.until(lambda: text in ground.texts)
    assert photos(rig) == 0


async def test_a_number_of_photos_beyond_any_card_ends_when_it_is_stopped(
    rig: Rig, ground: Ground
) -> None:
    assert await ground.ask(PHOTO, 0, 1e6, 2**31, 0, component=CAMERA) is ACCEPTED
    await anyio.sleep(30.0)
    assert photos(rig) == 1
    assert await ground.ask(NO_PHOTOS, 0, component=CAMERA) is ACCEPTED


async def test_video_is_recorded_and_shown_as_ordered(rig: Rig, ground: Ground) -> None:
    assert await ground.ask(VIDEO, 0, 0, component=CAMERA) is ACCEPTED
    assert is_recording(rig)
    await rig.until(lambda: ground.last("CAMERA_CAPTURE_STATUS")["video_status"] == 1)
    assert await ground.ask(PHOTO, 0, 0, 1, component=CAMERA) is ACCEPTED
    assert await ground.ask(NO_VIDEO, 0, component=CAMERA) is ACCEPTED
    assert not is_recording(rig)
    assert (await shown(rig, ground, "CAMERA_CAPTURE_STATUS"))["video_status"] == 0
    assert await ground.ask(VIDEO, 3, 0, component=CAMERA) is DENIED


async def test_a_camera_order_reaches_it_by_the_autopilot_too(rig: Rig, ground: Ground) -> None:
    assert await ground.ask(PHOTO, 0, 0, 1) is ACCEPTED
    assert photos(rig) == 1


async def test_who_does_not_fly_takes_no_photo_while_somebody_flies(
    rig: Rig, ground: Ground
) -> None:
    other = Ground(rig, ("127.0.0.1", 9), 77)
    other.beat()
    assert await other.ask(PHOTO, 0, 0, 1, 1, component=CAMERA) is ACCEPTED
    await ground.arm()
    assert await other.ask(PHOTO, 0, 0, 1, 2, component=CAMERA) is REJECTED
    assert await other.ask(POINT, -30, 0, NAN, NAN, 0, NAN, 1) is REJECTED
    assert await other.ask(CONFIGURE, 77, 190, 0, 0, NAN, NAN, 1) is REJECTED
    await rig.until(lambda: "camera: MAVLink 245 at 127.0.0.1:14540 flies" in other.texts)
    other.send("GIMBAL_MANAGER_SET_PITCHYAW", target_system=1, pitch=-0.5, yaw=0.0)
    await anyio.sleep(2.0)
    assert (photos(rig), mount(rig).pitch) == (1, 0.0)
    assert await ground.ask(PHOTO, 0, 0, 1, 1, component=CAMERA) is ACCEPTED


async def test_another_client_of_the_agent_that_has_control_is_named(
    rig: Rig, ground: Ground
) -> None:
    lease = await rig.client.acquire("console")
    assert await ground.ask(PHOTO, 0, 0, 1, 1, component=CAMERA) is REJECTED
    assert await ground.ask(POINT, -30, 0, NAN, NAN, 0, NAN, 1) is REJECTED
    assert photos(rig) == 0
    await rig.until(lambda: "console" in ground.texts)
    rig.client.let_go(lease)
    await anyio.sleep(0.5)
    assert await ground.ask(PHOTO, 0, 0, 1, 2, component=CAMERA) is ACCEPTED


async def test_photos_at_an_interval_end_with_the_line(rig: Rig, ground: Ground) -> None:
    assert await ground.ask(PHOTO, 0, 1.5, 0, 0, component=CAMERA) is ACCEPTED
    rig.aircraft.unplug()
    await anyio.sleep(20.0)
    assert "no more photos" in ground.texts
    assert rig.vehicle.world.payload.interval_s == 0.0
    ground.command(PHOTO, 0, 0, 1, 5, component=CAMERA)
    await anyio.sleep(20.0)
    results = [one["result"] for one in ground.all("COMMAND_ACK") if one["command"] == PHOTO]
    assert results[0] == ACCEPTED
    assert ACCEPTED not in results[1:]


async def test_a_flood_of_photos_waits_for_nobody(rig: Rig, ground: Ground) -> None:
    rig.late = 1.0
    for count in range(200):
        ground.command(PHOTO, 0, 0, 1, count + 1, component=CAMERA)
    await anyio.sleep(3.0)
    assert len(rig.vehicle._payload._photos) <= 8
    assert rig.vehicle._payload._pending == set()


# -- the gimbal ------------------------------------------------------------------------------------


async def test_the_manager_says_what_the_gimbal_can_do(rig: Rig, ground: Ground) -> None:
    manager = await shown(rig, ground, "GIMBAL_MANAGER_INFORMATION")
    assert manager["gimbal_device_id"] == 1, "no component of its own: 1 to 6"
    limits = {"pitch_min": -90, "pitch_max": 30, "roll_min": -35, "roll_max": 35}
    limits |= {"yaw_min": -320, "yaw_max": 320}
    for name, angle in limits.items():
        assert manager[name] == pytest.approx(math.radians(angle), abs=1e-6)
    can = 2 | 4 | 16 | 32 | 128 | 256 | 512 | 1024 | 4096
    assert manager["cap_flags"] == can | 131072  # and looks at a place
    device = await shown(rig, ground, "GIMBAL_DEVICE_INFORMATION")
    assert (device["vendor_name"], device["model_name"], device["uid"]) == ("DJI", "", 0)
    assert (device["cap_flags"], device["gimbal_device_id"]) == (can, 1)


async def test_its_attitude_is_a_quaternion_from_north(rig: Rig, ground: Ground) -> None:
    gimbal = mount(rig)
    gimbal.pitch, gimbal.yaw = -30.0, normalize_degrees(90.0 - heading(rig))
    await anyio.sleep(1.0)
    seen = ground.last(ATTITUDE)
    # z-y-x: 90 degrees about down, then 30 down about right.
    half = math.radians(15.0), math.radians(45.0)
    cp, sp, cy, sy = (one(angle) for angle in half for one in (math.cos, math.sin))
    expected = (cp * cy, sp * sy, -sp * cy, cp * sy)
    assert seen["q"] == pytest.approx(expected, abs=0.02)
    assert seen["flags"] == ROLL_LOCK | PITCH_LOCK | LOCK | OF_NORTH | 128
    assert seen["delta_yaw"] == pytest.approx(math.radians(heading(rig)), abs=0.02)
    rates = [seen[f"angular_velocity_{axis}"] for axis in "xyz"]
    assert all(map(math.isnan, (*rates, seen["delta_yaw_velocity"])))
    assert (seen["failure_flags"], seen["gimbal_device_id"], seen["target_system"]) == (0, 1, 0)
    gimbal.pitch = -90.0
    await anyio.sleep(1.0)
    assert ground.last(ATTITUDE)["failure_flags"] == 2  # AT_PITCH_LIMIT


AIMS: list[tuple[float, float, int, tuple[float | None, str, float | None]]] = [
    (-45.0, 0.0, 0, (-45.0, "nose", 0.0)),  # no flag: follow, in the frame of the nose
    (20.0, 90.0, 0, (20.0, "nose", 90.0)),
    (-45.0, 90.0, LOCK, (-45.0, "north", 90.0)),  # lock, in the frame of north
    (-45.0, -90.0, ROLL_LOCK | PITCH_LOCK | LOCK, (-45.0, "north", -90.0)),
    (10.0, 30.0, OF_NOSE, (10.0, "nose", 30.0)),
    (10.0, 30.0, LOCK | OF_NORTH, (10.0, "north", 30.0)),
    (10.0, 30.0, LOCK | OF_NOSE, (10.0, "nose", 30.0)),  # then it stays with north
    (10.0, 30.0, OF_NORTH, (10.0, "north", 30.0)),  # then it goes with the nose
    (-90.0, NAN, 0, (-90.0, "nose", None)),
    (NAN, 45.0, LOCK, (None, "north", 45.0)),
    (NAN, NAN, NEUTRAL, (0.0, "nose", 0.0)),
]


@pytest.mark.parametrize(
    ("pitch", "yaw", "flags", "expected", "way"),
    [
        *((*aim, "long") for aim in AIMS),
        *((*aim, way) for aim in AIMS[1::5] for way in ("int", "message")),
    ],
)
async def test_pitch_is_positive_up_and_yaw_clockwise_in_the_frame_of_the_flags(
    rig: Rig,
    ground: Ground,
    pitch: float,
    yaw: float,
    flags: int,
    expected: tuple[float | None, str, float | None],
    way: str,
) -> None:
    mount(rig).pitch = -5.0
    before = looks(rig)
    if way == "message":
        angles = {"pitch": math.radians(pitch), "yaw": math.radians(yaw), "flags": flags}
        rates = {"pitch_rate": NAN, "yaw_rate": NAN}
        ground.send("GIMBAL_MANAGER_SET_PITCHYAW", target_system=1, **angles, **rates)
    elif way == "int":
        named = dict(
            zip(("param1", "param2", "param3", "param4"), (pitch, yaw, NAN, NAN), strict=True)
        )
        to = {"target_system": 1, "target_component": 1, "command": POINT}
        ground.send("COMMAND_INT", **to, **named, x=flags, z=1.0)
    else:
        assert await ground.ask(POINT, pitch, yaw, NAN, NAN, flags, NAN, 1) is ACCEPTED
    await anyio.sleep(3.0)
    seen, (up, frame, turned) = looks(rig), expected
    assert seen[0] == pytest.approx(before[0] if up is None else up, abs=0.2)
    base = heading(rig) if frame == "nose" else 0.0
    wanted = before[1] if turned is None else turned + base
    assert normalize_degrees(seen[1] - wanted) == pytest.approx(0.0, abs=0.7)


async def test_yaw_follows_the_nose_unless_it_is_locked(rig: Rig, ground: Ground) -> None:
    await ground.fly()
    rows = ((0, True), (LOCK, False), (LOCK | OF_NOSE, False), (OF_NORTH, True))
    for flags, goes_with_it in rows:
        assert await ground.ask(POINT, -20, 40, NAN, NAN, flags, NAN, 1) is ACCEPTED
        await anyio.sleep(3.0)
        before, nose = looks(rig)[1], heading(rig)
        turn = math.radians(normalize_degrees(nose + 70.0))
        told = await ground.ask(MavCommand.DO_REPOSITION, NAN, 0, NAN, turn, NAN, NAN, NAN)
        assert told is ACCEPTED, flags
        await anyio.sleep(6.0)
        assert normalize_degrees(heading(rig) - nose) == pytest.approx(70.0, abs=3.0), flags
        turned = normalize_degrees(looks(rig)[1] - before)
        assert turned == pytest.approx(70.0 if goes_with_it else 0.0, abs=3.0), flags
        locked = bool(ground.last("GIMBAL_MANAGER_STATUS")["flags"] & LOCK)
        assert locked is not goes_with_it, flags


async def test_a_rate_turns_until_the_next_order(rig: Rig, ground: Ground) -> None:
    assert await ground.ask(POINT, NAN, NAN, -5, 10, 0, NAN, 1) is ACCEPTED
    start = looks(rig)
    await anyio.sleep(4.0)
    pitch, yaw = looks(rig)
    sent = [one.command for one in rig.aircraft.autopilot.received_commands]
    assert sum(isinstance(one, GimbalSpeed) for one in sent) == pytest.approx(16, abs=2)
    assert pitch - start[0] == pytest.approx(-20.0, abs=2.0)
    assert normalize_degrees(yaw - start[1]) == pytest.approx(40.0, abs=4.0)
    assert await ground.ask(POINT, NAN, NAN, 0, 0, 0, NAN, 1) is ACCEPTED
    await anyio.sleep(0.2)
    rests = looks(rig)
    await anyio.sleep(3.0)
    assert looks(rig) == pytest.approx(rests, abs=0.01)


async def test_a_turn_to_an_angle_takes_the_time_of_60_degrees_a_second(
    rig: Rig, ground: Ground
) -> None:
    for pitch in (-30, -60):
        assert await ground.ask(POINT, pitch, 0, NAN, NAN, 0, NAN, 1) is ACCEPTED
        await anyio.sleep(3.0)
    sent = [one.command for one in rig.aircraft.autopilot.received_commands]
    *_, last = (one for one in sent if isinstance(one, GimbalAngle))
    assert last.duration_s == pytest.approx(0.5, abs=0.11)


async def test_a_turn_ends_with_its_peer(rig: Rig, ground: Ground) -> None:
    assert await ground.ask(POINT, NAN, NAN, -2, 0, 0, NAN, 1) is ACCEPTED
    ground.is_silent = True
    await anyio.sleep(5.0)
    rests = looks(rig)
    assert rests[0] < -3.0
    await anyio.sleep(3.0)
    assert looks(rig) == rests


@pytest.mark.parametrize("rate", [1.0, -0.5, 3.0])
async def test_sticks_turn_it_at_a_share_of_45_degrees_a_second(
    rig: Rig, ground: Ground, rate: float
) -> None:
    fields = {"pitch": NAN, "yaw": NAN, "pitch_rate": 0.0, "yaw_rate": rate}
    start = looks(rig)[1]
    ground.send("GIMBAL_MANAGER_SET_MANUAL_CONTROL", target_system=1, target_component=1, **fields)
    await anyio.sleep(1.0)
    share = max(-1.0, min(1.0, rate))
    assert normalize_degrees(looks(rig)[1] - start) == pytest.approx(45 * share, abs=6.0)
    fields |= {"pitch": 0.1}
    ground.send("GIMBAL_MANAGER_SET_MANUAL_CONTROL", target_system=1, target_component=1, **fields)
    await rig.until(lambda: "an angle has no unit there" in ground.texts)
    rates = {"angular_velocity_x": 0.1, "angular_velocity_y": 0.0, "angular_velocity_z": 0.0}
    ground.send("GIMBAL_MANAGER_SET_ATTITUDE", target_system=1, flags=0, q=(NAN,) * 4, **rates)
    await rig.until(lambda: "it cannot be rolled by a rate" in ground.texts)


async def test_an_attitude_is_a_quaternion_in_the_frame_of_the_flags(
    rig: Rig, ground: Ground
) -> None:
    # 60 degrees about down, then 20 up about right, then 10 to the right about forward.
    roll, pitch, yaw = (math.radians(one) / 2 for one in (10.0, 20.0, 60.0))
    cr, sr, cp, sp, cy, sy = (
        one(angle) for angle in (roll, pitch, yaw) for one in (math.cos, math.sin)
    )
    q = (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )
    rates = dict.fromkeys((f"angular_velocity_{axis}" for axis in "xyz"), NAN)
    ground.send("GIMBAL_MANAGER_SET_ATTITUDE", target_system=1, flags=LOCK, q=q, **rates)
    await anyio.sleep(5.0)
    assert looks(rig) == pytest.approx((20.0, 60.0), abs=0.3)
    assert mount(rig).roll == pytest.approx(10.0, abs=0.3)
    turn = {"angular_velocity_x": NAN, "angular_velocity_y": 0.1, "angular_velocity_z": NAN}
    ground.send("GIMBAL_MANAGER_SET_ATTITUDE", target_system=1, flags=LOCK, q=(NAN,) * 4, **turn)
    await anyio.sleep(1.0)
    assert looks(rig)[0] == pytest.approx(20 + math.degrees(0.1), abs=1.5)


BAD: list[tuple[tuple[float, ...], str]] = [
    ((31, 0, NAN, NAN, 0, NAN, 1), "pitch 31.0 deg; it has -90 to 30"),
    ((-91, 0, NAN, NAN, 0, NAN, 1), "pitch -91.0 deg"),
    ((0, 1e9, NAN, NAN, LOCK, NAN, 1), "yaw"),
    ((NAN, NAN, NAN, NAN, 0, NAN, 1), "neither an angle nor a turn"),
    ((NAN, NAN, 181, NAN, 0, NAN, 1), "181 deg/s"),
    ((NAN, NAN, -181, NAN, 0, NAN, 1), "-181 deg/s"),
    ((NAN, NAN, NAN, 181, 0, NAN, 1), "181 deg/s"),
    ((NAN, NAN, NAN, -181, 0, NAN, 1), "-181 deg/s"),
    ((10, NAN, NAN, 5, 0, NAN, 1), "it cannot turn on one axis"),
    ((0, 0, NAN, NAN, RETRACT, NAN, 1), "retracted"),
    ((0, 0, NAN, NAN, OF_NOSE | OF_NORTH, NAN, 1), "two frames"),
    ((0, 0, NAN, NAN, -1, NAN, 1), "flags -1"),
    ((0, 0, NAN, NAN, 1e20, NAN, 1), "flags 1e+20"),
    ((0, 0, NAN, NAN, 0, NAN, 3), "no gimbal 3"),
    ((math.inf, 0, NAN, NAN, 0, NAN, 1), "not finite"),
]


@pytest.mark.parametrize(("parameters", "text"), BAD)
async def test_what_the_gimbal_cannot_do_is_denied_with_the_reason(
    rig: Rig, ground: Ground, parameters: tuple[float, ...], text: str
) -> None:
    before = looks(rig)
    assert await ground.ask(POINT, *parameters) is DENIED
    await rig.until(lambda: text in ground.texts)
    assert looks(rig) == pytest.approx(before, abs=0.01)


async def test_drawn_messages_are_flown_or_refused_and_never_raise(
    rig: Rig, ground: Ground
) -> None:
    random = Random(35)
    values = (NAN, math.inf, -math.inf, 0.0, -0.0, 1.0, -1.5, 1e38, -1e38, 1e-38, 0.3)
    for _ in range(400):
        kind = random.choice(["ATTITUDE", "PITCHYAW", "MANUAL_CONTROL", "command"])
        if kind == "command":
            command = random.choice([POINT, CONFIGURE, LOOK, LOOK_AWAY, PHOTO, VIDEO, NO_VIDEO])
            target = random.choice([0, 1, CAMERA])
            given = [random.choice([*values, 1e6, 255.0]) for _ in range(7)]
            ground.command(command, *given, component=target)
            continue
        layout = LAYOUTS[f"GIMBAL_MANAGER_SET_{kind}"]
        fields: dict[str, Any] = {name: random.choice(values) for name in layout.fields}
        fields |= {"q": tuple(random.choice(values) for _ in range(4))} if "q" in fields else {}
        fields |= {"flags": random.getrandbits(32), "gimbal_device_id": random.randrange(3)}
        ground.send(layout.name, **fields | {"target_system": 1, "target_component": 1})
        if random.random() < 0.2:
            await anyio.sleep(0.3)
    await anyio.sleep(3.0)
    pitch, _ = looks(rig)
    assert -90.0 <= pitch <= 30.0
    assert not rig.motors_on
    assert await ground.ask(CONFIGURE, 0, 0, 0, 0, NAN, NAN, 1) is ACCEPTED
    assert await ground.ask(POINT, -30, 0, NAN, NAN, LOCK, NAN, 1) is ACCEPTED
    await anyio.sleep(5.0)
    assert looks(rig) == pytest.approx((-30.0, 0.0), abs=0.3)


# -- control of the gimbal -------------------------------------------------------------------------


def control(ground: Ground) -> tuple[int, ...]:
    seen = ground.last("GIMBAL_MANAGER_STATUS")
    names = ("primary_control", "secondary_control")
    return tuple(seen[f"{name}_{part}"] for name in names for part in ("sysid", "compid"))


async def test_control_is_given_as_the_command_says(rig: Rig, ground: Ground) -> None:
    for parameters, expected in (
        ((245, 190, 0, 0), (245, 190, 0, 0)),
        ((-1, -1, 245, 190), (245, 190, 245, 190)),  # -1 leaves it unchanged
        ((-3, -3, -1, -1), (0, 0, 245, 190)),  # -3 gives it back
        ((-2, -2, -3, -3), (245, 190, 0, 0)),  # -2 is the sender
        ((0, 0, 0, 0), (0, 0, 0, 0)),
    ):
        assert await ground.ask(CONFIGURE, *parameters, NAN, NAN, 1) is ACCEPTED
        await anyio.sleep(1.1)
        assert control(ground) == expected
    assert await ground.ask(CONFIGURE, 245, 300, 0, 0, NAN, NAN, 1) is DENIED
    assert await ground.ask(CONFIGURE, 245, NAN, 0, 0, NAN, NAN, 1) is DENIED


async def test_of_two_stations_the_one_with_control_turns_it_until_it_has_gone(
    rig: Rig, ground: Ground
) -> None:
    other = Ground(rig, ("127.0.0.1", 9), 77)
    other.beat()
    assert await other.ask(POINT, -10, 0, NAN, NAN, LOCK, NAN, 1) is ACCEPTED  # nobody has it
    assert await ground.ask(CONFIGURE, 245, 190, 0, 0, NAN, NAN, 1) is ACCEPTED
    assert await other.ask(POINT, -60, 0, NAN, NAN, LOCK, NAN, 1) is REJECTED
    await rig.until(lambda: "gimbal: 245/190 has control of it" in other.texts)
    other.send("GIMBAL_MANAGER_SET_PITCHYAW", target_system=1, pitch=-1.0, yaw=0.0, flags=LOCK)
    assert await other.ask(LOOK, 0, 0, 0, 0, 47.0, 8.0, 500.0) is REJECTED
    assert await ground.ask(POINT, -20, 0, NAN, NAN, LOCK, NAN, 1) is ACCEPTED
    await anyio.sleep(3.0)
    assert looks(rig)[0] == pytest.approx(-20.0, abs=0.3)
    ground.is_silent = True
    await anyio.sleep(12.0)
    assert control(other) == (0, 0, 0, 0)
    assert await other.ask(POINT, -60, 0, NAN, NAN, LOCK, NAN, 1) is ACCEPTED
    await anyio.sleep(3.0)
    assert looks(rig)[0] == pytest.approx(-60.0, abs=0.3)


async def test_a_command_that_another_one_replaces_is_answered(rig: Rig, ground: Ground) -> None:
    for pitch in (-10.0, -20.0, -30.0):
        ground.command(POINT, pitch, 0, NAN, NAN, LOCK, NAN, 1)
    await anyio.sleep(3.0)
    results = [one["result"] for one in ground.all("COMMAND_ACK") if one["command"] == POINT]
    assert results == [REJECTED, REJECTED, ACCEPTED]
    assert looks(rig)[0] == pytest.approx(-30.0, abs=0.3)


async def test_a_stream_of_angles_costs_no_more_than_a_few_orders(rig: Rig, ground: Ground) -> None:
    """Five seconds of 200 messages a second: the newest counts, and orders do not pile up."""
    for step in range(1000):
        angles = {"pitch": math.radians(-step / 20), "yaw": 0.0, "flags": LOCK}
        rates = {"pitch_rate": NAN, "yaw_rate": NAN}
        ground.send("GIMBAL_MANAGER_SET_PITCHYAW", target_system=1, **angles, **rates)
        await anyio.sleep(0.005)
    assert len(rig.vehicle.manager.orders) <= 2
    await anyio.sleep(3.0)
    assert looks(rig)[0] == pytest.approx(-49.95, abs=0.3)


# -- a place to look at ----------------------------------------------------------------------------


async def test_it_looks_at_a_place_while_the_aircraft_flies(rig: Rig, ground: Ground) -> None:
    await ground.fly(height=10.0)
    start = rig.aircraft.vehicle.flight.dynamics
    home = rig.vehicle.world.home
    assert home is not None
    # 20 m north and 15 m east of home, on the ground: 25 m away and 10 m below.
    place = home.frame.to_geodetic(20.0, 15.0)
    altitude = home.altitude_m
    assert await ground.ask(LOOK, 1, 0, 0, 0, NAN, NAN, altitude) is DENIED
    assert await ground.ask(LOOK, 1, 0, 0, 0, *place, altitude) is ACCEPTED

    def error() -> float:
        north, east = 20.0 - start.north, 15.0 - start.east
        pitch = math.degrees(math.atan2(-rig.height, math.hypot(north, east)))
        yaw = math.degrees(math.atan2(east, north))
        seen = looks(rig)
        return max(abs(seen[0] - pitch), abs(normalize_degrees(seen[1] - yaw)))

    await anyio.sleep(5.0)
    assert error() < 2.0
    there = home.frame.to_geodetic(20.0, -5.0)
    to = (*there, altitude + 10.0)
    assert await ground.ask(MavCommand.DO_REPOSITION, 3.0, 0, NAN, NAN, *to) is ACCEPTED
    for _ in range(8):
        await anyio.sleep(1.0)
        assert error() < 8.0
    await anyio.sleep(10.0)
    assert error() < 2.0
    assert await ground.ask(LOOK_AWAY, 1) is ACCEPTED
    rests = looks(rig)
    back = (*home.frame.to_geodetic(0.0, 0.0), altitude + 10.0)
    assert await ground.ask(MavCommand.DO_REPOSITION, 3.0, 0, NAN, NAN, *back) is ACCEPTED
    await anyio.sleep(8.0)
    assert looks(rig)[0] == pytest.approx(rests[0], abs=0.3)


async def test_the_altitude_of_a_place_is_above_sea_level_in_every_frame(
    rig: Rig, ground: Ground
) -> None:
    home = rig.vehicle.world.home
    assert home is not None
    x, y = (round(one * 1e7) for one in home.frame.to_geodetic(10.0, 0.0))
    to = {"target_system": 1, "target_component": 1, "command": LOOK, "param1": 0.0}
    for frame in (0, 3, 5, 6):  # MAVSDK leaves it at 3, "relative", and PX4 does not look at it
        assert await ground.ask(POINT, -40, 90, NAN, NAN, LOCK, NAN, 1) is ACCEPTED
        await anyio.sleep(3.0)
        # 5 m up, 10 m north
        ground.send("COMMAND_INT", **to, frame=frame, x=x, y=y, z=home.altitude_m + 5.0)
        await anyio.sleep(4.0)
        assert looks(rig)[0] == pytest.approx(math.degrees(math.atan2(5, 10)), abs=1.0)
        assert looks(rig)[1] == pytest.approx(0.0, abs=2.0)
    assert await ground.ask(LOOK, 1) is DENIED
    assert await ground.ask(LOOK, 1, 0, 0, 0, 91.0, 8.0, 10.0) is DENIED


async def test_a_place_right_below_leaves_the_yaw_alone(rig: Rig, ground: Ground) -> None:
    await ground.fly(height=10.0)
    place = rig.client.view.place
    assert place is not None
    assert await ground.ask(POINT, 0, 60, NAN, NAN, LOCK, NAN, 1) is ACCEPTED
    await anyio.sleep(3.0)
    here = place.latitude_deg, place.longitude_deg, rig.ground_altitude
    assert await ground.ask(LOOK, 1, 0, 0, 0, *here) is ACCEPTED
    await anyio.sleep(4.0)
    assert looks(rig)[0] == pytest.approx(-90.0, abs=3.0)
    assert looks(rig)[1] == pytest.approx(60.0, abs=25.0)
