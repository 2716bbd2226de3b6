"""zenoh itself, over loopback: a router, and two sessions that meet there."""

from __future__ import annotations

import asyncio
import logging
import subprocess
import sys
import threading
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack
from pathlib import Path
from time import monotonic
from typing import Any
from unittest.mock import Mock

import anyio
import pytest

from m100link.apps.bus import session as session_module
from m100link.apps.bus.network import Inbox, Question
from m100link.apps.bus.session import LARGEST, Opening, ZenohBus, open_session
from m100link.errors import M100Error, PortBusy, UsageError
from m100link.sim.clock import virtual_clock_loop
from tests.apps.bus.pair import free_place, opening, two, until
from tests.waiting import PATIENCE

zenoh: Any = pytest.importorskip("zenoh", reason="zenoh is not installed")

pytestmark = pytest.mark.anyio


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


@pytest.fixture
async def sessions() -> AsyncIterator[tuple[ZenohBus, ZenohBus]]:
    place = [free_place()]
    async with AsyncExitStack() as stack:
        await stack.enter_async_context(open_session(opening("router", listen_endpoints=place)))
        client = opening("client", connect_endpoints=place)
        yield (
            await stack.enter_async_context(open_session(client)),
            await stack.enter_async_context(open_session(client)),
        )


async def test_what_waits_goes_before_its_outlet_ends() -> None:
    sent: list[bytes] = []
    session = Mock()
    session.declare_publisher.return_value.put = lambda payload, **_: sent.append(payload)
    outlet = ZenohBus(session).publish("a/b", within=10.0)
    for number in range(200):
        outlet.put_later(str.encode, str(number))
    assert outlet.is_wanted()
    assert sent == []
    outlet.close()
    assert sent == [b"%d" % number for number in range(200)]
    assert not outlet.is_wanted()


@pytest.mark.pty
@pytest.mark.smoke
async def test_messages_arrive_in_the_event_loop(
    sessions: tuple[ZenohBus, ZenohBus],
) -> None:
    one, other = sessions
    found: list[tuple[str, bytes]] = []
    here, threads = threading.get_ident(), set()

    def take(key: str, payload: bytes) -> None:
        threads.add(threading.get_ident())
        found.append((key, payload))

    other.subscribe("m/*/a", take)
    outlet = one.publish("m/x/a")
    await until(outlet.is_wanted)
    for number in range(600):  # more than is taken in one turn
        outlet.put(b"%d" % number)
    await until(lambda: len(found) == 600)
    assert found[:2] == [("m/x/a", b"0"), ("m/x/a", b"1")]
    assert threads == {here}
    outlet.close()
    outlet.put(b"nothing happens")
    assert not outlet.is_wanted()


@pytest.mark.pty
async def test_each_answers_under_its_own_key(
    sessions: tuple[ZenohBus, ZenohBus],
) -> None:
    one, other = sessions

    def served(name: str) -> Callable[[Question], None]:
        return lambda asked: asked.answer(f"m/{name}/cmd", asked.payload + name.encode())

    held = [one.serve(f"m/{name}/cmd", served(name)) for name in ("a1", "a2")]
    found: dict[str, bytes] = {}

    async def asked() -> dict[str, bytes]:
        return {one.key: one.payload for one in await other.ask("m/*/cmd", b"to ", timeout=2.0)}

    with anyio.fail_after(PATIENCE):
        while len(found) < 2:
            found = await asked()
    assert found == {"m/a1/cmd": b"to a1", "m/a2/cmd": b"to a2"}
    for one_held in held:
        one_held.close()
    assert await other.ask("m/nobody/cmd", timeout=2.0) == []


@pytest.mark.pty
async def test_a_question_that_is_held_is_answered_later(
    sessions: tuple[ZenohBus, ZenohBus],
) -> None:
    one, other = sessions
    waiting: list[Question] = []
    one.serve("m/a1/cmd", waiting.append)
    answers: list[bytes] = []

    async def ask() -> None:
        while not answers:
            answers.extend(a.payload for a in await other.ask("m/a1/cmd", timeout=PATIENCE))

    async with anyio.create_task_group() as group:
        group.start_soon(ask)
        await until(lambda: waiting)
        await anyio.sleep(0.1)
        for question in waiting:
            question.answer("m/a1/cmd", b"late")
    assert answers == [b"late"]


