"""Fly a square by MAVLink, with a socket and the codec of m100link: no MAVLink library is needed.

python examples/mavlink/square.py                           # with a virtual aircraft of its own
python examples/mavlink/square.py udp://127.0.0.1:14550     # m100link mavlink URL --listen there
"""

import contextlib
import json
import math
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from urllib.parse import urlsplit

from m100link.apps.mavlink.translator.codec import MavlinkMessage, MessageReader, write_frame
from m100link.apps.mavlink.translator.numbers import BaseMode, MavCommand, MavFrame, MavResult

OFFBOARD, HOLD = (6, 0), (4, 3)  # main and sub mode, by the numbers of PX4
LEGS = [(2.0, 0.0), (0.0, 2.0), (-2.0, 0.0), (0.0, -2.0)]  # m/s north, m/s east
LEG_SECONDS = 3.0
ONLY_VELOCITY = 0b1101_1100_0111  # what SET_POSITION_TARGET_LOCAL_NED ignores: all the rest
PATIENCE = 60.0


class Vehicle:
    """The aircraft as this ground station sees it."""

    def __init__(self, url: str) -> None:
        place = urlsplit(url)
        self.line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.line.connect((place.hostname, place.port))
        self.line.settimeout(0.05)
        self.newest: dict[str, MavlinkMessage] = {}
        self.sent, self.beaten_at = 0, -math.inf

    def say(self, message: str, **fields: float | str) -> None:
        self.sent += 1
        to = {"target_system": 1, "target_component": 1}
        values = MavlinkMessage(message, fields | to, component=190)
        self.line.send(write_frame(values, system=255, sequence=self.sent))

    def listen(self) -> None:
        """Hear what has come, and say the heartbeat: who is silent for 3 s counts as lost."""
        if time.monotonic() - self.beaten_at >= 0.5:
            self.beaten_at = time.monotonic()
            self.say("HEARTBEAT", type=6, autopilot=8)
        with contextlib.suppress(TimeoutError, ConnectionRefusedError):
            for message in MessageReader(self.line.recv(65536)):
                if message.component != 1:  # the camera has a heartbeat of its own
                    continue
                self.newest[message.name] = message
                if message.name == "STATUSTEXT":  # why something was refused, or happened
                    print("   ", message["text"])

    def wait(self, name: str, **wanted: float | str) -> MavlinkMessage:
        """Wait for a message, with these values if any are named."""
        self.newest.pop(name, None)
        ends = time.monotonic() + PATIENCE
        while time.monotonic() < ends:
            self.listen()
            found = self.newest.get(name)
            if found is not None and all(found[key] == one for key, one in wanted.items()):
                return found
        raise SystemExit(f"no {name} {wanted} in {PATIENCE:g} s")

    def command(self, number: int, *parameters: float) -> None:
        """Give a command; what is refused ends this program."""
        given = (*parameters, *[math.nan] * (7 - len(parameters)))
        named = {f"param{place}": value for place, value in enumerate(given, 1)}
        self.say("COMMAND_LONG", command=number, **named)
        result = MavResult.IN_PROGRESS
        while result is MavResult.IN_PROGRESS:  # arming takes as long as the aircraft takes
            result = MavResult(self.wait("COMMAND_ACK", command=number)["result"])
        print(f"{MavCommand(number).name}: {result.name}")
        if result is not MavResult.ACCEPTED:
            raise SystemExit(1)

    def fly(self, north: float, east: float, seconds: float) -> None:
        """Velocity setpoints, 20 a second or more: when they stop coming it hovers."""
        ends = time.monotonic() + seconds
        while time.monotonic() < ends:
            mask = {"coordinate_frame": MavFrame.LOCAL_NED, "type_mask": ONLY_VELOCITY}
            self.say("SET_POSITION_TARGET_LOCAL_NED", vx=north, vy=east, **mask)
            self.listen()

    def place(self) -> tuple[float, float]:
        """Metres north and east of where it took off."""
        here = self.wait("LOCAL_POSITION_NED")
        return here["x"], here["y"]


@contextlib.contextmanager
def virtual_aircraft() -> Iterator[str]:
    """``m100link mavlink sim://`` as a program of its own; gives where it listens."""
    command = [sys.executable, "-m", "m100link", "mavlink", "sim://", "--json"]
    command += ["--listen", "udp://127.0.0.1:0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as bridge:
        try:
            assert bridge.stdout is not None
            yield json.loads(bridge.stdout.readline())["mavlink"][0]
        finally:
            bridge.terminate()


def fly(vehicle: Vehicle) -> None:
    vehicle.wait("HOME_POSITION")
    vehicle.say("PARAM_SET", param_id="MIS_TAKEOFF_ALT", param_value=4.0, param_type=9)
    vehicle.wait("PARAM_VALUE", param_id="MIS_TAKEOFF_ALT")
    vehicle.command(MavCommand.COMPONENT_ARM_DISARM, 1)
    try:
        square(vehicle)
    finally:  # whatever happened
        vehicle.command(MavCommand.NAV_LAND)
    while vehicle.wait("HEARTBEAT")["base_mode"] & BaseMode.ARMED:
        pass
    print("landed")


def square(vehicle: Vehicle) -> None:
    vehicle.command(MavCommand.NAV_TAKEOFF)
    ends = time.monotonic() + PATIENCE
    while vehicle.wait("GLOBAL_POSITION_INT")["relative_alt"] < 3500:  # mm
        if time.monotonic() > ends:
            raise SystemExit("the take-off takes too long")
    vehicle.fly(0.0, 0.0, 0.2)  # offboard begins only where there is something to fly
    vehicle.command(MavCommand.DO_SET_MODE, BaseMode.CUSTOM, *OFFBOARD)
    for number, (north, east) in enumerate(LEGS, 1):
        vehicle.fly(north, east, LEG_SECONDS)
        print("corner {}: {:5.1f} m north {:5.1f} m east".format(number, *vehicle.place()))
    print(f"back within {math.hypot(*vehicle.place()):.1f} m")
    vehicle.command(MavCommand.DO_SET_MODE, BaseMode.CUSTOM, *HOLD)


def main(url: str) -> None:
    vehicle = Vehicle(url)
    with contextlib.closing(vehicle.line):
        fly(vehicle)


if __name__ == "__main__":
    with contextlib.ExitStack() as stack:
        main(sys.argv[1] if len(sys.argv) > 1 else stack.enter_context(virtual_aircraft()))
