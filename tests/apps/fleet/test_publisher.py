"""What a wall shows is what the aircraft said, and what cannot be read is counted."""

from __future__ import annotations

import asyncio
import random
from collections import Counter
from types import SimpleNamespace
from typing import Any, cast
from unittest.mock import MagicMock, call

import anyio
import pytest

from m100link.apps.agent import messages
from m100link.apps.agent.messages import LeaseChanged
from m100link.apps.agent.orders import UploadPlan
from m100link.apps.bus.network import Question
from m100link.apps.fleet.keys import Keys
from m100link.apps.fleet.payloads import pack, unpack_message
from m100link.apps.fleet.publisher import FleetTelemetry, StatePublisher, Thinner
from m100link.errors import AuthorityLost
from m100link.missions.plan import WaypointPlan
from m100link.missions.waypoint import Waypoint
from m100link.protocol.codes import ActivationCode
from m100link.protocol.records import Attitude, Battery
from tests import known
from tests.apps.fleet.conftest import SITE, Rig

pytestmark = pytest.mark.anyio


async def test_a_wall_has_the_newest_values_of_all(rig: Rig) -> None:
    ones = [await rig.aircraft(name) for name in ("a1", "a2")]
    bus = rig.network.session()
    wall = FleetTelemetry(bus, Keys(SITE))
    await anyio.sleep(5.0)
    assert set(wall.states) == {"a1", "a2"}
    for one in ones:
        state = wall.states[one.name]
        assert one.client.telemetry is not None
        assert state.get(Battery) == one.client.telemetry.get(Battery)
        assert (state.age(Attitude) or 0.0) < 0.25
    assert 20 <= wall.received["a1"] <= 60
    wall.close()
    before = wall.received.total()
    await anyio.sleep(1.0)
    assert wall.received.total() == before


async def test_one_is_heard_in_full_and_each_package_handed_on(rig: Rig) -> None:
    await rig.aircraft("a1")
    values: list[bytes] = []
    full = FleetTelemetry(
        rig.network.session(),
        Keys(SITE, "a1"),
        full=True,
        on_sample=lambda _, sample: values.append(sample.value),
    )
    await anyio.sleep(2.0)
    assert len(values) == full.received["a1"] > 90


async def test_what_cannot_be_read_is_counted(rig: Rig) -> None:
    bus = rig.network.session()
    wall = FleetTelemetry(bus, Keys(SITE))
    outlet = rig.network.session().publish(Keys(SITE, "a1").thinned)
    for payload in (b"", b"\x02x", b"\x01{}", b"\x01\x02junk"):
        outlet.put(payload)
    await anyio.sleep(0.1)
    assert (wall.unread, wall.received.total()) == (4, 0)


async def test_what_fronts_elsewhere_hear_comes_again_lest_it_was_lost(rig: Rig) -> None:
    """The state four times a second, lease and counters each second, the plan each five."""
    heard: Counter[str] = Counter()

    def take(_: str, payload: bytes) -> None:
        heard[type(unpack_message(payload)).__name__] += 1

    rig.network.session().subscribe(Keys(SITE, "a1").told, take)
    await rig.served("a1")
    await anyio.sleep(1.0)
    heard.clear()
    await anyio.sleep(10.0)
    often = {"State": 40, "Hello": 10, "LeaseChanged": 10, "LinkCounted": 10, "PlanChanged": 2}
    assert heard == often


HELLO = messages.Hello(messages.VERSION, "5c0f8b1e", 40.25)
PLAN = WaypointPlan([Waypoint(-33.12, 151.23, 9.0), Waypoint(-33.13, 151.22, 8.0)])


