"""How fast frames are read and written, beside pymavlink on the same machine in the same run.

    python benchmarks/run.py [--rounds 15] [--json]

Method: one process, pinned to one CPU; the benches of a round run in random order, garbage
collection on and collected before each. The table shows the median over the rounds and their range.
A ratio is the median of the ratios within each round, so that what slows the machine slows both
sides. Compare ratios between machines, never times.

What is timed is checked first: every bench must deliver the messages that went in.
"""

from __future__ import annotations

import argparse
import gc
import importlib
import importlib.util
import json
import os
import platform
import random
import statistics
import sys
import time
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

from m100link.protocol import (
    Attitude,
    Move,
    Position,
    TelemetryPacket,
    Velocity,
    encode_telemetry,
    profile,
)
from m100link.wire import Cipher, FrameDecoder, encode_frame

SEED = 2015
COUNT = 3000  # messages per timing
HOSTILE_SIZE = 60_000  # bytes per timing
LINE_RATE = 92_160  # bytes/s of a serial line at 921600 baud, the fastest that the assistant offers
FIRMWARE = profile("1.0")
KEY = bytes(range(32))


class Bench(NamedTuple):
    """One thing to time; ``run`` handles ``units`` messages, or bytes of hostile input."""

    name: str
    units: int
    run: Callable[[], int]
    is_hostile: bool = False


# -- m100link --------------------------------------------------------------------------------------


def telemetry_value(tick: int) -> bytes:
    """Telemetry with all items: 116 bytes, 134 on the wire."""
    items: dict[str, list[float]] = {
        "time": [tick],
        "quaternion": [0.7, 0.1, -0.1, 0.7],
        "acceleration": [0.1, 0.2, 9.8],
        "velocity": [1.5, -2.5, 0.25],
        "angular_velocity": [0.01, 0.02, 0.03],
        "position": [0.3927, 1.9879, 31.5, 12.25, 5],
        "magnetometer": [120, -340, 1100],
        "rc": [100, -200, 300, -400, 8000, -4545],
        "gimbal": [0.5, -30.0, 12.0],
        "flight_status": [3],
        "battery": [88],
        "control_device": [2],
    }
    return encode_telemetry(items, FIRMWARE)


def chunks(stream: bytes, size: int) -> list[bytes]:
    """A stream as reads of one size deliver it."""
    return [stream[at : at + size] for at in range(0, len(stream), size)]


def decode(reads: list[bytes], cipher: Cipher | None = None) -> int:
    """Frames alone."""
    found = 0
    feed = FrameDecoder(cipher).feed
    for read in reads:
        found += len(feed(read))
    return found


def decode_telemetry(
    reads: list[bytes],
    use: Callable[[TelemetryPacket], object] | None,
    cipher: Cipher | None = None,
) -> int:
    """Frames, and a typed packet for each; ``use`` is what the program does with it."""
    found = 0
    feed = FrameDecoder(cipher).feed
    for read in reads:
        for frame in feed(read):
            packet = TelemetryPacket(frame.data[2:], FIRMWARE)
            if use is not None:
                use(packet)
            found += 1
    return found


def read_three(packet: TelemetryPacket) -> None:
    """What a control loop looks at."""
    packet.get(Attitude)
    packet.get(Velocity)
    packet.get(Position)


