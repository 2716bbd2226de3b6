"""Silence is no answer: orders through a network that loses, repeats, delays and reorders."""

from __future__ import annotations

import asyncio
import math
import random
from collections import Counter
from contextlib import AsyncExitStack
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast
from unittest.mock import AsyncMock

import anyio
import pytest

from m100link.apps.agent import orders
from m100link.apps.agent.latency import ClockEstimate
from m100link.apps.agent.lease import Lease
from m100link.apps.agent.messages import MessageError, RemoteError
from m100link.apps.bus.network import Bus, QueryAnswer, Question
from m100link.apps.fleet.asking import (
    Asker,
    Questions,
    _raised,
    believed,
    clocks_of,
)
from m100link.apps.fleet.client import Fleet, open_fleet
from m100link.apps.fleet.keys import Keys
from m100link.apps.fleet.payloads import (
    OrderMessage,
    OrderReply,
    Outcome,
    Progress,
    outcome_of,
    pack,
    unpack,
)
from m100link.errors import (
    GuardRefused,
    M100Error,
    NotAllowed,
    OutcomeUnknown,
    StaleLease,
    Unreachable,
    UsageError,
)
from tests.apps.bus.memory import MemoryBus, MemoryNetwork, Weather
from tests.apps.bus.pair import free_place, until
from tests.apps.fleet.conftest import SITE, Rig, with_camera

pytestmark = pytest.mark.anyio

NOT_DONE = (Outcome.REFUSED, Outcome.STALE_LEASE, Outcome.NOT_ALLOWED, Outcome.UNREACHABLE)


async def asked(one: Asker, message: orders.Order, lease: Lease) -> Outcome:
    try:
        await one.ask(message, fence=lease.number, token=lease.token)
    except M100Error as error:
        return outcome_of(error)
    return Outcome.OK


@pytest.mark.parametrize("seed", range(2))
async def test_at_most_once_and_never_a_false_ok(rig: Rig, seed: int) -> None:
    """Forty orders; the aircraft itself counts what was done."""
    one, pilot = await rig.aircraft("a1", virtual=with_camera()), await rig.pilot(patience=2.0)
    await one.agent.ask(orders.Activate())
    camera, outcomes, wrong = one.aircraft.vehicle.camera, Counter[Outcome](), []
    asker = pilot["a1"].asker
    rig.network.seed(seed)
    for _ in range(40):
        rig.network.weather = Weather()
        await anyio.sleep(4.0)  # what was late has come, the camera is ready, the lease has ended
        lease, _ = await asker.take_lease(asker.lease_request())
        before = camera.photos
        rig.network.weather = Weather(loss=0.2, repeat=0.3, delay_s=0.01, jitter_s=0.3)
        outcome = await asked(asker, orders.UseCamera(orders.CameraUse.PHOTO), lease)
        rig.network.weather = Weather()
        await anyio.sleep(2.0)
        done = camera.photos - before
        outcomes[outcome] += 1
        is_lie = (outcome is Outcome.OK) > done or (done and outcome in NOT_DONE)
        if done > 1 or is_lie:
            wrong.append((outcome, done))
    assert wrong == [], f"seed {seed}"
    assert outcomes[Outcome.OK] > 25, f"seed {seed}: {outcomes}"


async def test_a_way_that_is_cut_is_unknown_and_what_is_not_there_unreachable(rig: Rig) -> None:
    one, pilot = await rig.aircraft("a1"), await rig.pilot()
    rig.network.cut(one.bus)
    began = anyio.current_time()
    with pytest.raises(OutcomeUnknown):
        await pilot["a1"].stop()
    assert 10.0 <= anyio.current_time() - began < 11.0
    await anyio.sleep(2.0)
    with pytest.raises(Unreachable):
        await pilot["a1"].stop()


async def test_an_outcome_is_found_again_when_the_way_is_whole_again(rig: Rig) -> None:
    one, pilot = await rig.aircraft("a1"), await rig.pilot()

    async def cut() -> None:
        await anyio.sleep(3.5)  # in the middle of the take-off
        rig.network.cut(one.bus)
        await anyio.sleep(1.0)
        rig.network.join(one.bus)

    async with anyio.create_task_group() as group:
        group.start_soon(cut)
        await pilot["a1"].take_off()
    assert one.height > 1.0


