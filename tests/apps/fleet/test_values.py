"""What a fleet tells of the known aircraft: cards, payloads and tables, value by value.

Keys, bytes and units are those of docs/reference/fleet-wire.md and of the fields' names; the bytes
are made and read by code of this file.
"""

from __future__ import annotations

import asyncio
import base64
import dataclasses
import hashlib
import hmac
import io
import json
import math
import struct
import time
from types import SimpleNamespace
from typing import Any, cast
from unittest.mock import AsyncMock, MagicMock, call

import anyio
import pytest
from rich.console import Console

pytest.importorskip("zenoh")

import m100link
from m100link.apps.agent.messages import Event, LeaseChanged, RemoteError, State, Steer, Telemetry
from m100link.apps.agent.orders import AskVersion, Land, Stop, TakeOff
from m100link.apps.bus.session import LARGEST
from m100link.apps.cli import fleet_verbs
from m100link.apps.fleet import client as clients
from m100link.apps.fleet.agent import FleetAgent
from m100link.apps.fleet.keys import Keys
from m100link.apps.fleet.lost_link import LostLinkPlan
from m100link.apps.fleet.missions.manager import MissionManager
from m100link.apps.fleet.payloads import (
    Card,
    MissionCard,
    MissionStage,
    OrderMessage,
    OrderReply,
    Outcome,
    Progress,
    ShowCard,
    ShowStage,
    pack,
    pack_steer,
    unpack,
    unpack_message,
    unpack_steer,
)
from m100link.apps.fleet.publisher import FleetTelemetry
from m100link.errors import GuardRefused, M100Error, NotAllowed, OutcomeUnknown
from m100link.missions.plan import WaypointPlan
from m100link.missions.waypoint import Waypoint
from m100link.protocol.records import Battery, Position
from m100link.protocol.setpoint import (
    ControlMode,
    Horizontal,
    ReferenceFrame,
    Setpoint,
    Vertical,
    Yaw,
)
from m100link.telemetry.state import AircraftState
from tests import known, limits
from tests.apps.bus.memory import MemoryNetwork

pytestmark = pytest.mark.anyio

AT = 1_795_420_802.25


def heard(*changed: Any, age: float = 0.25, clock: float = 40.0) -> AircraftState:
    state = AircraftState(lambda: clock)
    state.update(known.sample(at=clock - age, changed=changed))
    return state


def client(telemetry: AircraftState | None, **state: Any) -> Any:
    told = State(0.0, "connected", firmware="3.1", has_authority=True, **state)
    return SimpleNamespace(
        view=known.seen(telemetry, 40.0, state=told, holder=LeaseChanged(17, "tower")),
        state=told,
        now=40.0,
        on_mission_report=[],
        on_lease=[],
    )


def card(telemetry: AircraftState | None, **state: Any) -> Card:
    """What the agent of that aircraft tells of it."""
    one = FleetAgent.__new__(FleetAgent)
    one._disk_fault = None
    one.client = client(telemetry, **state)
    one.boot, one._keys, one._utc = "5c0f8b1e", Keys("field", "kite"), lambda: AT
    one._lost_plan = LostLinkPlan("land", 7.5)
    missions = SimpleNamespace(words="")
    one._orders = cast(Any, SimpleNamespace(missions=missions))
    one.missions = cast(Any, missions)
    return one.card()


def mission(telemetry: AircraftState | None, **state: Any) -> MissionCard:
    """What it tells of a mission that began 12.75 s ago and goes to the third of its points."""
    points = [Waypoint(-33.12, 151.23, 9.0), Waypoint(-33.13, 151.22, 8.0)]
    # 55.66 m east of where it is: 0.0005966 degrees at that latitude.
    points.append(Waypoint(known.LATITUDE, known.LONGITUDE + 5.966e-4, 7.0))
    one = MissionManager(
        client(telemetry, **({"mission": "waypoint mission", "mission_index": 2} | state))
    )
    one.stage, one._plan, one._begun_at = MissionStage.FLYING, WaypointPlan(points), 27.25
    one._digest, one._by, one._points, one._is_paused = "ab" * 8, "anna", 3, True
    one._reached[:], one._reached_count = bytes([0, 1]), 2
    return one.card("kite", "5c0f8b1e")


