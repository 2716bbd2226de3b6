"""What reads bytes of others, with inputs that it takes and the errors that it may raise.

A target says nothing about what is right but what every input has to keep: the same frames however
the bytes were cut, answers that JSON can carry, one typed error and no other.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from m100link.agent.fault import MessageError
from m100link.agent.message_bytes import decode as decode_message
from m100link.agent.message_bytes import encode as encode_message
from m100link.agent.messages import Event, Hello, LeaseChanged, State
from m100link.cli.configuration import read_configuration
from m100link.cli.decode import decode_stream
from m100link.errors import BadPlan, BadURL, LayoutMismatch, M100Error, UsageError
from m100link.link.url import parse_url
from m100link.missions.plan import WaypointPlan
from m100link.protocol.command import plain
from m100link.protocol.commands.registry import COMMANDS, parse_command
from m100link.protocol.firmware import PROFILES
from m100link.protocol.packet import TelemetryPacket
from m100link.sim.orders.scenario import Scenario
from m100link.station.launch import read_launch
from m100link.station.ros.client import Client
from m100link.station.ros.graph import Graph
from m100link.station.ros.rosapi import add_rosapi
from m100link.wire import Cipher, FrameDecoder

__all__ = ["TARGETS", "Target"]

_VECTORS = Path(__file__).parents[1] / "vectors"
_KEY = "c018bf2af2d444f4acd1766295217a48949d82efdbd78df1017c370bedc5a978"


@dataclass(frozen=True)
class Target:
    """Something that reads.

    Attributes:
        read: Reads an input; an :class:`AssertionError` says what did not hold.
        seeds: Inputs that it takes.
        refuses: Errors that say that an input is bad.
        tokens: Words of its language.
        share: Of all executions, in a thousand.
    """

    read: Callable[[bytes], object]
    seeds: Callable[[], Sequence[bytes]]
    refuses: tuple[type[Exception], ...] = ()
    tokens: tuple[bytes, ...] = ()
    share: int = 10


def _vectors(name: str, field: str) -> list[bytes]:
    found: list[dict[str, Any]] = json.loads((_VECTORS / f"{name}.json").read_text("utf-8"))
    return [bytes.fromhex(one[field]) for one in found if one.get(field)]


def _streams() -> list[bytes]:
    return _vectors("frames", "frame") + _vectors("later-commands", "frame") + _long_streams()


@cache
def _long_streams() -> list[bytes]:
    return [one for one in _vectors("streams", "bytes") if len(one) <= 1500]


def _commands() -> list[bytes]:
    found = json.loads((_VECTORS / "later-commands.json").read_text("utf-8"))
    asked = [one for one in found if "set" in one]
    later = [bytes((one["set"], one["id"])) + bytes.fromhex(one["value"]) for one in asked]
    movement = [b"\x01\x03" + value for value in _vectors("movement", "value")]
    return later + movement + [b"\x02\x00" + value for value in _vectors("telemetry", "value")]


def _read_frames(data: bytes, cipher: Cipher | None = None) -> None:
    whole, pieces = FrameDecoder(cipher), FrameDecoder(cipher)
    expected = whole.feed(data) + whole.close()
    size = 1 + (data[0] if data else 0) % 64
    found = []
    for at in range(0, len(data), size):
        found += pieces.feed(data[at : at + size])
    found += pieces.close()
    assert found == expected, "other frames when the bytes come in other pieces"
    assert pieces.discarded_bytes == whole.discarded_bytes
    assert pieces.discards == whole.discards


@cache
def _cipher() -> Cipher:
    return Cipher(_KEY)


def _read_command(data: bytes) -> None:
    for profile in PROFILES.values():
        repr(parse_command(data, profile))


# What nobody answers has no ack to read.
_KINDS = tuple(kind for kind in COMMANDS.values() if hasattr(kind, "parse_ack"))


def _acks() -> list[bytes]:
    """Payloads, each behind the number of a command that reads it."""
    found = []
    for payload in _vectors("later-commands", "value"):
        for number, kind in enumerate(_KINDS):
            try:
                kind.parse_ack(payload)
            except M100Error:
                continue
            found.append(bytes((number,)) + payload)
    return found


def _read_ack(data: bytes) -> None:
    kind = _KINDS[(data[0] if data else 0) % len(_KINDS)]
    with suppress(M100Error):
        repr(plain(kind.parse_ack(data[1:])))


def _read_telemetry(data: bytes) -> None:
    for profile in PROFILES.values():
        try:
            package = TelemetryPacket(data, profile)
        except LayoutMismatch:
            continue
        package.row()
        repr([package.attitude, package.position, package.remote_control, package.control_device])


def _decode(data: bytes) -> None:
    profile = tuple(PROFILES.values())[len(data) % len(PROFILES)]
    told = decode_stream(data, profile=profile, cipher=_cipher() if len(data) % 2 else None)
    json.dumps(told, allow_nan=False)


def _rosbridge() -> Callable[[bytes], None]:
    def receive(data: bytes) -> None:
        graph = Graph()
        graph.add_topic("/height", "std_msgs/Float32")
        graph.add_topic("/joy", "sensor_msgs/Joy", lambda *_: None)
        graph.add_service("/task", "dji_sdk/DroneTaskControl", lambda _: None)
        add_rosapi(graph)
        client = Client(graph)
        for number, one in enumerate(data.split(b"\n\n")[:8]):
            text: str | bytes = one
            if number % 2 == 0:
                text = one.decode("utf-8", "replace")
            client.receive(text, number * 0.1)
        client.advance(1.0)
        for _ in range(200):
            frame = client.next_frame()
            if frame is None:
                break
            if isinstance(frame, str):
                json.loads(frame)
        client.close(2.0)

    return receive


def _message(data: bytes) -> None:
    encode_message(decode_message(data))


_MESSAGES = (
    Hello(6, "a front", 1.0),
    LeaseChanged(1, "a pilot"),
    State(at=1.0),
    Event(1, 2.0, "info", "text"),
)


@cache
def _place() -> Path:
    """A file of this process, in memory where the system has a place for that."""
    memory = Path("/dev/shm")
    where = memory if os.access(memory, os.W_OK) else None
    return Path(tempfile.mkdtemp(prefix="m100link-fuzz-", dir=where)) / "input"


def _of_file(read: Callable[[Path], object]) -> Callable[[bytes], object]:
    def work(data: bytes) -> object:
        path = _place()
        path.write_bytes(data)
        return read(path)

    return work


_OPERATIONS = [
    '{"op":"subscribe","topic":"/height","throttle_rate":50,"queue_length":3,"id":"a"}',
    """{"op":"advertise","topic":"/joy","type":"sensor_msgs/Joy"}

