"""Every message of a flight is valid by the schema that stands in its file."""

from __future__ import annotations

import json
import math
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from m100link.log.channels import (
    CHUNKS,
    COMMAND,
    EVENT,
    FIX,
    LINK,
    SCHEMAS,
    TELEMETRY,
    FrameInterpreter,
)
from m100link.protocol.firmware import FIRMWARE_3_1, profile
from m100link.protocol.records import Acceleration, AccelerationMode, Attitude, Position, quaternion
from m100link.wire import Cipher, encode_frame
from tests.known import LATITUDE, LONGITUDE, package, position
from tests.log.flight import URL, fly

pytestmark = pytest.mark.anyio


@pytest.mark.parametrize("options", ["", "&firmware=3.1&loss=0.02&damage=0.02", "&firmware=2.3"])
async def test_every_message_is_valid_by_its_schema(tmp_path: Path, options: str) -> None:
    jsonschema: Any = pytest.importorskip("jsonschema", reason="the judge is not installed")
    path = tmp_path / "flight.mcap"
    await fly(path, URL + options)
    counts: Counter[str] = Counter()
    validators: dict[str, Any] = {}
    with path.open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            if schema is None:
                assert channel.message_encoding == "application/octet-stream"
                continue
            if schema.name not in validators:
                text = json.loads(schema.data)
                jsonschema.Draft202012Validator.check_schema(text)
                validators[schema.name] = jsonschema.Draft202012Validator(text)
            validators[schema.name].validate(json.loads(message.data))
            counts[channel.topic] += 1
    assert counts.keys() == {CHUNKS, FIX, TELEMETRY, COMMAND, EVENT, LINK}
    assert min(counts.values()) > 3


def test_schemas_of_foxglove_have_its_fields() -> None:
    # As foxglove.dev/docs lists them; the panels know these names alone.
    published = {
        "foxglove.LocationFix": {
            "timestamp",
            "frame_id",
            "latitude",
            "longitude",
            "altitude",
            "position_covariance",
            "position_covariance_type",
        },
        "foxglove.FrameTransform": {
            "timestamp",
            "parent_frame_id",
            "child_frame_id",
            "translation",
            "rotation",
        },
        "foxglove.Log": {"timestamp", "level", "message", "name", "file", "line"},
    }
    ours = {one.name: set(json.loads(one.text)["properties"]) for one in SCHEMAS.values()}
    assert {name: ours[name] for name in published} == published


# -- what goes over a line, in words, by who sent it -----------------------------------------------


FIRMWARE = profile("1.0")
OBTAIN = b"\x01\x00\x01"


def test_an_answer_is_known_by_its_question_and_its_asker() -> None:
    witness = FrameInterpreter(0.0)
    [(topic, asked)] = witness.sent(encode_frame(OBTAIN, session=2, sequence=9), None, FIRMWARE)
    assert topic == COMMAND
    assert (asked["command"], asked["is_ack"], asked["direction"]) == (
        "request_authority",
        False,
        "tx",
    )
    # An ack of ours with the same numbers answers something else.
    own = encode_frame(b"\x02\x00", session=2, sequence=9, is_ack=True)
    [(_, other)] = witness.sent(own, None, FIRMWARE)
    assert other["command"] == "?"
    [(_, answer)] = witness.received(own, 1.0, None, FIRMWARE)
    assert answer["command"] == "request_authority"
    assert answer["ack"]["name"] == "OBTAINED"


def test_what_is_encrypted_is_read_with_the_key_and_passed_over_without() -> None:
    cipher = Cipher(bytes(32).hex())
    frame = encode_frame(OBTAIN, session=2, sequence=9, cipher=cipher)
    assert list(FrameInterpreter(0.0).sent(frame, None, FIRMWARE)) == []
    [(_, told)] = FrameInterpreter(0.0).sent(frame, cipher, FIRMWARE)
    assert told["command"] == "request_authority"


def test_what_no_document_knows_is_reported_with_its_address() -> None:
    [(_, told)] = FrameInterpreter(0.0).sent(
        encode_frame(b"\x77\x01\x05", session=0, sequence=1), None, FIRMWARE
    )
    assert told["command"] == "0x77/0x01"
    assert told["problem"]


def seen(witness: FrameInterpreter, *packages: dict[str, Any]) -> list[tuple[str, Any]]:
    """The records of packages of the known aircraft, 10 ms after each other."""
    return [
        one
        for place, options in enumerate(packages)
        for one in witness.received(
            encode_frame(b"\x02\x00" + package(**options), session=0, sequence=place),
            0.01 * place,
            None,
            FIRMWARE_3_1,
        )
    ]