# -- cards ----------------------------------------------------------------------------------------

CARD: dict[str, Any] = {
    "name": "kite",
    "boot": "5c0f8b1e",
    "at": 1_795_420_802.25,
    "connection": "connected",
    "fault": None,
    "firmware": "3.1",
    "holder": "tower",
    "fence": 17,
    "has_authority": True,
    "task": "going home",
    "phase": "in air",
    "height_m": pytest.approx(12.34, rel=1e-6),
    "latitude_deg": pytest.approx(-33.1234567, rel=1e-12),
    "longitude_deg": pytest.approx(151.2345678, rel=1e-12),
    "battery_percent": 63,
    "lost": "land",
    "lost_after": 7.5,
    "version": m100link.__version__,
}

MISSION: dict[str, Any] = {
    "name": "kite",
    "boot": "5c0f8b1e",
    "stage": "flying",
    "by": "anna",
    "digest": "ab" * 8,
    "points": 3,
    "reached": "AAE=",
    "reached_count": 2,
    "is_paused": True,
    "is_finished": False,
    "fault": None,
    "kind": "waypoint mission",
    "index": 2,
    "status": 5,
    "elapsed_s": 12.75,
    "distance_m": pytest.approx(55.66, rel=5e-3),
    "height_m": pytest.approx(12.34, rel=1e-6),
}


def test_a_card_has_each_value_under_its_name() -> None:
    payload = pack(card(heard(), task="going home"))
    assert payload[:1] == b"\x04"
    assert json.loads(payload[1:]) == CARD
    assert unpack(Card, payload) == card(heard(), task="going home")


def test_the_card_of_a_mission_has_each_value_under_its_name() -> None:
    payload = pack(mission(heard(), mission_status=5))
    assert payload[:1] == b"\x04"
    assert json.loads(payload[1:]) == MISSION


UNKNOWN = {"height_m", "latitude_deg", "longitude_deg"}
NOTHING = UNKNOWN | {"battery_percent", "phase"}


@pytest.mark.parametrize(
    ("telemetry", "missing"),
    [
        (None, NOTHING),
        (heard(age=5.1), NOTHING),
        (heard(age=2.6), UNKNOWN | {"phase"}),
        (heard(age=1.3), UNKNOWN),
        (heard(age=1.1), set()),
        (heard(known.position(height=math.nan)), UNKNOWN),
        (heard(known.position(height=-math.inf)), UNKNOWN),
        (heard(known.position(latitude=math.nan)), UNKNOWN),
        (heard(known.position(latitude=90.0)), UNKNOWN),
    ],
    ids=["never", "old", "later", "late", "young", "nan", "inf", "no place", "pole"],
)
def test_what_is_not_known_is_null_and_the_card_goes_out(
    telemetry: AircraftState | None, missing: set[str]
) -> None:
    told = json.loads(pack(card(telemetry))[1:])
    assert {name for name in NOTHING if told[name] in (None, "")} == missing
    of_mission = json.loads(pack(mission(telemetry))[1:])
    assert (of_mission["distance_m"] is None) is bool(missing)


@pytest.mark.parametrize(("charge", "told"), [(0, 0), (100, 100), (101, None), (255, None)])
def test_a_charge_above_a_hundred_is_none(charge: int, told: int | None) -> None:
    assert card(heard(Battery(charge))).battery_percent == told


def test_below_the_ground_is_negative_and_what_nobody_knows_is_null() -> None:
    told = card(heard(known.position(height=-1.75)))
    assert told.height_m == -1.75
    of_mission = mission(heard(known.position(height=-1.75)), mission_index=-1, mission_status=-1)
    assert (of_mission.height_m, of_mission.index, of_mission.status) == (-1.75, None, None)