class OnlyStatus:
    """A router whose rules let one ask what became of an order, and give none."""

    def __init__(self, bus: MemoryBus) -> None:
        self._bus = bus

    async def ask(self, key: str, payload: bytes = b"", *, timeout: float) -> list[QueryAnswer]:
        if "/status/" in key:
            return await self._bus.ask(key, payload, timeout=timeout)
        return []

    async def tokens(self, pattern: str, *, timeout: float) -> list[str]:
        return await self._bus.tokens(pattern, timeout=timeout)


async def test_an_order_that_never_arrives_is_not_sent_for_ever(rig: Rig) -> None:
    await rig.aircraft("a1")
    bus = cast(Bus, OnlyStatus(rig.network.session()))
    asker = Asker(bus, Keys(SITE, "a1"), "pilot", patience=3.0)
    began = anyio.current_time()
    with pytest.raises(OutcomeUnknown, match="has not heard of the order"):
        await asker.take_lease(asker.lease_request())
    assert 3.0 <= anyio.current_time() - began < 6.0


async def test_an_answer_that_cannot_be_read_is_no_refusal(rig: Rig) -> None:
    """The one who gives it may have done what was asked, as here."""
    one, pilot = await rig.aircraft("a1", virtual=with_camera()), await rig.pilot()
    await one.agent.ask(orders.Activate())
    asker = pilot["a1"].asker
    lease, _ = await asker.take_lease(asker.lease_request())
    other = rig.network.session()
    other.serve("m100/*/a1/cmd", lambda question: question.answer("m100/x/a1/cmd", b"\x09{}"))
    photo = orders.UseCamera(orders.CameraUse.PHOTO)
    assert await asked(pilot["a1"].asker, photo, lease) is Outcome.OK, "one of two can be read"
    for outlet in list(rig.network.takers("serve", "m100/*/a1/cmd")):
        if outlet.session is one.bus:
            outlet.close()
    assert await asked(pilot["a1"].asker, photo, lease) is Outcome.UNKNOWN, "nothing else came"


async def test_a_take_off_that_is_broken_off_is_unknown_to_who_asked(rig: Rig) -> None:
    one, pilot, other = await rig.aircraft("a1"), await rig.pilot(), await rig.pilot("other")
    results: list[Outcome] = []

    async def take_off() -> None:
        results.append((await pilot.each(lambda a: a.take_off(), ["a1"]))["a1"].outcome)

    async with anyio.create_task_group() as group:
        group.start_soon(take_off)
        await rig.until(lambda: one.height > 0.3)
        assert (await other.stop())["a1"].is_ok
    assert results == [Outcome.UNKNOWN], "it is in the air"
    assert one.height > 0.3


async def test_an_order_is_as_old_as_the_slowest_clock_would_have_it(rig: Rig) -> None:
    """Two clocks part by 100 µs in a second at most; no order is made younger than it is."""
    asker = Asker(rig.network.session(), Keys(SITE, "a1"), "pilot")
    assert asker.lease_request().order.clock == 0.0, "it never answered"
    now = anyio.current_time()
    assert asker.its_clock.heard(now, 500.0, now)
    await anyio.sleep(1000.0)
    assert asker.lease_request().order.clock == pytest.approx(1499.9, abs=0.001)


