"""App ids are taken out of what is written down, wherever an activation stands."""

from __future__ import annotations

import pytest

from m100link.log.recorder import Redaction
from m100link.wire import Cipher, FrameDecoder, encode_frame

APP_ID = (0x7A3C91E5).to_bytes(4, "little")
ACTIVATION = b"\x00\x01" + APP_ID + bytes(8) + b"12345678901234567890123456789012"
FRAME = encode_frame(ACTIVATION, session=2, sequence=77)
VERSION = encode_frame(b"\x00\x00\x00", session=2, sequence=78)


def test_the_frame_stays_one_but_has_no_app_id() -> None:
    redaction = Redaction()
    written = redaction.sent(FRAME, 0.0)
    assert len(written) == len(FRAME)
    assert APP_ID not in written
    [frame] = FrameDecoder().feed(written)
    assert (frame.session, frame.sequence) == (2, 77)
    assert frame.data == b"\x00\x01" + bytes(len(ACTIVATION) - 2)
    assert redaction.count == 1


def test_its_checksum_does_not_give_it_away() -> None:
    others = (b"\x00\x01" + bytes([n]) * 4 + ACTIVATION[6:] for n in range(5))
    written = {Redaction().sent(encode_frame(one, session=2, sequence=77), 0.0) for one in others}
    assert len(written) == 1


@pytest.mark.parametrize("place", [0, 1, 2])
def test_other_frames_of_the_same_write_stay_as_they_are(place: int) -> None:
    frames = [VERSION, VERSION]
    frames.insert(place, FRAME)
    written = Redaction().sent(b"".join(frames), 0.0)
    assert written.count(VERSION) == 2
    assert APP_ID not in written
    assert len(FrameDecoder().feed(written)) == 3


def test_encrypted_frames_acks_and_what_is_no_frame_stay_as_they_are() -> None:
    sealed = encode_frame(ACTIVATION, session=2, sequence=1, cipher=Cipher(bytes(32).hex()))
    ack = encode_frame(ACTIVATION, session=2, sequence=1, is_ack=True)
    for data in (sealed, ack, b"\x00\x01" + bytes(40), b"\xaa\x00\x00" + bytes(30) + b"\x00\x01"):
        assert Redaction().sent(data, 0.0) == data


def test_an_echo_of_it_is_blanked_too_and_is_waited_for() -> None:
    redaction = Redaction()
    assert redaction.received(FRAME, 0.0) == FRAME  # not ours: of another end
    blank = redaction.sent(FRAME, 0.0)
    assert redaction.received(b"ab" + FRAME + b"cd", 1.0) == b"ab" + blank + b"cd"
    for length in range(1, len(FRAME)):
        assert redaction.is_within(b"noise" + FRAME[:length], 1.0)
    assert not redaction.is_within(b"noise" + FRAME, 1.0)
    assert not redaction.is_within(b"", 1.0)


@pytest.mark.parametrize("app_id", [0x7A3C91E5, 1021034, 7, 0])
def test_an_echo_of_which_a_byte_is_lost_does_not_show_it(app_id: int) -> None:
    secret = app_id.to_bytes(4, "little")
    frame = encode_frame(b"\x00\x01" + secret + ACTIVATION[6:], session=2, sequence=77)
    for lost in (*range(14), *range(18, len(frame))):  # not of the app id itself
        redaction = Redaction()
        redaction.sent(frame, 0.0)
        damaged = frame[:lost] + frame[lost + 1 :]
        echo = redaction.received(damaged, 0.1)
        assert len(echo) == len(damaged)
        if app_id:
            assert secret not in echo
        if lost < len(frame) - 4:  # with it, the four bytes would be found by trying
            assert frame[-4:] not in echo


@pytest.mark.parametrize("app_id", [0x7A3C91E5, 1021034])
def test_an_echo_that_lost_a_byte_of_the_app_id_does_not_show_the_rest(app_id: int) -> None:
    secret = app_id.to_bytes(4, "little")
    frame = encode_frame(b"\x00\x01" + secret + ACTIVATION[6:], session=2, sequence=77)
    for lost in range(14, 18):
        redaction = Redaction()
        redaction.sent(frame, 0.0)
        damaged = frame[:lost] + frame[lost + 1 :]
        echo = redaction.received(damaged, 0.1)
        assert len(echo) == len(damaged)
        assert echo[14:17] == bytes(3)


def test_an_echo_that_ends_anywhere_does_not_show_it() -> None:
    for first in (0, 1):  # its first byte may be lost, too
        for length in range(14, len(FRAME)):
            redaction = Redaction()
            redaction.sent(FRAME, 0.0)
            echo = redaction.last(FRAME[first:length], 0.1)
            assert len(echo) == length - first
            assert not any(APP_ID[:n] in echo for n in (2, 3, 4))
            assert FRAME[-4:-1] not in echo


def test_a_last_package_keeps_its_checksum_though_its_last_byte_may_begin_a_secret() -> None:
    redaction = Redaction()
    redaction.sent(FRAME, 0.0)
    for byte in {FRAME[0], 0, *APP_ID, *FRAME[-4:]}:
        assert redaction.last(bytes([7, byte]), 0.1) == bytes([7, byte])
    assert redaction.last(b"\7" + APP_ID[:2], 0.1) == bytes([7, 0, 0])


def test_telemetry_long_after_it_stays_as_it_is_even_if_it_has_the_same_number() -> None:
    redaction = Redaction()
    redaction.sent(FRAME, 5000.0)
    assert redaction.received(APP_ID, 5029.0) == bytes(4)
    assert redaction.is_within(APP_ID[:2], 5029.0)
    assert not redaction.is_within(APP_ID[:2], 5031.0)
    assert redaction.received(APP_ID, 5031.0) == APP_ID


def test_an_app_id_of_few_bytes_is_not_looked_for_in_telemetry() -> None:
    redaction = Redaction()
    redaction.sent(encode_frame(b"\x00\x01\x07" + bytes(43), session=2, sequence=1), 0.0)
    for data in (b"\x05\x07\x00\x00\x00\x01", b"\x00\x01\x07\x00\x00\x01", b"\x07\x00\x00\x05"):
        assert redaction.received(data, 0.1) == data


def test_a_frame_behind_bytes_that_are_not_one_is_found() -> None:
    assert APP_ID not in Redaction().sent(b"x\xaa" + FRAME, 0.0)


@pytest.mark.parametrize(("count", "is_blanked"), [(0, False), (3, False), (4, True), (5, True)])
def test_four_bytes_are_an_app_id_and_fewer_are_none(count: int, is_blanked: bool) -> None:
    frame = encode_frame(b"\x00\x01" + b"\x7a\x3c\x91\xe5\x07"[:count], session=2, sequence=1)
    redaction = Redaction()
    assert (redaction.sent(frame, 0.0) != frame) is is_blanked
    assert redaction.count == int(is_blanked)