# -- payloads -------------------------------------------------------------------------------------


@pytest.mark.parametrize("firmware", ["1.0", "2.3", "3.1"])
def test_telemetry_is_version_kind_time_profile_and_the_package(firmware: str) -> None:
    value = known.package(firmware)
    head = b"\x04\x02" + struct.pack("<dB", 40.25, 3) + firmware.encode()
    assert pack(Telemetry(value, firmware, 40.25)) == head + value
    assert unpack_message(head + value) == Telemetry(value, firmware, 40.25)


def test_an_event_has_its_fields() -> None:
    payload = pack(Event(7, 12.5, "info", "taken off"))
    assert payload[:1] == b"\x04"
    told = {"kind": "Event", "number": 7, "at": 12.5, "level": "info", "text": "taken off"}
    assert json.loads(payload[1:]) == told | {"topic": ""}


SETPOINT = Setpoint(
    ControlMode(Horizontal.VELOCITY, Vertical.VELOCITY, Yaw.RATE),
    *(1.25, -2.5, 0.75, -30.0),
    ReferenceFrame.GROUND,
    stable=False,
)


def test_a_setpoint_is_proved_and_packed_as_the_page_says() -> None:
    """Control flag by DJI's document: 0x40 velocities, 0x08 a yaw rate, and ground frame."""
    flag = 0x48
    data = b"\x01" + struct.pack("<BQddB4d", 1, 17, 40.25, 0.4, flag, 1.25, -2.5, 0.75, -30.0)
    assert len(data) == 59
    proof = hmac.new(b"5e" * 32, data, hashlib.sha256).digest()[:16]
    steer = Steer(17, 40.25, 0.4, SETPOINT)
    token = "5e" * 32
    assert pack_steer(steer, token, begins=True) == b"\x04" + proof + data
    assert unpack_steer(b"\x04" + proof + data, {17: token}.get) == (steer, True)
    assert unpack_steer(b"\x04" + proof + data, {18: token}.get) is None
    assert unpack_steer(b"\x04" + bytes(16) + data, {17: token}.get) is None
    assert unpack_steer(b"\x04" + proof + data, {17: "5f" * 32}.get) is None


ORDER = OrderMessage(
    *(
        "0b" * 16,
        "field",
        "kite",
        "anna",
        17,
        1_795_420_802.25,
        TakeOff(),
        83.25,
        "5c0f8b1e",
        "anna",
    ),
    key=bytes(range(32)),
    since=80.5,
)
DOCUMENT = (
    '{"id":"' + "0b" * 16 + '","site":"field","aircraft":"kite","by":"anna","fence":17,'
    '"at":1795420802.25,"order":{"kind":"TakeOff"},"clock":83.25,"boot":"5c0f8b1e","signer":"anna",'
    '"key":"AAECAwQFBgcICQoLDA0ODxAREhMUFRYXGBkaGxwdHh8=","since":80.5}'
).encode()


def test_an_order_is_what_the_page_says() -> None:
    assert pack(ORDER) == b"\x04" + bytes(64) + bytes(16) + DOCUMENT
    assert ORDER.digest == hashlib.sha256(DOCUMENT).digest()[:16]
    proof = hmac.new(b"secret", DOCUMENT, hashlib.sha256).digest()[:16]
    payload = pack(ORDER.under("secret"))
    assert payload == b"\x04" + bytes(64) + proof + DOCUMENT
    assert unpack(OrderMessage, payload) == ORDER.under("secret")
    assert unpack(OrderMessage, payload).proves("secret")
    assert not ORDER.under("secret").proves("another")
    for name, value in (("fence", 18), ("at", 1.0), ("clock", 1.0), ("aircraft", "crow")):
        changed: Any = {name: value}
        assert not dataclasses.replace(ORDER.under("secret"), **changed).proves("secret")