class Forgetful:
    """An agent whose answers come in any order, late or never, and that may be started anew.

    Nothing outlives it, as if somebody had emptied its order log.
    """

    def __init__(self, seed: int, forgets_after: float) -> None:
        self.chance = random.Random(seed)
        self.begun: list[float] = []  # when the order was carried out
        self.heard: dict[str, tuple[OrderMessage, float]] = {}  # by id: until when it runs
        self.forgets_at = anyio.current_time() + forgets_after
        self.has_told = False  # that it has begun, in an answer that came
        self.sent_after_told = 0  # how often the order was sent all the same

    async def tokens(self, pattern: str, *, timeout: float) -> list[str]:
        return [Keys(SITE, "a1").live_by("a")]

    async def ask(self, key: str, payload: bytes = b"", *, timeout: float) -> list[QueryAnswer]:
        # A message sent when nothing was heard yet may arrive whenever it likes.
        self.sent_after_told += bool(payload) and self.has_told
        try:
            async with asyncio.timeout(timeout):
                await self._travel()
                reply = self._answer(key, payload)
                await self._travel()
        except TimeoutError:
            return []
        self.has_told = self.has_told or reply.progress is not Progress.NEVER
        return [QueryAnswer(key, pack(reply), "a")]

    async def _travel(self) -> None:
        is_lost = self.chance.random() < 0.15
        await asyncio.sleep(60.0 if is_lost else self.chance.choice((0.01, 0.2, 3.0)))

    def _answer(self, key: str, payload: bytes) -> OrderReply:
        now = anyio.current_time()
        if now >= self.forgets_at:
            self.heard, self.forgets_at = {}, math.inf
        if payload:
            order: OrderMessage = unpack(OrderMessage, payload)
            if order.id not in self.heard:
                self.heard[order.id] = order, now + self.chance.uniform(0.0, 6.0)
                self.begun.append(now)
        identity = key.rpartition("/")[2] if "/status/" in key else order.id
        if identity not in self.heard:
            return OrderReply(identity, "a1", "boot", Progress.NEVER)
        order, until = self.heard[identity]
        progress = Progress.RUNNING if now < until else Progress.DONE
        return OrderReply(identity, "a1", "boot", progress, Outcome.OK, order=order.digest)


@pytest.mark.parametrize("seed", range(60))
async def test_what_has_begun_is_not_sent_again_to_an_agent_that_forgot_it(seed: int) -> None:
    agent = Forgetful(seed, math.inf if seed % 2 else random.Random(seed).uniform(0.0, 10.0))
    asker = Asker(cast(Bus, agent), Keys(SITE, "a1"), "pilot", patience=8.0)
    try:
        reply = await asker.ask(orders.TakeOff())
    except OutcomeUnknown:
        pass  # nobody knows: it may have begun, or never arrived
    else:
        assert (reply.progress, bool(agent.begun)) == (Progress.DONE, True)
    assert agent.sent_after_told == 0
    if seed % 2:
        assert len(agent.begun) <= 1


# -- whose answer is believed: as a table, and over zenoh itself -----------------------------------


KEYS = Keys("field", "a1")
OK = OrderReply("id", "a1", "boot", Progress.DONE, Outcome.OK, clock=5.0)
REFUSED = replace(OK, outcome=Outcome.REFUSED)


def answer(reply: OrderReply | bytes, session: str = "a") -> QueryAnswer:
    payload = reply if isinstance(reply, bytes) else pack(reply)
    return QueryAnswer(KEYS.command, payload, session)


@pytest.mark.parametrize(
    ("answers", "sessions", "expected"),
    [
        ([], "a", None),
        ([answer(OK)], "a", OK),
        ([answer(OK, "b")], "a", None),
        ([answer(OK, "")], "a", None),
        ([answer(OK)], "", None),
        ([answer(REFUSED, "b"), answer(OK)], "a", OK),
        ([answer(OK), answer(OK)], "a", OK),
        ([answer(OK), answer(replace(OK, clock=6.0, is_repeated=True))], "a", OK),
        ([answer(OK), answer(REFUSED)], "a", OutcomeUnknown),
        ([answer(REFUSED), answer(OK)], "a", OutcomeUnknown),
        ([answer(OK), answer(replace(OK, progress=Progress.RUNNING))], "a", OutcomeUnknown),
        ([answer(OK), answer(replace(OK, number=3))], "a", OutcomeUnknown),
        ([answer(OK), answer(replace(OK, key=b"k" * 32))], "a", OutcomeUnknown),
        ([answer(OK), answer(replace(OK, boot="other"))], "a", OutcomeUnknown),
        ([answer(replace(OK, order=b"digest"))], "a", replace(OK, order=b"digest")),
        ([answer(replace(OK, order=b"others"))], "a", OutcomeUnknown),
        ([answer(OK), answer(replace(OK, order=b"digest"))], "a", OutcomeUnknown),
        ([answer(OK)], "ab", OutcomeUnknown),
        ([answer(OK, "b")], "ab", OutcomeUnknown),
        ([], "ab", None),
        ([answer(b"junk")], "a", MessageError),
        ([answer(b"junk", "b")], "a", None),
        ([answer(b"junk"), answer(OK)], "a", OK),
        ([answer(replace(OK, id="other"))], "a", None),
        ([answer(replace(OK, id=""))], "a", replace(OK, id="")),
        ([answer(replace(OK, name="a2"))], "a", None),
    ],
)
def test_believed_is_one_word_of_the_session_that_shows_the_token(
    answers: list[QueryAnswer], sessions: str, expected: OrderReply | type[Exception] | None
) -> None:
    if expected is OutcomeUnknown:
        with pytest.raises(OutcomeUnknown):
            believed(answers, KEYS, "id", set(sessions), b"digest")
    elif expected is MessageError:
        assert isinstance(believed(answers, KEYS, "id", set(sessions), b"digest"), MessageError)
    else:
        assert believed(answers, KEYS, "id", set(sessions), b"digest") == expected


