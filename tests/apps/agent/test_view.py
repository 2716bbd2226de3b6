"""What a front may believe: each item by its age, and the agent by its silence."""

from __future__ import annotations

import ast
import asyncio
import math
import pathlib
import random
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import FrozenInstanceError, replace
from itertools import product
from types import FrameType
from typing import Any

import anyio
import pytest

import m100link
import m100link.apps
from m100link.apps.agent.client import AgentClient, Hearing
from m100link.apps.agent.messages import VERSION, Hello, LeaseChanged, State
from m100link.apps.agent.transports import memory_channels
from m100link.apps.fleet.signing import verifying
from m100link.apps.mavlink.translator.codec import MavlinkMessage, write_frame
from m100link.apps.mavlink.translator.numbers import MavCommand
from m100link.apps.mavlink.translator.vehicle_state import MODES, Mode
from m100link.link.transport import MemoryTransport
from m100link.protocol.items import BY_RECORD
from m100link.protocol.records import (
    Attitude,
    Battery,
    FlightPhase,
    FlightStatus,
    Position,
    RcMode,
    RemoteControl,
    Velocity,
)
from m100link.sim.clock import virtual_clock_loop
from m100link.sim.virtual import VirtualAircraft
from m100link.telemetry.integrity import Integrity, IntegrityState
from m100link.telemetry.state import AircraftState
from tests.apps.fleet import conftest as fleet
from tests.apps.fleet.test_signing import ANNA, RIGHTS
from tests.apps.mavlink import conftest as mavlink
from tests.apps.ros2 import conftest as ros2
from tests.apps.station import conftest as station
from tests.apps.station.console.test_tab import airborne
from tests.known import CONNECTED, Known, KnownAgent, position, sample, seen

AGES_S = dict.fromkeys(BY_RECORD, 1.2) | {FlightStatus: 2.5, Battery: 5.0}
"""An item at 1 Hz is known all the time; of the status one package may be lost, of the charge four.
As docs/reference/guards.md has them for the guards."""

NOBODY = LeaseChanged(0, "")


@pytest.fixture
def anyio_backend() -> tuple[str, dict[str, Any]]:
    return "asyncio", {"loop_factory": virtual_clock_loop}


STILL = Velocity(0.0, 0.0, 0.0, 7)


def told(*changed: Any, at: float = 0.0, without: tuple[type[Any], ...] = ()) -> AircraftState:
    state = AircraftState(lambda: 0.0)
    state.update(sample(at=at, changed=changed, without=without))
    return state


@pytest.mark.parametrize("record", AGES_S, ids=lambda record: record.__name__)
def test_an_item_is_known_until_its_age_and_no_longer(record: type[Any]) -> None:
    limit, one = AGES_S[record], told()
    assert seen(one, limit - 1e-3).get(record) is not None
    assert seen(one, limit + 1e-3).get(record) is None
    assert seen(one, 0.499).to_steer_by(record) is not None
    assert seen(one, 0.501).to_steer_by(record) is None
    assert seen(one, 0.299).together(record) is not None
    assert seen(one, 0.301).together(record) is None
    assert seen(one, -limit - 1e-3).get(record) is None, "of a time that is to come"
    of_no_time = seen(told(at=math.nan), 0.0)
    assert (of_no_time.get(record), of_no_time.rate_hz(record)) == (None, 0.0)
    assert (of_no_time.is_new(record), of_no_time.is_heard) == (False, False)
    assert seen(None).get(record) is None
    assert seen(AircraftState(lambda: 0.0)).get(record) is None


@pytest.mark.parametrize(
    ("age", "is_heard"), [(0.0, True), (1.2, True), (1.201, False), (-1.2, True), (-2.0, False)]
)
def test_an_aircraft_is_heard_that_tells_something_once_a_second(
    age: float, is_heard: bool
) -> None:
    assert seen(told(), age).is_heard is is_heard
    assert not seen(None).is_heard
    assert not seen(AircraftState(lambda: 0.0)).is_heard


@pytest.mark.parametrize("record", AGES_S, ids=lambda record: record.__name__)
def test_an_item_arrives_until_its_age_whatever_it_says(record: type[Any]) -> None:
    limit, one = AGES_S[record], told(Battery(101))
    ages = (0.0, limit, -limit, limit + 1e-3, -limit - 1e-3)
    assert [seen(one, age).is_new(record) for age in ages] == [True, True, True, False, False]
    assert not seen(one, is_gone=True).is_new(record)
    assert not seen(told(without=(record,))).is_new(record)
    assert not seen(None).is_new(record)
    assert (seen(one, 0.75).age(record), seen(told(without=(record,))).age(record)) == (0.75, None)