@pytest.mark.parametrize(
    ("mode", "north_east_up"),
    [
        # The nose points east. 0.1 g forward, 0.2 g right and 1.5 g against gravity.
        (AccelerationMode.RAW, (-1.96133, 0.980665, 4.903325)),
        (AccelerationMode.FUSED, (0.1, 0.2, -1.5)),
        (None, None),
    ],
)
def test_acceleration_is_logged_in_metres_to_the_north_the_east_and_up_or_not_at_all(
    mode: AccelerationMode | None, north_east_up: tuple[float, ...] | None
) -> None:
    """Raw values are forward, right and down in g, with gravity: other axes, and off by 9.8."""
    witness = FrameInterpreter(0.0)
    witness.acceleration.fix(mode)
    east = Attitude(*quaternion(0.0, 0.0, math.pi / 2))
    usual = {"changed": (east, Acceleration(0.1, 0.2, -1.5))}
    rows = [told for topic, told in seen(witness, usual, usual) if topic == TELEMETRY]
    assert len(rows) == 2
    for row in rows:
        found = [value for name, value in row.items() if name.startswith("acceleration.")]
        assert found == ([] if north_east_up is None else pytest.approx(north_east_up, abs=1e-5))


def test_a_place_is_a_fix_in_degrees() -> None:
    """foxglove.LocationFix: degrees, m; a covariance of type 0 is not known."""
    [_, (topic, fix)] = seen(FrameInterpreter(0.0), {})
    assert (topic, fix) == (
        FIX,
        {
            "frame_id": "m100",
            "latitude": pytest.approx(LATITUDE, abs=1e-9),
            "longitude": pytest.approx(LONGITUDE, abs=1e-9),
            "altitude": pytest.approx(87.65, abs=1e-5),
            "position_covariance": [0.0] * 9,
            "position_covariance_type": 0,
        },
    )


def test_a_place_of_another_package_than_the_one_that_is_due_is_a_fix() -> None:
    usual: list[dict[str, Any]] = [{"without": (Position,)}] * 11
    usual[3] = {}
    assert [topic for topic, _ in seen(FrameInterpreter(10.0), *usual)] == [
        TELEMETRY,
        TELEMETRY,
        FIX,
    ]


@pytest.mark.parametrize("place", [position(latitude=math.nan), position(latitude=89.5)])
def test_what_cannot_be_a_place_is_no_fix(place: Position) -> None:
    assert [topic for topic, _ in seen(FrameInterpreter(0.0), {"changed": (place,)})] == [TELEMETRY]


def test_whose_app_it_is_stands_in_no_log() -> None:
    """An activation loses it in each direction, one that cannot be read too."""
    app_id = b"\xe5\x91\x3c\x7a"
    whole = b"\x00\x01" + app_id + bytes(8) + b"12345678901234567890123456789012"
    for data, told_of in ((whole, {}), (whole[:-9], {"problem": "unreadable"})):
        frame = encode_frame(data, session=2, sequence=9)
        for told in (
            FrameInterpreter(0.0).sent(frame, None, FIRMWARE),
            FrameInterpreter(0.0).received(frame, 1.0, None, FIRMWARE),
        ):
            [(_, found)] = told
            direction = found.pop("direction")
            assert direction in ("tx", "rx")
            assert found == told_of | {
                **{"is_ack": False, "session": 2, "sequence": 9},
                **{"command": "activate", "redacted": True},
            }


def test_what_wants_no_answer_is_answered_by_nothing() -> None:
    """Session 0: an ack under its numbers is of something else. An empty frame says nothing."""
    witness = FrameInterpreter(0.0)
    assert len(list(witness.sent(encode_frame(OBTAIN, session=0, sequence=9), None, FIRMWARE))) == 1
    stray = encode_frame(b"\x02\x00", session=0, sequence=9, is_ack=True)
    [(_, answer)] = witness.received(stray, 1.0, None, FIRMWARE)
    assert (answer["command"], answer["data"]) == ("?", "0200")
    empty = encode_frame(b"", session=2, sequence=1)
    assert list(witness.sent(empty, None, FIRMWARE)) == []
    list(witness.sent(encode_frame(OBTAIN, session=2, sequence=9), None, FIRMWARE))
    short = encode_frame(b"\x02", session=2, sequence=9, is_ack=True)
    [(_, unread)] = witness.received(short, 1.0, None, FIRMWARE)
    assert (unread["command"], "ack" in unread) == ("request_authority", False)
    assert unread["problem"]
