"""A process that the station starts: what its loop is not held up by."""

from __future__ import annotations

import asyncio
import io
import json
import logging
import subprocess
import sys
from asyncio.subprocess import Process
from typing import Any, cast

import pytest

from m100link.apps.agent.background import Ended
from m100link.apps.station.supervisor import ChildProcess, run_child, supervised
from m100link.errors import M100Error
from m100link.sim.clock import virtual_clock_loop

FIRST = asyncio.FIRST_COMPLETED

_PROGRAM = """
import gc
import m100link.apps.station.run  # all that such a process loads
from m100link.apps.station.supervisor import leave_what_stays

walked = len(gc.get_objects())
leave_what_stays()
kept = [[] for _ in range(10)]
kept[0].append(kept)
del kept
left, found = len(gc.get_objects()), gc.collect()
print(walked, left, found)
"""


def test_what_stays_is_not_walked_through_and_what_comes_later_is_collected() -> None:
    program = (sys.executable, "-c", _PROGRAM)
    told = subprocess.run(program, capture_output=True, text=True, check=True).stdout
    walked, left, found = map(int, told.split())
    assert walked > 10_000
    assert left < walked / 50
    assert found >= 11


def test_a_child_shows_its_warnings_where_nobody_chose_a_log(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A front without a free file descriptor accepted no client and gave no reason."""

    async def work(request: dict[str, Any], ended: Ended) -> None:
        logging.getLogger("m100link.some.front").info("not asked for")
        logging.getLogger("m100link.some.front").error("no connection can be accepted")

    monkeypatch.setattr(sys, "stdin", io.StringIO(json.dumps({"log": {}})))
    assert run_child(work) == 0
    lines = capsys.readouterr().err.splitlines()
    assert [line.split(" ", 1)[1] for line in lines] == [
        "ERROR m100link.some.front: no connection can be accepted"
    ]


class Killed:
    """A process that the system ended."""

    async def wait(self) -> int:
        return -9


@pytest.mark.parametrize(
    "met", [MemoryError(), RuntimeError("can't start new thread"), OSError(24)]
)
def test_a_child_that_could_not_be_started_is_tried_again_whatever_was_lacking(
    met: Exception, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Or the station would have no front any more, and nobody would hear of it."""
    notes: list[str] = []
    child = ChildProcess("fronts", "fronts", {}, lambda text, level: notes.append(text))
    child._process = cast(Process, Killed())
    starts: list[Exception | None] = [met, None]
    running = asyncio.Event()
    child.on_restart.append(running.set)

    async def start() -> None:
        if (lacking := starts.pop(0)) is not None:
            raise lacking

    monkeypatch.setattr(child, "start", start)

    async def keep() -> None:
        keeping = asyncio.ensure_future(child.keep())
        await asyncio.wait([keeping, asyncio.ensure_future(running.wait())], return_when=FIRST)
        assert not keeping.done()
        keeping.cancel()

    with asyncio.Runner(loop_factory=virtual_clock_loop) as runner:
        runner.run(keep())
    ended, failed, served = notes
    assert ended.endswith("ended (SIGKILL), to be started again")
    assert failed.split(":")[1].strip() == "not started"
    assert served.endswith("serving again")


def test_where_one_cannot_start_the_others_are_ended_once_they_have(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A process that begins after its end was asked for would have no end."""
    notes: list[str] = []
    bad, slow = (ChildProcess("fronts", one, {}, lambda text, level: None) for one in ("a1", "a2"))

    async def refuse() -> None:
        raise M100Error("a1: no port")

    async def start() -> None:
        await asyncio.sleep(1.0)
        notes.append("started")

    async def end(timeout: float | None) -> None:
        notes.append("ended")

    monkeypatch.setattr(bad, "start", refuse)
    monkeypatch.setattr(slow, "start", start)
    monkeypatch.setattr(slow, "end", end)

    async def serve() -> None:
        with pytest.raises(M100Error, match="a1: no port"):
            async with supervised(bad, slow):
                pytest.fail("it serves with one of two")

    with asyncio.Runner(loop_factory=virtual_clock_loop) as runner:
        runner.run(serve())
    assert notes == ["started", "ended"]
