"""``sim://`` URLs: a virtual aircraft by its options, as ``m100link sim`` has them."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any, get_type_hints
from urllib.parse import parse_qsl

from m100link.errors import BadURL, UsageError
from m100link.sim.clock import LockstepEventLoop, VirtualClockEventLoop, loop_factory
from m100link.sim.line import LineFaults
from m100link.sim.vehicle.activation import DEMO_APP_ID, DEMO_KEY
from m100link.sim.vehicle.missions.route import MissionSettings
from m100link.sim.vehicle.settings import AircraftSettings, AssistantSettings
from m100link.sim.virtual import VirtualAircraft

LINE_OPTIONS: dict[str, str] = {
    one.name: {"baud_rate": "line-baud"}.get(one.name, one.name.replace("_", "-"))
    for one in fields(LineFaults)
}
"""What the fields of :class:`LineFaults` are called as options."""

_SITE_NAMES = {
    "latitude_deg": "latitude",
    "longitude_deg": "longitude",
    "heading_deg": "heading",
    "noise": "sensor-noise",
}
SITE_OPTIONS: dict[str, str] = {
    name: _SITE_NAMES.get(name, name.replace("_", "-"))
    for name in (
        *("latitude_deg", "longitude_deg", "ground_altitude", "heading_deg"),
        *("wind_north", "wind_east", "gusts", "noise", "movement_timeout", "server_delay"),
        "gimbal_follows",
    )
}
"""What the fields of :class:`AircraftSettings` are called that are options."""

MISSION_OPTIONS: dict[str, str] = {
    **{"status_hz": "mission-status-hz", "takes_off_by_itself": "mission-takes-off"},
    **{name: name.replace("_", "-") for name in ("hotpoint_acks", "follow_yaw_reversed")},
    **{"radius_limit": "radius-limit", "never_logged_in": "never-logged-in"},
}
"""What the fields of :class:`MissionSettings` are called that are options."""

_EXAMPLE = "sim://?firmware=3.1&speed=10&loss=0.1&seed=7"
_OWN: dict[str, Any] = {
    **{"firmware": str, "seed": int, "app-id": int, "key": str, "level": int},
    **{"cold": bool, "activated": bool, "speed": str, "pace": bool, "baud": int},
}
_TRUE, _FALSE = ("1", "true", "yes", "on", ""), ("0", "false", "no", "off")


def _bad(url: str, why: str) -> BadURL:
    return BadURL(f"{url}: {why}", remedy=f"write it like {_EXAMPLE}")


def _options(url: str) -> dict[str, Any]:
    """The options of a URL by their names, each of its type."""
    _, _, query = url.partition("?")
    found: dict[str, Any] = {}
    kinds = _kinds()
    for given, text in parse_qsl(query, keep_blank_values=True):
        name = given.replace("_", "-")
        if name not in kinds:
            raise _bad(url, f"sim:// has no option {given!r}; it has {', '.join(sorted(kinds))}")
        found[name] = _read(url, name, text, kinds[name])
    return found


def _kinds() -> dict[str, Any]:
    """The type of each option."""
    kinds = dict(_OWN)
    sources: tuple[tuple[type, dict[str, str]], ...] = (
        (LineFaults, LINE_OPTIONS),
        (AircraftSettings, SITE_OPTIONS),
        (MissionSettings, MISSION_OPTIONS),
    )
    for source, names in sources:
        hints = get_type_hints(source)
        kinds |= {option: hints[field] for field, option in names.items()}
    return kinds


def _read(url: str, name: str, text: str, kind: Any) -> Any:
    if kind is bool:
        if text.lower() not in (*_TRUE, *_FALSE):
            raise _bad(url, f"{name} is 1 or 0, not {text!r}")
        return text.lower() in _TRUE
    if kind is str:
        return text
    try:
        return int(text) if kind is int or kind == (int | None) else float(text)
    except ValueError:
        raise _bad(url, f"{name} is a number, not {text!r}") from None


def speed_of(url: str) -> float:
    """How many of its seconds a real one has; infinity for ``speed=max``.

    Raises ``BadURL``: it is not a speed.
    """
    text = _options(url).get("speed", "1")
    try:
        speed = float("inf") if text == "max" else float(text)
    except ValueError:
        speed = 0.0
    if not speed > 0:
        raise _bad(url, f"speed is a number above 0, or max, not {text!r}")
    return speed


def clock_of(line: object) -> Callable[[], asyncio.AbstractEventLoop] | None:
    """The event loop that a line wants for itself; None: any will do.

    With ``speed=max`` it is the one whose time passes while another thread waits.
    """
    if not isinstance(line, str) or not line.startswith("sim:"):
        return None
    speed = speed_of(line)
    if speed == 1.0:
        return None
    return LockstepEventLoop if speed == float("inf") else loop_factory(speed)


def check_clock(url: str, loop: asyncio.AbstractEventLoop) -> None:
    """Whether time passes here as fast as the URL says: the aircraft lives on the program's clock.

    Raises ``UsageError``: it does not.
    """
    if "speed" not in _options(url):
        return
    wanted = speed_of(url)
    there = float("inf") if isinstance(loop, VirtualClockEventLoop) else 1.0
    there = getattr(loop, "speed", there)
    if wanted != there:
        raise UsageError(
            f"{url} asks for a speed of {wanted:g}, and the time of this event loop passes at "
            f"{there:g}",
            cause="a virtual aircraft in a program lives on the clock of its event loop",
            remedy="asyncio.Runner(loop_factory=m100link.sim.loop_factory(SPEED)), "
            "infinity for max; or m100link.sync, which makes its own; or `m100link sim --speed`",
        )


def aircraft_of(url: str) -> VirtualAircraft:
    """The virtual aircraft that a URL describes.

    Raises ``BadURL``: an option that does not exist, or a value that it cannot have.
    """
    options = _options(url)

    def taken(names: Mapping[str, str]) -> dict[str, Any]:
        return {field: options[option] for field, option in names.items() if option in options}

    cold = options.get("cold", False)
    try:
        assistant = AssistantSettings(
            api_control_enabled=not cold, baud_rate=options.get("baud", 230_400)
        )
        return VirtualAircraft(
            seed=options.get("seed", 0),
            firmware=options.get("firmware", "1.0"),
            app_id=options.get("app-id", DEMO_APP_ID),
            key=options.get("key", DEMO_KEY),
            level=options.get("level", 2),
            cold=cold,
            activated=options.get("activated", False),
            settings=AircraftSettings(
                **taken(SITE_OPTIONS), missions=MissionSettings(**taken(MISSION_OPTIONS))
            ),
            assistant=assistant,
            faults=LineFaults(**taken(LINE_OPTIONS)),
            paced=options.get("pace", False),
        )
    except ValueError as error:
        raise _bad(url, str(error)) from error
