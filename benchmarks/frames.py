"""How fast frames are read and written, beside pymavlink, without I/O.

    python -m benchmarks.frames [ROW …] [--rounds 15] [--json] [--beside TREE] [--codec COMMAND]

A frame is telemetry with all twelve items: 118 bytes of data, 134 on the wire. What a telemetry
package costs depends on what is read of it: nothing, every value as one flat row, twelve records.

``--codec`` names a program that decodes the same frames in another language. It is started once as
``COMMAND plain|aes FRAMES KEY``, where FRAMES is a file of the frames, each behind its length as
two little-endian bytes, and KEY 64 hex digits; for every line it reads it decodes all of them, one
per feed, and prints how many came through and the CPU seconds that it took.
"""

from __future__ import annotations

import shlex
import subprocess
import tempfile
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from pathlib import Path

from benchmarks import peers
from benchmarks.program import main
from benchmarks.rows import (
    Absent,
    Program,
    Row,
    Setting,
    Side,
    at_least,
    at_most,
    ratio,
    timed,
)
from m100link.protocol import Setpoint, TelemetryPacket, encode_telemetry, profile
from m100link.wire import Cipher, FrameDecoder, encode_frame

COUNT = 3000  # messages per timing
FIRMWARE = profile("1.0")
KEY = bytes(range(32))
PLAIN, SECRET = "decode, one frame per feed", "decode AES, one frame per feed"
CODEC, CODEC_SECRET = "the other codec", "the other codec, AES"