def our_benches() -> list[Bench]:
    """Reading and writing frames of 118 bytes of data."""
    cipher = Cipher(KEY)
    payloads = [b"\x02\x00" + telemetry_value(tick) for tick in range(COUNT)]
    frames = [encode_frame(data, session=0, sequence=n) for n, data in enumerate(payloads)]
    secret = [
        encode_frame(data, session=0, sequence=n, cipher=cipher) for n, data in enumerate(payloads)
    ]
    stream = b"".join(frames)

    def encode(cipher: Cipher | None) -> int:
        for sequence, data in enumerate(payloads):
            encode_frame(data, session=0, sequence=sequence, cipher=cipher)
        return COUNT

    def encode_from_values() -> int:
        for sequence in range(COUNT):
            value = telemetry_value(sequence)
            encode_frame(b"\x02\x00" + value, session=0, sequence=sequence)
        return COUNT

    def encode_movement() -> int:
        for sequence in range(COUNT):
            data = Move(0x48, 1.0, 2.0, 0.5, 10.0).encode(FIRMWARE)
            encode_frame(data, session=0, sequence=sequence)
        return COUNT

    row, records = TelemetryPacket.row, TelemetryPacket.records
    return [
        Bench("decode, a frame per read", COUNT, lambda: decode(frames)),
        Bench("decode, 4096-byte reads", COUNT, lambda: decode(chunks(stream, 4096))),
        Bench("decode, 62-byte reads", COUNT, lambda: decode(chunks(stream, 62))),
        Bench("decode, 16-byte reads", COUNT, lambda: decode(chunks(stream, 16))),
        Bench("decode AES", COUNT, lambda: decode(secret, cipher)),
        Bench("telemetry, nothing read", COUNT, lambda: decode_telemetry(frames, None)),
        Bench("telemetry, 3 items read", COUNT, lambda: decode_telemetry(frames, read_three)),
        Bench("telemetry, every value", COUNT, lambda: decode_telemetry(frames, row)),
        Bench("telemetry, all 12 items", COUNT, lambda: decode_telemetry(frames, records)),
        Bench(
            "telemetry AES, all 12 items", COUNT, lambda: decode_telemetry(secret, records, cipher)
        ),
        Bench("encode 118 bytes", COUNT, lambda: encode(None)),
        Bench("encode 118 bytes AES", COUNT, lambda: encode(cipher)),
        Bench("encode telemetry from values", COUNT, encode_from_values),
        Bench("encode movement command", COUNT, encode_movement),
    ]


# -- hostile input ---------------------------------------------------------------------------------


