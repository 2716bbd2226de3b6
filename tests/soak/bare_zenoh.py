"""What zenoh alone takes for the messages of a fleet: the yardstick of :mod:`tests.soak.fleet`.

Nothing of this project runs in these processes: a router, two that publish under the keys of half
of the aircraft each, as many bytes and as often, what is due together in one moment, and one that
takes what came as often. What a fleet costs beyond that is what it does with its messages.
"""

from __future__ import annotations

import json
import sys
import time
from itertools import chain
from typing import Any

import zenoh

__all__ = ["main"]

SITE = "bare"
WALL_HZ, CARD_HZ, FULL_HZ = 5.0, 1.0, 50.0
MOMENT_S = 0.05
PACKAGE, CARD = bytes(120), bytes(320)
"""As long as a package of telemetry and the card of an agent are, in the mean."""

_DEPTH = 20_000


def _line(**what: object) -> None:
    sys.stdout.write(json.dumps(what) + "\n")
    sys.stdout.flush()


def _open(mode: str, endpoints: str, place: str) -> zenoh.Session:
    config = zenoh.Config()
    config.insert_json5("mode", json.dumps(mode))
    config.insert_json5(endpoints, json.dumps([place]))
    config.insert_json5("scouting/multicast/enabled", "false")
    return zenoh.open(config)


def route(place: str) -> None:
    """A router, until its standard input ends."""
    with _open("router", "listen/endpoints", place):
        _line(ready=True)
        sys.stdin.read()


def publish(place: str, first: int, count: int, seconds: float) -> None:
    """What as many aircraft tell; the first of all in full, too."""
    with _open("client", "connect/endpoints", place) as session:

        def publisher(number: int, kind: str) -> zenoh.Publisher:
            return session.declare_publisher(
                f"m100/{SITE}/a{number}/{kind}",
                congestion_control=zenoh.CongestionControl.DROP,
                allowed_destination=zenoh.Locality.REMOTE,
            )

        numbers = range(first, first + count)
        wall = [publisher(number, "tel/5hz") for number in numbers]
        cards = [publisher(number, "state") for number in numbers]
        full = [publisher(0, "tel")] if first == 0 else []
        streams = (
            (wall, WALL_HZ * count, PACKAGE),
            (cards, CARD_HZ * count, CARD),
            (full, FULL_HZ * len(full), PACKAGE),
        )
        done = [0] * len(streams)
        _line(ready=True)
        sys.stdin.readline()
        began, cpu = time.monotonic(), time.process_time()
        while (passed := time.monotonic() - began) < seconds:
            for which, (outlets, rate, payload) in enumerate(streams):
                # A full message waits for nothing.
                until = passed if outlets is full else passed - passed % MOMENT_S
                while done[which] < rate * until:
                    outlets[done[which] % len(outlets)].put(payload)
                    done[which] += 1
            time.sleep(1.0 / FULL_HZ if full else MOMENT_S)
        _line(cpu=time.process_time() - cpu, sent=sum(done))
        sys.stdin.read()


def take(place: str, seconds: float) -> None:
    """Who takes all of it."""
    with _open("client", "connect/endpoints", place) as session:
        rings: list[Any] = [
            session.declare_subscriber(f"m100/{SITE}/*/{kind}", zenoh.handlers.RingChannel(_DEPTH))
            for kind in ("tel/5hz", "state", "tel")
        ]
        _line(ready=True)
        sys.stdin.readline()
        ends, cpu, heard = time.monotonic() + seconds, time.process_time(), 0
        while time.monotonic() < ends:
            time.sleep(MOMENT_S)
            for sample in chain.from_iterable(iter(ring.try_recv, None) for ring in rings):
                sample.payload.to_bytes()
                heard += 1
        _line(cpu=time.process_time() - cpu, heard=heard)
        sys.stdin.read()


def main(words: list[str]) -> None:
    """One: ``route PLACE``, ``publish PLACE FIRST COUNT SECONDS`` or ``take PLACE SECONDS``."""
    role, place, *numbers = words
    if role == "route":
        route(place)
    elif role == "publish":
        publish(place, int(numbers[0]), int(numbers[1]), float(numbers[2]))
    else:
        take(place, float(numbers[0]))


if __name__ == "__main__":
    main(sys.argv[1:])