@pytest.mark.pty
async def test_tokens_come_and_go(sessions: tuple[ZenohBus, ZenohBus]) -> None:
    one, other = sessions
    token = one.declare("m/a1/live")
    found: list[str] = []
    with anyio.fail_after(PATIENCE):
        while not found:
            found = await other.tokens("m/*/live", timeout=2.0)
    assert found == ["m/a1/live"]
    seen: list[tuple[str, bool]] = []
    other.watch("m/*/live", lambda key, is_there: seen.append((key, is_there)))
    await until(lambda: ("m/a1/live", True) in seen)
    token.close()
    await until(lambda: seen[-1] == ("m/a1/live", False))


@pytest.mark.pty
async def test_what_is_too_long_is_not_taken(
    sessions: tuple[ZenohBus, ZenohBus],
) -> None:
    one, other = sessions
    found: list[int] = []
    other.subscribe("m/x/a", lambda _, payload: found.append(len(payload)))
    outlet = one.publish("m/x/a")
    await until(outlet.is_wanted)
    outlet.put(bytes(2 * LARGEST))
    outlet.put(b"short")
    await until(lambda: 5 in found)
    assert max(found) == 5


@pytest.mark.pty
@pytest.mark.parametrize(
    ("mode", "told", "done"),
    [
        ("client", "no router answered", "start one"),
        ("router", "no router can be here", "look at the port"),
        ("peer", "no session of zenoh", "look at the port"),
    ],
)
async def test_what_cannot_be_opened_is_reported_in_the_words_of_its_user(
    mode: str, told: str, done: str
) -> None:
    place = [free_place()]
    async with open_session(opening("router", listen_endpoints=place)):
        made = opening(mode, listen_endpoints=place)
        if mode == "client":
            made = opening(mode, connect_endpoints=[free_place()])
        options = dict(made.options) | {"connect/timeout_ms": "100"}
        remedies = {"client": "start one", "": "look at the port"}
        with pytest.raises((UsageError, PortBusy), match=told) as caught:
            async with open_session(Opening("a test", "x", options, remedies=remedies)):
                pass
    assert caught.value.remedy == done
    assert " at /" not in str(caught.value)  # a place in zenoh's source helps nobody


async def test_what_zenoh_raises_as_it_opens_is_raised_as_it_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its text is shown, and has to be that of the cause."""
    zenoh, error = pytest.importorskip("zenoh"), ValueError("no such key")
    monkeypatch.setattr(zenoh, "open", Mock(side_effect=error))
    with pytest.raises(ValueError, match="no such key") as caught:
        await session_module._opened(zenoh.Config())
    assert caught.value is error


async def test_a_panic_of_zenoh_is_an_error_of_the_one_who_opens(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With 12 file descriptors it panics, which is no Exception: verbs waited for ever."""

    class PanicException(BaseException):
        pass

    zenoh = pytest.importorskip("zenoh")
    monkeypatch.setattr(zenoh, "open", Mock(side_effect=PanicException("Failed to init net")))
    async with asyncio.timeout(PATIENCE):
        with pytest.raises(M100Error, match="zenoh: Failed to init net") as caught:
            await session_module._opened(zenoh.Config())
    assert caught.value.remedy == "try ulimit -n 1024"


@pytest.mark.pty
@pytest.mark.parametrize("way", ["waits", "raises"])
async def test_a_program_that_leaves_hears_why_and_not_of_a_session_that_does_not_close(
    monkeypatch: pytest.MonkeyPatch, way: str
) -> None:
    """Of a router that is cut off zenoh's close waits for ten seconds, and then raises."""
    import zenoh

    may_end, ended = threading.Event(), threading.Event()

    class CutOff:
        def close(self) -> None:
            if way == "waits":
                may_end.wait()
            ended.set()
            raise zenoh.ZError("close operation timed out!")

    monkeypatch.setattr(zenoh, "open", lambda config: CutOff())
    with anyio.fail_after(PATIENCE):
        with pytest.raises(UsageError, match="why"):
            async with open_session(opening("client")):
                raise UsageError("why")
    assert ended.is_set() is (way == "raises")
    may_end.set()
    assert ended.wait(PATIENCE)


