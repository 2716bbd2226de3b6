"""Control of one pilot by a clock that stands, of an agent that says what the test says."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Coroutine
from contextlib import asynccontextmanager
from dataclasses import replace
from functools import partial
from typing import Any

import pytest

from m100link.apps.agent import orders
from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.control_session import (
    ControlSession,
    ControlState,
    Terms,
)
from m100link.apps.agent.lease import Lease, LeaseHeld, LeaseRefused, TakeOver
from m100link.apps.agent.messages import (
    Ask,
    AuthorityTaken,
    Event,
    EventTopic,
    JournalNote,
    LeaseChanged,
    OrderOutcome,
    RemoteError,
    Stage,
    State,
    Steer,
    SteerRefused,
)
from m100link.apps.agent.transports import memory_channels
from m100link.errors import (
    AuthorityLost,
    GuardRefused,
    LinkError,
    LossReason,
    M100Error,
    NoAuthority,
    StaleLease,
)
from m100link.protocol.setpoint import Setpoint
from tests.apps.agent.test_control_session import at
from tests.known import KnownAgent

S = ControlState
NORTH = Setpoint.velocity(north=1.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)

pytestmark = pytest.mark.anyio


class Front:
    """One pilot. The agent grants lease 7, and answers what is asked unless it ``is_slow``."""

    def __init__(self, one: ControlSession, client: AgentClient, agent: KnownAgent) -> None:
        self.one, self.client, self.agent = one, client, agent
        self.now = 0.0
        self.states: list[ControlState] = []
        one.on_change = self.states.append

    async def begin(self, work: Coroutine[Any, Any, object]) -> asyncio.Task[object]:
        task = asyncio.create_task(work)
        await asyncio.sleep(0.02)
        return task

    def orders(self) -> list[str]:
        return [type(one.order).__name__ for one in self.agent.heard if isinstance(one, Ask)]

    def answer(self, error: M100Error | None = None) -> None:
        """To the newest question."""
        number = [one.id for one in self.agent.heard if isinstance(one, Ask) and one.id][-1]
        fault = None if error is None else RemoteError.of(error)
        self.agent.tell(OrderOutcome(number, Stage.FAILED if fault else Stage.DONE, fault))

    def taken(self) -> None:
        """The pilot leaves F."""
        self.agent.tell(replace(self.agent.state, has_authority=False))
        error = AuthorityLost("the pilot left F")
        error.reason = LossReason.MODE_SWITCH
        self.agent.tell(AuthorityTaken(RemoteError.of(error)))

    def returned(self) -> None:
        self.agent.tell(replace(self.agent.state, has_authority=True))


@asynccontextmanager
async def front(is_activated: bool = True, **terms: Any) -> AsyncIterator[Front]:
    ours, its = memory_channels()
    state = State(0.0, "connected", firmware="3.1", is_activated=is_activated)
    async with AgentClient(ours, "front") as client:
        found = Front(ControlSession(client, "front", Terms(**terms)), client, KnownAgent(its))
        client._clock = lambda: found.now
        found.agent.tell(state)
        found.agent.heard.clear()
        yield found


EIGHT = Lease("front", "eight", 8)


@pytest.mark.parametrize(
    ("activates", "is_activated", "is_asked"),
    [(True, False, True), (True, True, False), (False, False, False)],
)
async def test_an_aircraft_is_activated_that_is_not_where_the_terms_say_so(
    activates: bool, is_activated: bool, is_asked: bool
) -> None:
    async with front(is_activated, activates=activates) as pilot:
        await pilot.one.obtain()
        middle = [S.ACTIVATING] if is_asked else []
        assert pilot.states == [S.ASKING, S.LEASED, *middle, S.OBTAINING, S.HOLDING]
        asked = ["Activate"] if is_asked else []
        assert pilot.orders() == ["AcquireLease", *asked, "Obtain"]


@pytest.mark.parametrize("during", ["Activate", "Obtain"])
@pytest.mark.parametrize(
    ("end", "is_let_go", "raised"),
    [
        ("done", True, NoAuthority),
        ("refused", True, NoAuthority),
        ("refused", False, GuardRefused),
        ("cancelled", True, asyncio.CancelledError),
        ("cancelled", False, asyncio.CancelledError),
    ],
)
async def test_what_is_let_go_or_fails_goes_back_once_and_asks_for_nothing_more(
    during: str, end: str, is_let_go: bool, raised: type[BaseException]
) -> None:
    async with front(is_activated=False) as pilot:
        pilot.agent.is_slow = True
        asking = await pilot.begin(pilot.one.obtain())
        if during == "Obtain":
            pilot.answer()
            await asyncio.sleep(0.02)
        assert pilot.orders()[-1] == during
        before = pilot.orders()
        if is_let_go:
            pilot.one.let_go()
            assert pilot.orders() == [*before, "ReleaseLease"], "at once"
            assert pilot.states[-2:] == [S.LETTING_GO, S.ABSENT]
        if end == "cancelled":
            asking.cancel()
        else:
            pilot.answer(GuardRefused("too low") if end == "refused" else None)
        await asyncio.sleep(0.02)
        assert pilot.orders() == [*before, "ReleaseLease"]  # or nobody would answer the next one
        with pytest.raises(raised, match="gave control back" if raised is NoAuthority else None):
            await asking
        assert (at(pilot.one), pilot.one.lease) == (S.ABSENT, None)


@pytest.mark.parametrize("is_refused", [False, True])
async def test_what_was_asked_under_an_older_lease_ends_no_newer_one(is_refused: bool) -> None:
    async with front() as pilot:
        pilot.agent.is_slow = True
        asking = await pilot.begin(pilot.one.obtain())
        pilot.agent.tell(LeaseChanged(8, "front"))
        pilot.one.adopt(EIGHT)
        pilot.answer(GuardRefused("too low") if is_refused else None)
        with pytest.raises(NoAuthority, match="gave control back"):
            await asking
        assert (at(pilot.one), pilot.one.lease) == (S.LEASED, EIGHT)
        assert "ReleaseLease" not in pilot.orders()


@pytest.mark.parametrize("answer", [EIGHT, LeaseHeld("another has control"), None])
@pytest.mark.parametrize("is_cancelled", [True, False])
async def test_a_lease_that_comes_when_it_is_wanted_no_more_goes_back(
    answer: Lease | LeaseHeld | None, is_cancelled: bool
) -> None:
    wrong: list[dict[str, Any]] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, context: wrong.append(context))
    coming: asyncio.Future[Lease] = asyncio.get_running_loop().create_future()

    async def grant(_: float) -> Lease:
        return await coming

    async with front() as pilot:
        asking = await pilot.begin(pilot.one.take(grant))
        if is_cancelled:
            asking.cancel()
        else:
            pilot.one.let_go()
        await asyncio.sleep(0.02)
        if isinstance(answer, Lease):
            coming.set_result(answer)
        elif answer is None:
            coming.cancel()  # as the client ends
        else:
            coming.set_exception(answer)
        (ended,) = await asyncio.gather(asking, return_exceptions=True)
        await asyncio.sleep(0.02)
        if isinstance(answer, Lease):
            assert isinstance(ended, asyncio.CancelledError if is_cancelled else NoAuthority)
            released = [one.token for one in pilot.agent.asked(orders.ReleaseLease)]
            assert released == ["eight"]
            pilot.agent.tell(LeaseChanged(8, "front"))  # which is late
            assert not pilot.one.is_others
        else:
            assert pilot.orders() == []
        assert pilot.states == [S.ASKING, *([] if is_cancelled else [S.LETTING_GO]), S.ABSENT]
    assert wrong == []


async def test_a_lease_that_is_held_is_asked_for_again_by_a_question_of_the_callers() -> None:
    async def grant(_: float) -> Lease:
        pilot.agent.tell(LeaseChanged(8, "front"))
        return EIGHT

    async with front() as pilot:
        seven = await pilot.one.take()
        assert await pilot.one.take() is seven
        assert pilot.orders() == ["AcquireLease"]
        assert await pilot.one.take(grant) == EIGHT
        assert pilot.one.lease == EIGHT


@pytest.mark.parametrize("number", [0, 1])
async def test_a_loss_without_a_report_is_seen_by_the_next_message_and_the_next_question(
    number: int,
) -> None:
    """As when the client found another agent."""
    lost = S.TAKEN_OVER if number else S.LOST
    async with front() as pilot:
        await pilot.one.obtain()
        pilot.states.clear()
        pilot.client.holder = LeaseChanged(number, "")
        pilot.returned()
        assert (pilot.one.is_obeyed, pilot.states) == (False, [])
        pilot.now = 9.0
        pilot.one.heard()
        assert pilot.states == [lost]
        assert pilot.orders() == ["AcquireLease", "Obtain"], "what ended is not renewed"
    async with front() as pilot:
        await pilot.one.obtain()
        pilot.states.clear()
        pilot.client.holder = LeaseChanged(number, "")

        async def refuse(_: float) -> Lease:
            raise LeaseHeld("another has control")

        with pytest.raises(LeaseHeld):
            await pilot.one.take(refuse)
        assert pilot.states == [lost, S.ASKING, S.ABSENT]
        pilot.agent.tell(LeaseChanged(7, "front"))
        assert pilot.one.lease is None, "a message does not bring back what was lost"
        with pytest.raises(NoAuthority):
            pilot.one.steer(NORTH)


@pytest.mark.parametrize("refusal", [LeaseRefused("it ended"), StaleLease("it ended")])
@pytest.mark.parametrize(("refusals", "is_had"), [(0, True), (2, True), (3, False)])
async def test_a_lease_that_changes_hands_meanwhile_is_taken_over_in_three_attempts(
    refusal: M100Error, refusals: int, is_had: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    tokens: list[str] = []

    async def held(name: str, _: float) -> Lease:
        raise LeaseHeld("another has control")

    async def offer(name: str, _: float) -> TakeOver:
        return TakeOver(name, "another", f"offer {len(tokens)}", 5, 9.0)

    async def confirm(token: str, _: float) -> Lease:
        tokens.append(token)
        if len(tokens) <= refusals:
            raise refusal
        pilot.agent.tell(LeaseChanged(8, "front"))
        return EIGHT

    async with front() as pilot:
        for name, work in (("acquire", held), ("ask_take_over", offer), ("confirm", confirm)):
            monkeypatch.setattr(pilot.client, name, work)
        with pytest.raises(LeaseHeld):
            await pilot.one.take()
        assert tokens == []
        if is_had:
            assert await pilot.one.take(take_over=True) == EIGHT
        else:
            with pytest.raises(type(refusal), match="it ended"):
                await pilot.one.take(take_over=True)
        assert tokens == [f"offer {number}" for number in range(min(refusals + 1, 3))]


@pytest.mark.parametrize(("seconds", "renewals"), [(0.44, 0), (0.45, 1)])
async def test_a_lease_is_renewed_when_it_is_due(seconds: float, renewals: int) -> None:
    async with front() as pilot:
        await pilot.one.obtain()
        pilot.now = seconds
        pilot.one.heard()
        assert pilot.orders().count("RenewLease") == renewals


async def test_a_pilot_who_is_heard_often_renews_twice_a_second() -> None:
    async with front() as pilot:
        pilot.now = 100.0
        await pilot.one.obtain()
        renewed = []
        for tenth in range(1, 26):
            pilot.now = 100.0 + tenth / 10
            if tenth == 12:
                pilot.returned()
                pilot.one.steer(NORTH)  # which renews it
            before = pilot.orders().count("RenewLease")
            pilot.one.heard()
            if pilot.orders().count("RenewLease") > before:
                renewed.append(tenth)
        assert renewed == [5, 10, 17, 22]


async def test_what_is_kept_is_renewed_each_half_second_and_no_longer_than_the_block() -> None:
    async with front() as pilot:
        pilot.client._clock = asyncio.get_running_loop().time
        await pilot.one.obtain()
        async with pilot.one.kept():
            await asyncio.sleep(2.2)
            assert pilot.orders().count("RenewLease") == 4
        await asyncio.sleep(3.0)
        assert pilot.orders().count("RenewLease") == 4
        keeping = await pilot.begin(pilot.one.keep())
        pilot.one.close()
        await asyncio.sleep(0.6)
        assert keeping.done()


async def test_a_renewal_without_memory_is_not_the_last_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A landing that nobody waits for would be broken off when the lease ends."""
    async with front() as pilot:
        pilot.client._clock = asyncio.get_running_loop().time
        await pilot.one.obtain()
        heard, lacking = pilot.one.heard, [MemoryError()]

        def lacks() -> None:
            if lacking:
                raise lacking.pop()
            heard()

        monkeypatch.setattr(pilot.one, "heard", lacks)
        async with pilot.one.kept():
            await asyncio.sleep(2.2)
        assert not lacking
        assert pilot.orders().count("RenewLease") == 4