def hostile_streams() -> dict[str, bytes]:
    """Bytes that cost a decoder more than frames do."""
    dice = random.Random(SEED)

    def false_header() -> bytes:
        start = bytes(
            (0xAA, dice.randrange(256), dice.randrange(4), dice.randrange(64), 0, 0, 0, 0)
        )
        return start + dice.randbytes(4)

    def damaged_frame(number: int) -> bytes:
        frame = bytearray(
            encode_frame(b"\x02\x00" + telemetry_value(number), session=0, sequence=1)
        )
        if dice.random() < 0.5:
            frame[dice.randrange(len(frame))] ^= 1 << dice.randrange(8)
        return bytes(frame) + dice.randbytes(dice.choice((0, 0, 5, 40)))

    long_header = encode_frame(bytes(1007), session=0, sequence=7)[:12]
    return {
        "random bytes": dice.randbytes(HOSTILE_SIZE),
        "a flood of start bytes": b"\xaa" * HOSTILE_SIZE,
        "start bytes and zeros": bytes(dice.choice((0xAA, 0)) for _ in range(HOSTILE_SIZE)),
        "headers with a wrong CRC16": b"".join(false_header() for _ in range(HOSTILE_SIZE // 12)),
        "good headers, wrong CRC32": long_header * (HOSTILE_SIZE // 12),
        "damaged telemetry": b"".join(damaged_frame(n) for n in range(HOSTILE_SIZE // 145)),
    }


def hostile_benches() -> list[Bench]:
    """Each stream in reads of 62 bytes, a packet of a USB adapter."""

    def run(reads: list[bytes], size: int) -> Callable[[], int]:
        return lambda: decode(reads) * 0 + size

    benches = []
    for name, stream in hostile_streams().items():
        reads, size = chunks(stream, 62), len(stream)
        benches.append(Bench(name, size, run(reads, size), is_hostile=True))
    return benches


# -- pymavlink -------------------------------------------------------------------------------------


def pymavlink_benches() -> list[Bench]:
    """MAVLink 2 messages of like size, read and written; none where pymavlink is not installed."""
    if importlib.util.find_spec("pymavlink") is None:
        return []
    mavlink: Any = importlib.import_module("pymavlink.dialects.v20.common")
    sender = mavlink.MAVLink(None)
    wave = [0.5 + n / 7 for n in range(21)]
    imu = mavlink.MAVLink_highres_imu_message(10**12, *wave[:13], 0x1FFF, 1)
    others = [
        mavlink.MAVLink_attitude_quaternion_cov_message(10**12, wave[:4], 0.1, 0.2, 0.3, wave[:9]),
        mavlink.MAVLink_odometry_message(
            10**12, 1, 8, *wave[:3], wave[:4], *wave[:6], wave, wave, 1, 1, 90
        ),
        mavlink.MAVLink_hil_state_quaternion_message(
            10**12, wave[:4], 0.1, 0.2, 0.3, 225000000, 1139000000, 31500, *range(150, 158)
        ),
    ]

    def wires(messages: Iterable[Any]) -> list[bytes]:
        packed = []
        for message in messages:
            packed.append(bytes(message.pack(sender)))
            sender.seq = (sender.seq + 1) % 256
        return packed

    def parse(reads: list[bytes]) -> int:
        found = 0
        parse_buffer = mavlink.MAVLink(None).parse_buffer
        for read in reads:
            for message in parse_buffer(read) or ():
                found += message.get_type() != "BAD_DATA"
        return found

    def pack() -> int:
        for number in range(COUNT):
            message = mavlink.MAVLink_highres_imu_message(number, *wave[:13], 0x1FFF, 1)
            message.pack(sender)
        return COUNT

    alone = wires([imu] * COUNT)
    mixed = wires([imu, *others] * (COUNT // 4))
    mean = sum(map(len, mixed)) / len(mixed)
    stream = b"".join(alone)
    return [
        Bench(f"{MAVLINK_IMU} ({len(alone[0])} B)", COUNT, lambda: parse(alone)),
        Bench(f"{MAVLINK_IMU}, 4096-byte reads", COUNT, lambda: parse(chunks(stream, 4096))),
        Bench(f"{MAVLINK_MIX} ({mean:.0f} B on average)", COUNT, lambda: parse(mixed)),
        Bench(MAVLINK_PACK, COUNT, pack),
    ]


MAVLINK_IMU = "pymavlink HIGHRES_IMU"
MAVLINK_MIX = "pymavlink mix of 4 kinds"
MAVLINK_PACK = "pymavlink pack HIGHRES_IMU"


# -- measuring -------------------------------------------------------------------------------------


def measure(benches: list[Bench], rounds: int) -> dict[str, list[float]]:
    """Seconds per unit for each bench in each round."""
    dice = random.Random(SEED)
    for bench in benches:
        handled = bench.run()
        if handled != bench.units:
            raise SystemExit(f"{bench.name}: {handled} of {bench.units} came through")
    times: dict[str, list[float]] = {bench.name: [] for bench in benches}
    for _ in range(rounds):
        for bench in dice.sample(benches, len(benches)):
            gc.collect()
            begun = time.perf_counter()
            bench.run()
            times[bench.name].append((time.perf_counter() - begun) / bench.units)
    return times


# Dividend, divisor, what the ratio says, and the floor that the project set itself, if any.
RATIOS: list[tuple[str, str, str, float | None]] = [
    (MAVLINK_MIX, "telemetry, nothing read", "telemetry beside pymavlink mix, untouched", 3.0),
    (MAVLINK_MIX, "telemetry, 3 items read", "telemetry beside pymavlink mix, 3 items", None),
    (MAVLINK_MIX, "telemetry, every value", "telemetry beside pymavlink mix, every value", 3.0),
    (MAVLINK_MIX, "telemetry, all 12 items", "telemetry beside pymavlink mix, all items", None),
    (MAVLINK_IMU, "telemetry, nothing read", "telemetry beside pymavlink IMU, untouched", None),
    (MAVLINK_IMU, "telemetry, 3 items read", "telemetry beside pymavlink IMU, 3 items", None),
    (MAVLINK_IMU, "telemetry, all 12 items", "telemetry beside pymavlink IMU, all items", None),
    (MAVLINK_PACK, "encode movement command", "movement command beside pymavlink pack", 4.0),
    (MAVLINK_PACK, "encode 118 bytes", "encoding a frame beside pymavlink pack", None),
    ("decode, 16-byte reads", "decode, a frame per read", "cost of 16-byte reads", None),
    ("decode AES", "decode, a frame per read", "cost of AES, decoding", None),
    ("telemetry AES, all 12 items", "telemetry, all 12 items", "cost of AES, telemetry", None),
    ("encode 118 bytes AES", "encode 118 bytes", "cost of AES, encoding", None),
]


def paired_ratio(times: dict[str, list[float]], dividend: str, divisor: str) -> float | None:
    """Median over the rounds of one time divided by another; None when a side was not measured."""
    found = [next((n for n in times if n.startswith(name)), None) for name in (dividend, divisor)]
    if found[0] is None or found[1] is None:
        return None
    pairs = zip(times[found[0]], times[found[1]], strict=True)
    return statistics.median(above / below for above, below in pairs)


def environment() -> dict[str, object]:
    """What the figures depend on."""
    return {
        "python": platform.python_version(),
        "machine": platform.machine(),
        "cpus": os.cpu_count(),
        "fastcrc": importlib.util.find_spec("fastcrc") is not None,
        "load": os.getloadavg()[0],
    }


def report(benches: list[Bench], times: dict[str, list[float]]) -> dict[str, Any]:
    """All figures, ready for JSON."""
    rows = []
    for bench in benches:
        values = times[bench.name]
        middle = statistics.median(values)
        row: dict[str, Any] = {
            "name": bench.name,
            "unit": "byte" if bench.is_hostile else "message",
            "ns": round(middle * 1e9, 1),
            "ns_min": round(min(values) * 1e9, 1),
            "ns_max": round(max(values) * 1e9, 1),
            "per_second": round(1 / middle),
        }
        if bench.is_hostile:
            row["times_line_rate"] = round(1 / middle / LINE_RATE, 1)
        rows.append(row)
    ratios = []
    for dividend, divisor, meaning, floor in RATIOS:
        ratio = paired_ratio(times, dividend, divisor)
        if ratio is not None:
            ratios.append({"name": meaning, "ratio": round(ratio, 2), "floor": floor})
    return {"environment": environment(), "benches": rows, "ratios": ratios}


def show(figures: dict[str, Any]) -> None:
    """The figures as tables."""
    print(", ".join(f"{name} {value}" for name, value in figures["environment"].items()))
    print(f"\n{'':44}{'median':>10}{'range':>22}{'per second':>14}")
    for row in figures["benches"]:
        spread = f"{row['ns_min']:,} to {row['ns_max']:,}"
        tail = f"{row['per_second']:>14,}"
        if row["unit"] == "byte":
            tail = f"{row['times_line_rate']:>10} × line"
        print(f"{row['name']:44}{row['ns']:>7,} ns{spread:>22}{tail}")
    print(f"\n{'':44}{'ratio':>10}{'floor':>10}")
    for row in figures["ratios"]:
        floor = row["floor"]
        missed = "  below" if floor is not None and row["ratio"] < floor else ""
        print(f"{row['name']:44}{row['ratio']:>10}{floor or '':>10}{missed}")


def main() -> None:
    """Measure and show."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rounds", type=int, default=15, help="rounds to run, 15 by default")
    parser.add_argument("--json", action="store_true", help="print one JSON object, no table")
    options = parser.parse_args()
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    benches = our_benches() + pymavlink_benches() + hostile_benches()
    if importlib.util.find_spec("pymavlink") is None:
        print("pymavlink is not installed: no comparison", file=sys.stderr)
    figures = report(benches, measure(benches, options.rounds))
    if options.json:
        print(json.dumps(figures, indent=1))
    else:
        show(figures)


if __name__ == "__main__":
    main()