async def test_an_option_that_cannot_be() -> None:
    with pytest.raises(UsageError, match="cannot be in a session"):
        async with open_session(Opening("a test", "x", {"mode": '"captain"'})):
            pass


@pytest.mark.parametrize("text", ["{nonsense", None])
async def test_a_configuration_that_cannot_be_read_is_named_in_the_words_of_its_user(
    text: str | None, tmp_path: Path
) -> None:
    path = tmp_path / "zenoh.json5"
    if text is not None:
        path.write_text(text)
    asked = Opening("a test", "x", {}, file=(str(path), "--zenoh-config"))
    with pytest.raises(UsageError, match=r"--zenoh-config: .*json5 cannot be read"):
        async with open_session(asked):
            pass


_ENDS = """
import asyncio
from m100link.apps.bus import session
session._AGAIN_S = 0.0
options = {"mode": '"client"', "connect/endpoints": '["tcp/127.0.0.1:1"]'}
async def waits():
    opening = session.Opening("a test", "x", options, is_patient=True)
    async with session.open_session(opening):
        pass
async def main():
    tasks = [asyncio.ensure_future(waits()) for _ in range(4)]
    await asyncio.sleep(0.3)
    for task in tasks:
        task.cancel()
asyncio.run(main())
"""


@pytest.mark.pty
def test_a_program_that_ends_while_zenoh_looks_for_a_router_ends_well() -> None:
    """A thread that came back from zenoh as Python 3.13 or older ended aborted the process."""
    done = subprocess.run(
        [sys.executable, "-c", _ENDS],
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )
    assert (done.returncode, "FATAL" in done.stderr) == (0, False)


# -- how long is waited: zenoh itself does not run -------------------------------------------------


class NoSession:
    """A session that nothing comes to, and whose questions never end."""

    def liveliness(self) -> NoSession:
        return self

    def get(self, *what: object, **how: object) -> None:
        """Nobody answers, and nothing ends it."""

    def close(self) -> None:
        pass


async def opened_after(
    monkeypatch: pytest.MonkeyPatch, router_s: float, **how: Any
) -> tuple[float, str]:
    """Seconds until a session was opened, or refused, where a router answers after some; which."""
    import zenoh

    begin = anyio.current_time()

    async def opened(config: object) -> Any:
        if anyio.current_time() - begin < router_s:
            raise zenoh.ZError("nobody")
        return NoSession()

    monkeypatch.setattr(session_module, "_opened", opened)
    options = {
        "mode": f'"{how.pop("mode", "client")}"',
        "connect/endpoints": '["tcp/10.0.0.7:7447"]',
    }
    try:
        async with open_session(Opening("a test", "x", options, **how)):
            return anyio.current_time() - begin, "opened"
    except UsageError:
        return anyio.current_time() - begin, "refused"


@pytest.mark.parametrize(
    ("router_s", "how", "outcome", "least_s", "most_s", "told"),
    [
        (0.0, {}, "opened", 0.0, 0.0, 0),
        (1.2, {}, "refused", 0.0, 0.0, 0),
        (1.2, {"patience_s": 5.0}, "opened", 1.2, 1.9, 0),
        (60.0, {"patience_s": 5.0}, "refused", 5.0, 5.7, 0),
        (3600.0, {"is_patient": True}, "opened", 3600.0, 3600.7, 1),
        (1.2, {"is_patient": True, "patience_s": 5.0, "mode": "router"}, "refused", 0.0, 0.0, 0),
        (1.2, {"is_patient": True, "patience_s": 5.0, "mode": "peer"}, "refused", 0.0, 0.0, 0),
    ],
)
def test_a_client_tries_again_for_as_long_as_its_settings_say(
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    router_s: float,
    how: dict[str, Any],
    outcome: str,
    least_s: float,
    most_s: float,
    told: int,
) -> None:
    """Without an end the log says once why it waits; with one the refusal says it."""
    with asyncio.Runner(loop_factory=virtual_clock_loop) as runner:
        took_s, seen = runner.run(opened_after(monkeypatch, router_s, **how))
    assert seen == outcome
    assert least_s <= took_s <= most_s
    warned = [one.getMessage() for one in caplog.records if one.levelno == logging.WARNING]
    assert len(warned) == told
    assert all("10.0.0.7" in one for one in warned)


