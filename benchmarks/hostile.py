"""Bytes that cost a decoder more than frames do, in multiples of the fastest line.

    python -m benchmarks.hostile [ROW …] [--rounds 15] [--json] [--beside TREE]

The worst pattern is searched for anew in every run and for each tree: short patterns repeated, runs
of start bytes, headers good and bad of many lengths, damaged frames. Those that cost most are timed
again, with what small changes make of them, until one is left. All come in reads of 62 bytes, a
packet of a USB adapter.
"""

from __future__ import annotations

import random
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from functools import cache, partial
from itertools import product

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
GENERATIONS = 8

Reads = list[bytes]


def cost(reads: Reads) -> float:
    """CPU seconds per byte."""
    feed = FrameDecoder().feed
    began = time.thread_time()
    for read in reads:
        feed(read)
    return (time.thread_time() - began) / sum(map(len, reads))


# -- what may come ---------------------------------------------------------------------------------


@cache
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

    def different_headers(dice: random.Random, between: Sequence[int] = (0,)) -> Iterator[bytes]:
        """More than a decoder remembers, each of a long frame that never comes."""
        while True:
            size, session = dice.randrange(700, 1007), dice.randrange(32)
            frame = encode_frame(bytes(size), session=session, sequence=dice.randrange(65536))
            yield frame[:12] + bytes([START] * dice.choice(between))

    def empty_frames(dice: random.Random, padded: int = 32) -> Iterator[bytes]:
        """Header after header, start bytes between; what says that it is padded is no frame."""
        while True:
            padding = dice.randrange(8) << 5 | dice.randrange(padded)
            header = bytes([START, 12, 0, dice.randrange(64), padding, 0, 0, 0, START, START])
            between = bytes([START] * dice.randrange(4))
            yield header + crc16(header).to_bytes(2, "little") + between

    def short_frames(dice: random.Random) -> Iterator[bytes]:
        """Good frames of many kinds, start bytes in them and between."""
        while True:
            size, session = dice.randrange(1, 12), dice.randrange(32)
            made = encode_frame(bytes([START] * size), session=session, sequence=0xAAAA)
            yield made + bytes([START] * dice.randrange(4))

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
        "good headers, all different": different_headers,
        "good headers, start bytes between": partial(different_headers, between=(1, 4, 11)),
        "empty frames, all different, start bytes between": empty_frames,
        "empty frames, all good, start bytes between": partial(empty_frames, padded=1),
        "short frames, start bytes between": short_frames,
        "good headers that overlap": repeated(overlapping(40)),
        "headers of another version, one for 3 bytes": partial(other_versions, gap=3),
        "headers of another version, one for 4 bytes": partial(other_versions, gap=4),
    }


def crc16(data: bytes) -> int:
    """Header checksum: reflected 0x8005, start 0x3AA3."""
    register = 0x3AA3
    for byte in data:
        register ^= byte
        for _ in range(8):
            register = register >> 1 ^ (0xA001 if register & 1 else 0)
    return register


def overlapping(count: int) -> bytes:
    """Headers of which each begins in the sequence number of the one before: one for 9 bytes.

    The checksum of a header is the length of the next one.
    """
    made, lower, upper = bytearray(), 0xF0, 3
    for _ in range(count):
        for session, padding, sequence in product(range(32), range(32), range(256)):
            fields = (START, lower, upper, session, padding, 0, 0, 0, sequence)
            low, high = crc16(bytes((*fields, START))).to_bytes(2, "little")
            if high < 4:
                made += bytes(fields)
                lower, upper = low, high
                break
    return bytes(made)


def other_versions(_: random.Random, gap: int) -> Iterator[bytes]:
    """Start bytes; every gap bytes begins a header with a right CRC16."""
    made = bytes([START] * 10)
    yield made
    while True:
        more = crc16(made).to_bytes(2, "little") + bytes([START] * (gap - 2))
        made = (made + more)[-10:]
        yield more


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
    return known() | {name_of(piece): repeated(piece) for piece in pieces}


def name_of(piece: bytes) -> str:
    """A repeated piece as hex, shortened."""
    return piece.hex() if len(piece) <= 24 else f"{piece[:24].hex()}…, {len(piece)} B"


def mutant(piece: bytes, dice: random.Random) -> bytes:
    """A piece with a byte changed, added or taken out."""
    place = dice.randrange(len(piece))
    byte = bytes([dice.choice((START, 0, dice.randrange(256)))])
    left, right = piece[:place], piece[place + 1 :]
    return dice.choice((left + byte + right, piece[:place] + byte + piece[place:], left + right))


def stream(pieces: Callable[[random.Random], Iterator[bytes]], size: int) -> Reads:
    """So many bytes of a pattern, in reads."""
    made = bytearray()
    for piece in pieces(random.Random(SEED)):
        made += piece
        if len(made) >= size:
            break
    return reads_of(bytes(made[:size]), READ)


def worst(setting: Setting) -> tuple[str, Reads]:
    """The pattern that costs most, and its bytes.

    The dearest of all are changed a little and timed with what came of it, some times over; then
    fewer are timed more often.
    """
    dice = random.Random(SEED)
    size = setting.count(SEARCH_SIZE)
    found = {name: stream(pieces, size) for name, pieces in patterns(dice).items()}

    def dearest(keep: int, repeats: int) -> None:
        costs = {n: min(cost(reads) for _ in range(repeats)) for n, reads in found.items()}
        for name in sorted(found, key=costs.__getitem__)[:-keep]:
            del found[name]

    dearest(40, 1)
    for _ in range(1 if setting.is_quick else GENERATIONS):
        for reads in list(found.values()):
            piece = b"".join(reads)[: dice.choice((8, 9, 12, 13, 16, 17, 24, 36))]
            for one in (piece, mutant(piece, dice)):
                if one:
                    found[name_of(one)] = stream(repeated(one), size)
        dearest(40, 2)
    dearest(6, 5)
    dearest(1, 15)
    return found.popitem()


# -- sides and rows --------------------------------------------------------------------------------


def ours(setting: Setting, stack: ExitStack) -> Iterable[Side]:
    """The worst pattern, and the known ones beside it."""
    size = setting.count(SIZE)
    for name, pieces in known().items():
        yield side(name, stream(pieces, size))
    flood = repeated(bytes([START] * 16 + [0]))
    yield side("a flood of start bytes", stream(flood, size))
    name, reads = worst(setting)
    print(f"worst: {name}", file=sys.stderr)
    yield side(WORST, reads * (SIZE // SEARCH_SIZE))


def side(name: str, reads: Reads) -> Side:
    """CPU time per byte."""
    return Side(name, lambda: cost(reads))


def times_line_rate(costs: Costs) -> float:
    """How many of the fastest lines one CPU reads, whatever comes."""
    return 1 / (max(costs[name] for name in (WORST, *known())) * LINE_RATE)


PROGRAM = Program(
    name="hostile",
    rows=(Row("worst hostile input ÷ a 921600 line", times_line_rate, at_least(50, 60)),),
    ours=ours,
)

if __name__ == "__main__":
    main(PROGRAM)
