"""What a log shows of the known aircraft: columns in each format, rows, pcapng, the story.

Names and units are those of the manual, pcapng's blocks those of its specification (IETF
draft-ietf-opsawg-pcapng); nothing here is computed by what it judges.
"""

from __future__ import annotations

import csv
import io
import math
import struct
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from m100link.apps.cli.log import csv as log_csv
from m100link.errors import BadSetpoint
from m100link.link import Direction
from m100link.log import read
from m100link.log.pcapng import _Tables, write_pcapng
from m100link.log.picture import facts
from m100link.log.reading import Chunk, write_parquet
from m100link.log.ros2 import joy_move
from m100link.log.story import read_story
from m100link.protocol.firmware import PROFILES
from m100link.protocol.records import Attitude, Battery, FlightStatus, Position
from m100link.protocol.setpoint import ReferenceFrame
from m100link.wire import Cipher
from tests import known, limits
from tests.known_columns import COLUMNS, OLDER, are, on_the_wire
from tests.log.known_flight import PUSH, SINKING, UTC, moved, pushed, write
from tests.support import KEY, encrypted_frame, raw_frame

pytestmark = pytest.mark.anyio

RX, TX = Direction.RECEIVED, Direction.SENT


@pytest.fixture(params=["1.0", "2.3", "3.1"])
async def flight(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> tuple[str, Path]:
    """One package with everything, and half a second later one that has the battery alone."""
    firmware: str = request.param
    others = [type(one) for one in known.EVERYTHING if not isinstance(one, Battery)]
    heard = [
        (2.25, RX, pushed(firmware, 3)),
        (2.75, RX, pushed(firmware, 4, without=others, changed=[Battery(62)])),
    ]
    await write(tmp_path / "flight.mcap", monkeypatch, heard, firmware)
    return firmware, tmp_path / "flight.mcap"


def expected(firmware: str) -> list[dict[str, float]]:
    """The two rows: time of the loop, POSIX time, and each column."""
    nothing = dict.fromkeys(COLUMNS, math.nan)
    return [
        {"received_at": 42.25, "utc": UTC + 2.25} | OLDER[firmware],
        {"received_at": 42.75, "utc": UTC + 2.75} | nothing | {"battery.percent": 62},
    ]


# -- columns --------------------------------------------------------------------------------------


async def test_a_table_has_each_value_in_its_column(flight: tuple[str, Path]) -> None:
    firmware, path = flight
    table = read(path).table()
    for row, wanted in zip(table.rows, expected(firmware), strict=True):
        are(dict(zip(table.names, row, strict=True)), wanted)
    heights = read(path).table(Position, Attitude)
    assert heights.names[2:9] == tuple(name for name in COLUMNS if name.startswith("position."))


async def test_csv_has_the_same_and_nothing_for_what_is_not_there(
    flight: tuple[str, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    firmware, path = flight
    assert log_csv(path) == 0
    rows = list(csv.DictReader(io.StringIO(capsys.readouterr().out)))
    for row, wanted in zip(rows, expected(firmware), strict=True):
        are({name: text or None for name, text in row.items()}, wanted)
        assert "nan" not in "".join(row.values()).lower()


async def test_parquet_has_the_same_and_null(flight: tuple[str, Path]) -> None:
    parquet = pytest.importorskip("pyarrow.parquet", reason="the extra `analysis` is not there")
    firmware, path = flight
    stream = io.BytesIO()
    assert write_parquet(read(path), stream) == 2
    table = parquet.read_table(io.BytesIO(stream.getvalue()))
    assert {str(one) for one in table.schema.types} == {"double"}
    for row, wanted in zip(table.to_pylist(), expected(firmware), strict=True):
        are(row, wanted)
        assert {name for name, one in row.items() if one is None} == {
            name for name, one in wanted.items() if math.isnan(one)
        }


# -- what stands in the file ----------------------------------------------------------------------


async def test_rows_and_places_in_the_file(flight: tuple[str, Path]) -> None:
    firmware, path = flight
    messages = list(read(path).messages("/m100/telemetry", "/m100/fix"))
    assert [one.at for one in messages] == [42.25, 42.25, 42.75]
    assert [one.utc - UTC for one in messages] == pytest.approx([2.25, 2.25, 2.75], abs=1e-6)
    full, last = (one.content() for one in messages if one.topic == "/m100/telemetry")
    wanted = {"received_at": 42.25} | on_the_wire(firmware)
    are({name: full.get(name) for name in wanted}, wanted)
    assert full.keys() == wanted.keys()
    assert {name: one for name, one in last.items() if one is not None} == {
        "received_at": 42.75,
        "battery.percent": 62.0,
    }
    # foxglove.LocationFix: degrees, metres, and a covariance of the type 0, which says unknown.
    [fix] = [one.content() for one in messages if one.topic == "/m100/fix"]
    assert fix["timestamp"].keys() == {"sec", "nsec"}
    assert fix["timestamp"]["sec"] == 1_795_420_802
    assert fix["timestamp"]["nsec"] == pytest.approx(250_000_000, abs=1000)
    assert fix["latitude"] == pytest.approx(-33.1234567, rel=1e-12)
    assert fix["longitude"] == pytest.approx(151.2345678, rel=1e-12)
    assert fix["altitude"] == pytest.approx(87.65, rel=1e-7)
    assert (fix["position_covariance_type"], fix["position_covariance"]) == (0, [0.0] * 9)
    assert fix["frame_id"] == "m100"


async def test_reads_of_one_message_have_times_of_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A message of raw bytes holds a tenth of a second; µs after it stand beside it."""
    times = [(2.25, RX), (2.28, RX), (2.29, TX), (2.31, RX), (2.315, TX)]
    heard = [(at, way, raw_frame(bytes([n]), sequence=n)) for n, (at, way) in enumerate(times)]
    await write(tmp_path / "flight.mcap", monkeypatch, heard)
    log = read(tmp_path / "flight.mcap")
    assert [one.direction for one in log.chunks()] == [way for _, way in times]
    assert [one.data for one in log.chunks()] == [data for *_, data in heard]
    assert [one.at - 40.0 for one in log.chunks()] == pytest.approx([at for at, _ in times])
    assert [one.utc - UTC for one in log.chunks()] == pytest.approx(
        [at for at, _ in times], abs=1e-6
    )
    told = [one.content() for one in log.messages("/m100/raw/chunks")]
    assert [one["offset_us"] for one in told if one["direction"] == "rx"] == [[0, 30000, 60000]]
    assert [one["offset_us"] for one in told if one["direction"] == "tx"] == [[0, 25000]]


# -- pcapng ---------------------------------------------------------------------------------------


def blocks(data: bytes) -> list[tuple[int, bytes]]:
    """Type and body of each block: its length stands before and behind, a multiple of four."""
    found, at = [], 0
    while at < len(data):
        kind, length = struct.unpack_from("<II", data, at)
        assert length % 4 == 0
        assert struct.unpack_from("<I", data, at + length - 4) == (length,)
        found.append((kind, data[at + 8 : at + length - 4]))
        at += length
    assert at == len(data)
    return found


def options(data: bytes) -> dict[int, bytes]:
    """Code and value of each option, padded to four bytes; the last is code 0 of length 0."""
    found: dict[int, bytes] = {}
    while True:
        code, length = struct.unpack_from("<HH", data)
        data = data[4:]
        if code == 0:
            assert (length, data) == (0, b"")
            return found
        assert code not in found
        assert data[length : length + -length % 4].strip(b"\0") == b""
        found[code], data = data[:length], data[length + -length % 4 :]


def test_a_capture_is_what_the_specification_of_pcapng_says() -> None:
    """Block types, link type, options and time stamps by draft-ietf-opsawg-pcapng 4.1 to 4.3."""
    first, noise = raw_frame(PUSH + known.package(), sequence=3), b"\x01\x02\x03\x04\x05"
    secret = encrypted_frame(b"\x01\x00\x01", session=2, sequence=9)
    plain = raw_frame(b"\x01\x00\x01", session=2, sequence=9)
    heard = [
        Chunk(RX, 42.25, UTC + 2.25, noise + first),
        Chunk(TX, 42.75, UTC + 2.75, secret),
        Chunk(RX, 43.5, UTC + 3.5, first[:20]),
    ]
    log = cast(Any, SimpleNamespace(firmware=PROFILES["3.1"], chunks=lambda: iter(heard)))
    stream = io.BytesIO()
    assert write_pcapng(log, stream, cipher=Cipher(KEY)) == 4
    section, *interfaces, one, two, three, other, last = blocks(stream.getvalue())
    # Little-endian, version 1.0, of a length that nobody knows.
    assert section == (0x0A0D0D0A, bytes.fromhex("4d3c2b1a 0100 0000 ffffffffffffffff"))
    names = ("m100link", "m100link decrypted")
    for (kind, body), name in zip(interfaces, names, strict=True):
        assert kind == 1
        assert struct.unpack_from("<HHI", body) == (147, 0, 0)  # LINKTYPE_USER0, nothing is cut
        assert options(body[8:]) == {
            2: name.encode(),
            3: f"{name}, firmware 3.1".encode(),
            9: b"\x09",  # 10 to the minus ninth of a second
        }
    for (kind, body), wanted in zip(
        (one, two, three, other, last),
        (
            (0, UTC + 2.25, noise, 1),
            (0, UTC + 2.25, first, 1),
            (0, UTC + 2.75, secret, 2),
            (1, UTC + 2.75, plain, 2),
            (0, UTC + 3.5, first[:20], 1),
        ),
        strict=True,
    ):
        interface, utc, data, direction = wanted
        assert kind == 6  # an enhanced packet
        found, high, low, kept, whole = struct.unpack_from("<5I", body)
        assert (found, kept, whole) == (interface, len(data), len(data))
        assert (high << 32) + low == pytest.approx(round(utc * 4) * 250_000_000, abs=1000)
        padded = len(data) + -len(data) % 4
        assert body[20 : 20 + padded] == data + bytes(padded - len(data))
        # Flags: 01 came in, 10 went out; nothing is said of how, of checksums, or of errors.
        assert options(body[20 + padded :]) == {2: struct.pack("<I", direction)}


def test_a_time_beyond_64_bits_is_the_last_one() -> None:
    """A log's own times have 64 bits of ns; as a float they may be more."""
    heard = [Chunk(RX, 0.0, (2**64 - 1) / 1e9, b"hello")]
    log = cast(Any, SimpleNamespace(firmware=None, chunks=lambda: iter(heard)))
    stream = io.BytesIO()
    assert write_pcapng(log, stream) == 1
    (_, body) = blocks(stream.getvalue())[-1]
    assert struct.unpack_from("<3I", body) == (0, 2**32 - 1, 2**32 - 1)


# -- the story ------------------------------------------------------------------------------------


async def test_the_story_has_each_maximum_in_its_unit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It climbs at 12.34 m, sinks at 10.11 m, 44.4 m to the north and 55.5 m to the west."""
    north, east = 44.4, -55.5
    radius = 6_371_008.8
    latitude = known.LATITUDE + math.degrees(north / radius)
    across = radius * math.cos(math.radians(known.LATITUDE))
    there = known.position(
        latitude=latitude, longitude=known.LONGITUDE + math.degrees(east / across), height=10.11
    )
    ground = [FlightStatus(1)]
    heard = [
        (0.5, RX, pushed("3.1", 1, changed=ground)),
        (1.0, TX, raw_frame(moved(1.0, -2.0, 0.5, -30.0), sequence=1)),
        (1.25, RX, pushed("3.1", 2)),
        (3.5, RX, pushed("3.1", 3, changed=[SINKING, Battery(62), there])),
        (4.25, RX, pushed("3.1", 4, changed=[SINKING, Battery(62), there, *ground])),
    ]
    path = tmp_path / "flight.mcap"
    await write(path, monkeypatch, heard)
    story = read_story(read(path))
    most = story.maxima
    assert most.height_m == pytest.approx(12.34, rel=1e-6)
    assert most.distance_m == pytest.approx(math.hypot(north, east), rel=5e-3)
    assert most.ground_speed_m_s == pytest.approx(3.5733738, rel=1e-6)
    assert (most.climb_m_s, most.descent_m_s) == pytest.approx((0.84, 0.62), rel=1e-6)
    # The angle of the body against the vertical: its cosine is cos roll times cos pitch.
    upright = math.cos(math.radians(10.0)) * math.cos(math.radians(20.0))
    assert most.tilt_deg == pytest.approx(math.degrees(math.acos(upright)), rel=1e-5)
    assert most.silence_s == pytest.approx(2.25, abs=1e-6)
    assert (most.battery_first_percent, most.battery_last_percent) == (63, 62)
    assert most.airborne_s == pytest.approx(3.0, abs=1e-6)
    assert most.track_m == pytest.approx(math.hypot(north, east), rel=5e-3)
    assert [one.name for one in story.phases] == ["ground", "flight", "ground"]
    lasted = [one.end_s - one.begin_s for one in story.phases]
    assert lasted[:2] == pytest.approx([0.75, 3.0], abs=1e-6)
    place = story.track.places()[-1][1:3]
    assert place == pytest.approx([north, east], rel=5e-3)
    curves = {
        name: list(getattr(story.curves, name).points()) for name in ("climb_m_s", "height_m")
    }
    assert [value for _, value in curves["climb_m_s"] if not math.isnan(value)] == pytest.approx(
        [0.84, 0.84, -0.62, -0.62]
    )
    shown = dict(facts(story))
    assert shown.pop("Farthest")[:3] == shown.pop("Way over ground")[:3] == "71."
    assert shown.pop("Recorded").endswith(" s")
    assert shown == {
        **{"In the air": "3.0 s", "Highest": "12.3 m", "Fastest": "3.6 m/s"},
        **{"Climb / descent": "0.8 / 0.6 m/s", "Largest tilt": "22.3 °", "Battery": "63 → 62 %"},
        **{"Longest silence": "2.25 s", "Repeats": "0", "Firmware": "3.1"},
    }
    [told] = [one.content() for one in read(path).messages("/m100/command")]
    assert (told["direction"], told["command"], told["is_ack"]) == ("tx", "move", False)
    assert told["movement"] == {
        **{"control_flag": 0x4A, "roll_or_x": 1.0, "pitch_or_y": -2.0},
        **{"throttle_or_z": 0.5, "yaw": -30.0},
    }


# -- the dissector --------------------------------------------------------------------------------


@pytest.mark.parametrize("firmware", ["1.0", "2.3", "3.1"])
def test_wireshark_reads_each_item_where_it_stands(firmware: str) -> None:
    """The tables of the plugin, on the package; what its Lua does of them is for tshark."""
    value = known.package(firmware)
    [flags] = struct.unpack_from("<H", value)
    at, found = 2, dict[str, float]()
    for item in _Tables().made()["telemetry"][firmware]:
        assert flags & item["flag"], item["name"]
        for part in item["parts"]:
            prefix, _, name = part["abbreviation"].rpartition(".")
            assert prefix == f"m100.telemetry.{item['name']}"
            assert part["size"] == struct.calcsize("<" + part["format"])
            [found[f"{item['name']}.{name}"]] = struct.unpack_from(
                "<" + part["format"], value, at + part["offset"]
            )
        at += item["size"]
    assert at == len(value)
    are(found, on_the_wire(firmware))


def test_wireshark_reads_commands_where_their_values_stand() -> None:
    """By DJI's document: control flag, x, y, then vertical and yaw; a gimbal's yaw is the first."""
    made = _Tables().made()
    fields = {one["abbreviation"]: one["kind"] for one in made["fields"]}
    assert made["push"] == 0x0200
    assert made["start"] == 0x3AA3
    move = made["commands"][0x0103]["forms"][17]
    names = [(one["abbreviation"].rpartition(".")[2], one["offset"]) for one in move]
    assert names == [("flag", 0), ("x", 1), ("y", 5), ("throttle", 9), ("yaw", 13)]
    assert list(made["commands"][0x0103]["by_firmware"]) == ["1.0-document"]
    [document] = made["commands"][0x0103]["by_firmware"].values()
    names = [(one["abbreviation"].rpartition(".")[2], one["offset"]) for one in document[17]]
    assert names == [("flag", 0), ("x", 1), ("y", 5), ("yaw", 9), ("throttle", 13)]
    gimbal = made["commands"][0x011A]["forms"]
    [speed] = gimbal.values()
    angles = [
        (one["abbreviation"].rpartition(".")[2], one["offset"], one["format"]) for one in speed
    ]
    assert angles[:3] == [("yaw", 0, "h"), ("roll", 2, "h"), ("pitch", 4, "h")]
    assert fields["m100.move.yaw"] == "double"
    assert fields["m100.telemetry.magnetometer.x"] == "double", "3f by the document, 3h as sent"
    assert fields["m100.telemetry.rc.throttle"] == "int32"
    assert fields["m100.telemetry.battery.percent"] == "uint32"
    words = {one["abbreviation"]: one["words"] for one in made["fields"]}
    assert words["m100.telemetry.battery.percent"] is None


# -- movements of ROS -----------------------------------------------------------------------------

RATE, ANGLE, BODY = 0x08, 0x00, 0x02


@pytest.mark.parametrize(
    ("flag", "given", "expected"),
    [
        # Flag bits 7 and 6 are tilt, velocity or position; 5 and 4 velocity, height or thrust.
        (0x40 | RATE, (1.0, 2.0, 3.0, math.radians(10)), (2.0, 1.0, 3.0, -10.0)),
        (0x40 | RATE | BODY, (1.0, 2.0, -3.0, math.radians(-10)), (1.0, -2.0, -3.0, 10.0)),
        (0x90 | RATE, (-4.0, 5.0, 12.0, 0.0), (5.0, -4.0, 12.0, 0.0)),
        # A tilt is forward, left, up whatever the frame: pitch as DJI's node has it, negated.
        (0x20 | RATE, (math.radians(5), math.radians(3), 45.0, 0.0), (5.0, -3.0, 45.0, 0.0)),
        # Counter-clockwise from east becomes clockwise from north, −180 to 180 degrees.
        (0x40 | ANGLE, (0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 90.0)),
        (0x40 | ANGLE, (0.0, 0.0, 0.0, math.radians(135)), (0.0, 0.0, 0.0, -45.0)),
        (0x40 | ANGLE, (0.0, 0.0, 0.0, math.radians(-135)), (0.0, 0.0, 0.0, -135.0)),
        (0x40 | ANGLE, (0.0, 0.0, 0.0, math.radians(-100)), (0.0, 0.0, 0.0, -170.0)),
        (0x40 | ANGLE, (0.0, 0.0, 0.0, math.radians(-80)), (0.0, 0.0, 0.0, 170.0)),
    ],
)
def test_a_movement_of_ros_is_one_of_the_aircraft(
    flag: int, given: tuple[float, ...], expected: tuple[float, ...]
) -> None:
    move = joy_move(flag, *given)
    assert (move.x, move.y, move.z, move.yaw) == pytest.approx(expected)
    is_tilt = flag >> 6 == 0
    assert move.frame is ReferenceFrame(int(is_tilt or bool(flag & BODY)))
    wanted = (flag >> 6 & 3, flag >> 4 & 3, flag >> 3 & 1)
    assert tuple(int(one) for one in move.mode) == wanted


@pytest.mark.parametrize(
    ("flag", "names"), [(0xC8, "no control mode"), (0x78, "no control mode"), (0x4C, "no frame")]
)
def test_a_flag_that_names_nothing_moves_nothing(flag: int, names: str) -> None:
    with pytest.raises(BadSetpoint, match=names):
        joy_move(flag, 1.0, 2.0, 3.0, 0.0)


def test_each_limit_is_as_agreed() -> None:
    assert limits.differences("log") == []
