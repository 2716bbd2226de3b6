"""Set-ups that are broken, made by script, and what the doctor is to say of each.

``python -m tests.apps.doctor.setups`` runs them all, on virtual time, and prints the table of the
manual (``docs/reference/diagnoses.md``). Each is looked at once more in test_diagnosis.py.
"""

from __future__ import annotations

import asyncio
import fcntl
import math
import os
import re
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pytest

from m100link import Credentials
from m100link.apps.cli.connection import exit_status
from m100link.apps.doctor import Report, Stage, diagnose
from m100link.apps.doctor.machine import Process
from m100link.protocol.codes import AuthorityCode
from m100link.protocol.commands.activation import GetVersion
from m100link.protocol.firmware import FIRMWARE_1_0
from m100link.sim import DEMO_APP_ID, DEMO_KEY, VirtualAircraft, VirtualClockEventLoop
from m100link.sim.vehicle.dynamics import STEPS_PER_SECOND
from m100link.sim.vehicle.remote import ControlArbiter
from m100link.sim.vehicle.sensors import Sensors
from m100link.wire.frame import encode_frame
from tests.apps.doctor.bench import CONSOLE, GPS, TELEMETRY, Bench, FakeMachine, mavlink

APP = Credentials(DEMO_APP_ID, DEMO_KEY)
OTHER_KEY = Credentials(DEMO_APP_ID, "11" * 32)
OTHER_APP = Credentials(2_942_424_217, DEMO_KEY)
ITEMS = (
    *("time", "quaternion", "acceleration", "velocity", "angular_velocity", "position"),
    *("magnetometer", "rc", "gimbal", "flight_status", "battery", "control_device"),
)
NO_RATES = "rates " + " ".join(f"{item}=0" for item in ITEMS)
QUESTION = encode_frame(GetVersion().encode(FIRMWARE_1_0), session=2, sequence=77)


@dataclass(frozen=True)
class SetUp:
    """A set-up, and what is to be said of it.

    Attributes:
        name: What is wrong with it.
        stage: At which it ends; None where it does not fail.
        seen: A part of what is seen there.
        cause: A part of the likeliest cause.
        status: Exit status of the command.
        url: Where the aircraft is; the port of the bench when empty.
        breaks: Breaks it, on the bench.
        app: Whose app it is.
        arguments: Of the diagnosis.
        doubts: Stages that are doubtful before it.
    """

    name: str
    stage: Stage | None
    seen: str = ""
    cause: str = ""
    status: int = 0
    url: str = ""
    breaks: Callable[[Bench], object] = lambda bench: None
    app: Credentials | None = None
    arguments: dict[str, Any] = field(default_factory=dict)
    doubts: tuple[Stage, ...] = ()


def _lock(bench: Bench) -> None:
    """As a program of another user does, into which nobody can look."""
    number = os.open(bench.port, os.O_RDWR | os.O_NOCTTY)
    fcntl.flock(number, fcntl.LOCK_EX)
    bench.machine.locks.append(number)


def _unknown(bench: Bench) -> None:
    profile = replace(FIRMWARE_1_0, version_name="SDK-v9.9 BETA M999-09.09.09.09")
    bench.order(make=lambda _: VirtualAircraft(firmware=profile, seed=1))


def _simulate(bench: Bench) -> None:
    """As DJI's PC simulator: the nose turns by 20° a second, and the IMU stands on the desk."""

    def turn(self: Sensors) -> tuple[float, ...]:
        half = math.radians(20.0 * self.ticks / STEPS_PER_SECOND) / 2
        return math.cos(half), 0.0, 0.0, math.sin(half)

    bench.patch.setattr(Sensors, "_read_quaternion", turn)


def _hold(bench: Bench) -> None:
    """As owners of firmware 3.1 report it once the app has flown a mission."""
    bench.patch.setattr(ControlArbiter, "_obtain", lambda _: AuthorityCode.NOT_CHANGED)


def _order(*orders: str, at: float = 0.0) -> Callable[[Bench], None]:
    return lambda bench: bench.order(*orders, at=at)


def _speak(*args: Any, **options: Any) -> Callable[[Bench], None]:
    return lambda bench: bench.speak(*args, **options)


