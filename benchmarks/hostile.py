"""Bytes that cost a decoder more than frames do, in multiples of the fastest line.

    python -m benchmarks.hostile [ROW …] [--rounds 15] [--json] [--beside TREE]

The worst pattern is searched for anew in every run and for each tree: short patterns repeated, runs
of start bytes, headers good and bad of many lengths, damaged frames. Those that cost most are timed
again until one is left. All come in reads of 62 bytes, a packet of a USB adapter.
"""

from __future__ import annotations

import random
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack

from benchmarks.frames import reads_of, telemetry_frames
from benchmarks.program import main
from benchmarks.rows import Costs, Program, Row, Setting, Side, at_least
from m100link.wire import FrameDecoder, encode_frame

SEED = 2015
SIZE = 60_000  # bytes per timing
SEARCH_SIZE = 6_000  # bytes per timing while searching
LINE_RATE = 92_160  # bytes/s of a serial line at 921600 baud, the fastest that the assistant offers
START = 0xAA
WORST = "the worst pattern found"
READ = 62

Reads = list[bytes]


def cost(reads: Reads) -> float:
    """CPU seconds per byte."""
    feed = FrameDecoder().feed
    began = time.thread_time()
    for read in reads:
        feed(read)
    return (time.thread_time() - began) / sum(map(len, reads))


# -- what may come ---------------------------------------------------------------------------------


def known() -> dict[str, Callable[[random.Random], Iterator[bytes]]]:
    """Streams that have cost much before, as endless pieces."""
    frame = telemetry_frames(1)[0]

    def false_headers(dice: random.Random) -> Iterator[bytes]:
        while True:
            start = (START, dice.randrange(256), dice.randrange(4), dice.randrange(64), 0, 0, 0, 0)
            yield bytes(start) + dice.randbytes(4)

    def damaged_frames(dice: random.Random) -> Iterator[bytes]:
        while True:
            broken = bytearray(frame)
            if dice.random() < 0.5:
                broken[dice.randrange(len(broken))] ^= 1 << dice.randrange(8)
            yield bytes(broken) + dice.randbytes(dice.choice((0, 0, 5, 40)))

    def start_bytes_and_zeros(dice: random.Random) -> Iterator[bytes]:
        while True:
            yield bytes(dice.choice((START, 0)) for _ in range(64))

    def noise(dice: random.Random) -> Iterator[bytes]:
        while True:
            yield dice.randbytes(64)

    return {
        "random bytes": noise,
        "start bytes and zeros": start_bytes_and_zeros,
        "headers with a wrong CRC16": false_headers,
        "damaged telemetry": damaged_frames,
    }


def repeated(piece: bytes) -> Callable[[random.Random], Iterator[bytes]]:
    """The same again and again."""

    def pieces(_: random.Random) -> Iterator[bytes]:
        while True:
            yield piece

    return pieces


def patterns(dice: random.Random) -> dict[str, Callable[[random.Random], Iterator[bytes]]]:
    """Everything that the search looks at, by a name that says what it is."""
    pieces: list[bytes] = []
    bytes_ = (0x00, 0x01, 0x03, 0x04, 0x0C, 0x0D, 0x20, 0x7F, 0x80, 0xA9, 0xAB, 0xC0, 0xFC, 0xFF)
    for run in (*range(1, 17), 24, 31, 32, 61, 62, 63):
        pieces += [bytes([START] * run + [other]) for other in bytes_]
    for gap in range(2, 14):
        pieces += [bytes([START]) + bytes([other]) * (gap - 1) for other in bytes_[:6]]
    for size in (0, 1, 2, 16, 32, 48, 118, 256, 512, 1007):
        for encrypted in (False, True):
            data = dice.randbytes(size)
            frame = bytearray(
                encode_frame(data, session=dice.randrange(32), sequence=dice.randrange(65536))
            )
            if encrypted:  # the header says so and its checksum is wrong
                frame[4] |= 0x20
            pieces += [bytes(frame[:12]), bytes(frame[:11]), bytes(frame[:13]), bytes(frame[:-1])]
            pieces += [
                bytes(frame[:12]) + bytes([START]) * 12,
                bytes([START] * 3) + bytes(frame[:12]),
            ]
            frame[-1] ^= 1
            pieces.append(bytes(frame))
    for _ in range(150):  # chance finds what nobody thought of
        alphabet = [START, START, 0, *dice.randbytes(2)]
        pieces.append(bytes(dice.choice(alphabet) for _ in range(dice.randrange(2, 20))))
    found = {
        one.hex() if len(one) < 24 else f"{one[:24].hex()}…, {len(one)} B": one for one in pieces
    }
    return known() | {name: repeated(piece) for name, piece in found.items()}


def stream(pieces: Callable[[random.Random], Iterator[bytes]], size: int) -> Reads:
    """So many bytes of a pattern, in reads."""
    made = bytearray()
    for piece in pieces(random.Random(SEED)):
        made += piece
        if len(made) >= size:
            break
    return reads_of(bytes(made[:size]), READ)


def worst(setting: Setting) -> str:
    """Name of the pattern that costs most: the dearest are timed again, fewer and more often."""
    found = patterns(random.Random(SEED))
    left = list(found)
    for keep, repeats in ((40, 1), (6, 5), (1, 15)):
        costs = {}
        for name in left:
            reads = stream(found[name], setting.count(SEARCH_SIZE))
            costs[name] = min(cost(reads) for _ in range(repeats))
        left = sorted(left, key=costs.__getitem__)[-keep:]
    return left[-1]


# -- sides and rows --------------------------------------------------------------------------------


def ours(setting: Setting, stack: ExitStack) -> Iterable[Side]:
    """The worst pattern, and the known ones beside it."""
    found = patterns(random.Random(SEED))
    names = {name: name for name in known()}
    names["a flood of start bytes"] = bytes([START] * 16 + [0]).hex()
    names[WORST] = worst(setting)
    for name, pattern in names.items():
        yield side(name, stream(found[pattern], setting.count(SIZE)))


def side(name: str, reads: Reads) -> Side:
    """CPU time per byte."""
    return Side(name, lambda: cost(reads))


def times_line_rate(costs: Costs) -> float:
    """How many of the fastest lines one CPU reads."""
    return 1 / (costs[WORST] * LINE_RATE)


PROGRAM = Program(
    name="hostile",
    rows=(Row("worst hostile input ÷ a 921600 line", times_line_rate, at_least(50, 60)),),
    ours=ours,
)

if __name__ == "__main__":
    main(PROGRAM)