@pytest.mark.parametrize("use", ["obtain", "hear", "ask", "steer"])
async def test_idle_counts_from_the_newest_use(use: str) -> None:
    async with front(idle_s=5.0, who="this tab") as pilot:
        pilot.agent.is_slow = use == "obtain"
        obtaining = await pilot.begin(pilot.one.obtain())
        pilot.now = 3.0
        pilot.returned()
        if use == "obtain":
            pilot.answer()
        await obtaining
        if use == "hear":
            pilot.one.heard()
        elif use == "ask":
            assert (await pilot.one.ask(orders.Land())).stage is Stage.DONE
            assert getattr(pilot.agent.heard[-1], "fence", None) == 7
        elif use == "steer":
            pilot.one.steer(NORTH)
        pilot.now = 7.9
        pilot.one.heard(is_idle=True)
        assert pilot.one.has_lease
        pilot.now = 8.0
        pilot.one.heard(is_idle=True)
        assert pilot.orders()[-1] == "ReleaseLease"
        assert at(pilot.one) is S.ABSENT
        (note,) = pilot.agent.asked(JournalNote)
        assert note.text == "this tab gives control back: no order in 5 s"


async def test_idle_ends_no_request_that_is_under_way() -> None:
    async with front(idle_s=5.0) as pilot:
        pilot.agent.is_slow = True
        obtaining = await pilot.begin(pilot.one.obtain())
        pilot.now = 9.0
        pilot.one.heard(is_idle=True)
        assert pilot.orders() == ["AcquireLease", "Obtain", "RenewLease"]
        pilot.answer()
        await obtaining
        assert at(pilot.one) is S.HOLDING