_PORT = (
    SetUp(
        *(
            "there is no such port",
            Stage.PORT,
            "there is no device",
            "the adapter is not plugged",
        ),
        *(3, "/dev/ttyUSB99"),
    ),
    SetUp(
        "a container that was not given the port",
        Stage.PORT,
        "there is no device",
        "this is a container",
        3,
        "/dev/ttyUSB99",
        lambda bench: bench.machine.write(".dockerenv", ""),
    ),
    SetUp(
        *(
            "a folder of that name",
            Stage.PORT,
            "is not a serial port",
            "a file or a folder",
        ),
        *(3, "/tmp"),
    ),
    SetUp(
        "the user is not in the port's group",
        Stage.PERMISSION,
        "you may not read and write",
        "you are not in the group dialout",
        3,
        breaks=lambda bench: bench.forbid("dialout"),
    ),
    SetUp(
        "the user was added to it, and has not logged in again",
        Stage.PERMISSION,
        "you may not read and write",
        "after you logged in",
        3,
        breaks=lambda bench: bench.forbid("dialout", is_member=True),
    ),
    SetUp(
        "the port belongs to root alone",
        Stage.PERMISSION,
        "you may not read and write",
        "no rule gives the device",
        3,
        breaks=lambda bench: bench.forbid("root"),
    ),
    SetUp(
        "another program has the port",
        Stage.OWNER,
        "in use by minicom (process 4711)",
        "two programs on one port",
        3,
        breaks=lambda bench: bench.give_to(Process(4711, "minicom")),
    ),
    SetUp(
        "another user's program has it, which is not seen",
        Stage.OPENING,
        "is in use",
        "only one program can talk to the aircraft",
        3,
        breaks=_lock,
    ),
    SetUp(
        "a login prompt runs on it",
        Stage.INTERFERENCE,
        "a login prompt runs on it",
        "the system offers a console",
        3,
        breaks=lambda bench: bench.machine.run(99, "/sbin/agetty", Path(bench.port).name),
    ),
    SetUp(
        "the kernel writes its messages to it",
        Stage.INTERFERENCE,
        "the kernel writes its messages to it",
        "on the kernel's command line",
        3,
        breaks=lambda bench: bench.machine.write("proc/consoles", f"{Path(bench.port).name} -W-\n"),
    ),
    SetUp(
        "a device that is not a serial port",
        Stage.OPENING,
        "/dev/null is not a serial port",
        "a device of another kind",
        3,
        "/dev/null",
    ),
    SetUp(
        "nobody listens there",
        Stage.OPENING,
        "nothing answers at tcp://127.0.0.1:1",
        "the program that should listen there is not running",
        3,
        "tcp://127.0.0.1:1",
    ),
)

_NOISE = "noise: no common ground"
_FLOATING = "RX is joined to nothing"
_LINE = (
    SetUp(
        "the wire from the aircraft is broken",
        *(Stage.BYTES, "no answer to two version queries", "TX and RX are swapped"),
        *(4, "sim://?mute=1"),
    ),
    SetUp(
        "both wires are broken",
        *(Stage.BYTES, "not one byte", "TX and RX are swapped", 4, "sim://?mute=1&deaf=1"),
    ),
    SetUp(
        "a computer that listens, and has no aircraft",
        *(Stage.BYTES, "not one byte", "the program that listens there has no aircraft"),
        *(4, "tcp://127.0.0.1:7000", _speak()),
    ),
    SetUp(
        "a computer that hangs up at once",
        *(Stage.BYTES, "closed the connection at once", "has another client"),
        *(4, "tcp://127.0.0.1:7000", _speak(closes=True)),
    ),
    SetUp(
        "RX hangs in the air and picks up noise",
        *(Stage.FRAMES, "an aircraft sends far more", _FLOATING),
        *(4, "sim://?mute=1&noise=0.8&seed=3"),
    ),
    SetUp(
        "the levels are inverted",
        *(Stage.FRAMES, "whose levels are inverted", "an adapter for RS-232"),
        *(4, "sim://?inverted=1"),
    ),
    SetUp(
        "115200 baud instead of 230400",
        Stage.FRAMES,
        "at 230400 baud; at 115200 baud they are frames",
        "the aircraft is set to 115200 baud in the PC assistant",
        4,
        breaks=_speak(TELEMETRY * 4, rate=115_200),
    ),
    SetUp(
        "a rate that nobody uses",
        *(Stage.FRAMES, "nor at any other usual rate", _NOISE, 4),
        breaks=_speak(TELEMETRY * 4, rate=31_250),
    ),
    SetUp(
        "nearly every frame is damaged",
        *(Stage.FRAMES, "part of no frame", _NOISE, 4, "sim://?damage=0.97&seed=3"),
    ),
    SetUp(
        "bytes of each frame are missing",
        *(Stage.FRAMES, "bytes are missing", "another program reads from this port", 4),
        *("sim://", _speak(TELEMETRY[:40] * 3)),
    ),
    SetUp(
        "one frame of twelve is damaged",
        *(None, "", "", 0, "sim://?damage=0.08&seed=3"),
        app=APP,
        doubts=(Stage.FRAMES,),
    ),
    SetUp(
        "more noise than frames, and frames between it",
        *(None, "", "", 0, "sim://?noise=200&noise-bytes=200"),
        app=APP,
        doubts=(Stage.FRAMES,),
    ),
    SetUp(
        "the line is held low",
        *(Stage.FRAMES, "all", "the line is held low", 4, "sim://", _speak(bytes(50))),
    ),
    SetUp(
        "TX and RX of the adapter are joined",
        *(
            Stage.FRAMES,
            "what was sent comes back",
            "TX and RX of this adapter are joined",
        ),
        *(4, "sim://", _speak(b"", lambda heard: heard)),
    ),
    SetUp(
        "a GPS receiver is on the port",
        *(Stage.FRAMES, "it is NMEA text", "a GPS receiver is on this port"),
        *(4, "sim://", _speak(GPS)),
    ),
    SetUp(
        "a boot console is on the port",
        *(Stage.FRAMES, "it is text", "a boot console or a login prompt"),
        *(4, "sim://", _speak(CONSOLE)),
    ),
    SetUp(
        "an autopilot that speaks MAVLink",
        *(Stage.FRAMES, "it is MAVLink 2", "an autopilot that speaks MAVLink"),
        *(4, "sim://", _speak(mavlink(0xFD, 12))),
    ),
    SetUp(
        "a web server instead of an aircraft",
        *(Stage.FRAMES, "it is text: 'HTTP/1.1 400", "another program listens there"),
        *(4, "tcp://127.0.0.1:80"),
        _speak(b"", lambda _: b"HTTP/1.1 400 Bad Request\r\nConnection: close\r\n\r\n"),
    ),
)

