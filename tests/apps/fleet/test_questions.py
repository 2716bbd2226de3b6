"""Several questions that are open at once."""

from __future__ import annotations

import anyio
import pytest

from m100link.apps.bus.network import Question
from m100link.apps.fleet.asking import STEP_S, Questions
from tests.apps.bus.memory import MemoryNetwork, Weather

pytestmark = pytest.mark.anyio

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
        assert questions.left == pytest.approx(STEP_S)
        ended = [await questions.answered(10.0), await questions.answered(10.0)]
    assert [(one[0], one[1][0].payload) for one in ended if one] == [(first, b"1"), (second, b"2")]
    assert anyio.current_time() == pytest.approx(STEP_S + 2.0)


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
    assert waits == pytest.approx([2 * STEP_S, 4 * STEP_S, 8 * STEP_S, 2 * STEP_S])


async def test_none_waits_for_longer_than_it_is_of_use() -> None:
    road = Road(5.0)
    async with Questions(road.here) as questions:
        number = questions.ask(KEY, within=0.5)
        assert await questions.answered(10.0) == (number, [])
    assert anyio.current_time() == pytest.approx(0.5)