class Teller:
    """The publisher of one aircraft, and what it sent."""

    def __init__(self, **changed: Any) -> None:
        self.client: Any = SimpleNamespace(
            state=messages.State(39.5, "connected"),
            holder=LeaseChanged(17, "tower"),
            link=messages.LinkCounted(39.25, {"frames": 7}, {}, 0.125),
            **{"plan": None, "plan_by": "", "now": 40.25},
            **{f"on_{one}": [] for one in ("lease", "authority_taken", "activating")},
            on_mission_report=[],
        )
        vars(self.client).update(changed)
        self.bus = MagicMock()
        self.outlet = self.bus.publish.return_value
        self.publisher = StatePublisher(
            cast(Any, self.client), self.bus, Keys(SITE, "a1"), "5c0f8b1e"
        )

    def sent(self) -> list[messages.Message]:
        found = [unpack_message(one.args[0]) for one in self.outlet.put.mock_calls]
        self.outlet.put.reset_mock()
        return found


async def test_each_message_of_the_agent_is_told_and_nothing_is_left_behind() -> None:
    one = Teller()
    client = one.client
    one.outlet.is_wanted.return_value = False
    running = asyncio.create_task(one.publisher.run())
    await asyncio.sleep(1.0)
    assert one.sent() == [], "nobody listens"
    for told, heard in (
        (client.on_lease, LeaseChanged(18, "anna")),
        (client.on_authority_taken, AuthorityLost("the pilot left F")),
        (client.on_activating, ActivationCode.ENCRYPTED),
        (client.on_mission_report, messages.MissionReport(2, b"12345")),
    ):
        [tell] = told
        tell(heard)
    hello, lease, taken, *others = one.sent()
    assert (hello, lease) == (HELLO, LeaseChanged(18, "anna"))
    assert isinstance(taken, messages.AuthorityTaken)
    assert (taken.fault.kind, taken.fault.seen) == ("AuthorityLost", "the pilot left F")
    code = int(ActivationCode.ENCRYPTED)
    assert others == [messages.Activating(code), messages.MissionReport(2, b"12345")]
    key, greet = one.bus.serve.call_args.args
    answers: list[bytes] = []
    greet(Question(key, b"", lambda _, data: answers.append(data), lambda: None))
    assert answers == [pack(HELLO)], "a listener that came late"
    one.outlet.is_wanted.return_value = True
    await asyncio.sleep(0.25)
    assert client.state in one.sent()
    running.cancel()
    await asyncio.wait([running])
    one.outlet.close.assert_called_once_with()
    one.bus.serve.return_value.close.assert_called_once_with()
    lists = [getattr(client, name) for name in vars(client) if name.startswith("on_")]
    assert lists == [[], [], [], []]


def test_lease_and_counters_go_with_each_fourth_state_and_a_plan_as_it_changes() -> None:
    one = Teller()
    client, tell = one.client, one.publisher._tell_state
    one.publisher._outlet = one.outlet
    lease, no_plan = [HELLO, LeaseChanged(17, "tower")], messages.PlanChanged("", None)
    tell(0)
    assert one.sent() == [client.state, *lease, client.link, no_plan]
    tell(1)
    assert one.sent() == [client.state]
    client.plan, client.plan_by, client.link = PLAN, "anna", None
    tell(2)
    with_plan = messages.PlanChanged("anna", UploadPlan.of(PLAN))
    assert one.sent() == [client.state, with_plan]
    tell(3)
    assert one.sent() == [client.state]
    tell(4)
    assert one.sent() == [client.state, *lease]
    for turn, with_it in ((19, []), (20, [*lease, with_plan]), (24, lease), (40, lease)):
        tell(turn)
        assert one.sent()[1:] == with_it + ([with_plan] if turn == 40 else [])


