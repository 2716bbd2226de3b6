"""App ids are taken out of what is written down, wherever an activation stands."""

from __future__ import annotations

import pytest

from m100link.log.redaction import Redaction
from m100link.wire import Cipher, FrameDecoder, encode_frame

APP_ID = (0x7A3C91E5).to_bytes(4, "little")
ACTIVATION = b"\x00\x01" + APP_ID + bytes(8) + b"12345678901234567890123456789012"
FRAME = encode_frame(ACTIVATION, session=2, sequence=77)
VERSION = encode_frame(b"\x00\x00\x00", session=2, sequence=78)


def test_the_frame_stays_one_but_has_no_app_id() -> None:
    redaction = Redaction()
    written = redaction.sent(FRAME)
    assert len(written) == len(FRAME)
    assert APP_ID not in written
    [frame] = FrameDecoder().feed(written)
    assert (frame.session, frame.sequence) == (2, 77)
    assert frame.data == b"\x00\x01" + bytes(len(ACTIVATION) - 2)
    assert redaction.count == 1


def test_its_checksum_does_not_give_it_away() -> None:
    others = (b"\x00\x01" + bytes([n]) * 4 + ACTIVATION[6:] for n in range(5))
    written = {Redaction().sent(encode_frame(one, session=2, sequence=77)) for one in others}
    assert len(written) == 1


@pytest.mark.parametrize("place", [0, 1, 2])
def test_other_frames_of_the_same_write_stay_as_they_are(place: int) -> None:
    frames = [VERSION, VERSION]
    frames.insert(place, FRAME)
    written = Redaction().sent(b"".join(frames))
    assert written.count(VERSION) == 2
    assert APP_ID not in written
    assert len(FrameDecoder().feed(written)) == 3


def test_encrypted_frames_acks_and_what_is_no_frame_stay_as_they_are() -> None:
    sealed = encode_frame(ACTIVATION, session=2, sequence=1, cipher=Cipher(bytes(32).hex()))
    ack = encode_frame(ACTIVATION, session=2, sequence=1, is_ack=True)
    for data in (sealed, ack, b"\x00\x01" + bytes(40), b"\xaa\x00\x00" + bytes(30) + b"\x00\x01"):
        assert Redaction().sent(data) == data


def test_an_echo_of_it_is_blanked_too_and_is_waited_for() -> None:
    redaction = Redaction()
    assert redaction.received(FRAME) == FRAME  # not ours: of another end
    blank = redaction.sent(FRAME)
    assert redaction.received(b"ab" + FRAME + b"cd") == b"ab" + blank + b"cd"
    for length in range(1, len(FRAME)):
        assert redaction.is_within(b"noise" + FRAME[:length])
    assert not redaction.is_within(b"noise" + FRAME)
    assert not redaction.is_within(b"")