@pytest.mark.parametrize(
    ("age", "rate_hz"), [(0.0, 10.0), (1.2, 10.0), (1.201, 0.0), (-1.2, 10.0), (-1.201, 0.0)]
)
def test_a_rate_is_that_of_lately(age: float, rate_hz: float) -> None:
    one = told(at=-1.0)
    assert seen(one, -1.0).rate_hz(Velocity) == 0.0, "one arrival is none"
    for tenth in range(9, -1, -1):
        one.update(sample(at=-tenth / 10, without=(Position,)))
    assert seen(one, age).rate_hz(Velocity) == pytest.approx(rate_hz)
    assert seen(one, 0.5).rate_hz(Position) == 0.0
    assert seen(told(without=(Velocity,))).rate_hz(Velocity) == 0.0
    assert seen(None).rate_hz(Velocity) == 0.0


def test_when_telemetry_came_last_and_whether_it_can_be_true() -> None:
    one = told()
    one.update(sample(at=0.7, without=(Position,)))
    assert (seen(one, 9.0).telemetry_at, seen(one, 9.0).integrity) == (0.7, one.integrity)
    assert seen(None).telemetry_at is None
    assert seen(None).integrity == Integrity(IntegrityState.UNKNOWN)
    good = Known().view
    assert good.integrity == Integrity(IntegrityState.GOOD, "", 0.25, 0.375)


HEARD = {Hearing.HEARD: (0.0, 2.0), Hearing.SILENT: (2.001, 60.0, -3.0, math.nan)}


@pytest.mark.parametrize(
    ("connection", "has_authority", "hearing"),
    list(product(("connecting", "connected", "lost"), (True, False), Hearing)),
)
def test_each_state_of_the_agent_at_each_silence(
    connection: str, has_authority: bool, hearing: Hearing
) -> None:
    state = State(0.0, connection=connection, has_authority=has_authority)
    is_gone = hearing is Hearing.GONE
    for silence in (1.0, 99.0) if is_gone else HEARD[hearing]:
        one = seen(told(), 0.0, state=state, is_gone=is_gone, heard_at=-silence)
        is_believed = hearing is Hearing.HEARD and connection == "connected"
        assert one.hearing is hearing
        assert one.is_connected is is_believed
        assert one.is_heard is is_believed
        assert one.has_authority is (hearing is Hearing.HEARD and has_authority)
        assert one.connection == ("silent" if hearing is Hearing.SILENT else connection)
        assert (one.get(Position) is not None) is is_believed
        assert (one.to_steer_by(Position) is not None) is is_believed
        assert (one.is_on_ground is None) is not is_believed
        assert one.is_airborne is is_believed


@pytest.mark.parametrize(
    ("status", "on_ground", "is_airborne"),
    [(1, True, False), (2, False, False), (3, False, True), (4, False, True), (9, False, False)],
)
def test_what_is_not_seen_on_the_ground_is_not_on_it(
    status: int, on_ground: bool, is_airborne: bool
) -> None:
    state = AircraftState(lambda: 0.0)
    for at in (-1.0, -0.5, 0.0):  # one status of standing is not enough
        state.update(sample(at=at, changed=(FlightStatus(status), STILL)))
    one = seen(state)
    assert (one.is_on_ground, one.is_airborne) == (on_ground, is_airborne)
    phases = {1: FlightPhase.STANDBY, 2: FlightPhase.TAKING_OFF, 3: FlightPhase.IN_AIR}
    assert one.phase is {**phases, 4: FlightPhase.LANDING}.get(status)
    gone = seen(told(FlightStatus(status), without=(FlightStatus,)))
    assert (gone.is_on_ground, gone.is_airborne, gone.phase) == (None, False, None)