HELD, OTHERS, NOBODYS = LeaseChanged(7, "front"), LeaseChanged(8, "another"), LeaseChanged(0, "")


@pytest.mark.parametrize(
    ("holder", "has_authority", "silence", "steers", "is_held", "seen"),
    [
        (HELD, True, 0.0, True, True, ""),
        (HELD, False, 0.0, True, False, "this client has no control; nothing was sent"),
        (OTHERS, True, 0.0, False, False, "this client has no control: another has control; n"),
        (NOBODYS, True, 0.0, False, False, "this client has no control; nothing was sent"),
        (HELD, True, 3.0, False, False, "owns the aircraft has said nothing for 3 s; nothing w"),
    ],
)
async def test_what_goes_out_and_what_is_obeyed(
    holder: LeaseChanged,
    has_authority: bool,
    silence: float,
    steers: bool,
    is_held: bool,
    seen: str,
) -> None:
    for is_asked in (True, False):
        async with front() as pilot:
            pilot.now = 50.0
            if is_asked:
                await pilot.one.obtain()
            pilot.client._receive(holder)
            pilot.agent.tell(replace(pilot.agent.state, has_authority=has_authority))
            pilot.now += silence
            one, steer = pilot.one, partial(pilot.one.steer, NORTH)
            assert one.has_control is one.is_obeyed is (is_held and is_asked)
            for call, goes in ((steer, steers), (one.held, is_held)):
                if goes and is_asked:
                    call()
                else:
                    with pytest.raises(NoAuthority) as raised:
                        call()
                    assert not is_asked or seen in raised.value.seen
            sent = [message.fence for message in pilot.agent.asked(Steer)]
            assert sent == [7] * (steers and is_asked)


