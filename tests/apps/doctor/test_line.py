"""Each limit by which a line is judged, from both sides of it.

Limits are those of the manual (docs/reference/diagnoses.md) and of what is known of adapters: a
frame in fifty may be damaged, and a twentieth of the bytes; a wire that is joined to nothing picks
up less than 200 bytes; a port keeps at most 8 KiB from before.
"""

from __future__ import annotations

import pytest

from m100link.apps.doctor import answers, line
from m100link.apps.doctor.findings import Stage, Verdict
from m100link.apps.doctor.line import Heard, hear
from m100link.link.url import parse_url
from m100link.wire import Frame
from tests.apps.doctor.bench import TELEMETRY

pytestmark = pytest.mark.anyio

GOOD, DOUBTFUL, FAILED = Verdict.GOOD, Verdict.DOUBTFUL, Verdict.FAILED
[FRAME] = hear(TELEMETRY).frames


def heard(
    frames: int, *, damaged: int = 0, discarded: int = 0, size: int = 10_000, frame: Frame = FRAME
) -> Heard:
    half = damaged // 2
    causes = {"header_crc": half, "frame_crc": damaged - half, "no_key": 1000, "length": 1000}
    return Heard(bytes(size), (frame,) * frames, discarded, causes)


@pytest.mark.parametrize(
    ("found", "verdict"),
    [
        (heard(100), GOOD),
        # Three pieces are nothing, however few frames there are.
        (heard(10, damaged=3), GOOD),
        (heard(10, damaged=4), DOUBTFUL),
        # Beyond that: 2 % of the good ones.
        (heard(1000, damaged=20), GOOD),
        (heard(1000, damaged=21), DOUBTFUL),
        # Of the bytes 5 % may be part of no frame.
        (heard(100, discarded=500), GOOD),
        (heard(100, discarded=501), DOUBTFUL),
    ],
)
def test_how_much_damage_is_a_doubt(found: Heard, verdict: Verdict) -> None:
    told = line._frames(found)
    assert (told.stage, told.verdict) == (Stage.FRAMES, verdict)
    assert bool(told.causes) is (verdict is DOUBTFUL)


@pytest.mark.parametrize(
    ("size", "discarded", "is_left"),
    [
        (1000, 500, False),  # half of the bytes are frames
        (1000, 501, True),
        (20_000, 11_808, True),  # 8192 bytes of frames
        (20_000, 11_807, False),
    ],
)
def test_few_frames_among_much_else_may_have_waited_in_the_port(
    size: int, discarded: int, is_left: bool
) -> None:
    assert line._may_be_left_behind(heard(5, discarded=discarded, size=size)) is is_left


@pytest.mark.parametrize(
    ("size", "seen"), [(199, "an aircraft sends far more"), (200, "not one valid frame")]
)
async def test_how_few_bytes_are_picked_up_from_the_air(size: int, seen: str) -> None:
    noise = bytes((n * 89 + 130) % 251 | 0x80 for n in range(size))
    told = await line._no_frames(parse_url("tcp://127.0.0.1:9"), hear(noise))
    assert told.verdict is FAILED
    assert seen in told.seen
    assert ("an aircraft sends far more" in told.seen) is (size < 200)


@pytest.mark.parametrize("count", [2, 3])
def test_three_frames_that_end_too_early_are_bytes_that_another_reader_took(count: int) -> None:
    cut = TELEMETRY[:60] * count + TELEMETRY[:13]
    likeness = hear(cut).likeness()
    assert (likeness is not None and likeness.name == "cut") is (count >= 3)


@pytest.mark.parametrize(("printable", "is_text"), [(90, True), (89, False)])
def test_nine_bytes_of_ten_that_can_be_printed_are_text(printable: int, is_text: bool) -> None:
    data = bytes(33 + n % 60 for n in range(printable)) + bytes(
        128 + n for n in range(100 - printable)
    )
    likeness = hear(data).likeness()
    assert (likeness is not None and likeness.name == "text") is is_text


def test_how_long_it_is_listened_to() -> None:
    """The slowest item comes once a second, and an answer within 0.1 s."""
    assert 1.0 < line.LISTEN_S < 2.0
    assert 0.2 <= line.ANSWER_S <= 0.5
    assert 0.2 <= line.SCAN_S <= 1.0
    assert 1.0 < answers.TELEMETRY_S < 2.0