def test_a_reply_is_what_the_page_says() -> None:
    fault = RemoteError("GuardRefused", "too low", "the floor", "climb")
    reply = OrderReply(
        *("0b" * 16, "kite", "5c0f8b1e", Progress.DONE, Outcome.REFUSED, fault, "words", 4),
        *("offer", b"key", 83.25, True, ORDER.digest),
        show=ShowCard(ShowStage.READY, "ab", 0.25, ""),
    )
    assert json.loads(pack(reply)[1:]) == {
        **{"id": "0b" * 16, "name": "kite", "boot": "5c0f8b1e", "progress": "done"},
        "outcome": "refused",
        "fault": {
            **{"kind": "GuardRefused", "seen": "too low", "cause": "the floor"},
            **{"remedy": "climb", "details": {}},
        },
        **{"text": "words", "number": 4, "offer": "offer", "key": "a2V5", "clock": 83.25},
        **{"is_repeated": True, "order": base64.b64encode(ORDER.digest).decode()},
        "show": {"stage": "ready", "digest": "ab", "farthest_m": 0.25, "why": ""},
    }


# -- what a pilot sees ----------------------------------------------------------------------------


def printed(table: Any) -> list[list[str]]:
    console = Console(width=200, record=True, file=io.StringIO())
    console.print(table)
    lines = console.export_text().splitlines()
    return [[cell.strip() for cell in line.split("  ") if cell.strip()] for line in lines]


def test_the_list_of_the_fleet(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time, "time", lambda: AT)  # else its clock is told to be behind
    rows = printed(fleet_verbs._table(["kite"], {"kite": card(heard(), task="going home")}))
    assert rows == [
        ["name", "link", "phase", "height", "battery", "flies", "control", "when lost"],
        [
            *("kite", "connected", "in air", "12.3 m", "63 %", "going home", "tower"),
            "land after 7.5 s",
        ],
    ]


async def test_an_operator_hears_the_values_that_were_sent() -> None:
    network = MemoryNetwork(seed=5)
    ground, board = network.session(), network.session()
    keys = Keys("field", "kite")
    fleet: Any = SimpleNamespace(present={"kite"})
    hears = FleetTelemetry(ground, Keys("field", "*"), full=True)
    outlet = board.publish(keys.telemetry)
    await anyio.sleep(0.1)
    outlet.put(pack(Telemetry(known.package("2.3"), "2.3", 7.0)))
    await anyio.sleep(1.5)
    told = fleet_verbs._facts(fleet, hears, "kite")
    assert (told["name"], told["is_there"], told["received"]) == ("kite", True, 1)
    assert told["age"] == pytest.approx(1.5, abs=0.1)
    assert told["velocity"] == {
        "north_m_s": pytest.approx(3.21),
        "east_m_s": pytest.approx(-1.57),
        "up_m_s": pytest.approx(0.84),
        "status": 7,
    }
    assert told["position"] == {
        "latitude_rad": pytest.approx(-0.578113379057, rel=1e-11),
        "longitude_rad": pytest.approx(2.639541150941, rel=1e-11),
        "altitude_m": pytest.approx(87.65),
        "height_m": pytest.approx(12.34),
        "gps_health": 4,
    }
    assert (told["battery"], told["flight_status"]) == ({"percent": 63}, {"status": 3})
    rows = printed(fleet_verbs._wall(fleet, hears))
    assert rows == [
        ["name", "age", "phase", "height", "speed", "battery", "place"],
        ["kite", "1.5 s", "in air", "12.3 m", "3.6 m/s", "63 %", "-33.123457 151.234568"],
    ]
    outlet.put(pack(Telemetry(known.package("2.3", without=[Position]), "2.3", 8.5)))
    await anyio.sleep(0.1)
    assert fleet_verbs._facts(fleet, hears, "kite")["position"] is None, "it was not sent again"
    assert printed(fleet_verbs._wall(fleet, hears))[1][2:] == ["in air", "3.6 m/s", "63 %"]
    outlet.put(b"\x01nonsense")
    await anyio.sleep(0.1)
    assert (hears.unread, hears.received["kite"]) == (1, 2)
    hears.close()