@pytest.mark.parametrize(("number", "is_others"), [(0, False), (1, True), (7, False), (8, True)])
async def test_the_holder_of_the_lease(number: int, is_others: bool) -> None:
    async with front() as pilot:
        pilot.client._receive(LeaseChanged(number, "x"))
        assert pilot.one.is_others is (number != 0)
        pilot.client._receive(LeaseChanged(0, ""))
        await pilot.one.take()
        pilot.one.let_go()
        pilot.client._receive(LeaseChanged(number, "x"))
        assert pilot.one.is_others is is_others


async def test_a_stop_stands_before_anybody_answers_and_goes_out_from_each_pilot() -> None:
    async with front() as pilot:
        await pilot.one.stop()  # without control, too
        assert (pilot.orders(), pilot.states) == (["Stop"], [])
        pilot.one.begin_anew("released")
        assert pilot.orders() == ["Stop"], "nothing without the lease"
        await pilot.one.obtain()
        pilot.agent.is_slow = True
        stopping = await pilot.begin(pilot.one.stop())
        assert pilot.states[-1:] == [S.STOPPED]
        pilot.answer()
        await stopping
        pilot.one.begin_anew("released")
        halt = pilot.agent.heard[-1]
        assert isinstance(halt, Ask)
        assert (halt.id, halt.order, halt.fence) == (0, orders.Halt("released", True), 7)
        assert pilot.states[-1:] == [S.HOLDING]


