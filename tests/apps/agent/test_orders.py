"""Orders: what each is beside its fields, and what an agent makes of any values in them."""

from __future__ import annotations

import dataclasses
import importlib.util
import inspect
import random
import re
import types
from collections.abc import Iterator

import anyio
import pytest

from m100link.apps.agent import orders
from m100link.apps.agent.codec import decode, encode
from m100link.apps.agent.messages import Ask, MessageError
from m100link.apps.agent.orders import (
    LIVES,
    ORDERS,
    AfterStop,
    Age,
    Life,
    Needs,
    News,
    Order,
    Right,
    setpoint_of,
)
from m100link.apps.agent.server import agent as handlers
from m100link.errors import GuardRefused, M100Error, UsageError
from m100link.protocol.firmware import FIRMWARE_3_1
from m100link.protocol.setpoint import ReferenceFrame, Setpoint
from tests.apps.agent.conftest import Rig
from tests.apps.agent.examples import EXAMPLES, example

# Needs no lease, needs one if somebody has it; the right to stop, to watch; does not move the
# aircraft, is not kept, may be old, is young if its time is known, is done at once. After a STOP:
# it is done, or done where it is newer. It ends a movement, or gives control back.
BY_HAND = {
    "Stop": "no-lease stop still unkept any-age done ends",
    "Halt": "no-lease stop still unkept any-age at-once done ends",
    "Land": "stop still unkept newer ends",
    "AskVersion": "no-lease watch still unkept any-age done",
    "UploadPlan": "still unkept any-age done",
    "AcquireLease": "no-lease unkept if-known at-once newer",
    "AskTakeOver": "no-lease unkept any-age at-once newer",
    "ConfirmTakeOver": "no-lease unkept at-once newer",
    "RenewLease": "no-lease still unkept at-once done",
    "ReleaseLease": "no-lease still unkept any-age at-once done ends",
    "OrderReplay": "no-lease newer",
    "GoHome": "ends",
    **dict.fromkeys(("Activate", "PointGimbal", "TurnGimbal", "UseCamera"), "if-held newer"),
    **dict.fromkeys(("Obtain", "SendToMobile"), "newer"),
    **dict.fromkeys(
        ("Release", "StopMotors", "StopMission", "PauseMission"), "still unkept done ends"
    ),
}


@pytest.mark.parametrize("kind", ORDERS.values(), ids=ORDERS)
def test_an_order_is_the_most_dangerous_one_unless_it_is_named(kind: type[Order]) -> None:
    """By hand: what nobody thought of needs everything."""
    said = {
        "no-lease": kind.needs is Needs.NOTHING,
        "if-held": kind.needs is Needs.LEASE_IF_HELD,
        "stop": kind.right is Right.STOP,
        "watch": kind.right is Right.WATCH,
        "still": not kind.moves,
        "unkept": not kind.is_kept,
        "any-age": kind.age is Age.ANY,
        "if-known": kind.age is Age.YOUNG_IF_KNOWN,
        "at-once": kind.is_at_once,
        "done": kind.after_stop is AfterStop.DONE,
        "newer": kind.after_stop is AfterStop.IF_NEWER,
        "ends": kind.ends,
    }
    assert {one for one, is_so in said.items() if is_so} == set(
        BY_HAND.get(kind.__name__, "").split()
    )


@pytest.mark.parametrize("kind", ORDERS.values(), ids=ORDERS)
def test_each_field_says_what_it_is_and_in_which_unit(kind: type[Order]) -> None:
    """A number, a text or bytes alone says nothing; a class of its own has units of its own."""
    source = inspect.getsource(kind)
    for one in dataclasses.fields(kind):  # type: ignore[arg-type]  # see examples
        if str(one.type).partition(" ")[0] in ("int", "float", "str", "bytes", "bool"):
            said = re.search(rf"^    {one.name}: .*  #: \S", source, re.MULTILINE)
            assert said, f"{kind.__name__}.{one.name} has no comment with its unit behind #:"


@pytest.mark.parametrize("order", EXAMPLES, ids=lambda one: type(one).__name__)
def test_an_order_goes_over_the_wire_and_shows_no_token(order: Order) -> None:
    assert decode(encode(Ask(1, order))) == Ask(1, order)
    assert getattr(order, "token", "") not in repr(order) or not hasattr(order, "token")


@pytest.mark.parametrize("data", [b"", b"{}", b'{"kind":"Order"}', b'{"kind":"Stop"}'])
def test_what_is_no_message_is_refused(data: bytes) -> None:
    with pytest.raises(MessageError):
        decode(data)


def test_an_order_without_a_row_ends_the_import_with_its_name() -> None:
    class Somersault(Order):
        """Nobody carries it out."""

    spec = importlib.util.spec_from_file_location("handlers_again", handlers.__file__)
    assert spec is not None
    assert spec.loader is not None
    try:
        with pytest.raises(TypeError, match="Somersault"):
            spec.loader.exec_module(importlib.util.module_from_spec(spec))
    finally:
        del ORDERS["Somersault"]


@pytest.mark.parametrize(
    ("body", "data"),
    [
        ({}, {"needs": "lease"}),
        ({}, {"right": 3}),
        ({}, {"moves": 0}),
        ({}, {"age": None}),
        ({"is_kept": 0}, {}),
        ({"__annotations__": {"age": "float"}}, {}),
        ({"__annotations__": {"moves": "bool"}, "moves": True}, {}),
        ({"__annotations__": {"label": "str"}}, {}),
        ({"__annotations__": {"kind": "str"}}, {}),
        ({}, {"lease": False}),
    ],
)
def test_what_is_said_of_an_order_in_a_way_that_nobody_reads_ends_the_import(
    body: dict[str, object], data: dict[str, object]
) -> None:
    """A text is no need of a lease, and a field of that name would be the sender's to fill in."""
    with pytest.raises(TypeError, match="Odd"):
        types.new_class("Odd", (Order,), data, lambda space: space.update(body))
    assert "Odd" not in ORDERS


