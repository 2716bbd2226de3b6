"""What reads bytes of others, with inputs that it takes and the errors that it may raise.

A target says nothing about what is right but what every input has to keep: the same frames however
the bytes were cut, answers that JSON can carry, one typed error and no other.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

from websockets.exceptions import InvalidState

from m100link.apps.agent.codec import decode as decode_message
from m100link.apps.agent.codec import encode as encode_message
from m100link.apps.agent.messages import Event, Hello, LeaseChanged, MessageError, State
from m100link.apps.cli.configuration import read_configuration, remember
from m100link.apps.cli.decode import decode_stream
from m100link.apps.fleet.identity import Rights
from m100link.apps.station.config import read_launch
from m100link.apps.station.ros.client import Client
from m100link.apps.station.ros.graph import Graph, add_rosapi
from m100link.errors import BadPlan, BadURL, LayoutMismatch, M100Error, UsageError
from m100link.link.url import parse_replay, parse_url
from m100link.log.channels import RateLimiter
from m100link.missions.plan import WaypointPlan
from m100link.protocol.command import plain
from m100link.protocol.commands.registry import COMMANDS, parse_command
from m100link.protocol.firmware import PROFILES
from m100link.protocol.packet import TelemetryPacket
from m100link.sim.orders import Scenario
from m100link.sim.ports.driver import aircraft_of, speed_of
from m100link.sim.vehicle.dynamics import read_airframe
from m100link.wire import Cipher, FrameDecoder
from m100link.wire.crc import header_crc16
from tests.apps.fleet.show.plan.test_document import skyb
from tests.apps.fleet.show.shows import FIVE
from tests.fuzz import connections, files, worlds
from tests.fuzz.worlds import World

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

    def begin(self) -> None:
        """Forget what was read before: what follows depends on its inputs alone."""
        if isinstance(self.read, World):
            self.read.begin()

    def ready(self) -> None:
        """Do what is not for the next input, whose time is taken."""
        if isinstance(self.read, World):
            self.read.ready()


def _vectors(name: str, field: str) -> list[bytes]:
    found: list[dict[str, Any]] = json.loads((_VECTORS / f"{name}.json").read_text("utf-8"))
    return [bytes.fromhex(one[field]) for one in found if one.get(field)]


def _streams() -> list[bytes]:
    found = _vectors("frames", "frame") + _vectors("later-commands", "frame") + _long_streams()
    return [*found, _half_right()]


def _half_right() -> bytes:
    """A flood of start bytes; every fourth byte is half of a right CRC16 of a header."""
    made = bytearray(b"\xaa" * 12)
    while len(made) < 300:
        made += b"\xaa" * 3
        made.append(header_crc16(bytes(made[-10:])) & 0xFF)
    return bytes(made)


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
        package.raw_items()
        assert RateLimiter(0.0).hear(data, profile, 1.0)
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
        client.outbox.advance(1.0)
        for _ in range(200):
            frame = client.outbox.next_frame()
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


def _shows() -> list[bytes]:
    whole = json.loads(FIVE.read_text("utf-8"))
    whole["aircraft"] = [one | {"waypoints": one["waypoints"][:3]} for one in whole["aircraft"][:2]]
    return [json.dumps(whole).encode()]


def _read_plan(data: bytes) -> None:
    plan = WaypointPlan.parse(data)
    assert WaypointPlan.parse(plan.to_json()) == plan
    plan.to_wire()
    with suppress(BadPlan):  # it cannot say everything
        WaypointPlan.parse(plan.to_qgroundcontrol())


def _read_and_remember(path: Path) -> None:
    """What first contact found goes into any file that can be read, and comes out of it again."""
    configuration = read_configuration(path)
    name = next(iter(configuration.aircraft), "m1")
    remember(configuration, name, "sim://", {"acceleration": "raw", "seen": {"rc-lost": "zero"}})
    kept = read_configuration(path).aircraft[name]
    assert kept["acceleration"] == "raw"
    assert dict(kept["seen"]) == {"rc-lost": "zero"}


def _read_url(data: bytes) -> None:
    text = data.decode("utf-8", "replace")
    if text.startswith("replay:"):
        parse_replay(text)
    elif text.startswith("sim:"):
        aircraft_of(text)
        speed_of(text)
    else:
        parse_url(text)


_SIGNATURES = b'{"sent": 900, "newest": {"255.190.1": 800}}'
_EVENTS = [
    b'{"press": 3, "at": 12.5, "shown": "fly"}',
    b'{"view": "fly", "place": [52.1, 4.3], "index": 1, "kind": "corner"}',
    b'{"view": "plan", "place": [52.1, 4.3], "index": 1, "text": "{}"}',
    b'{"name": "radius", "value": 12.0}',
    b'{"language": "en", "length": "m", "speed": "m/s", "sound": true, "name": "anna"}',
    b'"start"',
]
_TOKENS = [
    b"@ros2_lv/0/0123456789abcdef/0/0/NN/%/%/m100",
    b"@ros2_lv/0/0123456789abcdef/0/1/MP/%/%/m100/%m100%imu/sensor_msgs::msg::dds_::Imu_/x/::,10",
    b"m100/field/a1/cmd",
]
_FOXGLOVE = [
    b'{"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 2}]}',
    b'{"op": "unsubscribe", "subscriptionIds": [1]}',
    b'{"op": "advertise"}',
]
_REQUESTS = [
    b"/console/?token=0123456789abcdefXY&a=b\nhost: 127.0.0.1\norigin: http://127.0.0.1",
    b"/?code=1\nhost: station\ncookie: m100link=1\nauthorization: Bearer 0123456789abcdefXY",
    b"/\nhost: [::1]:9090\nsec-fetch-site: cross-site\nsec-fetch-mode: navigate",
]
_REQUESTS.append(_REQUESTS[2] + b"\nsec-fetch-dest: document")
_ORDERS = [
    b'{"aircraft": 0, "order": ["rc-mode", "P"]}',
    b'{"aircraft": 0, "order": ["faults", "loss=0.2", "delay=0.05"]}',
    b'{"aircraft": 0, "order": ["battery", "12"]}',
    b'{"aircraft": 0, "order": ["message", "hex=0a0b"]}',
    b'{"order": ["status"]}',
]
_RIGHTS = """site = "field"
[aircraft.a1]
[aircraft.a2]
[identity.anna]
public_key = "{}"
fly = ["a1"]
stop = ["*"]
""".format("0a" * 32)
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
        files.of_file(read_launch),
        lambda: [_LAUNCH.encode()],
        (UsageError,),
        (b"<param ", b"<!DOCTYPE"),
    ),
    "scenario": Target(
        files.of_file(Scenario.read),
        lambda: [_SCENARIO.encode()],
        (UsageError,),
        (b"[[step]]", b"at ="),
    ),
    "configuration": Target(
        files.of_file(_read_and_remember),
        lambda: [_CONFIGURATION.encode()],
        (UsageError, BadURL),
        (b"[aircraft.", b"url ="),
    ),
    "airframe": Target(
        files.of_file(lambda path: read_airframe(str(path))),
        lambda: [b'base = "measured-3.1.10"\ntilt_frequency = 11.5\nhover_thrust = 38\n'],
        (UsageError,),
        (b"base =", b"command_delay = "),
    ),
    "plan": Target(_read_plan, _plans, (BadPlan,), (b'"command":', b"SimpleItem"), share=10),
    "URL": Target(
        _read_url,
        lambda: [
            b"/dev/ttyUSB0@230400",
            b"sim://?speed=2&seed=7&loss=0.1&wind-north=3",
            b"tcp://127.0.0.1:5760",
            b"replay://flight.mcap?speed=2&from=3",
        ],
        (BadURL, UsageError),
        (b"://", b"?", b"&", b"@", b"[::1]", b"~"),
    ),
    "MAVLink frames": Target(files.mavlink, files.frames_seeds),
    "MAVLink bridge": Target(World(worlds.on_bridge), worlds.datagrams, share=1),
    "MAVLink signatures": Target(files.read_signatures, lambda: [_SIGNATURES]),
    "agent's socket": Target(World(worlds.on_socket), worlds.agent_seeds, share=2),
    "console's socket": Target(World(worlds.on_console), worlds.page_seeds, share=4),
    "console's events": Target(files.events, lambda: _EVENTS, (ValueError, RecursionError)),
    **{
        name: Target(
            World(partial(connections.on_rosbridge, has_control=has_control)),
            connections.rosbridge_seeds,
            tokens=(b'"op":', b"\n\n"),
            share=4,
        )
        for name, has_control in (
            ("rosbridge with an aircraft", False),
            ("rosbridge's pilot", True),
        )
    },
    "serial line": Target(
        World(connections.on_line), lambda: connections.line_seeds(_commands(), _acks()), share=2
    ),
    "HTTP": Target(
        World(connections.on_http),
        connections.http_seeds,
        # uvicorn logs them for a text that is not UTF-8, and the connection ends.
        (InvalidState, UnicodeDecodeError),
        (b"\r\n", b"\x81\x80"),
        share=4,
    ),
    "guardian's page": Target(files.guardian_page, files.page_seeds),
    "ROS 2 node": Target(World(worlds.on_node), worlds.ros2_seeds, share=4),
    "ROS 2 tokens": Target(files.tokens, lambda: _TOKENS, tokens=(b"/", b"%", b"@ros2_lv")),
    "CDR": Target(files.read_cdr, files.cdr_seeds, (ValueError,)),
    "fleet on board": Target(World(worlds.on_board), worlds.fleet_seeds, share=1),
    "fleet's pilot": Target(
        World(worlds.on_pilot),
        lambda: worlds.pilot_seeds(_vectors("telemetry", "value")),
        share=1,
    ),
    "fleet's values": Target(files.fleet_values, files.value_seeds, (M100Error,)),
    "fleet's answers": Target(
        files.answers,
        lambda: [b"\n".join((one[1:], one[1:])) for one in files.value_seeds()[1:2]],
        (M100Error,),
    ),
    "ledger": Target(files.ledger, files.ledger_seeds, (UsageError,), share=2),
    "rights": Target(files.of_file(Rights.read), lambda: [_RIGHTS.encode()], (UsageError,)),
    "revoked names": Target(files.revoked, files.revoked_seeds, (UsageError,), share=2),
    "shared lease": Target(
        files.read_lease_file, lambda: [b'{"fence": 3, "token": "0a"}'], (UsageError,)
    ),
    "audit log": Target(files.audit, files.audit_seeds, (UsageError,), share=2),
    "tracks": Target(
        files.tracks,
        lambda: [
            skyb(1),
            skyb(2),
            b"Time [msec],x [m],y [m],z [m]\n0,0,0,0\n4000,0,0,4\n9000,3,0,4\n",
        ],
        (M100Error,),
    ),
    "show": Target(files.read_show, _shows, (M100Error,)),
    "key file": Target(files.of_file(files.keys), lambda: [b"0a" * 32 + b"\n"], (M100Error,)),
    "flight log": Target(
        files.logs, lambda: files.log_seeds(tuple(_streams()[:2])), (UsageError,), share=1
    ),
    "foxglove": Target(files.foxglove, lambda: _FOXGLOVE, tokens=(b'"op":', b"\n\n")),
    "gate": Target(files.gate, lambda: _REQUESTS, tokens=(b"token=", b"code=", b"\nhost: ")),
    "simulator's socket": Target(files.sim_orders, lambda: _ORDERS, share=2),
    "machine": Target(files.machine, lambda: [b"python\0-m\0m100link\0", b"ttyS0 -W- (EC p)\n"]),
    "line in a log": Target(files.witnessed, _streams, share=50),
    "hex": Target(
        files.hex_lines,
        lambda: [b"aa 10:00 0x00", *(one.hex().encode() for one in _streams()[:30])],
        (UsageError,),
    ),
    "station's environment": Target(
        files.station_environment, lambda: [b"9090", b"0x10", b"/dev/ttyUSB0"]
    ),
}
"""By name; a share is that of a reader among all, so that cheap ones have more executions."""
