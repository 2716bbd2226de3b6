"""``m100link plan``: make, check, draw and convert waypoint plans, without an aircraft."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from m100link.apps.cli.options import Above0, Force, group
from m100link.apps.cli.terminal import ExitCode, tell, tell_text
from m100link.errors import BadPlan, UsageError
from m100link.errors.texts import read_json
from m100link.geodesy import LocalFrame
from m100link.missions import document
from m100link.missions.checks import HOVER_MINUTES, PlanEstimate, leg_lengths
from m100link.missions.plan import WaypointPlan
from m100link.missions.survey import survey as lines_over
from m100link.missions.waypoint import (
    AtEnd,
    GimbalPitch,
    Heading,
    Stay,
    TurnTo,
    Waypoint,
    WaypointAction,
)

app = group("plan", "Make, check, draw and convert waypoint plans, without an aircraft.")

File = Annotated[str | Path, Parameter(allow_leading_hyphen=True)]
"""A name, or a hyphen for a standard stream: as it was typed. For a path shells offer files."""

PlanFile = Annotated[
    File, Parameter(help="A plan: JSON, or .plan of QGroundControl; - is standard input.")
]
Target = Annotated[File, Parameter(help="File to write; - is standard output.")]
TakeOff = Annotated[
    bool, Parameter("--takeoff", help="Take off first, from the ground, as plans with one do.")
]
Format = Annotated[
    Literal["json", "plan"] | None,
    Parameter("--format", help="Format to write; by default that of the file's name, else JSON."),
]

_WIDE = 64
"""Columns of a terminal that has room for places in degrees."""


@Parameter(name="*")
@dataclass(frozen=True)
class FileOptions:
    """How a .plan of QGroundControl is read.

    Attributes:
        leave_out: Items of a .plan to leave out: MAVLink numbers (530) or names (geoFence,
            rallyPoints), with commas or repeated.
        home_altitude: Altitude of the take-off point, m, if heights count from sea level.
    """

    leave_out: tuple[str, ...] = ()
    home_altitude: float | None = None


@Parameter(name="*")
@dataclass(frozen=True)
class EstimateOptions:
    """The assumptions of the estimate.

    Attributes:
        home: LATITUDE,LONGITUDE of the take-off point, to include the legs from and to it.
        hover_minutes: Minutes that a full battery keeps the aircraft in a hover.
    """

    home: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None
    hover_minutes: Annotated[float, Above0] = HOVER_MINUTES

    @property
    def place(self) -> tuple[float, float] | None:
        """Home in degrees. Raises UsageError: these are not two."""
        return None if self.home is None else degrees("home", self.home, LocalFrame)

    def of(self, plan: WaypointPlan) -> PlanEstimate:
        """The estimate."""
        return plan.estimate(home=self.place, hover_minutes=self.hover_minutes)


def read_plan(file: str | Path, options: FileOptions | None = None) -> WaypointPlan:
    """The plan in a file. Raises BadPlan, UsageError: the word names an aircraft."""
    path = str(file)
    if _names_an_aircraft(path):
        raise UsageError(
            f"the plan is {path!r}, which names an aircraft",
            remedy="did you swap PLAN and URL? The file comes first: m100link mission fly PLAN URL",
        )
    options = options or FileOptions()
    names = [name.strip() for word in options.leave_out for name in word.split(",")]
    leave_out = [int(name) if name.isdecimal() else name for name in names if name]
    how: dict[str, Any] = {"home_altitude": options.home_altitude, "leave_out": leave_out}
    if path != "-":
        return WaypointPlan.read(path, **how)
    return WaypointPlan.parse(sys.stdin.buffer.read(), **how)


def _names_an_aircraft(word: str) -> bool:
    """Whether a word that should be a file is a URL, a port, or a name of the configuration."""
    if "://" in word or word.startswith("sim:"):
        return True
    if os.path.exists(word):
        return Path(word).is_char_device()
    if word.startswith("/dev/"):
        return True
    from m100link.apps.cli.configuration import read_configuration

    return word in read_configuration().aircraft


@app.command
def check(
    plan: PlanFile, /, *, file: FileOptions | None = None, reckoning: EstimateOptions | None = None
) -> int:
    """Check a plan: its faults and surprises, its length and duration.

    The exit status is 0 if the aircraft would take the plan, and 2 if not. The check names every
    value that the aircraft cannot fly; without one, every distance between waypoints that it cannot
    fly. Of a file that it cannot read it names the first mistake.
    """
    reckoning = reckoning or EstimateOptions()
    place = reckoning.place
    try:
        found = read_plan(plan, file)
    except BadPlan as error:
        lines = [f"✗ {one.seen}" + f"\n  {one.remedy}" * bool(one.remedy) for one in error.problems]
        tell({"ok": False, "problems": [_problem(one) for one in error.problems]}, *lines)
        return ExitCode.USAGE
    made = reckoning.of(found)
    first = found.waypoints[0]
    near = place or (first.latitude_deg, first.longitude_deg)
    low, high = found.heights
    facts = {
        "ok": True,
        "problems": [],
        "remarks": found.remarks(),
        "waypoints": len(found.waypoints),
        "lowest_m": low,
        "highest_m": high,
        "farthest_m": round(found.farthest_m(*near), 2),
        "estimate": asdict(made),
    }
    return tell(
        facts,
        *(f"! {remark}" for remark in found.remarks()),
        f"✓ {len(found.waypoints)} waypoints, {f'{low:g} to ' if low < high else ''}{high:g} m "
        f"high, at most {found.farthest_m(*near):.0f} m from {'home' if place else 'the first'}",
        f"  about {made}",
    )


def _problem(error: BadPlan) -> dict[str, Any]:
    value = error.value if isinstance(error.value, bool | int | float | str) else None
    return {
        "point": error.point,
        "field": error.field,
        "value": value,
        "seen": error.seen,
        "remedy": error.remedy,
    }


@app.command
def show(
    plan: PlanFile, /, *, file: FileOptions | None = None, reckoning: EstimateOptions | None = None
) -> int:
    """Draw a plan: its track from above, its heights, and a table of its waypoints."""
    from m100link.apps.cli.common import out

    reckoning = reckoning or EstimateOptions()
    found = read_plan(plan, file)
    made = reckoning.of(found)
    words = *_choices(found), f"about {made}", *(f"! {remark}" for remark in found.remarks())
    return tell(
        {"estimate": asdict(made), "remarks": found.remarks()} | read_json(found.to_json()),
        lambda: out.print(*_pictures(found, max(20, min(out.width, 100))), sep="\n"),
        lambda: out.print("", _table(found, is_wide=out.width >= _WIDE), sep="\n"),
        lambda: out.print("", *words, sep="\n"),
    )


def _pictures(plan: WaypointPlan, width: int) -> Iterator[str]:
    """Seen from above, and from the side."""
    from m100link.apps.cli.display import line_plot, track_plot

    first = plan.waypoints[0]
    frame = LocalFrame(first.latitude_deg, first.longitude_deg)
    places = [frame.to_local(point.latitude_deg, point.longitude_deg) for point in plan.waypoints]
    names = [str(index) for index in range(len(places))]
    yield from track_plot(places, columns=width, rows=min(20, width // 3), names=names)
    flown = [0.0]
    for length in leg_lengths(plan.waypoints):
        flown.append(flown[-1] + length)
    heights = [(at, point.height) for at, point in zip(flown, plan.waypoints, strict=True)]
    if plan.heights[0] != plan.heights[1]:
        yield ""
        yield from line_plot(heights, unit="m", over="m", columns=width - 10, rows=6)


def _table(plan: WaypointPlan, *, is_wide: bool) -> Any:
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    places = ("latitude", "longitude") if is_wide else ()
    by_waypoint = plan.heading is Heading.BY_WAYPOINT
    for title in ("", *places, "height", "leg", *(("heading",) if by_waypoint else ()), "there"):
        table.add_column(title, justify="left" if title == "there" else "right", overflow="fold")
    legs = ["", *(f"{length:.1f} m" for length in leg_lengths(plan.waypoints))]
    for index, (point, leg) in enumerate(zip(plan.waypoints, legs, strict=True)):
        degrees = (f"{point.latitude_deg:.7f}", f"{point.longitude_deg:.7f}") if is_wide else ()
        heading = (f"{point.heading_deg:g}°",) if by_waypoint else ()
        table.add_row(str(index), *degrees, f"{point.height:g} m", leg, *heading, _there(point))
    return table


def _there(point: Waypoint) -> str:
    words = ", ".join(map(_word, point.actions))
    if point.actions and point.action_repeat > 1:
        words += f" ×{point.action_repeat}"
    if point.damping:
        words += f"{', ' if words else ''}corner {point.damping:g} m"
    return words


def _word(action: WaypointAction) -> str:
    match action:
        case Stay(seconds):
            return f"stay {seconds:g} s"
        case TurnTo(heading):
            return f"turn to {heading:g}°"
        case GimbalPitch(pitch):
            return f"gimbal {pitch:g}°"
        case _:
            # TakePhoto is "photo", StartVideo "start video".
            return {"TakePhoto": "photo", "StartVideo": "start video"}.get(
                type(action).__name__, "stop video"
            )


def _choices(plan: WaypointPlan) -> Iterator[str]:
    words = [
        plan.heading.name,
        plan.trace.name,
        f"at the end {plan.at_end.name}",
        f"without RC {plan.on_rc_loss.name}",
    ]
    yield (
        f"{plan.speed:g} m/s, with the stick up to {plan.max_speed:g} m/s"
        + (", flown twice" if plan.repeat == 2 else "")
    )
    yield ", ".join(word.lower().replace("_", " ").replace(" rc", " RC") for word in words)


@app.command
def convert(
    source: PlanFile,
    target: Target,
    /,
    *,
    file: FileOptions | None = None,
    format_: Format = None,
    force: Force = False,
) -> int:
    """Convert a plan: to JSON, or for QGroundControl if the name ends in .plan.

    The command refuses a QGroundControl item that the M100 cannot fly, unless you name it with
    --leave-out.
    """
    return _write(read_plan(source, file), target, format_, force=force)


def _write(
    plan: WaypointPlan, target: File, to: Literal["json", "plan"] | None, *, force: bool
) -> int:
    if str(target) != "-":
        require_free(target, force=force)
    return write_plan(plan, target, to)


def write_plan(plan: WaypointPlan, target: File, to: Literal["json", "plan"] | None = None) -> int:
    """Write a plan in the format of its name; - prints it."""
    kind = to or ("plan" if document.is_named_plan(target) else "json")
    text = plan.to_qgroundcontrol() if kind == "plan" else plan.to_json()
    if str(target) == "-":
        return tell_text(text, read_json(text))
    document.write(target, text)
    return tell({"file": str(target)})


def require_free(target: str | Path, *, force: bool) -> None:
    """Check a target before any work. Raises UsageError: a file is there, or there can be none."""
    path = Path(target)
    if os.path.isdir(path):
        raise UsageError(f"{target} is a folder", remedy=f"name a file: {path / 'plan.json'}")
    if os.path.exists(path) and not force:
        raise UsageError(f"{target} is there already", remedy="--force writes over it")
    if not os.path.isdir(path.parent):
        raise UsageError(
            f"there is no folder {path.parent}", remedy="make it first, or name another folder"
        )


@app.command
def survey(
    target: Target,
    /,
    *area: Annotated[str, Parameter(allow_leading_hyphen=True)],
    height: Annotated[float, Above0],
    spacing: Annotated[float, Above0],
    angle: float = 0.0,
    photo_every: Annotated[float | None, Above0] = None,
    cruise_speed: Annotated[float, Above0] = 5.0,
    take_off: TakeOff = False,
    at_end: Literal["hover", "go-home", "land"] = "hover",
    format_: Format = None,
    force: Force = False,
) -> int:
    """Write a plan of parallel lines (lawnmower) over an area.

    Args:
        area: Corners of the polygon in their order, each LATITUDE,LONGITUDE; 3 or more.
        height: Height above the take-off point, m.
        spacing: Distance between lines, m.
        angle: Direction of the lines, degrees clockwise from north.
        photo_every: Metres between photographs along a line; by default it takes none.
        cruise_speed: Horizontal speed, m/s.
        at_end: Action after the last line.
    """
    plan = lines_over(
        [degrees("a corner", word) for word in area],
        height=height,
        spacing=spacing,
        angle_deg=angle,
        photo_every=photo_every,
        speed=cruise_speed,
        at_end=AtEnd[at_end.replace("-", "_").upper()],
    )
    return _write(replace(plan, take_off=take_off), target, format_, force=force)


def degrees(
    what: str, word: str, check: Callable[[float, float], object] | None = None
) -> tuple[float, float]:
    """A place. Raises UsageError: these are not two numbers, or ``check`` takes them for none."""
    try:
        latitude, longitude = map(float, word.split(","))
        if check is not None:
            check(latitude, longitude)
    except ValueError:
        raise UsageError(
            f"{what} is {word!r}", remedy="LATITUDE,LONGITUDE in degrees: 52.1,4.31"
        ) from None
    return latitude, longitude
