"""A field photographed by a waypoint mission: planned, checked, and flown by the aircraft itself.

python examples/survey_with_photos.py                    # a virtual aircraft inside this program
python examples/survey_with_photos.py /dev/ttyUSB0       # a real one with firmware 3.1
"""

import asyncio
import math
import sys

import m100link
from m100link import (
    AtEnd,
    Credentials,
    GimbalPitch,
    Position,
    Reached,
    TakePhoto,
    Waypoint,
    WaypointPlan,
)
from m100link.geodesy import LocalFrame
from m100link.missions.patterns import survey

CREDENTIALS = Credentials(app_id=10086, key=bytes(range(32)))  # those of the virtual aircraft

FIELD = [(5.0, -15.0), (5.0, 15.0), (35.0, 18.0), (38.0, -12.0)]  # metres north and east of here
HEIGHT, SPEED = 25.0, 4.0


def plan_over(field: list[tuple[float, float]], frame: LocalFrame) -> WaypointPlan:
    """Lines 12 m apart, a photograph straight down every 15 m at most, then home and down."""
    lines = survey(field, spacing=12.0, height=HEIGHT, angle_deg=90.0)
    points = Waypoint.along(lines, frame=frame, every=15.0, actions=[GimbalPitch(-90), TakePhoto()])
    return WaypointPlan(points, speed=SPEED, at_end=AtEnd.GO_HOME)


async def main(url: str = "sim://?firmware=3.1") -> None:
    async with m100link.connect(url) as aircraft:
        await aircraft.activate(CREDENTIALS)
        async with aircraft.control(stop="land") as control:
            home = control.local_frame()
            plan = plan_over(FIELD, home)
            print(plan.estimate(home=(home.latitude_deg, home.longitude_deg)))
            await control.take_off()
            async with control.waypoint_mission(plan) as mission:
                async for event in mission:
                    if isinstance(event, Reached):
                        print(f"photograph {event.index + 1} of {len(plan.waypoints)}")
        position = aircraft.state.get(Position)
        assert position is not None
        away = math.hypot(*home.to_local(position.latitude_deg, position.longitude_deg))
        print(f"down {away:.1f} m from where it took off")


if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:]))