@pytest.mark.parametrize(
    ("told", "states", "ended_by"),
    [
        ([1], [], None),
        ([6], [], None),
        ([7], [], None),
        ([8], [S.TAKEN_OVER], 8),
        ([0], [S.LOST], 0),
        ([9, 0], [S.TAKEN_OVER], 9),
        ([0, 7], [S.LOST, S.LEASED], None),
    ],
)
async def test_which_end_of_a_lease_is_believed(
    told: list[int], states: list[ControlState], ended_by: int | None
) -> None:
    async with front() as pilot:
        await pilot.one.obtain()
        pilot.taken()
        pilot.states.clear()
        for number in told:
            pilot.agent.tell(LeaseChanged(number, "x"))
        assert pilot.states == states
        assert getattr(pilot.one.lease_end, "number", None) == ended_by
        loss = LossReason.MODE_SWITCH if not states else None
        assert pilot.one.loss is loss


@pytest.mark.parametrize("way", ["heard", "steer", "obtain", "adopt", "give_back"])
async def test_the_taker_is_known_until_it_is_had_again(way: str) -> None:
    async with front() as pilot:
        pilot.taken()
        assert (pilot.one.loss, pilot.states) == (None, []), "without the lease"
        await pilot.one.obtain()
        pilot.taken()
        assert (at(pilot.one), pilot.one.loss) == (S.SUSPENDED, LossReason.MODE_SWITCH)
        pilot.one.steer(NORTH)
        pilot.one.heard()
        assert (at(pilot.one), pilot.one.loss) == (S.SUSPENDED, LossReason.MODE_SWITCH)
        pilot.returned()
        expected = S.HOLDING
        if way == "steer":
            pilot.one.steer(NORTH)
        elif way == "heard":
            pilot.one.heard()
        elif way == "obtain":
            await pilot.one.obtain()
        elif way == "give_back":
            await pilot.one.give_back()
            expected = S.ABSENT
        else:
            pilot.one.adopt(EIGHT)
            assert pilot.one.loss is None
            pilot.agent.tell(LeaseChanged(8, "front"))
            expected = S.LEASED
        assert (at(pilot.one), pilot.one.loss) == (expected, None)


async def test_a_pilot_who_gives_way_gives_the_lease_back_at_once() -> None:
    async with front(gives_way=True) as pilot:
        await pilot.one.obtain()
        pilot.taken()
        assert pilot.orders()[-1] == "ReleaseLease"
        assert pilot.states[-3:] == [S.SUSPENDED, S.LETTING_GO, S.ABSENT]


def guarded(guard: str) -> GuardRefused:
    error = GuardRefused(f"by the guard {guard}")
    error.guard = guard
    return error


