"""Whose answer is believed: as a table, and over zenoh itself."""

from __future__ import annotations

from contextlib import AsyncExitStack
from dataclasses import replace

import pytest

from m100link.apps.agent.messages import Action, Ask
from m100link.apps.agent.remote_error import MessageError
from m100link.apps.bus.network import Answer, Bus, Question
from m100link.apps.fleet.asking import believed, clocks_told
from m100link.apps.fleet.client import Fleet
from m100link.apps.fleet.keys import Keys
from m100link.apps.fleet.payloads import Order, Outcome, Progress, Reply, pack, unpack
from m100link.apps.fleet.session import open_fleet
from m100link.errors import OutcomeUnknown
from tests.apps.bus.pair import free_place, until

KEYS = Keys("field", "a1")
OK = Reply("id", "a1", "boot", Progress.DONE, Outcome.OK, clock=5.0)
REFUSED = replace(OK, outcome=Outcome.REFUSED)


def answer(reply: Reply | bytes, session: str = "a") -> Answer:
    payload = reply if isinstance(reply, bytes) else pack(reply)
    return Answer(KEYS.command, payload, session)


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
    answers: list[Answer], sessions: str, expected: Reply | type[Exception] | None
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
    assert clocks_told(came, "a1") == [5.0, 9.0]


class Voice:
    """Somebody behind the router who answers orders to a1."""

    def __init__(self, bus: Bus, outcome: Outcome) -> None:
        self.bus, self.outcome, self.heard = bus, outcome, 0
        bus.serve(KEYS.command, self._answer)

    def _answer(self, question: Question) -> None:
        self.heard += 1
        order: Order = unpack(Order, question.payload)
        told = Reply(order.id, "a1", "boot", Progress.DONE, self.outcome, clock=1.0)
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
            return (await fleet.each(lambda one: one.asker.ask(Ask(0, Action.STOP)), ["a1"]))[
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
