"""What goes over a line, in words, by who sent it."""

from __future__ import annotations

from m100link.log.channels import COMMAND
from m100link.log.witness import Witness
from m100link.protocol.firmware import profile
from m100link.wire import Cipher, encode_frame

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