@pytest.mark.parametrize(("health", "is_place"), [(0, False), (2, False), (3, True), (5, True)])
def test_a_place_is_one_by_gps_alone(health: int, is_place: bool) -> None:
    one = seen(told(position(health=health)))
    assert one.get(Position) is not None
    assert (one.place is not None) is is_place
    assert seen(told(RemoteControl(0, 0, 0, 0, -8000, -4545))).switch is RcMode.P


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("record", [Velocity, Attitude, Position], ids=lambda one: one.__name__)
def test_a_number_that_is_none_hides_its_item_and_no_other(record: type[Any], wrong: float) -> None:
    values = {
        Velocity: Velocity(0.0, wrong, 0.0, 3),
        Attitude: Attitude(1.0, 0.0, wrong, 0.0),
        Position: position(altitude=wrong),
    }
    one = seen(told(values[record]))
    others = [other for other in values if one.get(other) is not None]
    assert others == [other for other in values if other is not record]
    assert one.is_heard


def test_a_charge_and_an_attitude_that_cannot_be_are_unknown() -> None:
    one = seen(told(Battery(101), Attitude(0.0, 0.0, 0.0, 0.0)))
    assert (one.get(Battery), one.get(Attitude)) == (None, None)


def test_an_item_that_comes_beside_an_old_one_does_not_make_it_young() -> None:
    one = told()
    one.update(sample(at=3.0, without=(Position, FlightStatus, Battery)))
    found = seen(one, 3.0)
    assert found.is_heard
    assert found.get(Attitude) is not None
    assert (found.get(Position), found.place, found.is_on_ground) == (None, None, None)
    assert found.get(Battery) is not None
    assert (found.age(Position), found.age(Attitude)) == (3.0, 0.0)
    assert found.rate_hz(Position) == 0.0


def test_a_view_is_asked_once_and_cannot_be_changed() -> None:
    one = told()
    found = seen(one)
    before = found.get(Position), found.is_on_ground
    one.update(sample(at=0.0, changed=(FlightStatus(1), position(height=1.0))))
    assert (found.get(Position), found.is_on_ground) == before, "one step sees one aircraft"
    with pytest.raises(FrozenInstanceError):
        found.is_connected = True  # type: ignore[misc] # that is what is tried
    with pytest.raises(FrozenInstanceError):
        found.holder = NOBODY  # type: ignore[misc] # the same


# -- of a client -----------------------------------------------------------------------------------


def both() -> tuple[AgentClient, KnownAgent]:
    ours, its = memory_channels()
    return AgentClient(ours, "front"), KnownAgent(its)


@pytest.mark.anyio
async def test_what_arrives_is_seen_at_once_and_nothing_is_asked_twice() -> None:
    client, agent = both()
    async with client:
        agent.tell(CONNECTED)
        agent.tell_package(client.now)
        first = client.view
        assert client.view is first
        assert first.is_airborne
        agent.tell_package(client.now, changed=[FlightStatus(2)])
        assert client.view.phase is FlightPhase.TAKING_OFF, "at the same instant"
        agent.tell(replace(CONNECTED, has_authority=False))
        assert not client.view.has_authority
        agent.tell(LeaseChanged(9, "another"))
        assert client.view.holder.number == 9
        agent.tell(replace(CONNECTED, connection="lost"))
        assert (client.view.is_connected, client.view.telemetry) == (False, None)


@pytest.mark.anyio
async def test_an_agent_that_hangs_is_believed_for_two_seconds() -> None:
    client, agent = both()
    async with client:
        agent.tell(CONNECTED)
        agent.tell_package(client.now)
        await anyio.sleep(1.9)
        assert client.view.has_authority
        assert client.view.get(Battery) is not None
        await anyio.sleep(0.2)
        assert client.view.hearing is Hearing.SILENT
        assert (client.has_authority, client.is_connected) == (False, False)
        assert client.view.get(Battery) is None, "it is young enough, and nobody sent it"


def place_of(client: AgentClient) -> Position | None:
    return client.view.place


@pytest.mark.anyio
async def test_nothing_of_the_aircraft_before_is_known_of_the_next_one() -> None:
    client, agent = both()
    async with client:
        agent.tell(CONNECTED)
        agent.tell_package(client.now)
        assert place_of(client) is not None
        before = client.telemetry
        client._closed("it was killed")
        assert client.view.hearing is Hearing.GONE
        assert place_of(client) is None
        ours, its = memory_channels()
        client.reopen(ours)
        assert place_of(client) is None
        KnownAgent(its).tell(Hello(VERSION, "next", 0.0), CONNECTED)
        assert client.view.is_connected
        assert client.telemetry is not before
        assert place_of(client) is None, "that was of another aircraft, at the same instant"