def test_a_question_that_zenoh_does_not_end_is_not_waited_for() -> None:
    nothing: Any = NoSession()

    async def asked() -> tuple[float, list[Any], list[str]]:
        bus, begin = ZenohBus(nothing), anyio.current_time()
        answers: list[Any] = await bus.ask("m/*/cmd", timeout=7.0)
        took_s = anyio.current_time() - begin
        return took_s, answers, await bus.tokens("m/*", timeout=7.0)

    with asyncio.Runner(loop_factory=virtual_clock_loop) as runner:
        took_s, answers, tokens = runner.run(asked())
    assert (answers, tokens) == ([], [])
    assert 7.0 <= took_s <= 9.0  # zenoh's own end, which loses nothing, comes first


# -- zenoh itself, over loopback: what waits to be taken, and floods that cost the oldest ----------


MOST_BYTES = 32768


async def some(inbox: Inbox[Any]) -> list[Any]:
    found: list[Any] = []

    def look() -> bool:
        found.extend(inbox.take())
        return bool(found)

    await until(look)
    return found


async def test_what_goes_out_comes_in() -> None:
    async with AsyncExitStack() as stack:
        one, other = await two(stack)
        assert one.session != other.session
        tokens = other.changes("@ros2_lv/**")
        token = one.declare("@ros2_lv/0/here")
        assert [(c.key, c.is_there) for c in await some(tokens)] == [("@ros2_lv/0/here", True)]
        token.close()
        assert [(c.key, c.is_there) for c in await some(tokens)] == [("@ros2_lv/0/here", False)]
        outlet, inbox = one.publish("0/a"), other.inbox("0/a", 8)
        await until(outlet.is_wanted)
        outlet.put(b"payload", b"attachment")
        assert [(r.payload, r.attachment) for r in await some(inbox)] == [
            (b"payload", b"attachment")
        ]
        for number in range(100):
            outlet.put(b"%d" % number, b"")
        outlet.put(b"last", b"")
        found: list[bytes] = []

        def has_last() -> bool:
            found.extend(one.payload for one in inbox.take())
            return found[-1:] == [b"last"]

        await until(has_last)


async def test_what_is_too_long_is_not_read() -> None:
    async with AsyncExitStack() as stack:
        one, other = await two(stack, largest=MOST_BYTES)
        outlet, inbox = one.publish("0/a"), other.inbox("0/a", 8)
        await until(outlet.is_wanted)
        seen: list[int] = []

        async def sizes_until(size: int, last: int) -> None:
            """Send until it comes: what is sent is dropped where the network is slow."""
            with anyio.fail_after(PATIENCE):
                while seen[-1:] != [last]:
                    outlet.put(bytes(size), b"")
                    await anyio.sleep(0.02)
                    seen.extend(len(one.payload) for one in inbox.take())

        await sizes_until(MOST_BYTES, MOST_BYTES)
        await sizes_until(MOST_BYTES + 1, 0)
        for _ in range(5):
            outlet.put(bytes(4 << 20), b"")  # zenoh does not put it together
        await sizes_until(1, 1)
        assert set(seen) == {MOST_BYTES, 0, 1}


async def test_a_ring_that_is_filled_meanwhile_has_an_end() -> None:
    async with AsyncExitStack() as stack:
        one, other = await two(stack)
        outlet, inbox = one.publish("0/a"), other.inbox("0/a", 8)
        await until(outlet.is_wanted)
        ends_at = anyio.current_time() + 2.0

        def flood() -> None:
            while monotonic() < ends_at:
                for _ in range(100):
                    outlet.put(b"x", b"")

        async with anyio.create_task_group() as group:
            group.start_soon(anyio.to_thread.run_sync, flood)
            while monotonic() < ends_at:
                assert len(inbox.take()) <= 8
                await anyio.sleep(0.001)


