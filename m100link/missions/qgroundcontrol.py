"""Plans of QGroundControl: the ``.plan`` file, mission items of MAVLink, read as waypoints.

A mission of the M100 knows less than MAVLink, and other things. The reader names the item that the
M100 cannot fly in its refusal, and leaves none out in silence; :func:`from_items` leaves out the
items that its caller names.

| Item | Becomes |
|---|---|
| 22 take-off | ``take_off``, and the first waypoint, unless the next one is there already |
| 16 waypoint | a waypoint; its hold time a :class:`~m100link.Stay`, its yaw the heading |
| 93, 112 delay | :class:`~m100link.Stay` |
| 115 yaw, absolute | :class:`~m100link.TurnTo` |
| 178 speed | the speed of the whole |
| 203 shoot, 2000 one image | :class:`~m100link.TakePhoto` |
| 206 photographs by distance | waypoints so far apart, each with a photograph |
| 2500, 2501 | :class:`~m100link.StartVideo`, :class:`~m100link.StopVideo` |
| 205, 1000 gimbal | :class:`~m100link.GimbalPitch` |
| 20 return, 21 land | what happens at the end; a place to land at is flown to first |
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Any, NamedTuple

from m100link.errors import BadPlan
from m100link.geodesy import normalize_degrees
from m100link.missions.checks import MOST_POINTS, NEAREST_M, leg_length
from m100link.missions.document import FILE_TYPE, FORMAT, VERSION, from_json, values_of
from m100link.missions.waypoint import (
    AtEnd,
    GimbalPitch,
    Heading,
    PlanValues,
    StartVideo,
    Stay,
    StopVideo,
    TakePhoto,
    TurnTo,
    Waypoint,
    WaypointAction,
    number,
)

# -- the mission items of a ``.plan`` of QGroundControl: a file taken apart, nothing understood ----


_FILE_VERSION, _MISSION_VERSION = 1, 2
_PARAMETERS = 7


class MavCommand(IntEnum):
    """MAV_CMD by its names: items in files of ground stations, and what the bridge answers."""

    NAV_WAYPOINT = 16
    NAV_LOITER_UNLIM = 17
    NAV_LOITER_TURNS = 18
    NAV_LOITER_TIME = 19
    NAV_RETURN_TO_LAUNCH = 20
    NAV_LAND = 21
    NAV_TAKEOFF = 22
    DO_ORBIT = 34
    NAV_SPLINE_WAYPOINT = 82
    NAV_VTOL_TAKEOFF = 84
    NAV_VTOL_LAND = 85
    NAV_DELAY = 93
    CONDITION_DELAY = 112
    CONDITION_CHANGE_ALT = 113
    CONDITION_DISTANCE = 114
    CONDITION_YAW = 115
    DO_SET_MODE = 176
    DO_JUMP = 177
    DO_CHANGE_SPEED = 178
    DO_SET_HOME = 179
    DO_SET_RELAY = 181
    DO_REPEAT_RELAY = 182
    DO_SET_SERVO = 183
    DO_REPEAT_SERVO = 184
    DO_SET_ACTUATOR = 187
    DO_LAND_START = 189
    DO_REPOSITION = 192
    DO_PAUSE_CONTINUE = 193
    DO_SET_ROI_LOCATION = 195
    DO_SET_ROI_WPNEXT_OFFSET = 196
    DO_SET_ROI_NONE = 197
    DO_CONTROL_VIDEO = 200
    DO_SET_ROI = 201
    DO_DIGICAM_CONFIGURE = 202
    DO_DIGICAM_CONTROL = 203
    DO_MOUNT_CONFIGURE = 204
    DO_MOUNT_CONTROL = 205
    DO_SET_CAM_TRIGG_DIST = 206
    DO_FENCE_ENABLE = 207
    DO_GRIPPER = 211
    DO_SET_CAM_TRIGG_INTERVAL = 214
    DO_SET_MISSION_CURRENT = 224
    DO_SET_STANDARD_MODE = 262
    MISSION_START = 300
    COMPONENT_ARM_DISARM = 400
    GET_HOME_POSITION = 410
    GET_MESSAGE_INTERVAL = 510
    SET_MESSAGE_INTERVAL = 511
    REQUEST_MESSAGE = 512
    REQUEST_AUTOPILOT_CAPABILITIES = 520
    REQUEST_CAMERA_INFORMATION = 521
    REQUEST_CAMERA_SETTINGS = 522
    REQUEST_STORAGE_INFORMATION = 525
    REQUEST_CAMERA_CAPTURE_STATUS = 527
    SET_CAMERA_MODE = 530
    SET_CAMERA_ZOOM = 531
    SET_CAMERA_FOCUS = 532
    DO_GIMBAL_MANAGER_PITCHYAW = 1000
    DO_GIMBAL_MANAGER_CONFIGURE = 1001
    IMAGE_START_CAPTURE = 2000
    IMAGE_STOP_CAPTURE = 2001
    DO_TRIGGER_CONTROL = 2003
    VIDEO_START_CAPTURE = 2500
    VIDEO_STOP_CAPTURE = 2501
    DO_VTOL_TRANSITION = 3000
    NAV_FENCE_RETURN_POINT = 5000
    NAV_FENCE_POLYGON_VERTEX_INCLUSION = 5001
    NAV_FENCE_POLYGON_VERTEX_EXCLUSION = 5002
    NAV_FENCE_CIRCLE_INCLUSION = 5003
    NAV_FENCE_CIRCLE_EXCLUSION = 5004


class QgcItem(NamedTuple):
    """One mission item, wherever it stood."""

    place: str  # how a person finds it: ``item 3``, or ``item 3.12`` inside of a survey
    command: int  # its number in MAVLink
    parameters: tuple[float, ...]  # seven; NaN where the file has null
    frame: int  # what its height counts from

    def refuse(self, why: str, *, value: object = None, remedy: str = "") -> BadPlan:
        """The error that names it."""
        return BadPlan(
            f"{self.place}, {self.name}: {why}",
            field=self.place,
            value=self.command if value is None else value,
            remedy=remedy,
        )

    @property
    def name(self) -> str:
        """Its name in MAVLink, and its number."""
        return command_name(self.command)


def command_name(command: int) -> str:
    """The name of a command in MAVLink, and its number; the number alone of others."""
    known = command in MavCommand.__members__.values()
    return f"{MavCommand(command).name} ({command})" if known else f"command {command}"


def bad(field_name: str, seen: str, value: object, remedy: str = "") -> BadPlan:
    """The error about a part of the file."""
    return BadPlan(seen, field=field_name, value=value, remedy=remedy)


def _part(found: object, name: str, kind: type[Any], what: str) -> Any:
    """A part of an object that has to be there and of a kind."""
    value = found.get(name) if isinstance(found, dict) else None
    if not isinstance(value, kind) or isinstance(value, bool):
        seen = f"{what} has no {name}" if value is None else f"{what}: {name} is of another kind"
        raise bad(name, seen, value, "write the file with QGroundControl again")
    return value


def items_of(
    document: dict[str, Any], leave_out: Collection[int | str]
) -> tuple[dict[str, Any], Iterator[QgcItem]]:
    """The mission of a file, and its items with those of surveys in their place.

    Raises ``BadPlan``: the file is none of these, or has a fence; from the iterator, an item is
    none.
    """
    if document.get("fileType") != FILE_TYPE:
        kind = document.get("fileType")
        raise bad("fileType", f"fileType is {kind!r}", kind, f"{FILE_TYPE!r}: a mission")
    version = document.get("version")
    if version != _FILE_VERSION or isinstance(version, bool):
        raise bad("version", f"version {version!r} of a .plan is not known", version, "version 1")
    mission = _part(document, "mission", dict, "the file")
    version = mission.get("version")
    if version != _MISSION_VERSION or isinstance(version, bool):
        raise bad("mission.version", f"version {version!r} of a mission is not known", version, "2")
    refuse_fences(document, leave_out)
    return mission, _items(_part(mission, "items", list, "the mission"), leave_out)


def refuse_fences(document: dict[str, Any], leave_out: Collection[int | str]) -> None:
    """Raise ``BadPlan`` for a fence."""
    # One that is read and not kept would be believed in.
    for name, parts in (("geoFence", ("circles", "polygons")), ("rallyPoints", ("points",))):
        fence = document.get(name)
        found = isinstance(fence, dict) and any(fence.get(part) for part in parts)
        if found and name not in leave_out:
            raise bad(
                name,
                f"the file has a {name}, which the M100 does not know",
                fence,
                f"leave it out by its name, {name!r}; a control block has guards of its own",
            )


def _items(
    found: Sequence[object], leave_out: Collection[int | str], prefix: str = "item "
) -> Iterator[QgcItem]:
    """The simple items, those of surveys in their place; item 1 is the first, as in the program."""
    for index, entry in enumerate(found, start=1):
        place = f"{prefix}{index}"
        if not isinstance(entry, dict):
            raise bad(place, f"{place} is not an object", entry)
        kind = entry.get("type")
        if kind == "SimpleItem":
            command = _part(entry, "command", int, place)
            if command not in leave_out:
                yield _simple(place, command, entry)
        elif kind == "ComplexItem":
            name = entry.get("complexItemType")
            if name not in leave_out:
                yield from _items(_inner(place, name, entry), leave_out, f"{place}.")
        else:
            raise bad(place, f"{place} is of type {kind!r}", kind, "SimpleItem or ComplexItem")


def _inner(place: str, name: object, entry: dict[str, Any]) -> list[object]:
    """The items that QGroundControl laid a survey or a corridor out as."""
    survey = entry.get("TransectStyleComplexItem")
    items = survey.get("Items") if isinstance(survey, dict) else None
    if not isinstance(items, list) or any(
        not isinstance(item, dict) or item.get("type") != "SimpleItem" for item in items
    ):
        raise bad(
            place,
            f"{place} is a {name!r} without items of its own",
            name,
            "surveys and corridors have them when QGroundControl has saved them; lay the others "
            "out as waypoints",
        )
    return items


def _simple(place: str, command: int, entry: dict[str, Any]) -> QgcItem:
    given = _part(entry, "params", list, place)
    found = [math.nan if value is None else number(value) for value in given]
    if len(found) != _PARAMETERS or None in found or math.inf in map(abs, filter(None, found)):
        raise bad(
            f"{place}.params", f"{place}: params are not 7 numbers", given, "7, or null in places"
        )
    parameters = tuple(value for value in found if value is not None)
    item = QgcItem(place, command, parameters, _part(entry, "frame", int, place))
    if entry.get("autoContinue", True) is not True:
        raise item.refuse("the mission would wait there", value=entry["autoContinue"])
    return item


# -- qgroundcontrol --------------------------------------------------------------------------------

_RELATIVE_FRAMES = (3, 6)  # above home: MAV_FRAME_GLOBAL_RELATIVE_ALT, and the same in integers
_SEA_LEVEL_FRAMES = (0, 5)
_TERRAIN_FRAMES = (10, 11)

_REMEDIES = {
    530: "the mode of the camera is set by hand",
    19: "a waypoint with a hold time",
    177: "repeat=2 of the plan flies the whole way twice",
}


def from_document(
    document: dict[str, Any],
    *,
    home_altitude: float | None = None,
    leave_out: Collection[int | str] = (),
) -> dict[str, Any]:
    """Arguments of a plan; see :meth:`m100link.WaypointPlan.from_qgroundcontrol`."""
    mission, items = items_of(document, leave_out)
    builder = _Builder(mission, home_altitude)
    for item in items:
        builder.read(item)
    return builder.arguments()


@dataclass
class _Builder:
    """The plan as far as the items were read."""

    mission: dict[str, Any]  # the object of the file that has the items
    home_altitude: float | None  # of the home position above sea level, m; None if nobody says it
    # Waypoints, each with the actions that came behind it.
    points: list[Waypoint] = field(default_factory=list)
    # Heading of each waypoint; None if it has none, NaN if it cannot have one.
    yaws: list[float | None] = field(default_factory=list)
    # Actions that came before there was a waypoint.
    waiting: list[WaypointAction] = field(default_factory=list)
    speed: float | None = None  # none until an item says it
    at_end: AtEnd | None = None  # none until an item ends the mission
    begins_with_take_off: bool = False  # whether the first waypoint is one
    # Metres from photograph to photograph, while they are taken by distance.
    spacing: float | None = None
    since_photo: float = 0.0  # metres flown since the last of them

    def read(self, item: QgcItem) -> None:
        if self.at_end is not None:
            raise item.refuse("it comes after the item that ends the mission")
        reader = _READERS.get(item.command)
        if reader is None:
            remedy = _REMEDIES.get(item.command, "fly it another way")
            raise item.refuse(
                "the M100 cannot do that in a mission",
                remedy=f"{remedy}; or leave it out by its number, {item.command}",
            )
        reader(self, item)

    def arguments(self) -> dict[str, Any]:
        if self.waiting and not self.points:
            raise bad("mission.items", "the mission has no waypoint", 0)
        speed = self.speed
        if speed is None and "hoverSpeed" in self.mission:
            speed = number(self.mission["hoverSpeed"])
            if speed is None or not speed > 0:
                found = self.mission["hoverSpeed"]
                raise bad("mission.hoverSpeed", f"hoverSpeed is {found!r}", found, "above 0 m/s")
        values: dict[str, Any] = {
            "at_end": self.at_end or AtEnd.HOVER,
            "take_off": self.begins_with_take_off,
        }
        if speed is not None:
            values |= {"speed": speed, "max_speed": max(10.0, speed)}
        return values | self._headed()

    def _headed(self) -> dict[str, Any]:
        """By waypoint if each has one; a few of them turn the nose where they are."""
        said = [yaw for yaw in self.yaws if yaw is None or not math.isnan(yaw)]
        points = list(zip(self.points, self.yaws, strict=True))
        if None in said or not said:
            turned = [
                point
                if yaw is None or math.isnan(yaw)
                else replace(point, actions=[TurnTo(yaw), *point.actions])
                for point, yaw in points
            ]
            return {"waypoints": turned}
        heading, headed = said[0], []
        for point, yaw in points:
            if yaw is not None and not math.isnan(yaw):
                heading = yaw
            headed.append(replace(point, heading_deg=heading or 0.0))
        return {"waypoints": headed, "heading": Heading.BY_WAYPOINT}

    def add(
        self, item: QgcItem, yaw: float | None, *, height: float | None = None, hold: float = 0.0
    ) -> None:
        """A waypoint where the item is."""
        latitude, longitude = item.parameters[4:6]
        if math.isnan(latitude) or math.isnan(longitude):
            raise item.refuse("it has no place", value=item.parameters[4:6])
        height = self._height(item) if height is None else height
        point = Waypoint(latitude, longitude, height, actions=self.waiting)
        first = self.points[0] if self.begins_with_take_off and len(self.points) == 1 else None
        if first is not None and leg_length(first, point) < NEAREST_M:
            # Taken off to this very place.
            point = replace(point, actions=[*first.actions, *self.waiting])
            self.points.clear()
            self.yaws.clear()
        self.waiting = []
        if self.spacing is not None and self.points:
            point = self._photograph_to(point)
        self.points.append(point)
        self.yaws.append(yaw)
        if hold > 0:
            self.do(Stay(hold))

    def _photograph_to(self, there: Waypoint) -> Waypoint:
        """Waypoints on the way, a photograph at each; those nearest to its ends are taken there."""
        assert self.spacing is not None
        here, begin = self.points[-1], self.spacing - self.since_photo
        length = leg_length(here, there)
        # One that falls behind the end by a hair is taken there.
        count = max(0, math.floor((length + NEAREST_M / 2 - begin) / self.spacing) + 1)
        if count > MOST_POINTS:
            raise bad(
                "mission.items",
                f"{count} photographs on one leg are more than a mission has waypoints",
                count,
                f"{MOST_POINTS} waypoints at most; a survey with fewer photographs, or in parts",
            )
        for index in range(count):
            flown = begin + index * self.spacing
            if flown < NEAREST_M:
                self.do(TakePhoto())
            elif flown > length - NEAREST_M:
                there = replace(there, actions=[TakePhoto(), *there.actions])
            else:
                self.points.append(_between(here, there, flown / length))
                self.yaws.append(math.nan)
        self.since_photo = length - (begin + (count - 1) * self.spacing)
        return there

    def do(self, action: WaypointAction) -> None:
        """An action at the newest waypoint, or at the first one when it comes."""
        if self.points:
            last = self.points[-1]
            self.points[-1] = replace(last, actions=[*last.actions, action])
        else:
            self.waiting.append(action)

    def _height(self, item: QgcItem) -> float:
        """Above the take-off point."""
        height = item.parameters[6]
        if math.isnan(height):
            raise item.refuse("it has no height", value=None)
        if item.frame in _RELATIVE_FRAMES:
            return height
        if item.frame in _SEA_LEVEL_FRAMES and self.home_altitude is not None:
            return height - self.home_altitude
        above = "sea level" if item.frame in _SEA_LEVEL_FRAMES else f"frame {item.frame}"
        if item.frame in _TERRAIN_FRAMES:
            above = "the terrain"
        raise item.refuse(
            f"its height {height:g} counts from {above}",
            value=item.frame,
            remedy="choose heights relative to launch in QGroundControl"
            + (
                ", or give the altitude of the take-off point"
                if item.frame in _SEA_LEVEL_FRAMES
                else ""
            ),
        )


def _between(here: Waypoint, there: Waypoint, part: float) -> Waypoint:
    """A place on the way, and a photograph there."""
    east = normalize_degrees(there.longitude_deg - here.longitude_deg)
    return Waypoint(
        here.latitude_deg + part * (there.latitude_deg - here.latitude_deg),
        normalize_degrees(here.longitude_deg + part * east),
        here.height + part * (there.height - here.height),
        actions=[TakePhoto()],
    )


def _zero(item: QgcItem, **named: float) -> None:
    """Refuse parameters that the M100 has nothing for; null and 0 ask for nothing."""
    for name, value in named.items():
        if value and not math.isnan(value):
            raise item.refuse(f"{name} {value:g} is not possible on the M100", value=value)


def _take_off(builder: _Builder, item: QgcItem) -> None:
    if builder.points:
        raise item.refuse("it comes behind a waypoint")
    place = item.parameters[4:6]
    if any(map(math.isnan, place)) or place == (0.0, 0.0):
        home = builder.mission.get("plannedHomePosition")
        found = [number(value) for value in home] if isinstance(home, list) else []
        place = tuple(value for value in found[:2] if value is not None)
        if len(place) < 2:
            raise item.refuse("it has no place, and the file no plannedHomePosition")
    parameters = (*item.parameters[:4], *place, item.parameters[6])
    builder.add(item._replace(parameters=parameters), math.nan)
    builder.begins_with_take_off = True


def _waypoint(builder: _Builder, item: QgcItem) -> None:
    hold, _, pass_radius, yaw, *_ = item.parameters
    _zero(item, pass_radius=pass_radius)
    heading = None if math.isnan(yaw) else normalize_degrees(yaw)
    builder.add(item, heading, hold=0.0 if math.isnan(hold) else hold)


def _return(builder: _Builder, _: QgcItem) -> None:
    builder.at_end = AtEnd.GO_HOME


def _land(builder: _Builder, item: QgcItem) -> None:
    latitude, longitude = item.parameters[4:6]
    has_place = not (math.isnan(latitude) or math.isnan(longitude)) and (latitude or longitude)
    if has_place and builder.points:
        last = builder.points[-1]
        # At the height that it has: that of a landing item is the ground's (MAVLink, 21).
        there = replace(last, latitude_deg=latitude, longitude_deg=longitude)
        if leg_length(last, there) >= NEAREST_M:
            builder.add(item, math.nan, height=last.height)
    builder.at_end = AtEnd.LAND


def _delay(builder: _Builder, item: QgcItem) -> None:
    seconds = item.parameters[0]
    if math.isnan(seconds) or seconds < 0:
        raise item.refuse("it waits for a time of day", remedy="a delay in seconds")
    builder.do(Stay(seconds))


def _yaw(builder: _Builder, item: QgcItem) -> None:
    angle, _, direction, relative, *_ = item.parameters
    _zero(item, relative=relative)
    if math.isnan(angle):
        raise item.refuse("it has no angle")
    point = builder.points[-1] if builder.points else None
    is_clockwise = direction != -1
    if point is None:
        raise item.refuse("it comes before the first waypoint")
    turns = any(isinstance(action, TurnTo) for action in point.actions)
    if turns and point.turn_clockwise != is_clockwise:
        raise item.refuse(
            "the M100 turns in one direction at a waypoint", value=direction, remedy="one of them"
        )
    builder.points[-1] = replace(point, turn_clockwise=is_clockwise)
    builder.do(TurnTo(normalize_degrees(angle)))


def _speed(builder: _Builder, item: QgcItem) -> None:
    kind, speed, throttle, *_ = item.parameters
    if throttle > 0 or kind not in (0, 1) or not speed > 0:
        raise item.refuse(
            "the M100 has one speed along the way",
            value=item.parameters[:3],
            remedy="an airspeed or ground speed in m/s, no throttle",
        )
    if builder.speed not in (None, speed) or (builder.speed is None and len(builder.points) > 1):
        raise item.refuse(
            "the speed changes on the way, and the M100 has one for the whole",
            value=speed,
            remedy="one speed, before the second waypoint; or two plans",
        )
    builder.speed = speed


def _digicam(builder: _Builder, item: QgcItem) -> None:
    _, zoom, zoom_step, focus, shoot, *_ = item.parameters
    _zero(item, zoom=zoom, zoom_step=zoom_step, focus=focus)
    if shoot != 1:
        raise item.refuse("it takes no photograph", value=shoot)
    builder.do(TakePhoto())


def _image(builder: _Builder, item: QgcItem) -> None:
    count = item.parameters[2]
    if count != 1:
        raise item.refuse(
            "photographs by time", value=count, remedy="one image (parameter 3 is 1) per item"
        )
    builder.do(TakePhoto())


def _by_distance(builder: _Builder, item: QgcItem) -> None:
    spacing, _, at_once, *_ = item.parameters
    if not spacing >= 0:
        raise item.refuse(f"photographs {spacing:g} m apart", value=spacing)
    if 0 < spacing < NEAREST_M:
        raise item.refuse(
            f"photographs {spacing:g} m apart, and the M100 stops at each",
            value=spacing,
            remedy=f"{NEAREST_M:g} m or more",
        )
    builder.spacing, builder.since_photo = spacing or None, 0.0
    if spacing and at_once == 1:
        builder.do(TakePhoto())


def _mount(builder: _Builder, item: QgcItem) -> None:
    pitch, roll, yaw, *_, mode = item.parameters
    _zero(item, roll=roll, yaw=yaw)
    if mode != 2 or math.isnan(pitch):
        raise item.refuse(f"mode {mode:g} of the mount", value=mode, remedy="2, angles")
    builder.do(GimbalPitch(pitch))


def _gimbal(builder: _Builder, item: QgcItem) -> None:
    pitch, yaw, pitch_rate, yaw_rate, *_ = item.parameters
    _zero(item, yaw=yaw, pitch_rate=pitch_rate, yaw_rate=yaw_rate)
    if math.isnan(pitch):
        raise item.refuse("it has no pitch")
    builder.do(GimbalPitch(pitch))


# Command → what becomes of it.
_READERS: dict[int, Callable[[_Builder, QgcItem], None]] = {
    16: _waypoint,
    20: _return,
    21: _land,
    22: _take_off,
    93: _delay,
    112: _delay,
    115: _yaw,
    178: _speed,
    203: _digicam,
    205: _mount,
    206: _by_distance,
    1000: _gimbal,
    2000: _image,
    2500: lambda builder, _: builder.do(StartVideo()),
    2501: lambda builder, _: builder.do(StopVideo()),
}


# -- plans as ``.plan`` files of QGroundControl ----------------------------------------------------
# MAVLink has no words for some of what the M100 flies. The items are the nearest that it has, for
# people to look at and for other aircraft; beside them, under ``"m100link"``, stands the plan as it
# is. The reader takes that one as long as the items are those that it makes, and the items of a
# file that was changed in QGroundControl.


EXTRA = "m100link"
_RELATIVE, _NO_PLACE = 3, 2
_PX4, _MULTIROTOR = 12, 2


def to_text(plan: PlanValues) -> str:
    """See :meth:`m100link.WaypointPlan.to_qgroundcontrol`."""
    return json.dumps(document_of(plan), indent=4) + "\n"


def document_of(plan: PlanValues) -> dict[str, Any]:
    """The file as an object."""
    first = plan.waypoints[0]
    items = [
        item | {"doJumpId": index, "autoContinue": True, "type": "SimpleItem"}
        for index, item in enumerate(_exported_items(plan), start=1)
    ]
    return {
        "fileType": FILE_TYPE,
        "version": 1,
        "groundStation": "m100link",
        "geoFence": {"circles": [], "polygons": [], "version": 2},
        "rallyPoints": {"points": [], "version": 2},
        "mission": {
            "version": 2,
            "firmwareType": _PX4,
            "vehicleType": _MULTIROTOR,
            "globalPlanAltitudeMode": 1,
            "cruiseSpeed": max(plan.speed, 1.0),
            "hoverSpeed": max(plan.speed, 1.0),
            "plannedHomePosition": [first.latitude_deg, first.longitude_deg, 0],
            "items": items,
        },
        EXTRA: {"format": FORMAT, "version": VERSION} | values_of(plan),
    }


def extra_of(document: dict[str, Any]) -> dict[str, Any] | None:
    """Arguments of the plan beside the items, or ``BadPlan``; None if there is none."""
    extra = document.get(EXTRA)
    return from_json(extra) if isinstance(extra, dict) else None


def _item(command: int, *parameters: float | None, frame: int = _NO_PLACE) -> dict[str, Any]:
    return {
        "command": command,
        "frame": frame,
        "params": [*parameters, *[0] * (7 - len(parameters))],
    }


def _exported_items(plan: PlanValues) -> Iterator[dict[str, Any]]:
    if plan.speed > 0:
        yield _item(178, 1, plan.speed, -1)
    if plan.take_off:
        yield _placed(22, plan.waypoints[0], None, plan.waypoints[0].height)
    for point in plan.waypoints:
        is_headed = plan.heading is Heading.BY_WAYPOINT
        yield _placed(16, point, point.heading_deg if is_headed else None, point.height)
        for action in point.actions:
            yield _action(action, point)
    if plan.at_end is AtEnd.GO_HOME:
        yield _item(20)
    elif plan.at_end is AtEnd.LAND:
        yield _placed(21, plan.waypoints[-1], None, 0)


def _placed(command: int, point: Waypoint, yaw: float | None, height: float) -> dict[str, Any]:
    place = point.latitude_deg, point.longitude_deg, height
    heights = {"AMSLAltAboveTerrain": None, "Altitude": height, "AltitudeMode": 1}
    return _item(command, 0, 0, 0, yaw, *place, frame=_RELATIVE) | heights


def _action(action: WaypointAction, point: Waypoint) -> dict[str, Any]:
    match action:
        case Stay(seconds):
            return _item(93, seconds, -1, -1, -1)
        case TakePhoto():
            return _item(2000, 0, 0, 1)
        case StartVideo():
            return _item(2500)
        case StopVideo():
            return _item(2501)
        case TurnTo(heading):
            return _item(115, heading % 360, 0, 1 if point.turn_clockwise else -1)
        case GimbalPitch(pitch):
            return _item(205, pitch, 0, 0, 0, 0, 0, 2)
    raise TypeError(f"{action!r} is not an action")