{"op":"publish","topic":"/joy","msg":{"axes":[1.0,0,0.5],"buttons":[1]}}""",
    '{"op":"call_service","service":"/task","args":{"task":4},"id":7}',
    '{"op":"call_service","service":"/rosapi/topics"}',
    r"""{"op":"fragment","id":"x","num":0,"total":2,"data":"{\"op\":"}

{"op":"fragment","id":"x","num":1,"total":2,"data":"\"set_level\",\"level\":\"none\"}"}""",
    '{"op":"subscribe","topic":"/height","compression":"cbor","fragment_size":64}',
]
_LAUNCH = """<launch><node pkg="dji_sdk" type="dji_sdk_node" name="dji_sdk_node" output="screen">
<param name="serial_name" type="string" value="/dev/ttyUSB0"/><param name="app_id" value="10086"/>
<param name="baud_rate" type="int" value="230400"/><param name="enc_key" value="00"/>
</node></launch>"""
_SCENARIO = """[[step]]
at = 12.0
do = "rc-mode P"
[[step]]
at = 15.0
do = ["rc-mode F", "faults loss=0.2 delay=0.05"]
[[step]]
when = "waypoint 3"
after = 2.0
do = "battery 12"
"""
_CONFIGURATION = """[defaults]
aircraft = "lab"
timeout = 2.0
[aircraft.lab]
url = "/dev/ttyUSB0"
baud = 230400
[station]
port = 9090
"""


def _plans() -> list[bytes]:
    plan = WaypointPlan.parse(
        '{"fileType":"Plan","version":1,"groundStation":"QGroundControl","geoFence":{"version":2,'
        '"circles":[],"polygons":[]},"rallyPoints":{"version":2,"points":[]},"mission":{"version":2,'
        '"firmwareType":12,"vehicleType":2,"cruiseSpeed":5,"hoverSpeed":3,'
        '"plannedHomePosition":[52.0,4.0,0],"items":['
        '{"type":"SimpleItem","command":22,"frame":3,"params":[0,0,0,null,52.0,4.0,10],'
        '"autoContinue":true,"doJumpId":1},'
        '{"type":"SimpleItem","command":16,"frame":3,"params":[0,0,0,null,52.0001,4.0,10],'
        '"autoContinue":true,"doJumpId":2},'
        '{"type":"SimpleItem","command":16,"frame":3,"params":[2,0,0,null,52.0001,4.0001,12],'
        '"autoContinue":true,"doJumpId":3}]}}'
    )
    return [plan.to_json().encode(), plan.to_qgroundcontrol().encode()]


TARGETS: dict[str, Target] = {
    "frames": Target(_read_frames, _streams, share=330),
    "frames with a key": Target(lambda d: _read_frames(d, _cipher()), _streams, share=200),
    "commands": Target(_read_command, _commands, share=150),
    "acks": Target(_read_ack, _acks, share=150),
    "telemetry": Target(_read_telemetry, lambda: _vectors("telemetry", "value"), share=100),
    "decode": Target(_decode, _streams, share=15),
    "rosbridge": Target(
        _rosbridge(), lambda: [one.encode() for one in _OPERATIONS], tokens=(b'"op":', b"\n\n")
    ),
    "agent's messages": Target(
        _message, lambda: [encode_message(one) for one in _MESSAGES], (MessageError,), share=20
    ),
    "launch file": Target(
        _of_file(read_launch), lambda: [_LAUNCH.encode()], (UsageError,), (b"<param ", b"<!DOCTYPE")
    ),
    "scenario": Target(
        _of_file(Scenario.read), lambda: [_SCENARIO.encode()], (UsageError,), (b"[[step]]", b"at =")
    ),
    "configuration": Target(
        _of_file(read_configuration),
        lambda: [_CONFIGURATION.encode()],
        (UsageError, BadURL),
        (b"[aircraft.", b"url ="),
    ),
    "plan": Target(WaypointPlan.parse, _plans, (BadPlan,), (b'"command":', b"SimpleItem"), share=3),
    "URL": Target(
        lambda data: parse_url(data.decode("utf-8", "replace")),
        lambda: [b"/dev/ttyUSB0@230400", b"sim://?speed=2&seed=7", b"tcp://127.0.0.1:5760"],
        (BadURL, UsageError),
        (b"://", b"?", b"&", b"@", b"[::1]"),
        share=2,
    ),
}
"""By name; the shares add up to a thousand."""