@pytest.mark.anyio
@pytest.mark.parametrize("seed", range(8))
async def test_what_is_kept_for_a_step_is_never_behind_what_arrived(seed: int) -> None:
    """Messages, silence, ends and other agents by chance, with a look between any two of them."""
    chance = random.Random(seed)
    client, agent = both()
    changed = (FlightStatus(1), FlightStatus(3), Battery(101), position(altitude=math.nan))
    async with client:
        for number in range(400):
            act = chance.randrange(8)
            if act < 3:
                one = [chance.choice(changed)]
                agent.tell_package(client.now + chance.choice((0, 0, -2, 9)), changed=one)
            elif act == 3:
                connection = chance.choice(("connected", "connected", "lost"))
                told = State(client.now, connection, has_authority=chance.random() < 0.5)
                agent.tell(told)
            elif act == 4:
                agent.tell(LeaseChanged(number, "somebody"))
            elif act == 5:
                await anyio.sleep(chance.choice((0.0, 0.006, 0.3, 1.3, 2.1)))
            elif act == 6 and chance.random() < 0.2:
                client._closed("killed")
            elif act == 7 and chance.random() < 0.2:
                ours, its = memory_channels()
                client.reopen(ours)
                agent = KnownAgent(its)
            found = client.view
            anew = replace(found, at=client.now, heard_at=client.heard_at, is_gone=client.is_gone)
            anew = replace(
                anew, state=client.state, holder=client.holder, telemetry=client.telemetry
            )
            assert found == anew, (seed, number)
            for record in BY_RECORD:
                assert found.get(record) == anew.get(record), (seed, number, record)
            assert found.is_connected or found.get(Position) is None
            assert not found.has_authority or found.hearing is Hearing.HEARD


# -- what a step of a front costs: calls of the library, from a message to the bytes on the line ---

ROOT = str(pathlib.Path(m100link.__file__).parent)


def is_of_aircraft(frame: FrameType | None) -> bool:
    """Whether the virtual aircraft does that, which reads frames by the library, too."""
    while frame is not None:
        place = frame.f_code.co_filename
        if "/sim/" in place and not place.endswith("clock.py"):
            return True
        frame = frame.f_back
    return False


class Counted(Counter[str]):
    """How often each function was called, and the files in which these functions are."""

    def __init__(self) -> None:
        super().__init__()
        self.files: set[str] = set()


@contextmanager
def counting() -> Iterator[Counted]:
    """How often each function of the library is called; the virtual aircraft is none of it."""
    counted = Counted()

    def count(frame: FrameType, event: str, _: object) -> None:
        place = frame.f_code.co_filename
        is_library = place.startswith(ROOT) and "/sim/" not in place
        if event == "call" and is_library and not is_of_aircraft(frame.f_back):
            counted[frame.f_code.co_qualname] += 1
            counted.files.add(place.removeprefix(f"{ROOT}/"))

    before = sys.getprofile()
    sys.setprofile(count)
    try:
        yield counted
    finally:
        sys.setprofile(before)


def calls(work: Callable[[], object]) -> Counted:
    """The same of one step."""
    with counting() as counted:
        work()
    return counted


def is_asked_once(counted: Counter[str], most: int) -> None:
    assert counted.total() <= most, counted.most_common(12)
    assert counted["VehicleView.__post_init__"] <= 1, "one view for a step"


@pytest.mark.anyio
async def test_a_setpoint_of_mavlink_is_a_few_calls() -> None:
    fields = {"type_mask": 0b1101_1100_0111, "coordinate_frame": 1, "vx": 1.0, "target_system": 1}
    async with mavlink.Rig().running() as rig:
        await rig.ground.fly()
        rig.ground.send("SET_POSITION_TARGET_LOCAL_NED", **fields)
        row = MODES[Mode.OFFBOARD]
        rig.ground.command(MavCommand.DO_SET_MODE, 1, row.main, row.sub)
        for _ in range(20):
            rig.ground.send("SET_POSITION_TARGET_LOCAL_NED", **fields)
            await anyio.sleep(0.05)
        assert rig.speed > 0.3
        frame = write_frame(
            MavlinkMessage("SET_POSITION_TARGET_LOCAL_NED", fields, component=190),
            system=rig.ground.system,
            sequence=1,
        )

        def step() -> None:
            rig.bridge.received(frame, rig.ground.address)
            rig.bridge.step()

        counted = calls(step)
    assert counted["AgentClient.steer"] == 1
    is_asked_once(counted, 185)
    # A reader follows it through these files, from the socket to the frame: they may only fall.
    assert len(counted.files) <= 30, sorted(counted.files)