async def test_a_program_that_comes_late_gets_what_was_latched() -> None:
    async with AsyncExitStack() as stack:
        one, other = await two(stack)
        outlet = one.publish("0/latched", kept=1)
        outlet.put(b"old", b"")
        outlet.put(b"new", b"1")
        late = zenoh.ext.declare_advanced_subscriber(
            other._session,
            "0/latched",
            zenoh.handlers.RingChannel(8),
            history=zenoh.ext.HistoryConfig(detect_late_publishers=True),
        )
        await until(lambda: (found := late.try_recv()) and bytes(found.payload) == b"new")


async def test_a_request_is_answered_or_dropped() -> None:
    async with AsyncExitStack() as stack:
        one, other = await two(stack)
        inbox = one.questions("0/service", 4)
        querier: Any = other._session.declare_querier("0/service", timeout=1000.0 * PATIENCE)
        await until(lambda: querier.matching_status.matching)

        def ask(payload: bytes) -> Any:
            return querier.get(zenoh.handlers.FifoChannel(8), payload=payload, attachment=b"a")

        answers = ask(b"question")
        [request] = await some(inbox)
        assert (request.payload, request.attachment) == (b"question", b"a")
        request.answer(request.key, b"answer", b"b")
        [reply] = await anyio.to_thread.run_sync(list, answers)
        assert (bytes(reply.ok.payload), bytes(reply.ok.attachment)) == (b"answer", b"b")
        answers = ask(b"junk")
        [request] = await some(inbox)
        request.drop()
        assert await anyio.to_thread.run_sync(list, answers) == []


async def test_a_question_by_a_pattern_says_so() -> None:
    async with AsyncExitStack() as stack:
        one, other = await two(stack)
        inbox = one.questions("0/service", 4)
        querier: Any = other._session.declare_querier("0/service", timeout=1000.0 * PATIENCE)
        await until(lambda: querier.matching_status.matching)
        ring = zenoh.handlers.FifoChannel(8)
        answers = other._session.get("0/*", ring, payload=b"question", timeout=PATIENCE)
        [request] = await some(inbox)
        assert (request.key, request.payload) == ("0/*", b"question")
        request.drop()
        assert await anyio.to_thread.run_sync(list, answers) == []


async def test_a_probe_is_answered_by_who_has_what_it_asks_for() -> None:
    async with AsyncExitStack() as stack:
        one, other = await two(stack, adminspace_enabled=True)

        def probe(by: ZenohBus, session: str) -> Inbox[bool]:
            return by.probe(f"@/{session}/*", timeout=2.0)

        nobody = [probe(other, one.session), probe(one, "abcdef")]
        asked: list[Inbox[bool]] = []

        def answers() -> bool:
            asked.append(probe(one, other.session))
            nobody.append(probe(other, one.session))
            return any(any(inbox.take()) for inbox in asked)

        await until(answers)
        assert not any(inbox.take() for inbox in nobody)


async def test_a_session_knows_whether_it_is_connected_to_anybody() -> None:
    async with open_session(opening("peer")) as bus:
        assert bus.is_alone()
    async with AsyncExitStack() as stack:
        one, other = await two(stack)
        await until(lambda: not (one.is_alone() or other.is_alone()))


async def test_nothing_is_raised_when_the_session_has_ended() -> None:
    async with open_session(opening("peer")) as bus:
        outlet = bus.publish("0/a")
        inbox = bus.probe("@/abcdef/*", timeout=2.0)
    outlet.put(b"", b"")
    assert inbox.take() == []


async def test_what_is_kept_needs_a_session_with_stamps() -> None:
    plain = dict(opening("peer").options) | {"timestamping/enabled": "false"}
    async with open_session(Opening("a test", "x", plain)) as bus:
        bus.publish("0/a").close()
        with pytest.raises(UsageError, match="keeps nothing") as caught:
            bus.publish("0/a", kept=1)
    assert "timestamping" in caught.value.remedy
