"""pymavlink as a ground station: python pymavlink_station.py WHAT ADDRESS [KEY-HEX]."""

from __future__ import annotations

import math
import os
import random
import sys
import time
from importlib import import_module
from typing import Any

os.environ["MAVLINK20"] = "1"
mavutil: Any = import_module("pymavlink.mavutil")
mavlink = mavutil.mavlink


class Station:
    """A connection that says its heartbeat."""

    def __init__(self, address: str, key: bytes | None = None, system: int = 255) -> None:
        self.line = mavutil.mavlink_connection(f"udpout:{address}", source_system=system)
        if key is not None:
            self.line.setup_signing(key, sign_outgoing=True)
        self.beaten_at = 0.0

    def beat(self) -> None:
        if time.monotonic() - self.beaten_at > 0.5:
            self.beaten_at = time.monotonic()
            self.line.mav.heartbeat_send(6, 8, 0, 0, 4)

    def wait(self, *kinds: str, seconds: float = 30.0, **wanted: Any) -> Any:
        ends = time.monotonic() + seconds
        while time.monotonic() < ends:
            self.beat()
            found = self.line.recv_match(type=list(kinds), blocking=True, timeout=0.2)
            if not found or found.get_srcComponent() != 1:  # the camera beats, too
                continue
            if all(getattr(found, name) == one for name, one in wanted.items()):
                return found
        raise AssertionError(f"no {kinds} {wanted} in {seconds} s")

    def command(self, number: int, *parameters: float, seconds: float = 10.0) -> int:
        given = [*parameters, *[math.nan] * (7 - len(parameters))]
        self.beat()
        self.line.mav.command_long_send(1, 1, number, 0, *given)
        while True:
            ack = self.wait("COMMAND_ACK", command=number, seconds=seconds)
            if ack.result != mavlink.MAV_RESULT_IN_PROGRESS:
                return int(ack.result)


def parameters(station: Station) -> None:
    station.wait("HEARTBEAT")
    station.line.mav.param_request_list_send(1, 1)
    found: dict[int, str] = {}
    count = 1
    while len(found) < count:
        value = station.wait("PARAM_VALUE")
        count, found[value.param_index] = value.param_count, value.param_id
    print(count, "parameters")


def missions(station: Station) -> None:
    """Up and down with 30 % of datagrams lost both ways."""
    chance = random.Random(3)
    station.wait("HEARTBEAT")
    home = station.wait("HOME_POSITION")
    for count in (3, 200):
        given = [
            (16, 0.0, home.latitude + place * 40, home.longitude - place * 20, 5.0 + place % 30)
            for place in range(count)
        ]
        upload(station, given, chance)
        found = download(station, count, chance)
        assert found == given, "it came down otherwise"
        print(count, "items up and down")


def upload(station: Station, given: list[tuple[Any, ...]], chance: random.Random) -> None:
    asked = -1
    while True:
        station.beat()
        if chance.random() > 0.3:
            if asked < 0:
                station.line.mav.mission_count_send(1, 1, len(given), 0)
            else:
                command, hold, x, y, z = given[asked]
                station.line.mav.mission_item_int_send(
                    1, 1, asked, 6, command, 0, 1, hold, 0, 0, math.nan, x, y, z, 0
                )
        while True:
            kinds = ["MISSION_REQUEST_INT", "MISSION_ACK"]
            got = station.line.recv_match(type=kinds, blocking=True, timeout=0.3)
            if got is None or chance.random() > 0.3:
                break
        if got is not None and got.get_type() == "MISSION_ACK":
            assert got.type == 0, got
            return
        if got is not None:
            asked = got.seq


def download(station: Station, count: int, chance: random.Random) -> list[tuple[Any, ...]]:
    told = -1
    while told != count:
        station.beat()
        station.line.mav.mission_request_list_send(1, 1, 0)
        got = station.line.recv_match(type=["MISSION_COUNT"], blocking=True, timeout=0.3)
        told = -1 if got is None or chance.random() < 0.3 else got.count
    found: list[tuple[Any, ...]] = []
    while len(found) < count:
        station.beat()
        if chance.random() > 0.3:
            station.line.mav.mission_request_int_send(1, 1, len(found), 0)
        got = station.line.recv_match(type=["MISSION_ITEM_INT"], blocking=True, timeout=0.2)
        if got is not None and got.seq == len(found) and chance.random() > 0.3:
            found.append((got.command, got.param1, got.x, got.y, got.z))
    return found


