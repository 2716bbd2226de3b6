"""Flights by MAVSDK over gRPC: python mavsdk_grpc_flights.py FLIGHT PORT GRPC-PORT."""

from __future__ import annotations

import asyncio
import sys
import tempfile
from collections.abc import Awaitable, Callable
from importlib import import_module
from pathlib import Path
from typing import Any

try:
    mavsdk: Any = import_module("mavsdk_grpc")
    PACKAGE = "mavsdk_grpc"
except ModuleNotFoundError:  # before version 4
    mavsdk = import_module("mavsdk")
    PACKAGE = "mavsdk"
mission: Any = import_module(f"{PACKAGE}.mission")
offboard: Any = import_module(f"{PACKAGE}.offboard")


async def first(values: Any, wanted: Callable[[Any], bool]) -> Any:
    async for value in values:
        if wanted(value):
            return value
    raise AssertionError("it ended")


async def ready(drone: Any) -> None:
    await first(
        drone.telemetry.health(), lambda one: one.is_global_position_ok and one.is_home_position_ok
    )


async def up(drone: Any, height: float = 4.0) -> None:
    await ready(drone)
    await drone.action.set_takeoff_altitude(height)
    assert await drone.action.get_takeoff_altitude() == height
    await drone.action.arm()
    await drone.action.takeoff()
    await first(drone.telemetry.position(), lambda one: one.relative_altitude_m > height - 0.5)


async def down(drone: Any) -> None:
    await drone.action.land()
    await first(drone.telemetry.armed(), lambda armed: not armed)
    assert not await first(drone.telemetry.in_air(), lambda _: True)


async def take_off(drone: Any) -> None:
    await up(drone)
    mode = await first(drone.telemetry.flight_mode(), lambda one: str(one) == "HOLD")
    print(mode)
    await down(drone)


async def go_to(drone: Any) -> None:
    await up(drone)
    home = await first(drone.telemetry.home(), lambda _: True)
    target = home.latitude_deg + 0.0002
    altitude = home.absolute_altitude_m + 8.0
    await drone.action.goto_location(target, home.longitude_deg, altitude, 90.0)
    await first(
        drone.telemetry.position(), lambda one: abs(one.latitude_deg - target) * 111_000 < 1.0
    )
    await drone.action.do_orbit(
        8.0,
        2.0,
        import_module(f"{PACKAGE}.action").OrbitYawBehavior.HOLD_FRONT_TO_CIRCLE_CENTER,
        target,
        home.longitude_deg,
        altitude,
    )
    await asyncio.sleep(10.0)
    await drone.action.hold()
    await drone.action.return_to_launch()
    await first(drone.telemetry.armed(), lambda armed: not armed)


async def setpoints(drone: Any) -> None:
    await ready(drone)
    await drone.action.arm()
    await drone.offboard.set_position_ned(offboard.PositionNedYaw(0.0, 0.0, 0.0, 0.0))
    await drone.offboard.start()
    await drone.offboard.set_position_ned(offboard.PositionNedYaw(6.0, -3.0, -5.0, 90.0))

    def is_there(one: Any) -> bool:
        place = one.position
        error = abs(place.north_m - 6) + abs(place.east_m + 3) + abs(place.down_m + 5)
        return float(error) < 0.8

    await first(drone.telemetry.position_velocity_ned(), is_there)
    await drone.offboard.set_velocity_body(offboard.VelocityBodyYawspeed(2.0, 0.0, 0.0, 30.0))
    await asyncio.sleep(3.0)
    await drone.offboard.stop()
    await down(drone)


def waypoint(latitude: float, longitude: float) -> Any:
    nan, no_camera = float("nan"), mission.MissionItem.CameraAction.NONE
    nothing = mission.MissionItem.VehicleAction.NONE
    place = (latitude, longitude, 8.0, 4.0, True, nan, nan)
    return mission.MissionItem(*place, no_camera, nan, nan, nan, nan, nan, nothing)


