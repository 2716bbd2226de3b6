"""What was uploaded of a waypoint mission, and its checks as they are due."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from m100link.protocol.codes import MissionCode
from m100link.protocol.commands.missions import Uploaded
from m100link.sim.vehicle.missions.plan import WaypointPlan, mission_code, point_code

if TYPE_CHECKING:
    from m100link.protocol.commands.waypoint import WaypointMission, WaypointPoint
    from m100link.sim.vehicle.missions.route import Place
    from m100link.sim.vehicle.missions.settings import MissionSettings
    from m100link.sim.vehicle.missions.site import Site

__all__ = ["WaypointUpload"]


class WaypointUpload:
    """The memory for one waypoint mission.

    Args:
        settings: Of missions.
        site: Where they may go.

    Attributes:
        mission: As 0x03/0x10 had it, with the idle speed that was set since; None without one.
        points: The points so far, by index.
        plan: All of it, once the check of the whole has passed.
    """

    __slots__ = ("_settings", "_site", "mission", "plan", "points")

    def __init__(self, settings: MissionSettings, site: Site) -> None:
        self._settings = settings
        self._site = site
        self.forget()

    def forget(self) -> None:
        """Nothing is there any more."""
        self.mission: WaypointMission | None = None
        self.points: dict[int, WaypointPoint] = {}
        self.plan: WaypointPlan | None = None

    def begin(self, mission: WaypointMission) -> MissionCode:
        """Take a mission; a former one is gone, whether this one is legal or not."""
        self.forget()
        code = mission_code(mission)
        if not code:
            self.mission = mission
        return code

    def add(self, point: WaypointPoint, home: Place | None) -> tuple[MissionCode, Uploaded | None]:
        """Take a point; with the last one that was missing, the whole is judged and told."""
        if self.mission is None:
            return MissionCode.NO_MISSION, None
        if point.index >= self.mission.count:
            return MissionCode.INDEX_TOO_LARGE, None
        code = point_code(point)
        if code:
            return code, None
        self.points[point.index] = point
        if len(self.points) < self.mission.count:
            return code, None
        points = tuple(self.points[index] for index in range(self.mission.count))
        places = tuple(self._site.place(p.latitude, p.longitude, p.altitude) for p in points)
        plan = WaypointPlan(self.mission, points, places)
        code = plan.check(self._settings, home, self._site)
        if code:
            self.points.clear()  # all of them have to come again
            self.plan = None
            return code, Uploaded(valid=0)
        self.plan = plan
        return code, Uploaded(valid=1, estimated_time=min(0xFFFF, round(plan.estimate())))

    def set_idle_speed(self, speed: float) -> MissionCode:
        """Change the speed without the stick."""
        mission = self.mission
        if mission is None:
            return MissionCode.NO_MISSION
        if not -mission.max_speed <= speed <= mission.max_speed:
            return MissionCode.BAD_SPEED
        self.mission = replace(mission, idle_speed=speed)
        if self.plan is not None:
            self.plan = replace(self.plan, mission=self.mission)
        return MissionCode.SUCCESS