_ITEM_RATES = "all telemetry rates are 0"
_AIRCRAFT = (
    SetUp(
        "the aircraft hears nothing",
        *(Stage.VERSION, "no answer to a version query", "the wire from our TX", 4),
        "sim://?deaf=1",
    ),
    SetUp(
        "RX hears another computer, not the aircraft",
        *(Stage.VERSION, "no answer to a version query", "the wire from our TX", 4),
        *("sim://?deaf=1", _speak(QUESTION)),
        doubts=(Stage.TELEMETRY,),
    ),
    SetUp(
        "it is switched off while it is looked at",
        *(Stage.ACTIVATION, "has fallen silent", "it was switched off", 4),
        *("sim://", _order("stall", at=1.5), APP),
    ),
    SetUp(
        "the line is slow",
        *(None, "", "", 0, "sim://?delay=0.6", lambda bench: None, APP),
        doubts=(Stage.VERSION,),
    ),
    SetUp(
        "every second frame is lost",
        *(Stage.ACTIVATION, "the aircraft is heard", "frames are lost on the way", 4),
        *("sim://?loss=0.5&seed=1", lambda bench: None, APP),
    ),
    SetUp(
        "no telemetry",
        *(None, "", "", 0, "sim://", _order(NO_RATES), APP),
        doubts=(Stage.TELEMETRY,),
    ),
    SetUp(
        "a firmware that nobody knows",
        *(None, "", "", 0, "sim://", _unknown, APP),
        doubts=(Stage.FIRMWARE,),
    ),
    SetUp(
        "another firmware is forced",
        *(Stage.FIRMWARE, "do not fit firmware 1.0", "another firmware than the one"),
        *(4, "sim://?firmware=3.1"),
        arguments={"firmware": "1.0"},
    ),
    SetUp(
        "its telemetry is that of another firmware",
        *(Stage.FIRMWARE, "do not fit firmware 1.0", "whose version text is like that"),
        *(4, "sim://?firmware=1.0-document"),
    ),
    SetUp(
        "the PC assistant sends acceleration raw, and the program was given another mode",
        *(None, "", "", 0, "sim://?acceleration=raw", lambda bench: None, APP),
        doubts=(Stage.ACCELERATION,),
        arguments={"acceleration": "fused"},
    ),
    SetUp(
        "the simulator of the PC assistant flies it",
        *(None, "", "", 0, "sim://?firmware=3.1", _simulate, APP),
        doubts=(Stage.ACCELERATION,),
    ),
    SetUp(
        "nobody has activated it",
        *(Stage.ACTIVATION, "it is not activated", "nobody activated it", 5, "sim://"),
    ),
    SetUp(
        "no phone with DJI's app",
        *(Stage.ACTIVATION, "the DJI app does not answer", "no mobile device", 5),
        *("sim://?cold=1", lambda bench: None, APP),
    ),
    SetUp(
        "the phone has no network",
        *(
            Stage.ACTIVATION,
            "the DJI app has no internet",
            "the server is reached through",
            5,
        ),
        *("sim://", _order("app internet=off"), APP),
    ),
    SetUp(
        "it asks DJI's server for ever",
        *(Stage.ACTIVATION, "so for 20 s", "the phone at the remote control has no internet", 5),
        *("sim://?firmware=3.1&server-delay=1000", lambda bench: None, APP),
    ),
    SetUp(
        "the app id is not registered",
        *(Stage.ACTIVATION, "code 6", "unknown app id", 5, "sim://"),
        app=OTHER_APP,
    ),
    SetUp(
        "the app id is of too low a level",
        *(Stage.ACTIVATION, "code 7", "registered for a lower level", 5, "sim://?level=1"),
        app=APP,
    ),
    SetUp(
        "the key is another, authority is not tried",
        *(None, "", "", 0, "sim://"),
        app=OTHER_KEY,
        doubts=(Stage.KEY,),
    ),
    SetUp(
        "the key is another",
        Stage.AUTHORITY,
        "no usable answer, while plain requests are answered",
        "the key of this program is not the one",
        6,
        "sim://",
        app=OTHER_KEY,
        arguments={"authority": True},
        doubts=(Stage.KEY,),
    ),
    SetUp(
        "the mode switch is not in F",
        *(Stage.MODE_SWITCH, "it is in P", "stands in P", 6, "sim://?cold=1&activated=1"),
    ),
    SetUp(
        "API control is not enabled",
        *(Stage.AUTHORITY, "the switch is in F", "API control is not enabled", 6),
        *("sim://", _order("api off"), APP, {"authority": True}),
    ),
    SetUp(
        "IOC is on",
        *(Stage.AUTHORITY, "IOC is on", "intelligent orientation control is active", 6),
        *("sim://?firmware=2.3", _order("ioc on"), APP, {"authority": True}),
    ),
    SetUp(
        "the mobile app controls the aircraft",
        *(Stage.AUTHORITY, "the mobile app controls", "the mobile app holds control", 6),
        *("sim://?firmware=3.1", _order("app-takes-control", "rates control_device=10")),
        *(APP, {"authority": True}),
    ),
    SetUp(
        "the app has flown a mission, and the switch was not in P since",
        *(Stage.AUTHORITY, "goes on being in progress", "the app has flown a mission", 6),
        *("sim://?firmware=3.1", _hold, APP, {"authority": True}),
    ),
    SetUp("nothing", None, url="sim://?seed=1", app=APP, arguments={"authority": True}),
)

