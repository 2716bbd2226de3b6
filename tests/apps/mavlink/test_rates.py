"""Each peer gets what it asked for, and nobody gets less because another asked."""

from __future__ import annotations

import itertools
from collections import Counter

import anyio
import pytest

from m100link.apps.agent.messages import LeaseChanged, State
from m100link.apps.mavlink.translator.codec import LAYOUTS
from m100link.apps.mavlink.translator.numbers import Command, Result
from m100link.apps.mavlink.translator.peers import MOST_PEERS, Peer
from m100link.apps.mavlink.translator.telemetry import MOST_HZ, STREAMS, Rates
from m100link.apps.mavlink.translator.world import World
from m100link.telemetry.state import AircraftState
from tests.apps.mavlink.conftest import Ground, Rig

HERE, THERE = ("127.0.0.1", 1), ("127.0.0.1", 2)
FIRST, SECOND = Peer(HERE, 245, 190), Peer(THERE, 246, 190)
NEIGHBOUR = Peer(HERE, 247, 190)


class NoAircraft:
    """Nothing is known; messages that need nothing are sent all the same."""

    state = State(at=0.0)
    holder = LeaseChanged(0, "")
    telemetry: AircraftState | None = None
    is_connected = has_authority = False


def rates() -> Rates:
    return Rates(World(NoAircraft()))


def counted(one: Rates, *peers: Peer, begin: float = 0.0) -> Counter[tuple[str, int]]:
    """How often each message goes to each port in ten seconds."""
    found: Counter[tuple[str, int]] = Counter()
    audience = {
        address: tuple(peer for peer in peers if peer.address == address)
        for address in (HERE, THERE)
    }
    for step in range(500):
        for message, addresses in one.due(begin + step * 0.02, audience):
            found.update((message.name, port) for _, port in addresses)
    return found


def test_what_one_asks_for_changes_nothing_for_another() -> None:
    one = rates()
    usual = counted(one, FIRST, SECOND)
    for name in STREAMS:
        one.set_hz(name, 1000.0, FIRST)
    one.set_hz("SYS_STATUS", 0.0, FIRST)
    found = counted(one, FIRST, SECOND, begin=10.0)
    assert found["SYSTEM_TIME", HERE[1]] == pytest.approx(10 * MOST_HZ, abs=1)
    assert found["SYS_STATUS", HERE[1]] == 0
    there = {pair: count for pair, count in found.items() if pair[1] == THERE[1]}
    assert there == {pair: count for pair, count in usual.items() if pair[1] == THERE[1]}
    assert there["SYS_STATUS", THERE[1]] == 20


def test_who_asks_again_gets_what_it_asked_for_last_and_the_usual_for_nothing() -> None:
    one = rates()
    for begin, hz, expected in ((0, 5.0, 50), (10, 0.5, 5), (20, None, 20), (30, -3.0, 0)):
        one.set_hz("SYS_STATUS", hz, FIRST)
        assert counted(one, FIRST, begin=begin)["SYS_STATUS", HERE[1]] == expected
    assert one.hz("SYS_STATUS", FIRST) == 0.0
    assert one.hz("SYS_STATUS", SECOND) == STREAMS["SYS_STATUS"].hz


def test_peers_behind_one_address_do_not_take_from_each_other() -> None:
    one = rates()
    one.set_hz("SYS_STATUS", 0.0, FIRST)
    one.set_hz("SYSTEM_TIME", 10.0, FIRST)
    found = counted(one, FIRST, NEIGHBOUR)
    assert found["SYS_STATUS", HERE[1]] == 20
    assert found["SYSTEM_TIME", HERE[1]] == 100


def test_rates_of_the_silent_are_kept_while_there_is_room() -> None:
    one = rates()
    one.set_hz("SYS_STATUS", 10.0, FIRST)
    assert counted(one, SECOND)["SYS_STATUS", HERE[1]] == 20, "nobody is there who wants more"
    assert counted(one, FIRST, begin=10.0)["SYS_STATUS", HERE[1]] == pytest.approx(100, abs=4)
    for number in range(100 * MOST_PEERS):
        one.set_hz("SYS_STATUS", 10.0, Peer(("127.0.0.1", 1000 + number), 1, 1))
    assert len(one._asked) == 2 * MOST_PEERS
    assert one.hz("SYS_STATUS", FIRST) == 10.0, "it is there"
    counted(one, SECOND, begin=20.0)
    for number in range(100 * MOST_PEERS):
        one.set_hz("SYS_STATUS", 10.0, Peer(("127.0.0.1", 1000 + number), 1, 1))
    assert one.hz("SYS_STATUS", FIRST) == STREAMS["SYS_STATUS"].hz


def test_what_comes_seldom_comes_soon_when_who_wanted_that_has_gone() -> None:
    one = rates()
    one.set_hz("SYS_STATUS", 0.001, FIRST)
    assert counted(one, FIRST)["SYS_STATUS", HERE[1]] == 1
    assert counted(one, NEIGHBOUR, begin=10.0)["SYS_STATUS", HERE[1]] == pytest.approx(20, abs=1)


