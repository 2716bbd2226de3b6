"""Whatever somebody tells under an agent's name: it costs itself alone, and the page goes on."""

from __future__ import annotations

import collections.abc
import dataclasses
import random
import struct
import types
from enum import Enum
from typing import Any, get_args, get_origin, get_type_hints

import anyio
import anyio.lowlevel
import pytest

from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.codec import decode, encode
from m100link.apps.agent.messages import (
    VERSION,
    Activating,
    AuthorityTaken,
    Event,
    Hello,
    LeaseChanged,
    LinkCounted,
    Message,
    MessageError,
    MissionReport,
    PlanChanged,
    State,
    SteerRefused,
    Telemetry,
)
from m100link.apps.agent.transports import memory_channels
from m100link.apps.station.console.view.fly import live
from m100link.apps.station.console.view.situation import Inputs, Ship
from m100link.apps.station.console.view.texts import Language, Text, Translator
from m100link.apps.station.console.view.view_model import Memory, ViewModel, view_of
from m100link.sim.clock import virtual_clock_loop
from tests.known import seen

pytestmark = pytest.mark.anyio

KINDS = (
    *(State, State, State, Event, LinkCounted, LeaseChanged, Activating, AuthorityTaken),
    *(MissionReport, PlanChanged, SteerRefused, Telemetry, Telemetry),
)
FLOATS = (0.0, -1.0, 1e300, -1e300, 1e-300, 1e17, -1e17, 1e9, 12345.6)
INTEGERS = (0, 1, -1, 2, 7, 99, 255, 1 << 31, 1 << 62, -(1 << 63), (1 << 63) - 1)
TEXTS = (
    *("", "x", "\x00", "\u202e", "x" * 4000, "connected", "connecting", "lost", "1.0", "3.1"),
    *("none", "held", "releasing", "take off", "land", "waypoint", "no mission", "info", "error"),
    *("AuthorityLost", "GuardRefused", "LinkError", "M100Error", "NotActivated"),
)
DETAILS = ("seen", "remedy", "reason", "guard", "limit", "error_code", "args", "0.1", "nan", "")
WIDE = {0x0FFF: 124, 0x07FF: 122, 0x00FF: 107}
"""Bytes of a package of firmware 3.1, by its flags."""


@pytest.fixture
def anyio_backend() -> tuple[str, dict[str, Any]]:
    return "asyncio", {"loop_factory": virtual_clock_loop}


def value(chance: random.Random, kind: Any) -> Any:
    """Something of a type, and otherwise what no agent would tell."""
    for plain, several in ((float, FLOATS), (int, INTEGERS), (str, TEXTS), (bool, (True, False))):
        if kind is plain:
            return chance.choice(several)
    if kind is bytes:
        return chance.randbytes(chance.choice((0, 1, 5, 20, 60)))
    if isinstance(kind, types.UnionType):
        return value(chance, chance.choice(get_args(kind)))
    if kind is type(None):
        return None
    if isinstance(kind, type) and issubclass(kind, Enum):
        return chance.choice(list(kind))
    if dataclasses.is_dataclass(kind) and isinstance(kind, type):
        return told(chance, kind)
    if get_origin(kind) is tuple:
        return tuple(value(chance, bytes) for _ in range(chance.randrange(4)))
    assert get_origin(kind) is collections.abc.Mapping, kind
    scalars = (None, True, 1, 1 << 62, 1e300, "x", "link", -5)
    return {one: chance.choice(scalars) for one in chance.sample(DETAILS, chance.randrange(5))}


def told(chance: random.Random, kind: type[Any]) -> Any:
    hints = get_type_hints(kind)
    missing = dataclasses.MISSING
    return kind(
        **{
            field.name: value(chance, hints[field.name])
            for field in dataclasses.fields(kind)
            if field.default is missing is field.default_factory or chance.random() < 0.4
        }
    )


def package(chance: random.Random) -> Telemetry:
    """A package of the right length whose numbers are none."""
    flags, size = chance.choice(list(WIDE.items()))
    filler = chance.choice((b"\xff", b"\x7f", b"\xf0", b""))
    rest = filler * (size - 2) if filler else chance.randbytes(size - 2)
    return Telemetry(struct.pack("<H", flags) + rest, "3.1", chance.choice(FLOATS))


def forged(chance: random.Random) -> Message | None:
    """As it arrives, or nothing where it is refused on its way."""
    kind = chance.choice(KINDS)
    try:
        made: Message = package(chance) if kind is Telemetry else told(chance, kind)
        return decode(encode(made))
    except MessageError:
        return None


def inputs_of(client: AgentClient) -> Inputs:
    ships = tuple(
        Ship(
            name,
            seen(client.telemetry, state=client.state, holder=client.holder),
            name == "a1",
            False,
        )
        for name in ("a1", "a2")
    )
    return Inputs(
        vehicle=seen(
            client.telemetry,
            client.view.now,
            state=client.state,
            holder=client.holder,
        ),
        plan=client.plan,
        events=tuple(client.events),
        link=client.link,
        wall=1.8e9,
        fleet=ships,
    )


def spoken(part: object) -> None:
    """Say all that there is to be said in a view."""
    if isinstance(part, Text):
        for language in Language:
            Translator(language)(part)
    elif dataclasses.is_dataclass(part) and not isinstance(part, type):
        for field in dataclasses.fields(part):
            spoken(getattr(part, field.name))
    elif isinstance(part, dict):
        spoken(tuple(part.values()))
    elif isinstance(part, tuple | frozenset):
        for one in part:
            spoken(one)


def look(client: AgentClient, memory: Memory) -> ViewModel:
    """Everything that a page does with what it knows."""
    view = view_of(inputs_of(client), memory)
    spoken(view)
    for line in view.events:
        line.time(60)
    live(client.view)
    return view


@pytest.mark.parametrize("seed", range(4))
async def test_no_message_ends_the_page(seed: int) -> None:
    chance, read = random.Random(seed), 0
    for _ in range(150):
        ours, its = memory_channels(as_bytes=True)
        its.open(lambda message: None, lambda reason: None)
        async with AgentClient(ours, "front") as client:
            its.send(Hello(VERSION, "agent", 0.0))
            its.send(State(at=0.0, connection="connected", firmware="3.1"))
            await anyio.lowlevel.checkpoint()
            memory = Memory()
            for message in (forged(chance) for _ in range(6)):
                if message is not None:
                    read += 1
                    client._receive(message)
                    look(client, memory)
            its.send(State(at=1.0, connection="connected", firmware="3.1"))
            await anyio.sleep(0.1)
            assert client.state.at == 1.0, "what is true comes in behind it"
            look(client, memory)
    assert read > 250
