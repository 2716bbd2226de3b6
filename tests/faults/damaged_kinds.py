"""What is stored: how each kind is written, and what a reader must tell of a damaged file."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Callable
from pathlib import Path
from unittest.mock import patch

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
    logging.getLogger("m100link.log").setLevel(logging.ERROR)  # ten thousand warnings
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
        return f"{damage.missing_messages} are told of {len(lost)} that are missing"
    newest = {every[number].topic: number for number in numbers}
    for number in sorted(set(range(len(every))) - set(numbers)):
        message = every[number]
        is_within = any(
            (one or 0.0) - _BATCH_S <= message.utc <= (other or math.inf) + _BATCH_S
            for one, other in damage.spans_utc
        )
        if number < newest.get(message.topic, -1) and not is_within:
            return f"{message.topic} at {message.utc} is within no span that is told"
    if whole.endswith(copy[-_MAGIC_BYTES:]) and len(copy) == len(whole) and lost and not damage:
        return "a hole is told as the end of a process"
    was_ended = whole.endswith(b"\x89MCAP0\r\n")
    if was_ended and copy[: len(whole) - _MAGIC_BYTES] != whole[:-_MAGIC_BYTES] and not is_told:
        return "a change of the file is not told"
    return ""


KINDS: dict[str, Callable[[Path], tuple[list[bytes], Judge]]] = {"log": logs}