def drawn(order: Order, chance: random.Random) -> Iterator[Order]:
    """The order with any values that a wire may bring in its fields."""
    odd = (0, -1, 3, 255, 1 << 40, 0.0, -1e300, 1e300, 1e-9, "", "ü" * 99, b"", b"\xff" * 101)
    for _ in range(12):
        values = {}
        for one in dataclasses.fields(order):  # type: ignore[arg-type]  # see examples
            value = getattr(order, one.name)
            fits = [other for other in odd if type(other) is type(value)]
            if dataclasses.is_dataclass(value) and not isinstance(value, type):
                changed = chance.choice(dataclasses.fields(value)).name
                number = chance.choice([other for other in odd if isinstance(other, int | float)])
                value = dataclasses.replace(value, **{changed: number})
            values[one.name] = chance.choice(fits) if fits else value
        yield dataclasses.replace(order, **values)  # type: ignore[type-var]


@pytest.mark.anyio
@pytest.mark.parametrize("seed", range(3))
async def test_whatever_is_in_an_order_it_is_done_or_refused_by_a_typed_error(seed: int) -> None:
    chance = random.Random(seed)
    refused, ends = 0, (orders.Stop, orders.Release, orders.ReleaseLease, orders.ConfirmTakeOver)
    async with Rig(firmware="3.1").running() as rig:
        await rig.agent.ask(orders.Obtain(), rig.token)
        for kind in [one for one in ORDERS.values() if one not in ends]:
            for order in drawn(example(kind), chance):
                with anyio.move_on_after(0.02):
                    try:
                        asked = decode(encode(Ask(1, order)))
                        assert isinstance(asked, Ask)
                        await rig.agent.ask(asked.order, rig.token)
                    except M100Error:
                        refused += 1
    assert refused > 50


def test_the_four_numbers_of_a_request_are_those_of_djis_node() -> None:
    """``/sdk_request_ctrl``: the first movement value is y, the second x; z turns, w climbs."""
    assert setpoint_of(1, x=-5.0, y=3.0, z=20.0, w=0.5) == Setpoint.tilt(
        roll_deg=3.0, pitch_deg=-5.0, up=0.5, yaw_rate_deg_s=20.0, frame=ReferenceFrame.BODY
    )
    assert setpoint_of(2, x=-5.0, y=3.0, z=20.0, w=0.5) == Setpoint.velocity(
        north=3.0, east=-5.0, up=0.5, yaw_rate_deg_s=20.0
    )
    # Control flags of the document: 0x0A is key 8, mode 2; 0x48 is key 9, mode 4.
    assert setpoint_of(1, 0.0, 0.0, 0.0, 0.0).control_flag(FIRMWARE_3_1) == 0x0A
    assert setpoint_of(2, 0.0, 0.0, 0.0, 0.0).control_flag(FIRMWARE_3_1) == 0x48
    with pytest.raises(UsageError, match="no control mode 3") as caught:
        setpoint_of(3, 0.0, 0.0, 0.0, 0.0)
    assert caught.value.remedy == "1 is angles, 2 is velocities"


@pytest.mark.parametrize(
    ("order", "asked_at", "is_refused"),
    [
        (orders.TakeOff(), 4.9, True),
        (orders.TakeOff(), 5.0, True),  # in the same moment: the aircraft stays where it is
        (orders.TakeOff(), 5.1, False),
        (orders.Land(), 4.9, True),
        (orders.Halt(), 4.9, False),  # ends a flight itself
        (orders.Stop(), 4.9, False),
    ],
)
def test_an_order_that_was_asked_for_before_a_stop_is_refused(
    order: Order, asked_at: float, is_refused: bool
) -> None:
    if not is_refused:
        orders.require_newer(order, asked_at, 5.0)
        return
    with pytest.raises(GuardRefused) as caught:
        orders.require_newer(order, asked_at, 5.0, "the computer was suspended")
    assert caught.value.guard == "stopped"
    assert caught.value.seen == (
        f"the computer was suspended after {order.label} was asked for; nothing was sent"
    )
    assert caught.value.remedy == "look at the aircraft, and ask anew"


# -- the life of an order --------------------------------------------------------------------------

# By hand: before, then what becomes of it by each news in the order of the columns.
LIVES_BY_HAND = """
          taken     left  seen   unseen    silence  done  failed
sent      accepted  -     -      -         -        done  refused
accepted  -         sent  flown  -         old      done  ended
flown     -         sent  -      accepted  old      done  ended
old       accepted  sent  -      -         -        done  ended
refused   -         -     -      -         -        -     -
done      -         -     -      -         -        -     -
ended     -         -     -      -         -        -     -
"""


def test_each_news_of_each_life_of_an_order() -> None:
    heads, *rows = [line.split() for line in LIVES_BY_HAND.strip().splitlines()]
    assert heads == [news.value for news in News]
    assert [row[0] for row in rows] == [life.value for life in Life]
    for before, *afters in rows:
        for news, after in zip(News, afters, strict=True):
            found = LIVES[Life(before)].get(news)
            assert (found.value if found else "-") == after, (before, news)


def test_nothing_is_flown_that_nobody_accepted_and_no_end_is_followed_by_anything() -> None:
    for life, row in LIVES.items():
        assert [news for news, after in row.items() if after is Life.FLOWN] == (
            [News.SEEN] if life is Life.ACCEPTED else []
        )
        is_end = life in (Life.REFUSED, Life.DONE, Life.ENDED)
        assert (not row) is is_end