# -- what an operator's program gives, where it arrives --------------------------------------------


async def test_each_option_of_a_fleet_reaches_its_askers(monkeypatch: pytest.MonkeyPatch) -> None:
    made, bus = MagicMock(), MagicMock()
    monkeypatch.setattr(clients, "Asker", made)
    sign, utc = MagicMock(), MagicMock()
    fleet = clients.Fleet(bus, site="field", name="anna", sign=sign, patience=7.5, utc=utc)
    fleet._on_token("m100-live/field/kite/beef", is_there=True)
    fleet.asker("kite")
    fleet.asker("hawk", "console")
    first, second = made.mock_calls
    assert first.args == (bus, Keys("field", "kite"), "anna")
    assert second.args == (bus, Keys("field", "hawk"), "anna: console")
    for one, present in ((first, True), (second, False)):
        options = dict(one.kwargs)
        assert bool(options.pop("sessions")()) is present
        assert options == {"patience": 7.5, "utc": utc, "sign": sign, "unstopped": {}}
    assert first.kwargs["unstopped"] is second.kwargs["unstopped"], "one STOP is of all of them"
    control = MagicMock()
    monkeypatch.setattr(clients, "FleetControl", control)
    aircraft = fleet["kite"]
    aircraft.control(stop="land", take_over=True)
    aircraft.control()
    assert control.mock_calls == [
        call(aircraft.asker, "anna", stop="land", take_over=True),
        call(aircraft.asker, "anna", stop="hover", take_over=False),
    ]