@pytest.mark.anyio
async def test_a_speed_of_ros_is_a_few_calls() -> None:
    async with ros2.Rig().running() as rig:
        await rig.program.up()
        await rig.program.fly(0.5, 1.0)
        rig.program.speed(1.0)
        counted = calls(rig.node.step)
    assert counted["AgentClient.steer"] == 1
    is_asked_once(counted, 190)


@pytest.mark.anyio
async def test_a_key_of_the_console_is_a_few_calls() -> None:
    async with station.Rig(VirtualAircraft(seed=5)).running() as rig:
        browser = await airborne(rig)
        await browser.hold(0.5, x=-2.0)
        text = browser.message("beat", mode=1, x=-2.0, y=0, z=0, w=0)
        counted = calls(lambda: browser.tab.receive(text))
    assert counted["AgentClient.steer"] == 1
    is_asked_once(counted, 151)


SLOT_S = 0.5  # until an agent answers that an order runs


@pytest.mark.anyio
async def test_a_take_off_of_a_fleet_is_a_few_calls(monkeypatch: pytest.MonkeyPatch) -> None:
    """Signed under a lease, over the network, to the line, and back with the first answer.

    What happens all the time is subtracted: that of as long an interval a second before. The
    aircraft is asked for its version every two seconds, in neither of both.
    """
    rig = fleet.Rig()
    async with rig.stack:
        verify = verifying(RIGHTS, ["a1"], rig.utc)
        await rig.aircraft("a1", as_bytes=False, verify=verify)
        anna = await rig.pilot("anna", sign=ANNA)
        async with anna["a1"].control() as control:
            await anyio.sleep(1.003)  # not at the moments of others
            asked_again, ask = asyncio.Event(), anna.bus.ask

            def asks(key: str, payload: bytes = b"", *, timeout: float) -> Any:
                if "/status/" in key:
                    asked_again.set()
                    sys.setprofile(None)
                return ask(key, payload, timeout=timeout)

            monkeypatch.setattr(anna.bus, "ask", asks)
            before = Counter({"Requests.query_version": 0})
            while not before["Requests.query_version"]:
                with counting() as before:
                    await anyio.sleep(SLOT_S)
            with counting() as idle:
                await anyio.sleep(SLOT_S)
            await anyio.sleep(SLOT_S)
            began_at = anyio.current_time()
            on_line: list[int] = []
            write = MemoryTransport.write

            def writes(line: MemoryTransport, data: bytes) -> None:
                on_line.append(counted.total())
                write(line, data)

            with counting() as counted:
                monkeypatch.setattr(MemoryTransport, "write", writes)
                order = asyncio.create_task(control.take_off())
                await asked_again.wait()
            assert anyio.current_time() - began_at == pytest.approx(SLOT_S, abs=1e-3)
            order.cancel()
    counted.subtract(idle)
    assert counted["Requests.query_version"] == idle["Requests.query_version"] == 0
    assert counted["Gate.check"] == counted["FleetAgent._carry_out"] == 1
    assert counted["Sender.request"] == 1, "one frame on the line"
    assert counted["OrderMessage.document"] == 1, (
        "written once, and signed and sent as it was written"
    )
    assert counted["AgentServer._state"] == 1
    assert on_line[0] <= 332, "from the order to its frame, at one instant"
    assert counted.total() <= 400, counted.most_common(12)


# -- nobody else decides ---------------------------------------------------------------------------

HERE = pathlib.Path(m100link.apps.__file__).parent
WITHOUT_AN_AGENT = {"doctor", "cli"}
"""They have an aircraft of their own; the table of the library is theirs, and no age."""


def test_no_front_has_an_age_of_its_own() -> None:
    found = []
    for path in sorted(HERE.rglob("*.py")):
        place, text = path.relative_to(HERE), path.read_text()
        if ".fresh(" not in text and ".finite(" not in text:
            continue
        for call in ast.walk(ast.parse(text)):
            if not isinstance(call, ast.Call) or not isinstance(call.func, ast.Attribute):
                continue
            has_age = any(one.arg == "within" for one in call.keywords)
            is_read = call.func.attr in ("fresh", "finite")
            if is_read and (has_age or place.parts[0] not in WITHOUT_AN_AGENT):
                found.append(str(place))
    # The second one reads files: what was known at a moment of a recorded flight.
    assert list(dict.fromkeys(found)) == ["agent/client.py", "station/console/kept.py"]
