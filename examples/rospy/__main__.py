"""Runs a Python program for ROS 1 unmodified, without ROS: see README.md."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from rospy_stand_in.launch import LaunchError, command_of, run_launch
from rospy_stand_in.packages import run_program


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        prog="python examples/rospy",
        usage="%(prog)s [--station ws://…] [--workspace FOLDER] program.py [argument …]",
        description="Run a Python program for ROS 1 unmodified, without ROS, on a station; or the "
        "Python programs that a launch file (*.launch) starts.",
        epilog="The arguments of the program may be remappings (a:=b), parameters (_rate:=50) and "
        "__ns:=/name. A token that the station asks for is in M100LINK_TOKEN.",
        allow_abbrev=False,
    )
    parser.add_argument(
        "--station",
        default="",
        metavar="ws://…",
        help="the rosbridge of the station; M100LINK_ROSBRIDGE, or ws://127.0.0.1:9090",
    )
    parser.add_argument(
        "--workspace",
        type=Path,
        metavar="FOLDER",
        help="the ROS packages that the program imports from; by default those around the program",
    )
    options, rest = parser.parse_known_args(arguments)
    if not rest:
        parser.error("name the program")
    program = Path(rest[0])
    if not program.is_file():
        parser.error(f"{program} is no file: name the program itself")
    if find_spec("websockets") is None:
        parser.error("it needs websockets: pip install '.[station]' in a clone of m100link")
    if program.suffix in (".launch", ".xml"):
        own = ["--station", options.station] if options.station else []
        own += ["--workspace", str(options.workspace)] if options.workspace else []
        try:
            raise SystemExit(run_launch(program, rest[1:], command_of(own), options.station))
        except LaunchError as error:
            parser.error(str(error))
    run_program(program, rest[1:], address=options.station, workspace=options.workspace)


if __name__ == "__main__":
    main()
