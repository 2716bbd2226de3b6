"""What goes over a line, in words, by who sent it."""

from __future__ import annotations

import math
from typing import Any

import pytest

from m100link.log.channels import COMMAND, FIX, TELEMETRY
from m100link.log.witness import Witness
from m100link.protocol.firmware import FIRMWARE_3_1, profile
from m100link.protocol.records import Position
from m100link.wire import Cipher, encode_frame
from tests.known import LATITUDE, LONGITUDE, package, position

FIRMWARE = profile("1.0")
OBTAIN = b"\x01\x00\x01"


def test_an_answer_is_told_by_what_was_asked_and_by_whom() -> None:
    witness = Witness(0.0)
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
    assert list(Witness(0.0).sent(frame, None, FIRMWARE)) == []
    [(_, told)] = Witness(0.0).sent(frame, cipher, FIRMWARE)
    assert told["command"] == "request_authority"


def test_what_no_document_knows_is_told_with_its_address() -> None:
    [(_, told)] = Witness(0.0).sent(
        encode_frame(b"\x77\x01\x05", session=0, sequence=1), None, FIRMWARE
    )
    assert told["command"] == "0x77/0x01"
    assert told["problem"]


def seen(witness: Witness, *packages: dict[str, Any]) -> list[tuple[str, Any]]:
    """What is told of packages of the known aircraft, 10 ms after each other."""
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


def test_a_place_is_a_fix_in_degrees() -> None:
    """foxglove.LocationFix: degrees, m; a covariance of type 0 is not known."""
    [_, (topic, fix)] = seen(Witness(0.0), {})
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
    assert [topic for topic, _ in seen(Witness(10.0), *usual)] == [TELEMETRY, TELEMETRY, FIX]


@pytest.mark.parametrize("place", [position(latitude=math.nan), position(latitude=89.5)])
def test_what_cannot_be_a_place_is_no_fix(place: Position) -> None:
    assert [topic for topic, _ in seen(Witness(0.0), {"changed": (place,)})] == [TELEMETRY]