def test_the_times_of_all_that_answer_are_known_for_a_landing() -> None:
    others = replace(OK, clock=9.0), replace(OK, name="a2", clock=1.0)
    came = [answer(OK), answer(others[0], "b"), answer(others[1]), answer(b"junk")]
    assert clocks_of(came, "a1") == [5.0, 9.0]


class Voice:
    """Somebody behind the router who answers orders to a1."""

    def __init__(self, bus: Bus, outcome: Outcome) -> None:
        self.bus, self.outcome, self.heard = bus, outcome, 0
        bus.serve(KEYS.command, self._answer)

    def _answer(self, question: Question) -> None:
        self.heard += 1
        order: OrderMessage = unpack(OrderMessage, question.payload)
        told = OrderReply(order.id, "a1", "boot", Progress.DONE, self.outcome, clock=1.0)
        question.answer(KEYS.command, pack(told))


@pytest.mark.pty
@pytest.mark.anyio
@pytest.mark.parametrize("anyio_backend", ["asyncio"])
async def test_over_zenoh_a_strangers_word_is_no_outcome(anyio_backend: str) -> None:
    """The session of an answer is known over two routers as well."""
    pytest.importorskip("zenoh", reason="the extra fleet is not installed")
    places = free_place(), free_place()
    async with AsyncExitStack() as stack:
        await stack.enter_async_context(open_fleet("router", listen=places[:1]))
        await stack.enter_async_context(open_fleet("router", listen=places[1:], connect=places[:1]))
        on_board, far, near, here = [
            await stack.enter_async_context(open_fleet("client", connect=(place,)))
            for place in (places[0], places[1], places[0], places[1])
        ]
        agent = Voice(on_board, Outcome.REFUSED)
        token = on_board.declare(KEYS.live_by(on_board.session))
        strangers = [Voice(bus, Outcome.OK) for bus in (far, near)]
        fleet = await stack.enter_async_context(Fleet(here, site="field", patience=3.0))
        await until(lambda: "a1" in fleet.present)

        async def asked() -> Outcome:
            return (await fleet.each(lambda one: one.asker.ask(orders.Stop()), ["a1"]))[
                "a1"
            ].outcome

        assert await asked() is Outcome.REFUSED
        assert agent.heard
        assert all(one.heard for one in strangers)
        held = far.declare(KEYS.live_by(far.session))
        await until(lambda: len(fleet._present["a1"]) == 2)
        assert await asked() is Outcome.UNKNOWN
        held.close()
        await until(lambda: len(fleet._present["a1"]) == 1)
        assert await asked() is Outcome.REFUSED
        token.close()
        await until(lambda: "a1" not in fleet.present)
        assert await asked() is Outcome.UNREACHABLE


# -- several questions that are open at once -------------------------------------------------------


KEY = "m100/field/a1/state"


class Road:
    """A way of so many seconds to somebody who answers."""

    def __init__(self, way: float) -> None:
        network = MemoryNetwork(weather=Weather(delay_s=way))
        self.here, self.there = network.session(), network.session()
        self.heard: list[Question] = []
        self._held = self.there.serve(KEY, self._take)
        self.is_silent = False

    def _take(self, question: Question) -> None:
        self.heard.append(question)
        if not self.is_silent:
            question.answer(KEY, b"%d" % len(self.heard))

    def leave(self) -> None:
        self._held.close()


