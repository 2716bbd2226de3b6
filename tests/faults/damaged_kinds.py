"""What is stored: how each kind is written, and what a reader must tell of a damaged file."""

from __future__ import annotations

import asyncio
import logging
import math
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from unittest.mock import patch

from m100link.apps.fleet.order_log import FileOrderLog
from m100link.errors import M100Error
from m100link.log import Message, read, recorder, recover
from m100link.sim import VirtualClockEventLoop
from tests.faults.damaged_files import Judge
from tests.log.flight import fly

_BEGAN_UTC = 1_800_000_000.0
_MAGIC_BYTES = 8
_BATCH_S = 0.5  # what arrives together is written together, by topic


# -- flight logs ----------------------------------------------------------------------------------


def logs(folder: Path) -> tuple[list[bytes], Judge]:
    """A flight that was recorded to its end, one whose process was killed, one that was mended."""
    before, recorder.FLUSH_S = recorder.FLUSH_S, 0.0  # of the wall clock: a part for each batch
    try:
        with (
            patch("time.time", lambda: _BEGAN_UTC),
            asyncio.Runner(loop_factory=VirtualClockEventLoop) as runner,
        ):
            runner.run(fly(folder / "flight.mcap"))
    finally:
        recorder.FLUSH_S = before
    logging.getLogger("m100link.log").addHandler(logging.NullHandler())  # ten thousand warnings
    ended = (folder / "flight.mcap").read_bytes()
    killed = ended[: len(ended) * 2 // 3]
    (folder / "killed.mcap").write_bytes(killed)
    recover(folder / "killed.mcap", folder / "mended.mcap")
    mended = (folder / "mended.mcap").read_bytes()
    held: dict[bytes, list[Message]] = {}

    def judge(whole: bytes, copy: bytes) -> str:
        path = folder / "copy.mcap"
        if whole not in held:
            path.write_bytes(whole)
            held[whole] = list(read(path).messages())
            assert not read(path).damage
        path.write_bytes(copy)
        return _untold_of_log(path, held[whole], whole, copy)

    return [ended, killed, mended], judge


def _untold_of_log(path: Path, every: list[Message], whole: bytes, copy: bytes) -> str:
    try:
        log = read(path)
        kept = list(log.messages())
    except M100Error:
        return ""
    damage = log.damage
    places = {message: number for number, message in enumerate(every)}
    numbers = [places.get(message, -1) for message in kept]
    if -1 in numbers or numbers != sorted(set(numbers)):
        why = f"{numbers.count(-1)} messages that nobody wrote so"
        return why if -1 in numbers else "messages twice, or not in their order"
    lost = [every[number] for number in sorted(set(range(len(every))) - set(numbers))]
    is_told = bool(damage) or not damage.is_ended
    if lost and not is_told:
        return f"{len(lost)} messages are missing in silence"
    if damage.missing_messages > len(lost):
        return f"{damage.missing_messages} are reported of {len(lost)} that are missing"
    newest = {every[number].topic: number for number in numbers}
    for number in sorted(set(range(len(every))) - set(numbers)):
        message = every[number]
        is_within = any(
            (one or 0.0) - _BATCH_S <= message.utc <= (other or math.inf) + _BATCH_S
            for one, other in damage.spans_utc
        )
        if number < newest.get(message.topic, -1) and not is_within:
            return f"{message.topic} at {message.utc} is within no reported span"
    if whole.endswith(copy[-_MAGIC_BYTES:]) and len(copy) == len(whole) and lost and not damage:
        return "a hole is reported as the end of a process"
    was_ended = whole.endswith(b"\x89MCAP0\r\n")
    if was_ended and copy[: len(whole) - _MAGIC_BYTES] != whole[:-_MAGIC_BYTES] and not is_told:
        return "a change of the file is not reported"
    return ""


# -- ledgers of fleet agents ----------------------------------------------------------------------

_UP = ("boot", 400.0)


def ledgers(folder: Path, suffix: str = ".jsonl") -> tuple[list[bytes], Judge]:
    """What agents leave that were killed: after a few orders, after many, and without any."""
    wholes: list[bytes] = []
    truths: dict[bytes, FileOrderLog] = {}
    beside: dict[bytes, Path] = {}
    for number, orders in enumerate((20, 300, 0)):
        path = folder / str(number) / "a1.jsonl"
        asyncio.run(_kept(path, orders))
        whole = path.with_suffix(suffix).read_bytes()
        wholes.append(whole)
        beside[whole] = folder / f"whole-{number}"
        shutil.copytree(path.parent, beside[whole])
        truths[whole] = FileOrderLog(path, lambda: 1_000.0, lambda: _UP)
        truths[whole].close()

    def judge(whole: bytes, copy: bytes) -> str:
        place = folder / "copy"
        shutil.rmtree(place, ignore_errors=True)
        shutil.copytree(beside[whole], place)
        (place / "a1").with_suffix(suffix).write_bytes(copy)
        try:
            found = FileOrderLog(place / "a1.jsonl", lambda: 1_000_000.0, lambda: _UP)
        except M100Error:
            return ""
        found.close()
        return _untold_of_ledger(found, truths[whole])

    return wholes, judge


async def _kept(path: Path, orders: int) -> None:
    up = [100.0]
    ledger = FileOrderLog(path, lambda: 1_000.0, lambda: ("boot", up[0]))
    for number in range(orders):
        up[0] += 0.5
        await ledger.begin(f"{number:032x}")
        if number % 7 == 0:
            await ledger.flies(number * (number % 2))
        await ledger.granted(number * 50)
    ledger.close()


def _untold_of_ledger(found: FileOrderLog, true: FileOrderLog) -> str:
    if not found.begun.items() <= true.begun.items():
        return "an order that nobody gave, or at another time"
    if found.leases_before < true.leases_before:
        return "leases begin below those that were granted"
    if found.last_flight != true.last_flight and (
        found.last_flight and found.last_flight.ago_s is not None
    ):
        return f"{found.last_flight} flew, and it was {true.last_flight}"
    is_same = (found.begun, found.last_flight) == (true.begun, true.last_flight)
    if not is_same and not found.damaged:
        return "it forgets in silence"
    return ""


KINDS: dict[str, Callable[[Path], tuple[list[bytes], Judge]]] = {
    "log": logs,
    "ledger": ledgers,
    "mark": partial(ledgers, suffix=".lock"),
}
