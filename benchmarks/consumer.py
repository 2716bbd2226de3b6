"""From bytes on the line to a consumer's hand: cost per telemetry frame, memory per kept sample.

    python -m benchmarks.consumer [--rounds 11] [--json]

The whole road of a package is timed, without the system calls: ``data_received`` of the link,
sessions, typed sample, merged state, clock model, subscription, and the consumer taking it. Beside
it in the same rounds: pymavlink parsing messages of like size and keeping the newest, which is what
a program on it does. Memory is what a thousand kept values add, by tracemalloc.
"""

from __future__ import annotations

import argparse
import asyncio
import gc
import importlib
import importlib.util
import json
import tracemalloc
from collections.abc import Callable
from typing import Any

import m100link
from benchmarks import run as base
from m100link.link import Link
from m100link.wire import encode_frame

KEPT = 1000


async def make_aircraft() -> tuple[m100link.Aircraft, Link]:
    link = Link()
    aircraft = m100link.Aircraft(link, firmware=base.FIRMWARE)
    return aircraft, link


def our_bench(readers: int) -> base.Bench:
    aircraft, link = asyncio.run(make_aircraft())
    frames = [
        encode_frame(b"\x02\x00" + base.telemetry_value(tick), session=0, sequence=tick & 0xFFFF)
        for tick in range(base.COUNT)
    ]
    consumers = [aircraft.telemetry() for _ in range(readers)]

    def deliver() -> int:
        taken = 0
        for frame in frames:
            link.data_received(frame)
            for consumer in consumers:
                taken += consumer.get_nowait() is not None
        return taken // readers

    return base.Bench(f"m100link, {readers} consumer(s)", base.COUNT, deliver)


def memory_of(make: Callable[[int], Any]) -> float:
    """Bytes per kept value."""
    gc.collect()
    tracemalloc.start()
    kept = [make(index) for index in range(KEPT)]
    size, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(kept) == KEPT
    return size / KEPT


def our_memory() -> float:
    values = [base.telemetry_value(tick) for tick in range(KEPT)]
    return memory_of(lambda index: m100link.Sample(bytes(values[index]), base.FIRMWARE, 0.0)) + len(
        values[0]
    )


def pymavlink_memory() -> float | None:
    if importlib.util.find_spec("pymavlink") is None:
        return None
    mavlink: Any = importlib.import_module("pymavlink.dialects.v20.common")
    sender = mavlink.MAVLink(None)
    wave = [0.5 + n / 7 for n in range(13)]
    wire = bytes(mavlink.MAVLink_highres_imu_message(10**12, *wave, 0x1FFF, 1).pack(sender))

    def parse(_: int) -> Any:
        return mavlink.MAVLink(None).parse_buffer(bytes(wire))

    return memory_of(parse)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=11)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    benches = [our_bench(1), our_bench(10), *base.pymavlink_benches()]
    times = base.measure(benches, options.rounds)
    result: dict[str, Any] = {
        "ns_per_frame": {name: sorted(t)[len(t) // 2] * 1e9 for name, t in times.items()},
        "pymavlink_mix_over_ours": base.paired_ratio(
            times, base.MAVLINK_MIX, "m100link, 1 consumer(s)"
        ),
        "bytes_per_kept_sample": our_memory(),
        "bytes_per_kept_pymavlink_message": pymavlink_memory(),
    }
    if options.json:
        print(json.dumps(result))
        return
    for name, rounds in times.items():
        print(f"{name:48} {sorted(rounds)[len(rounds) // 2] * 1e9:9.0f} ns")
    print(f"pymavlink mix / m100link, 1 consumer: {result['pymavlink_mix_over_ours'] or 0:.2f}")
    print(f"a kept sample: {result['bytes_per_kept_sample']:.0f} bytes")
    print(f"a kept pymavlink message: {result['bytes_per_kept_pymavlink_message'] or 0:.0f} bytes")


if __name__ == "__main__":
    main()