async def test_an_answer_that_comes_after_the_next_question_is_one() -> None:
    road = Road(1.0)
    async with Questions(road.here) as questions:
        first = questions.ask(KEY, within=10.0)
        assert await questions.answered(questions.left) is None
        second = questions.ask(KEY, within=10.0)
        assert questions.left == pytest.approx(1.5)
        ended = [await questions.answered(10.0), await questions.answered(10.0)]
    assert [(one[0], one[1][0].payload) for one in ended if one] == [(first, b"1"), (second, b"2")]
    assert anyio.current_time() == pytest.approx(3.5)


async def test_it_is_due_at_once_when_nobody_is_there() -> None:
    road = Road(0.0)
    road.leave()
    async with Questions(road.here) as questions:
        assert questions.is_due, "nothing was asked"
        number = questions.ask(KEY, within=10.0)
        assert await questions.answered(10.0) == (number, [])
        assert questions.is_due
        assert await questions.answered(10.0) is None, "none is open"


async def test_each_waits_for_longer_until_the_newest_is_answered() -> None:
    """Of two that serve a key one hangs: the other's answer is seen when the wait is over."""
    road = Road(0.0)
    road.there.serve(KEY, lambda question: None)
    waits = []
    async with Questions(road.here) as questions:
        for is_silent in (True, True, False, False):
            road.is_silent = is_silent
            began = anyio.current_time()
            questions.ask(KEY, within=60.0)
            await questions.answered(60.0)
            waits.append(anyio.current_time() - began)
    assert waits == pytest.approx([3.0, 6.0, 12.0, 3.0])


@pytest.mark.parametrize(("answered", "third_s"), [(1, 12.0), (2, 3.0)])
async def test_an_answer_to_an_older_question_shortens_no_wait(
    answered: int, third_s: float
) -> None:
    """Waits are 3 s, 6 s, 12 s and so on, until the newest question is answered."""
    waits: list[float] = []
    answer = QueryAnswer(KEY, b"")

    class Old:
        async def ask(self, _key: str, _payload: bytes, *, timeout: float) -> list[QueryAnswer]:
            waits.append(timeout)
            if len(waits) != answered:
                await anyio.sleep(timeout)
            return [answer]

    async with Questions(cast(Bus, Old())) as questions:
        for _ in range(2):
            questions.ask(KEY, within=60.0)
        assert await questions.answered(1.0) == (answered, [answer])
        questions.ask(KEY, within=60.0)
        await anyio.sleep(0.01)
    assert waits == [3.0, 6.0, third_s]


async def test_none_waits_for_longer_than_it_is_of_use() -> None:
    road = Road(5.0)
    async with Questions(road.here) as questions:
        number = questions.ask(KEY, within=0.5)
        assert await questions.answered(10.0) == (number, [])
    assert anyio.current_time() == pytest.approx(0.5)


async def test_a_wait_is_doubled_five_times_at_most() -> None:
    waits: list[float] = []

    class Silent:
        async def ask(self, _key: str, _payload: bytes, *, timeout: float) -> list[QueryAnswer]:
            waits.append(timeout)
            return []

    async with Questions(cast(Bus, Silent())) as questions:
        for _ in range(7):
            questions.ask(KEY, within=1000.0)
            await anyio.sleep(0.01)
    assert waits == [3.0, 6.0, 12.0, 24.0, 48.0, 48.0, 48.0]


# -- what an order says of its time, and what an answer means --------------------------------------


def bare(at_least: float = 83.25, boot: str = "run") -> Asker:
    """An asker without a network, to whom the clock of the agent shows so much at the earliest."""
    bus = cast(Bus, MemoryNetwork().session())
    made = Asker(bus, Keys("field", "a1"), "anna", utc=lambda: 1_800_000_000.5)
    made.its_clock = cast(Any, SimpleNamespace(at_least=lambda _now: at_least))
    made.its_boot = boot
    return made


async def test_an_order_is_stamped_by_both_calendars_and_clocks() -> None:
    made = bare().around(orders.TakeOff(), 7, "secret")
    assert (made.site, made.aircraft, made.by, made.fence) == ("field", "a1", "anna", 7)
    assert (made.at, made.clock, made.since, made.boot) == (1_800_000_000.5, 83.25, 0.0, "run")
    assert made.proves("secret")
    assert len(made.id) == 32
    given = bare().around(orders.Land(), clock=40.5, since=39.25, identity="0b" * 16, key=b"key")
    assert (given.clock, given.since, given.id, given.key) == (40.5, 39.25, "0b" * 16, b"key")