async def mission_of_three(drone: Any) -> None:
    await ready(drone)
    home = await first(drone.telemetry.home(), lambda _: True)
    latitude, longitude = home.latitude_deg, home.longitude_deg
    corners = [(0.0001, 0.0), (0.0001, 0.0001), (0.0, 0.0001)]
    items = [waypoint(latitude + north, longitude + east) for north, east in corners]
    await drone.mission.set_return_to_launch_after_mission(True)
    await drone.mission.upload_mission(mission.MissionPlan(items))
    assert len((await drone.mission.download_mission()).mission_items) == 3
    await drone.action.arm()
    await drone.mission.start_mission()
    await first(drone.mission.mission_progress(), lambda one: one.current == one.total == 3)
    print("3/3")
    await first(drone.telemetry.armed(), lambda armed: not armed)


async def patrol(drone: Any) -> None:
    """Fly a mission of 200 m, home at its end, and wait until somebody ends this program."""
    await ready(drone)
    home = await first(drone.telemetry.home(), lambda _: True)
    latitude, longitude = home.latitude_deg, home.longitude_deg
    corners = [(0.0005, 0.0), (0.0005, 0.0005), (0.0001, 0.0005)]
    items = [waypoint(latitude + north, longitude + east) for north, east in corners]
    await drone.mission.set_return_to_launch_after_mission(True)
    await drone.mission.upload_mission(mission.MissionPlan(items))
    await drone.action.arm()
    await drone.mission.start_mission()
    await first(drone.telemetry.flight_mode(), lambda one: str(one) == "MISSION")
    print("flying", flush=True)
    await asyncio.sleep(3600.0)


async def payload(drone: Any) -> None:
    """Point the gimbal, take a photo and fetch the newest flight log, on the ground and unarmed."""
    await ready(drone)
    gimbal = import_module(f"{PACKAGE}.gimbal")
    one = (await first(drone.gimbal.gimbal_list(), lambda found: bool(found.gimbals))).gimbals[0]
    await drone.gimbal.take_control(one.gimbal_id, gimbal.ControlMode.PRIMARY)
    ways = (gimbal.GimbalMode.YAW_FOLLOW, gimbal.SendMode.ONCE)
    await drone.gimbal.set_angles(one.gimbal_id, 0.0, -60.0, 45.0, *ways)
    await asyncio.sleep(6.0)
    seen = (await drone.gimbal.get_attitude(one.gimbal_id)).euler_angle_forward
    assert abs(seen.pitch_deg + 60.0) < 1.0, seen
    assert abs(seen.yaw_deg - 45.0) < 1.5, seen
    cameras = await first(drone.camera.camera_list(), lambda found: bool(found.cameras))
    [camera] = cameras.cameras
    assert (camera.vendor_name, camera.component_id) == ("DJI", 100)
    await drone.camera.take_photo(camera.component_id)
    entries = await drone.log_files.get_entries()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "flight.mcap"
        async for _ in drone.log_files.download_log_file(entries[-1], str(path)):
            pass
        assert path.stat().st_size == entries[-1].size_bytes
        assert path.read_bytes().startswith(b"\x89MCAP0\r\n")
        [entry] = (await drone.ftp.list_directory("/log")).entries
        for is_burst in (False, True):
            target = Path(folder) / str(is_burst)
            target.mkdir()
            async for _ in drone.ftp.download(f"/log/{entry.name}", str(target), is_burst):
                pass
            found = (target / entry.name).read_bytes()
            assert found.startswith(path.read_bytes()), len(found)


async def stay(drone: Any) -> None:
    """Fly north by setpoints until somebody ends this program."""
    await up(drone)
    await drone.offboard.set_velocity_ned(offboard.VelocityNedYaw(3.0, 0.0, 0.0, 0.0))
    await drone.offboard.start()
    print("flying", flush=True)
    await asyncio.sleep(3600.0)


FLIGHTS: dict[str, Callable[[Any], Awaitable[None]]] = {
    "take_off": take_off,
    "go_to": go_to,
    "setpoints": setpoints,
    "mission": mission_of_three,
    "payload": payload,
    "stay": stay,
    "patrol": patrol,
}


async def main(flight: str, port: str, grpc_port: str) -> None:
    drone = mavsdk.System(port=int(grpc_port))
    await drone.connect(system_address=f"udpin://127.0.0.1:{port}")
    await first(drone.core.connection_state(), lambda one: one.is_connected)
    await FLIGHTS[flight](drone)
    print(f"{flight}: done")


if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:]))
