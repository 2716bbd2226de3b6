"""``m100link log ros2`` and ``layout``: flights for the tools of others."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from m100link.apps.cli.common import out
from m100link.apps.cli.log_plot import new_file, write_new
from m100link.apps.cli.options import Firmware
from m100link.apps.cli.outcome import ExitCode
from m100link.apps.cli.progress import reading, status
from m100link.log.layout import layout as layout_of_panels
from m100link.log.ros2 import write_bag

__all__ = ["layout", "ros2"]


def ros2(
    file: Path,
    /,
    *,
    output: Annotated[Path | None, Parameter(name=("--output", "-o"))] = None,
    firmware: Firmware | None = None,
) -> int:
    """Write a bag of ROS 2: MCAP with its messages in CDR, for ``ros2 bag``, rosbags, Foxglove.

    Args:
        file: The log.
        output: A new file; by default FILE with ``-ros2`` before its suffix.
        firmware: Profile to read it by; by default that of the flight.
    """
    target = output or file.with_stem(f"{file.stem}-ros2")
    with reading(file, passes=2) as flight, new_file(target) as stream:
        count = write_bag(flight, stream, firmware=firmware)
    out.print(f"{count} messages in {target}", soft_wrap=True)
    return status(flight)


def layout(*, output: Annotated[Path | None, Parameter(name=("--output", "-o"))] = None) -> int:
    """Print a layout for Foxglove and Lichtblick: map, height, speed, battery, attitude, events.

    Import it there: Layouts, Import from file.

    Args:
        output: A new file instead of standard output.
    """
    text = json.dumps(layout_of_panels(), indent=2) + "\n"
    if output is None:
        sys.stdout.write(text)
    else:
        write_new(output, text.encode())
        out.print(f"layout in {output}", soft_wrap=True)
    return ExitCode.OK
