"""``m100link mavlink``: aircraft as vehicles for MAVSDK, QGroundControl and every other program."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from cyclopts import Parameter

from m100link.apps.cli.common import places
from m100link.apps.cli.options import offered, options_of
from m100link.apps.cli.serving import AS_USUAL, RunOptions, run_station
from m100link.apps.cli.station import aircraft_of
from m100link.apps.station.config import ENVIRONMENT, Settings

__all__ = ["mavlink"]

USUAL = ("udp://127.0.0.1:14550", "udp://127.0.0.1:14540")
"""Where ground stations and programs listen for a vehicle, as PX4's simulator knows them."""

_FromSettings: Any = options_of(
    Settings,
    (
        *("baud_rate", "firmware", "timeout", "app_id", "key", "key_file", "level"),
        *("app_version", "bundle_id", "max_height", "max_radius", "keep_authority"),
        *("mavlink", "mavlink_to", "sysid", "autopilot", "signing_key_file"),
    ),
    environment=ENVIRONMENT,
    called={"baud_rate": "--baud", "mavlink": "--listen", "mavlink_to": "--to"},
    is_layer=True,
)


@Parameter(name="*")
@dataclass(frozen=True)
class MavlinkOptions(_FromSettings):  # type: ignore[misc] # a class that is made has no type
    """Where the aircraft is, who may fly it and how far.

    Attributes:
        run: How the station is run and told of.
    """

    run: RunOptions = AS_USUAL


def mavlink(
    *url: Annotated[str, offered(places)], options: MavlinkOptions = MavlinkOptions()
) -> int:
    """Let MAVSDK, QGroundControl and other MAVLink programs see and fly the aircraft.

    They take each for a vehicle with PX4's modes, until Ctrl-C. Without --listen and --to those
    are spoken to that listen on this machine, at the usual ports 14550 and 14540: `m100link mavlink
    sim://`.

    Args:
        url: Where the aircraft is, or its name (M100LINK_URL); several, or name=URL, for several.
        options: See below.
    """
    aircraft = aircraft_of(options, url)
    first = next(iter(aircraft.values()))
    if not first.mavlink and not first.mavlink_to:
        aircraft = aircraft_of(options, url, mavlink_to=USUAL)
    return run_station(aircraft, options.run, with_rosbridge=False)