def test_a_group_is_what_older_programs_ask_for() -> None:
    one = rates()
    one.set_group(2, 10.0, FIRST)
    assert one.hz("SYS_STATUS", FIRST) == 10.0
    assert one.hz("ATTITUDE", FIRST) == STREAMS["ATTITUDE"].hz
    one.set_group(0, 4.0, FIRST)
    assert {one.hz(name, FIRST) for name in STREAMS} == {4.0}
    one.set_group(99, 1.0, FIRST)
    assert {one.hz(name, FIRST) for name in STREAMS} == {4.0}


@pytest.mark.anyio
async def test_a_peer_that_asks_for_a_kilohertz_changes_nothing_for_another(
    rig: Rig, ground: Ground
) -> None:
    other = Ground(rig, ("127.0.0.1", 7000), 246)
    other.beat()
    await anyio.sleep(0.1)
    for name in ("ATTITUDE", "SYSTEM_TIME"):
        number = LAYOUTS[name].number
        assert await ground.ask(Command.SET_MESSAGE_INTERVAL, number, 1000) is Result.ACCEPTED
    number = LAYOUTS["GLOBAL_POSITION_INT"].number
    assert await ground.ask(Command.SET_MESSAGE_INTERVAL, number, -1) is Result.ACCEPTED
    ground.heard.clear()
    other.heard.clear()
    await anyio.sleep(10.0)
    for one, attitudes, times, places in ((ground, 500, 500, 0), (other, 200, 0, 200)):
        assert len(one.all("ATTITUDE")) == pytest.approx(attitudes, abs=3)
        assert len(one.all("SYSTEM_TIME")) == pytest.approx(times, abs=3)
        assert len(one.all("GLOBAL_POSITION_INT")) == pytest.approx(places, abs=3)
    assert await other.ask(Command.GET_MESSAGE_INTERVAL, number) is Result.ACCEPTED
    assert other.last("MESSAGE_INTERVAL")["interval_us"] == 50_000
    assert await ground.ask(Command.GET_MESSAGE_INTERVAL, number) is Result.ACCEPTED
    assert ground.last("MESSAGE_INTERVAL")["interval_us"] == -1


@pytest.mark.anyio
@pytest.mark.parametrize(
    ("name", "expected"), [("ATTITUDE", 50_000), ("VFR_HUD", -1), ("HIL_STATE", 0)]
)
async def test_an_interval_is_that_of_the_definitions(
    ground: Ground, name: str, expected: int
) -> None:
    """MESSAGE_INTERVAL: -1 is disabled, 0 not available, and more the interval in µs."""
    number = LAYOUTS[name].number if name in LAYOUTS else 90
    wanted = LAYOUTS["MESSAGE_INTERVAL"].number
    assert await ground.ask(Command.REQUEST_MESSAGE, wanted, number) is Result.ACCEPTED
    assert ground.last("MESSAGE_INTERVAL")["message_id"] == number
    assert ground.last("MESSAGE_INTERVAL")["interval_us"] == expected


@pytest.mark.anyio
async def test_nobody_counts_as_lost_what_went_to_another(rig: Rig, ground: Ground) -> None:
    """Ground stations show how many are missing by the numbers of the frames."""
    other = Ground(rig, ("127.0.0.1", 7000), 246)
    other.beat()
    await anyio.sleep(0.1)
    rig.sent.clear()
    ground.command(Command.SET_MESSAGE_INTERVAL, LAYOUTS["ATTITUDE"].number, 1000)
    ground.send("PARAM_REQUEST_LIST", target_system=1, target_component=1)
    await anyio.sleep(2.0)
    for one in (ground, other):
        numbers = []
        for data, address in rig.sent:
            at = 0
            while address == one.address and at < len(data):
                numbers.append(data[at + 4])
                at += data[at + 1] + 12
        assert len(numbers) > 100
        steps = {(after - before) % 256 for before, after in itertools.pairwise(numbers)}
        assert steps == {1}


@pytest.mark.anyio
async def test_request_data_stream_is_obeyed_for_who_asks(rig: Rig, ground: Ground) -> None:
    other = Ground(rig, ("127.0.0.1", 7000), 246)
    other.beat()
    fields = {"target_system": 1, "target_component": 1, "req_stream_id": 10}
    ground.send("REQUEST_DATA_STREAM", req_message_rate=2, start_stop=1, **fields)
    await anyio.sleep(0.1)
    ground.heard.clear()
    other.heard.clear()
    await anyio.sleep(10.0)
    assert len(ground.all("ATTITUDE")) == pytest.approx(20, abs=1)
    assert len(other.all("ATTITUDE")) == pytest.approx(200, abs=2)
    ground.send("REQUEST_DATA_STREAM", req_message_rate=2, start_stop=0, **fields)
    await anyio.sleep(0.1)
    ground.heard.clear()
    await anyio.sleep(2.0)
    assert ground.all("ATTITUDE") == []