@pytest.mark.parametrize(
    ("is_full", "key", "within"),
    [(True, "m100/field/a1/tel", 0.0), (False, "m100/field/a1/tel/5hz", 0.05)],
)
async def test_an_overview_hears_thinned_packages_in_groups(
    is_full: bool, key: str, within: float
) -> None:
    bus, taken = MagicMock(), list[str]()
    hears = FleetTelemetry(
        bus, Keys(SITE, "a1"), full=is_full, on_sample=lambda name, _: taken.append(name)
    )
    assert bus.subscribe.mock_calls == [call(key, hears._heard, depth=20_000, within=within)]
    package = messages.Telemetry(known.package("2.3"), "2.3", 7.0)
    short = messages.Telemetry(known.package("2.3")[:-1], "2.3", 7.0)
    unknown = messages.Telemetry(known.package("2.3"), "9.9", 7.0)
    for message in (package, package, short, unknown, HELLO):
        hears._heard(key, pack(message))
    assert (taken, hears.received["a1"], hears.unread) == (["a1", "a1"], 2, 3)
    state = hears.states["a1"]
    hears._heard(key, pack(package))
    assert hears.states["a1"] is state, "items of earlier packages stay"


# -- An overview gets each item at its own rate or five times a second -----------------------------


FAST, MIDDLE, TENTH, SLOW = 1 << 1, 1 << 5, 1 << 9, 1 << 10
EVERY = {FAST: 1, MIDDLE: 2, TENTH: 10, SLOW: 100}
"""Items at 100, 50, 10 and 1 Hz, as an aircraft can be set to send them."""


def told_of(shifts: dict[int, int], *, jitter: float = 0.0, seed: int = 0) -> Counter[str]:
    """Packages and items in ten seconds, each item at a phase of its own."""
    thinner, told, chance = Thinner(5.0), Counter[str](), random.Random(seed)
    for tick in range(1000):
        flags = sum(
            item for item, every in EVERY.items() if tick % every == shifts.get(item, 0) % every
        )
        if flags and thinner.goes_on(flags, tick / 100 + jitter * chance.random()):
            told["packages"] += 1
            told.update(bin(item) for item in EVERY if flags & item)
    return told


def test_one_package_tells_all_items_where_one_has_all_of_them() -> None:
    told = told_of({})
    assert told["packages"] == 50
    assert told[bin(FAST)] == told[bin(MIDDLE)] == told[bin(TENTH)] == 50
    assert told[bin(SLOW)] == 10


@pytest.mark.parametrize("jitter", [0.0, 0.004, 0.012])
@pytest.mark.parametrize("shift", range(10))
def test_each_item_at_five_hertz_or_its_own_rate(shift: int, jitter: float) -> None:
    """With phases of their own, too; and with the jitter of a busy machine."""
    chance = random.Random(shift)
    shifts = {item: chance.randrange(100) for item in EVERY} | {SLOW: shift}
    told = told_of(shifts, jitter=jitter, seed=shift)
    about = f"seed {shift}: {shifts} {told}"
    assert told[bin(SLOW)] == 10, about
    for item in (FAST, MIDDLE, TENTH):
        # One that comes without the others is sent by itself, with the fast ones as company.
        assert 48 <= told[bin(item)] <= told["packages"], about
    assert told["packages"] <= 115, about


def test_what_has_nothing_new_does_not_go_on() -> None:
    thinner = Thinner(5.0)
    assert thinner.goes_on(FAST, 0.0)
    assert not thinner.goes_on(FAST, 0.01)
    assert thinner.goes_on(FAST | SLOW, 0.02)
    assert not thinner.goes_on(0, 0.03)


def test_what_was_silent_goes_on_at_once() -> None:
    thinner = Thinner(5.0)
    for tick in range(3):
        thinner.goes_on(FAST, tick / 100)
    assert thinner.goes_on(FAST, 3.0)
    assert not thinner.goes_on(FAST, 3.01)


def test_two_that_were_read_at_once_are_reported_once() -> None:
    thinner = Thinner(5.0)
    told = [at for at in range(100) for _ in range(2) if thinner.goes_on(FAST, at / 100)]
    assert told == [0, *range(20, 100, 20)]


def test_the_last_of_sixteen_items_is_one() -> None:
    thinner = Thinner(5.0)
    told = [tick for tick in range(100) if thinner.goes_on(1 << 15, tick / 100)]
    assert told == list(range(0, 100, 20))