SET_UPS = {one.name: one for one in (*_PORT, *_LINE, *_AIRCRAFT)}


@contextmanager
def on_bench(set_up: SetUp) -> Iterator[Bench]:
    """Break it; everything is whole again behind the block."""
    with ExitStack() as stack:
        patch = stack.enter_context(pytest.MonkeyPatch.context())
        root = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        ends = os.openpty()
        for number in ends:
            stack.callback(os.close, number)
        machine = FakeMachine(root)
        stack.callback(machine.unlock)
        bench = Bench(patch, machine, os.ttyname(ends[1]))
        set_up.breaks(bench)
        yield bench


async def diagnosed(set_up: SetUp) -> Report:
    """What the doctor says of it."""
    with on_bench(set_up) as bench:
        return await diagnose(
            set_up.url or bench.port,
            credentials=set_up.app,
            machine=bench.machine,
            **set_up.arguments,
        )


def row(set_up: SetUp, report: Report) -> str:
    """The row of the manual."""
    named = report.failure or next(iter(report.doubts), None)
    cells = [set_up.name, "nothing is wrong" if named is None else "", "", ""]
    if named is not None:
        cells[1:3] = f"{named.stage.title}: **{named.verdict}**", named.causes[0]
        cells[3] = named.commands[0]
    text = "| " + " | ".join([*cells, str(exit_status(report))]) + " |"
    text = text.replace(f" {report.place}", " PORT")  # which the manual cannot know
    # What differs from machine to machine.
    text = re.sub(r"ports on this machine: [^|]*", "m100link ports ", text)
    text = re.sub(r"(console=|getty@)\d+", r"\1ttyUSB0", text)
    return re.sub(r"/dev/pts/\d+", "/dev/ttyUSB0", text)


async def rows() -> list[str]:
    """All rows, with those of the head."""
    head = "| Broken | Named | Likeliest cause | First thing to do | Exit |"
    found = [head, "|---|---|---|---|---|"]
    for set_up in SET_UPS.values():
        found.append(row(set_up, await diagnosed(set_up)))
    return found


def main() -> None:
    """Print the table."""
    with asyncio.Runner(loop_factory=VirtualClockEventLoop) as runner:
        sys.stdout.write("\n".join(runner.run(rows())) + "\n")


if __name__ == "__main__":
    main()