async def test_a_connection_to_a_fleet_has_the_names_and_times_of_its_caller(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    opened, made, sign = MagicMock(), MagicMock(), MagicMock()
    monkeypatch.setattr(clients, "open_fleet", opened)
    monkeypatch.setattr(clients, "Fleet", made)
    given: dict[str, Any] = {"site": "field", "name": "anna", "sign": sign, "patience": 7.5}
    more = {"transport/x": "1"}
    async with clients.connect("tcp/a:1", "tcp/b:2", options=more, **given) as fleet:
        assert fleet is made.return_value.__aenter__.return_value
    opened.assert_called_once_with(
        "client", connect=("tcp/a:1", "tcp/b:2"), options=more, authority=None
    )
    made.assert_called_once_with(opened.return_value.__aenter__.return_value, **given)


@pytest.mark.parametrize("mode", ["client", "router"])
async def test_a_session_of_a_fleet_meets_named_endpoints_alone(
    mode: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = MagicMock()
    monkeypatch.setattr(clients, "open_session", opened)
    is_router = mode == "router"
    own = {"scouting/gossip/enabled": "true", "x": "1"}
    places: dict[str, Any] = {"connect": ("tcp/a:1",), "listen": ("tcp/b:2",)}
    async with clients.open_fleet(mode, **places, options=own, is_patient=is_router) as bus:
        assert bus.session == opened.return_value.__aenter__.return_value.session
    [opening] = opened.call_args.args
    assert opening.options == {
        "mode": f'"{mode}"',
        "connect/endpoints": '["tcp/a:1"]',
        "connect/timeout_ms": "-1" if is_router else "0",
        "connect/exit_on_failure": "false" if is_router else "true",
        "transport/unicast/open_timeout": "2000",
        "listen/endpoints": '["tcp/b:2"]',
        "scouting/multicast/enabled": "false",
        "scouting/gossip/enabled": "true",  # as somebody wants it
        "transport/link/tx/lease": "1200",
        "transport/link/rx/max_message_size": str(LARGEST),
        "transport/link/tx/queue/size/data": "8",
        "x": "1",
    }
    assert (opening.patience_s, opening.is_patient) == (2.0, is_router)
    assert opening.remedies["client"] == (
        "m100link fleet router --listen tcp/a:1, if none runs there; a router with certificates "
        "wants tls/… and --identity"
    )
    assert opening.remedies["router"] == "end the program that has tcp/b:2, or listen elsewhere"


OLD = GuardRefused("too old", guard="order_age")
OUTSIDE = GuardRefused("too far", guard="envelope")
UNSURE = OutcomeUnknown("no answer")


@pytest.mark.parametrize(("trip", "clock"), [(8.0, 1003.5), (4.5, 1000.0), (None, 1000.0)])
@pytest.mark.parametrize(
    ("ends", "asked", "raised"),
    [
        ([None], 1, None),
        ([OLD, None], 2, None),
        ([OLD, OLD, OLD], 3, OLD),
        ([OUTSIDE], 1, OUTSIDE),
        ([OLD, UNSURE], 2, UNSURE),
    ],
)
async def test_a_landing_is_asked_for_again_while_it_is_too_old_and_of_each_that_may_be_it(
    ends: list[Any], asked: int, raised: M100Error | None, trip: float | None, clock: float
) -> None:
    """Made later by what the round trip takes above 4.5 s, but not as it is a step of the first."""
    left = [*ends, *[None] * 20]

    async def answered(*_: Any, **__: Any) -> None:
        asker.doubtful_clocks = [100.0 + number for number in range(9)]
        if (error := left.pop(0)) is not None:
            raise error

    asker: Any = MagicMock(ask=AsyncMock(side_effect=answered))
    asker.its_time.side_effect = lambda _: 1000.0
    asker.its_clock.round_trip = trip
    landing = clients.FleetAircraft(asker, "anna").land()
    if raised is None:
        await landing
    else:
        with pytest.raises(type(raised), match=raised.seen):
            await landing
    each = asker.ask.mock_calls[asked:]
    clocks = [0.0, *[clock] * (asked - 1)]
    assert asker.ask.mock_calls[:asked] == [call(Land(), since=1000.0, clock=one) for one in clocks]
    assert [one.kwargs["clock"] for one in each] == (
        [100.0 + number for number in range(8)] if raised is UNSURE else []
    )
    assert all(one.kwargs["since"] <= one.kwargs["clock"] for one in each)


@pytest.mark.parametrize("error", [NotAllowed("old"), UNSURE])
async def test_a_stop_is_asked_for_by_one_order(error: M100Error) -> None:
    asker: Any = MagicMock(ask=AsyncMock(side_effect=error))
    with pytest.raises(type(error)):
        await clients.FleetAircraft(asker, "anna").stop()
    assert asker.ask.mock_calls == [call(Stop())]


async def test_one_that_answers_and_tells_no_state_is_asked_why(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(clients, "cards", AsyncMock(return_value={}))
    asker: Any = MagicMock(ask=AsyncMock(), keys=Keys("field", "kite"))
    with pytest.raises(OutcomeUnknown, match="kite answers, but does not say where it stands"):
        await clients.FleetAircraft(asker, "anna").card()
    assert set(map(str, asker.ask.mock_calls)) == {str(call(AskVersion()))}


async def test_one_is_gone_when_its_last_session_is() -> None:
    fleet = clients.Fleet(MagicMock(), site="field")
    told: list[Any] = []

    async def listen() -> None:
        async for change in fleet.changes():
            told.append((change.name, change.is_there))

    live = "m100-live/field/kite/"
    fleet._on_token(f"{live}a", is_there=True)
    task = asyncio.create_task(listen())
    await asyncio.sleep(0.0)
    fleet._on_token(f"{live}b", is_there=True)  # it is there already
    fleet._on_token(f"{live}a", is_there=False)
    assert fleet.present == {"kite"}
    fleet._on_token(f"{live}b", is_there=False)
    await asyncio.sleep(0.0)
    assert told == [("kite", True), ("kite", False)]
    assert fleet.present == frozenset()
    task.cancel()


def test_each_limit_is_as_agreed() -> None:
    assert limits.differences("apps/fleet") == []