@pytest.mark.parametrize(
    ("ago", "at_least", "its"),
    [
        (0.0, 83.25, 83.25),
        (2.5, 83.25, 80.75),
        (-2.5, 83.25, 83.25),  # a time to come is now
        (-math.inf, 83.25, 83.25),
        (2.5, 0.0, 0.0),  # nobody knows
    ],
)
async def test_a_time_of_ours_is_so_much_earlier_there(
    ago: float, at_least: float, its: float
) -> None:
    asker = bare(at_least)
    assert asker.its_time(anyio.current_time() - ago) == its


@pytest.mark.parametrize(
    ("outcome", "kind"),
    [
        (Outcome.STALE_LEASE, StaleLease),
        (Outcome.NOT_ALLOWED, NotAllowed),
        (Outcome.UNKNOWN, OutcomeUnknown),
        (Outcome.REFUSED, UsageError),
    ],
)
async def test_a_reason_is_raised_as_its_outcome_says(
    outcome: Outcome, kind: type[M100Error]
) -> None:
    fault = RemoteError("UsageError", "it cannot", "the cause", "the remedy")
    answer = OrderReply("", "a1", "run", Progress.DONE, outcome, fault)
    with pytest.raises(kind) as caught:
        _raised(answer)
    assert (caught.value.seen, caught.value.cause) == ("it cannot", "the cause")
    assert caught.value.remedy == "the remedy"
    with pytest.raises(MessageError, match="a1 gave no reason"):
        _raised(replace(answer, outcome=Outcome.REFUSED, fault=None))
    good = replace(answer, outcome=Outcome.OK, fault=None)
    assert _raised(good) is good


@pytest.mark.parametrize(
    ("outcome", "boot", "is_asked_again"),
    [
        (Outcome.NOT_ALLOWED, "", True),  # its answer shows the run, by which an order is fresh
        (Outcome.NOT_ALLOWED, "run", False),
        (Outcome.REFUSED, "", False),
        (Outcome.OK, "", False),
    ],
)
async def test_a_refusal_that_first_shows_the_time_there_is_asked_again(
    outcome: Outcome, boot: str, is_asked_again: bool
) -> None:
    asker, asked = bare(boot=boot), list[str]()

    async def ask(_key: str, payload: bytes, *, timeout: float) -> list[QueryAnswer]:
        assert timeout == 2.5
        made: OrderMessage = unpack(OrderMessage, payload)
        asked.append(made.boot)
        answer = OrderReply(made.id, "a1", "run", Progress.DONE, outcome, order=made.digest)
        return [QueryAnswer("m100/field/a1/show", pack(answer), "beef")]

    async def is_there() -> bool:
        return True

    asker.bus = cast(Any, SimpleNamespace(ask=ask))
    asker.is_there = is_there  # type: ignore[method-assign] # for this test
    asker._known = lambda: {"beef"}
    asker.its_clock = ClockEstimate()
    reply = await asker.once("m100/field/a1/show", orders.AskVersion(), within=2.5)
    assert reply is not None
    assert reply.outcome is outcome
    assert asked == ([boot, "run"] if is_asked_again else [boot])


async def test_nobody_who_is_not_there_is_asked_for_a_lease() -> None:
    one, asked = bare(), AsyncMock()
    one._answered = asked  # type: ignore[method-assign]
    with pytest.raises(Unreachable, match="no agent named a1"):
        await one.take_lease(one.lease_request())
    assert not asked.called


@pytest.mark.parametrize(("guard", "is_stop"), [("stopped", True), ("envelope", False)])
async def test_a_refusal_by_stop_alone_is_heard_as_a_stop(guard: str, *, is_stop: bool) -> None:
    one, told = bare(), list[int]()
    one.hear_of_stop = lambda: told.append(1)  # type: ignore[method-assign]
    fault = RemoteError("GuardRefused", "refused", "", "", {"guard": guard})
    with pytest.raises(GuardRefused):
        one._raised(OrderReply("", "a1", "run", Progress.DONE, Outcome.REFUSED, fault))
    assert bool(told) is is_stop
