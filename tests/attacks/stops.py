"""STOP, setpoints and control beside everything at once: ``python -m tests.attacks.stops``.

Three processes and the attacker, as in :mod:`tests.attacks.gaps`. In each round the pilot holds a
key, then has the station fly a pattern by itself, and sends STOP: how long after that came the
first frame that stands still, with none that moves behind it? The lifetime of a setpoint does not
help here, since it is the agent that flies. The same is done beside nothing, and shown beside it,
with and without what others took of the machine. Nothing here passes or fails; the suite judges a
short slice of it.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import random
import secrets
import statistics
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from tests.attacks.common import publish
from tests.attacks.gaps import Gaps, Station, be_nice, flying
from tests.waiting import until

__all__ = ["Stops", "measure", "told"]

_HELD, _FLOWN = 0.6, 0.3
_WATCHED, _PATIENCE = 0.6, 5.0
"""Seconds after STOP for which frames are watched, and after which it counts as not heard."""


@dataclass
class Stops:
    """What was seen.

    Attributes:
        times: Seconds from sending STOP until frames stood still; infinite if they did not.
        own: The same without the time for which others kept agent, front and pilot waiting.
        keys: Setpoints while a key was held.
        load: The machine's at the end.
    """

    times: list[float] = field(default_factory=list)
    own: list[float] = field(default_factory=list)
    keys: Gaps = field(default_factory=Gaps)
    load: float = 0.0


async def _stop(station: Station, seen: Stops, drawn: random.Random) -> None:
    line, loop = station.line, asyncio.get_running_loop()

    def flies() -> bool:
        return bool(line.moving) and line.moving[-1]

    await until(lambda: not flies())
    await station.pilot.send(publish("/sdk_request_simple_task", data=1.0))
    await until(flies)
    await asyncio.sleep(_FLOWN + drawn.random() / 50)  # at any moment between two frames
    sent, waited = line.now()
    await station.pilot.send(publish("/sdk_request_simple_task", data=-1.0))
    stopped: tuple[float, float] | None = None
    while loop.time() < sent + _WATCHED or (stopped is None and loop.time() < sent + _PATIENCE):
        if flies():
            stopped = None
        elif stopped is None:
            stopped = line.now()
        await asyncio.sleep(0.002)
    if stopped is None:
        seen.times.append(float("inf"))
        seen.own.append(float("inf"))
    else:
        seen.times.append(stopped[0] - sent)
        seen.own.append(stopped[0] - sent - (stopped[1] - waited))


async def _rounds(station: Station, seconds: float, drawn: random.Random) -> Stops:
    loop, seen = asyncio.get_running_loop(), Stops()
    end = loop.time() + seconds
    while loop.time() < end:
        over = loop.time() + _HELD
        seen.keys.add(await station.hold_a_key(lambda over=over: loop.time() >= over))  # type: ignore[misc]
        if not seen.keys.is_in_control:
            break
        await _stop(station, seen, drawn)
    seen.load = os.getloadavg()[0]
    return seen


async def measure(
    *options: str,
    seconds: float,
    seed: int,
    only: str = "",
    tls: Sequence[Path] = (),
) -> tuple[Stops, Stops]:
    """The time beside everything at once, and before it the same time beside nothing.

    Args:
        options: For ``m100link console``.
        seconds: How long each lasts.
        seed: What is drawn by.
        only: One kind of attack; all by default.
        tls: Certificate and key, to attack by TLS.
    """
    token, drawn = secrets.token_hex(16), random.Random(seed)
    with tempfile.NamedTemporaryFile("w", suffix=".token") as file:
        file.write(token)
        file.flush()
        more = ["--token-file", file.name, "--metrics", "0", "--foxglove", "0"]
        if tls:
            more += ["--tls-cert", str(tls[0]), "--tls-key", str(tls[1])]
        async with flying(*options, *more, token=token) as station:
            alone = await _rounds(station, seconds, drawn)
            attacker = await asyncio.create_subprocess_exec(
                *(sys.executable, "-m", "tests.attacks.everything"),
                *(str(station.ports["orders"]), str(station.ports["pages"]), token),
                *("--metrics", str(station.ports["metrics"])),
                *("--foxglove", str(station.ports["foxglove"])),
                *("--seconds", str(seconds + 5.0), "--seed", str(seed), "--only", only),
                *(("--tls",) if tls else ()),
                preexec_fn=be_nice,
            )
            try:
                await asyncio.sleep(1.5)  # it has to start
                attacked = await _rounds(station, seconds, drawn)
                assert attacker.returncode is None
            finally:
                if attacker.returncode is None:
                    attacker.terminate()
                await attacker.wait()
    return attacked, alone


def told(name: str, seen: Stops) -> str:
    """One line, times in ms."""

    def row(times: Sequence[float]) -> str:
        if not times:
            return "none"
        return f"{1000 * statistics.median(times):4.0f} {1000 * max(times):5.0f}"

    late = sum(one > 0.3 for one in seen.times)
    control = "kept" if seen.keys.is_in_control else "LOST"
    return (
        f"{name:12} STOP {len(seen.times)} times, {late} after 300 ms; p50, worst "
        f"{row(seen.times)}, own {row(seen.own)}; gaps {row(seen.keys.gaps)}, "
        f"own {row(seen.keys.own)}, of the key {row(seen.keys.unflown)}; control {control}; "
        f"load {seen.load:.1f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=15.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="")
    parser.add_argument("--tls", nargs=2, type=Path, default=(), metavar=("CERT", "KEY"))
    options = parser.parse_args()
    attacked, alone = asyncio.run(
        measure(seconds=options.seconds, seed=options.seed, only=options.only, tls=options.tls)
    )
    print(told("attacked", attacked))
    print(told("left alone", alone))


if __name__ == "__main__":
    main()