def telemetry_value(tick: int, up: float = 9.8) -> bytes:
    """Telemetry with all items: 116 bytes, 134 on the wire; ``up``: of the acceleration."""
    items: dict[str, list[float]] = {
        "time": [tick],
        "quaternion": [0.7, 0.1, -0.1, 0.7],
        "acceleration": [0.1, 0.2, up],
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


def telemetry_frame(tick: int, cipher: Cipher | None = None, up: float = 9.8) -> bytes:
    """One telemetry frame, numbered by its tick."""
    data = b"\x02\x00" + telemetry_value(tick, up)
    return encode_frame(data, session=0, sequence=tick & 0xFFFF, cipher=cipher)


def telemetry_frames(count: int, cipher: Cipher | None = None) -> list[bytes]:
    """That many telemetry frames, as an aircraft numbers them."""
    return [telemetry_frame(tick, cipher) for tick in range(count)]


def reads_of(stream: bytes, size: int) -> list[bytes]:
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
    """Frames, and a package of each; ``use`` is what the program does with it."""
    found = 0
    feed = FrameDecoder(cipher).feed
    for read in reads:
        for frame in feed(read):
            packet = TelemetryPacket(frame.data[2:], FIRMWARE)
            if use is not None:
                use(packet)
            found += 1
    return found


def movement(count: int) -> int:
    """Movement frames of one setpoint, as a control loop sends them."""
    setpoint = Setpoint.velocity(north=1.0, east=2.0, up=0.5, yaw_rate_deg_s=10.0)
    # Another checkout may be of a time when it took two steps.
    encode = getattr(setpoint, "encode", lambda to: setpoint.to_move(to).encode(to))
    for sequence in range(count):
        encode_frame(encode(FIRMWARE), session=0, sequence=sequence)
    return count


def ours(setting: Setting, stack: ExitStack) -> Iterable[Side]:
    """Reading and writing frames."""
    count = setting.count(COUNT)
    cipher = Cipher(KEY)
    frames, secret = telemetry_frames(count), telemetry_frames(count, cipher)
    stream = b"".join(frames)
    payloads = [b"\x02\x00" + telemetry_value(tick) for tick in range(count)]
    # Cut beforehand: a program gets its reads from the system.
    larger, smaller, smallest = (reads_of(stream, size) for size in (4096, 62, 16))
    row, records = TelemetryPacket.row, TelemetryPacket.records

    def encode(cipher: Cipher | None) -> int:
        for sequence, data in enumerate(payloads):
            encode_frame(data, session=0, sequence=sequence, cipher=cipher)
        return count

    works: dict[str, Callable[[], int]] = {
        PLAIN: lambda: decode(frames),
        "decode, 4096-byte reads": lambda: decode(larger),
        "decode, 62-byte reads": lambda: decode(smaller),
        "decode, 16-byte reads": lambda: decode(smallest),
        SECRET: lambda: decode(secret, cipher),
        "telemetry untouched": lambda: decode_telemetry(frames, None),
        "telemetry flat row": lambda: decode_telemetry(frames, row),
        "telemetry twelve records": lambda: decode_telemetry(frames, records),
        "AES telemetry row": lambda: decode_telemetry(secret, row, cipher),
        "encode 118 bytes": lambda: encode(None),
        "encode 118 bytes AES": lambda: encode(cipher),
        "movement command": lambda: movement(count),
    }
    return [timed(name, count, work) for name, work in works.items()]


def others(setting: Setting, stack: ExitStack) -> Iterable[Side | Absent]:
    """pymavlink, and the codec that was named."""
    count = setting.count(COUNT)
    yield peers.parsing(peers.MIX, peers.mix, count)
    yield peers.parsing(peers.IMU, peers.imu, count)
    yield peers.packing(count)
    for name, kind, cipher in ((CODEC, "plain", None), (CODEC_SECRET, "aes", Cipher(KEY))):
        if setting.codec is None:
            yield Absent(name, "needs a decoder in another language: --codec")
        else:
            frames = telemetry_frames(count, cipher)
            yield codec(name, shlex.split(setting.codec), kind, frames, stack)


def codec(name: str, command: list[str], kind: str, frames: list[bytes], stack: ExitStack) -> Side:
    """A decoder in a process of its own that times itself."""
    place = Path(stack.enter_context(tempfile.TemporaryDirectory())) / "frames"
    place.write_bytes(b"".join(len(one).to_bytes(2, "little") + one for one in frames))
    process = stack.enter_context(
        subprocess.Popen(
            [*command, kind, str(place), KEY.hex()],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
    )
    stdin, stdout = process.stdin, process.stdout
    assert stdin is not None
    assert stdout is not None
    stack.callback(stdin.close)

    def run() -> float:
        print(file=stdin, flush=True)
        found, seconds = stdout.readline().split()
        if int(found) != len(frames):
            raise RuntimeError(f"{name}: {found} of {len(frames)} came through")
        return float(seconds) / len(frames)

    return Side(name, run)


PROGRAM = Program(
    name="frames",
    rows=(
        Row(
            "frame decode, one per feed, other codec ÷ ours", ratio(CODEC, PLAIN), at_least(1, 1.15)
        ),
        Row(
            "telemetry untouched, pymavlink ÷ ours",
            ratio(peers.MIX, "telemetry untouched"),
            at_least(10, 11),
        ),
        Row(
            "telemetry flat row, pymavlink ÷ ours",
            ratio(peers.MIX, "telemetry flat row"),
            at_least(5.5, 6),
        ),
        Row(
            "telemetry twelve records, pymavlink ÷ ours",
            ratio(peers.MIX, "telemetry twelve records"),
            at_least(3, 3.5),
        ),
        Row(
            "AES telemetry row, other codec's decoding ÷ ours",
            ratio(CODEC_SECRET, "AES telemetry row"),
            at_least(3, 4),
        ),
        Row(
            "movement command, pymavlink ÷ ours",
            ratio(peers.PACK, "movement command"),
            at_least(6, 7),
        ),
        Row("16-byte reads ÷ a frame per feed", ratio("decode, 16-byte reads", PLAIN), at_most(4)),
        Row("AES ÷ plain, decoding", ratio(SECRET, PLAIN)),
        Row("AES ÷ plain, encoding", ratio("encode 118 bytes AES", "encode 118 bytes")),
    ),
    ours=ours,
    others=others,
)

if __name__ == "__main__":
    main(PROGRAM)
