"""Lateness of the 50 Hz control loop while telemetry streams at 100 Hz over a pseudo-terminal.

Beside it, in the same run and in turn: a bare ``loop.call_at`` chain. The virtual aircraft runs in
a process of its own. Prints p50 and p99 of both and their ratios; nothing here passes or fails.

    python benchmarks/ticks.py [--rounds 6] [--seconds 4] [--json]
"""

from __future__ import annotations

import argparse
import asyncio
import json
import random
import statistics
import subprocess
import sys
from typing import Any

import m100link
from m100link.flight.pacing import Ticker

PERIOD = 0.02


async def ticker(seconds: float) -> list[float]:
    late = []
    async for tick in Ticker(50):
        late.append(tick.lateness)
        if tick.elapsed >= seconds:
            break
    return late


async def call_at(seconds: float) -> list[float]:
    loop = asyncio.get_running_loop()
    late: list[float] = []
    done: asyncio.Future[None] = loop.create_future()
    start = loop.time()

    def on_tick(index: int) -> None:
        late.append(loop.time() - (start + index * PERIOD))
        if index * PERIOD >= seconds:
            done.set_result(None)
        else:
            loop.call_at(start + (index + 1) * PERIOD, on_tick, index + 1)

    loop.call_at(start, on_tick, 0)
    await done
    return late


def percentile(values: list[float], part: float) -> float:
    return sorted(values)[min(len(values) - 1, int(len(values) * part))]


async def measure(port: str, rounds: int, seconds: float, seed: int) -> dict[str, Any]:
    chance = random.Random(seed)
    late: dict[str, list[float]] = {"ticker": [], "call_at": []}
    async with m100link.connect(port) as aircraft:
        for _ in range(rounds):
            methods = [("ticker", ticker), ("call_at", call_at)]
            chance.shuffle(methods)
            for name, method in methods:
                await asyncio.sleep(chance.random() * 0.01)  # a random phase against whole ms
                late[name] += await method(seconds)
        rate = aircraft.state.statistics(m100link.Attitude).rate_hz
    result: dict[str, Any] = {"seed": seed, "telemetry_hz": rate}
    for name, values in late.items():
        result[name] = {
            "ticks": len(values),
            "p50_us": percentile(values, 0.50) * 1e6,
            "p99_us": percentile(values, 0.99) * 1e6,
            "earliest_us": min(values) * 1e6,
            "mean_us": statistics.fmean(values) * 1e6,
        }
    for name in ("p50_us", "p99_us"):
        result[f"ratio_{name[:3]}"] = result["ticker"][name] / result["call_at"][name]
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=6)
    parser.add_argument("--seconds", type=float, default=4.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    command = [sys.executable, "-m", "m100link", "sim", "--seed", str(options.seed)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as simulator:
        assert simulator.stdout is not None
        port = json.loads(simulator.stdout.readline())["port"]
        try:
            result = asyncio.run(measure(port, options.rounds, options.seconds, options.seed))
        finally:
            simulator.terminate()
    if options.json:
        print(json.dumps(result))
        return
    print(f"telemetry at {result['telemetry_hz']:.0f} Hz, seed {result['seed']}")
    for name in ("ticker", "call_at"):
        row = result[name]
        print(
            f"{name:8} {row['ticks']:6} ticks  p50 {row['p50_us']:7.0f} us  "
            f"p99 {row['p99_us']:7.0f} us  earliest {row['earliest_us']:6.1f} us"
        )
    print(f"ratio ticker / call_at: p50 {result['ratio_p50']:.2f}, p99 {result['ratio_p99']:.2f}")


if __name__ == "__main__":
    main()
