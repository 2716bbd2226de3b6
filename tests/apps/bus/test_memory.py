"""The network in memory does to messages what its weather says, the same for the same seed."""

from __future__ import annotations

from typing import Any

import anyio
import pytest

from m100link.apps.bus.network import Question
from m100link.sim.clock import virtual_clock_loop
from tests.apps.bus.memory import MemoryNetwork, Weather

pytestmark = pytest.mark.anyio


@pytest.fixture
def anyio_backend() -> tuple[str, dict[str, Any]]:
    return "asyncio", {"loop_factory": virtual_clock_loop}


async def heard(weather: Weather, seed: int, count: int = 1000) -> list[bytes]:
    network = MemoryNetwork(seed, weather)
    one, other = network.session(), network.session()
    found: list[bytes] = []
    other.subscribe("a/*", lambda _, payload: found.append(payload))
    outlet = one.publish("a/b")
    for number in range(count):
        outlet.put(b"%d" % number)
    await anyio.sleep(10.0)
    return found


async def test_good_weather_changes_nothing() -> None:
    assert await heard(Weather(), 1) == [b"%d" % number for number in range(1000)]


async def test_loss_and_repeats_have_their_shares() -> None:
    assert 850 < len(await heard(Weather(loss=0.1), 1)) < 950
    assert 1050 < len(await heard(Weather(repeat=0.1), 1)) < 1150


async def test_jitter_reorders() -> None:
    found = await heard(Weather(delay_s=0.1, jitter_s=0.5), 1)
    assert len(found) == 1000
    assert found != sorted(found, key=int)


async def test_the_same_seed_is_the_same_weather() -> None:
    weather = Weather(loss=0.2, repeat=0.2, jitter_s=1.0)
    assert await heard(weather, 7) == await heard(weather, 7)
    assert await heard(weather, 7) != await heard(weather, 8)


async def test_each_one_asked_answers_under_its_own_key_and_the_lost_are_not_waited_for() -> None:
    network = MemoryNetwork()
    asker, first, second = (network.session() for _ in range(3))

    def answers(question: Question) -> None:
        question.answer("a/1/cmd", question.payload + b"!")

    first.serve("a/1/cmd", answers)
    second.serve("a/2/cmd", lambda _: None)  # hangs
    began = anyio.current_time()
    [answer] = await asker.ask("a/*/cmd", b"do", timeout=0.5)
    assert (answer.key, answer.payload) == ("a/1/cmd", b"do!")
    assert anyio.current_time() - began == pytest.approx(0.5, abs=0.01)
    assert await asker.ask("a/3/cmd", timeout=0.5) == []


async def test_a_program_that_drops_a_question_is_nobody_at_once() -> None:
    network = MemoryNetwork()
    network.session().serve("a", lambda question: question.drop())
    began = anyio.current_time()
    assert await network.session().ask("a", timeout=5.0) == []
    assert anyio.current_time() - began < 0.1


async def test_a_cut_is_silence_and_tokens_go_after_a_while() -> None:
    network = MemoryNetwork()
    one, other = network.session(), network.session()
    seen: list[tuple[str, bool]] = []
    token = one.declare("a/live")
    other.watch("*/live", lambda key, is_there: seen.append((key, is_there)))
    found: list[bytes] = []
    other.subscribe("a/x", lambda _, payload: found.append(payload))
    outlet = one.publish("a/x")
    await anyio.sleep(0.01)
    assert seen == [("a/live", True)]
    assert outlet.is_wanted()
    network.cut(one)
    outlet.put(b"lost")
    assert not outlet.is_wanted()
    await anyio.sleep(1.4)
    assert len(seen) == 1
    await anyio.sleep(0.2)
    assert seen[1:] == [("a/live", False)]
    network.join(one)
    assert seen[2:] == [("a/live", True)]
    outlet.put(b"heard")
    await anyio.sleep(0.01)
    assert found == [b"heard"]
    token.close()
    await anyio.sleep(0.01)
    assert seen[3:] == [("a/live", False)]
    assert await other.tokens("**", timeout=1.0) == []


async def test_what_is_taken_in_steps_waits_in_what_it_has_room_for() -> None:
    network = MemoryNetwork(1)
    one, other = network.session(), network.session()
    assert one.session != other.session
    inbox, questions, tokens = (
        other.inbox("a/*", 2),
        other.questions("a/service", 2),
        other.changes("live/**"),
    )
    outlet = one.publish("a/b")
    for number in range(5):
        outlet.put(b"%d" % number, b"beside")
    held = one.declare("live/one")
    probes = [one.probe(key, timeout=1.0) for key in ("a/service", "a/nobody")]
    await anyio.sleep(0.1)
    assert [(got.payload, got.attachment) for got in inbox.take()] == [
        (b"3", b"beside"),
        (b"4", b"beside"),
    ]
    assert inbox.take() == []
    [question] = questions.take()
    question.answer("a/service", b"")
    held.close()
    await anyio.sleep(0.1)
    assert [(c.key, c.is_there) for c in tokens.take()] == [("live/one", True), ("live/one", False)]
    assert [probe.take() for probe in probes] == [[True], []]
    assert one.publish("a/nobody", kept=1).is_wanted()
    assert not one.publish("b/nobody").is_wanted()