def junk(station: Station) -> None:
    """Random datagrams between commands, each of which is answered, and how fast."""
    chance = random.Random(5)
    station.wait("HEARTBEAT")
    times = []
    for _ in range(1000):
        for _ in range(100):
            station.line.write(chance.randbytes(chance.randrange(1, 60)))
        began = time.monotonic()
        assert station.command(410) == 0
        times.append(time.monotonic() - began)
        time.sleep(0.01)  # the bridge drops a flood, which a fast machine would send
    times.sort()
    print(f"100000 datagrams of junk, 1000 commands, p99 {times[990] * 1000:.1f} ms")


def latency(station: Station) -> None:
    station.wait("HEARTBEAT")
    times = []
    for _ in range(500):
        began = time.monotonic()
        assert station.command(410) == 0
        times.append(time.monotonic() - began)
        time.sleep(0.01)
    times.sort()
    print(f"p50 {times[250] * 1000:.1f} ms p99 {times[495] * 1000:.1f} ms")


def signing(address: str, key: bytes) -> None:
    """Signed is obeyed; unsigned, another key and a replay are not."""
    signed = Station(address, key)
    signed.wait("HEARTBEAT")
    assert signed.command(410) == 0
    sent: list[bytes] = []
    write = signed.line.write

    def kept(data: bytes) -> None:
        sent.append(bytes(data))
        write(data)

    signed.line.write = kept
    assert signed.command(410) == 0
    replayed = [data for data in sent if len(data) > 40][-1]
    signed.line.write = write
    for other in (Station(address, None, 254), Station(address, bytes(32), 253)):
        try:
            other.command(410, seconds=2.0)
        except AssertionError:
            continue
        raise SystemExit("what is not signed was obeyed")
    while signed.line.recv_match(blocking=False):
        pass
    signed.line.write(replayed)
    assert signed.line.recv_match(type="COMMAND_ACK", blocking=True, timeout=2.0) is None
    assert signed.command(410) == 0
    print("signed: obeyed; unsigned, another key, replayed: not")


def ground_station(station: Station) -> None:
    """QGroundControl's order: take-off disarmed, arm behind the answer; mission mode, then arm."""
    station.wait("HEARTBEAT")
    assert station.command(512, 148) == 0
    assert station.command(512, 435, 0) == 0
    assert station.command(512, 397) == 0
    assert station.command(512, 395) == 3  # its predecessor, which the bridge does not have
    parameters(station)
    home = station.wait("HOME_POSITION")
    assert station.command(22, -1, 0, 0, math.nan, math.nan, math.nan, home.altitude / 1e3 + 6) == 0
    assert station.command(400, 1) == 0
    while station.wait("GLOBAL_POSITION_INT").relative_alt < 5500:
        pass
    nan = math.nan
    line = station.line.mav
    no = 0x7FFFFFFF
    altitude = home.altitude / 1e3 + 9
    line.command_int_send(1, 1, 0, 192, 0, 0, -1, 1, 0, nan, no, no, altitude)
    station.wait("COMMAND_ACK", command=192, result=0)
    while station.wait("GLOBAL_POSITION_INT").relative_alt < 8500:
        pass
    line.command_int_send(1, 1, 0, 192, 0, 0, -1, 1, 0, nan, no, no, nan)
    station.wait("COMMAND_ACK", command=192, result=0)
    assert station.command(176, 1, 4, 6) == 0
    station.wait("HEARTBEAT", custom_mode=4 << 16 | 6 << 24)
    while station.wait("HEARTBEAT", seconds=60).base_mode & 128:
        pass
    upload(station, [(16, 0.0, home.latitude + 800, home.longitude, 7.0)], random.Random(1))
    assert station.command(176, 1, 4, 4) == 0
    station.wait("HEARTBEAT", custom_mode=4 << 16 | 4 << 24)
    assert station.command(400, 1) == 0
    station.wait("MISSION_ITEM_REACHED", seconds=60)
    assert station.command(20) == 0
    while station.wait("HEARTBEAT", seconds=90).base_mode & 128:
        pass
    print("as QGroundControl asks: done")


def hold(station: Station) -> None:
    """A station that comes sees the mission that still flies, and ends it."""
    station.wait("HEARTBEAT", custom_mode=4 << 16 | 4 << 24)
    assert station.command(176, 1, 4, 3) == 0
    station.wait("HEARTBEAT", custom_mode=4 << 16 | 3 << 24)
    print("mission, then hold")


WHAT = {
    "hold": hold,
    "parameters": parameters,
    "missions": missions,
    "junk": junk,
    "latency": latency,
    "ground_station": ground_station,
}


def main(what: str, address: str, *key: str) -> None:
    if what == "signing":
        signing(address, bytes.fromhex(key[0]))
    else:
        WHAT[what](Station(address))


if __name__ == "__main__":
    main(*sys.argv[1:])
