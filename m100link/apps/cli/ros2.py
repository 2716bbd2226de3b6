"""``m100link ros2``: aircraft as nodes of ROS 2, for RViz, Nav2, rosbag2 and every program."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from cyclopts import Parameter

from m100link.apps.cli.common import places
from m100link.apps.cli.options import offered, options_of
from m100link.apps.cli.serving import AS_USUAL, RunOptions, run_station
from m100link.apps.cli.station import aircraft_of
from m100link.apps.station.config import ENVIRONMENT, Settings

__all__ = ["ros2"]

_FromSettings: Any = options_of(
    Settings,
    (
        *("baud_rate", "firmware", "timeout", "app_id", "key", "key_file", "level"),
        *("app_version", "bundle_id", "max_height", "max_radius", "keep_authority"),
        *("ros2_namespace", "ros2_node", "ros2_domain", "ros2_remap", "ros2_dji_names"),
    ),
    environment=ENVIRONMENT,
    called={
        "baud_rate": "--baud",
        "ros2_namespace": "--namespace",
        "ros2_node": "--node",
        "ros2_domain": "--domain",
        "ros2_remap": "--remap",
        "ros2_dji_names": "--dji-names",
    },
    is_layer=True,
)


@Parameter(name="*")
@dataclass(frozen=True)
class Ros2Options(_FromSettings):  # type: ignore[misc] # a class that is made has no type
    """Where the aircraft is, what it is called in the graph, and how far it may fly.

    Attributes:
        run: How the station is run and told of.
    """

    run: RunOptions = AS_USUAL


def ros2(*url: Annotated[str, offered(places)], options: Ros2Options = Ros2Options()) -> int:
    """Be a node of ROS 2, without a ROS installation, until Ctrl-C.

    Programs that run with RMW_IMPLEMENTATION=rmw_zenoh_cpp see and fly the aircraft, by the router
    at localhost:7447 or wherever ZENOH_SESSION_CONFIG_URI and ZENOH_CONFIG_OVERRIDE say. Whoever
    reaches that router can fly: `m100link ros2 sim://`.

    Args:
        url: Where the aircraft is, or its name (M100LINK_URL); several, or name=URL, for several.
        options: See below.
    """
    return run_station(aircraft_of(options, url, ros2=True), options.run, with_rosbridge=False)