@pytest.mark.parametrize(
    ("fence", "error", "state", "is_told"),
    [
        (7, guarded("stopped"), S.STOPPED, True),
        (7, guarded("battery"), S.HOLDING, True),
        (7, AuthorityLost("the pilot left F"), S.HOLDING, True),
        (6, guarded("stopped"), S.HOLDING, False),
        (8, guarded("stopped"), S.HOLDING, False),
    ],
)
async def test_a_refused_setpoint_is_reported_to_its_operator(
    fence: int, error: M100Error, state: ControlState, is_told: bool
) -> None:
    async with front() as pilot:
        refused: list[str] = []
        pilot.one.on_refused(error)  # nobody wants to hear it
        pilot.one.on_refused = lambda found: refused.append(found.seen)
        pilot.agent.tell(SteerRefused(fence, RemoteError.of(error)))
        assert refused == [], "without the lease"
        await pilot.one.obtain()
        pilot.agent.tell(SteerRefused(fence, RemoteError.of(error)))
        assert refused == [error.seen] * is_told
        assert at(pilot.one) is state


async def test_an_event_about_something_else_stops_nobody() -> None:
    async with front() as pilot:
        await pilot.one.obtain()
        for number, topic in enumerate((EventTopic.NONE, EventTopic.HALTED, EventTopic.STOPPED), 1):
            assert at(pilot.one) is S.HOLDING
            pilot.agent.tell(Event(number, 1.0, "info", "", topic))
        assert at(pilot.one) is S.STOPPED


@pytest.mark.parametrize("how", ["let_go", "give_back"])
async def test_nothing_is_flown_under_a_lease_that_goes_back(
    how: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with front() as pilot:
        await pilot.one.obtain()
        answer: asyncio.Future[None] = asyncio.get_running_loop().create_future()

        async def release(token: str) -> None:
            await answer

        monkeypatch.setattr(pilot.client, "release_lease", release)
        monkeypatch.setattr(pilot.client, "let_go", lambda lease: None)  # it is on its way
        if how == "let_go":
            pilot.one.let_go()
        else:
            giving = await pilot.begin(pilot.one.give_back())
        assert pilot.client.holder.number == 7
        assert (pilot.one.lease, pilot.one.has_control) == (None, False)
        with pytest.raises(NoAuthority):
            pilot.one.steer(NORTH)
        assert pilot.states[-1] is (S.LETTING_GO if how == "give_back" else S.ABSENT)
        if how == "give_back":
            answer.set_exception(LinkError("it has gone"))
            await giving
            assert at(pilot.one) is S.ABSENT


async def test_giving_back_waits_for_no_request_that_is_under_way() -> None:
    async with front() as pilot:
        pilot.agent.is_slow = True
        asking = await pilot.begin(pilot.one.obtain())
        giving = await pilot.begin(pilot.one.give_back())
        assert giving.done()
        assert pilot.orders() == ["AcquireLease", "Obtain", "ReleaseLease"]
        pilot.answer()
        with pytest.raises(NoAuthority):
            await asking


async def test_a_lease_that_is_handed_on_while_another_goes_back_is_held(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async with front() as pilot:
        await pilot.one.obtain()
        answer: asyncio.Future[None] = asyncio.get_running_loop().create_future()

        async def release(token: str) -> None:
            await answer

        monkeypatch.setattr(pilot.client, "release_lease", release)
        giving = await pilot.begin(pilot.one.give_back())
        pilot.agent.tell(LeaseChanged(8, "front"))
        pilot.one.adopt(EIGHT)
        answer.set_exception(LeaseRefused("this lease is not in force"))
        await giving
        assert (at(pilot.one), pilot.one.lease) == (S.LEASED, EIGHT)
        await pilot.one.obtain()
        assert at(pilot.one) is S.HOLDING
        assert pilot.one.is_obeyed


async def test_giving_back_ends_what_waits_behind_a_request_that_has_just_ended() -> None:
    """The lock is free for a moment then, and the next one in the line has not run yet."""
    async with front() as pilot:
        later: list[asyncio.Task[None]] = []

        async def shortly() -> None:
            await pilot.one.obtain()
            later.append(asyncio.create_task(pilot.one.obtain()))
            await pilot.one.give_back()
            assert pilot.orders() == ["AcquireLease", "Obtain", "ReleaseLease"]

        first = asyncio.create_task(shortly())
        waiting = asyncio.create_task(pilot.one.obtain())
        await first
        with pytest.raises(NoAuthority, match="gave control back"):
            await waiting
        await later[0]  # that was asked for after it
        assert at(pilot.one) is S.HOLDING
