"""What bytes look like that are no frames."""

from __future__ import annotations

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from m100link.doctor.listening import hear
from m100link.link.uart import read_inverted
from tests.doctor.bench import CONSOLE, GPS, TELEMETRY, mavlink


def test_frames_are_counted_and_what_is_cut_off_at_the_end_is_no_damage() -> None:
    heard = hear(TELEMETRY * 10 + TELEMETRY[:30])
    assert (len(heard.frames), heard.discarded_bytes, heard.damaged_share) == (10, 0, 0.0)
    assert heard.count(bytes([2, 0])) == 10
    assert heard.details()["frames"] == 10


def test_damage_is_counted() -> None:
    spoilt = TELEMETRY[:40] + b"\x00" + TELEMETRY[41:]
    heard = hear(TELEMETRY + spoilt * 2 + TELEMETRY)
    assert len(heard.frames) == 2
    assert heard.discards["frame_crc"] == 2
    assert heard.damaged_share == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("data", "name"),
    [
        (bytes(300), "held low"),
        (b"\xff" * 300, "one value"),
        (GPS, "a GPS receiver"),
        (CONSOLE, "text"),
        (mavlink(0xFE, 8), "MAVLink"),
        (b"\x01\x02" + mavlink(0xFD, 12), "MAVLink"),
        (read_inverted(TELEMETRY) * 5, "inverted"),
    ],
)
def test_what_it_looks_like(data: bytes, name: str) -> None:
    likeness = hear(data).likeness()
    assert likeness is not None
    assert likeness.name == name
    assert likeness.causes
    assert likeness.commands


def test_a_frame_cut_in_reads_of_an_inverted_line_is_recognised() -> None:
    """Each burst is a frame; what stands before it is noise."""
    noise = random.Random(3).randbytes(500)
    likeness = hear(noise + read_inverted(TELEMETRY) * 4).likeness()
    assert likeness is not None
    assert likeness.name == "inverted"


@pytest.mark.parametrize("seed", range(20))
def test_noise_looks_like_nothing(seed: int) -> None:
    assert hear(random.Random(seed).randbytes(8000)).likeness() is None


def test_a_wrong_baud_rate_looks_like_nothing() -> None:
    garbled = bytes((byte * 0x1D ^ 0xE6 ^ index * 7) & 0xFF for index, byte in enumerate(TELEMETRY))
    assert hear(garbled * 50).likeness() is None


@given(st.binary(min_size=1, max_size=600))
def test_no_bytes_raise(data: bytes) -> None:
    heard = hear(data)
    heard.likeness()
    assert heard.details()["bytes"] == len(data)
