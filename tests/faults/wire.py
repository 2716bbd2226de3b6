"""One direction of a bad line: what goes in as frames comes out lost, damaged, late or twice.

It shares nothing with the line of the simulator but the header's length field, and counts what it
did, so that both ends can be held to what they were given.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from random import Random

__all__ = ["Faults", "Wire"]

_APART_S = 1e-6  # what is due at the same time keeps its order


@dataclass(frozen=True, slots=True)
class Faults:
    """What a direction does to each frame.

    Attributes:
        loss: Probability that it does not arrive.
        bit_errors: Probability of each bit to be the other one.
        duplicates: Probability that it arrives twice, one after the other.
        spikes: Probability that it comes up to ``spike_s`` later; what follows waits behind it.
        spike_s: Longest spike, s.
        stall_s: How long nothing passes at the beginning of each period, and all of it then, s.
        stall_every_s: That period, s.
        overtaking: Whether later frames pass those that a spike holds, which no cable does.
    """

    loss: float = 0.0
    bit_errors: float = 0.0
    duplicates: float = 0.0
    spikes: float = 0.0
    spike_s: float = 1.2
    stall_s: float = 0.0
    stall_every_s: float = 10.0
    overtaking: bool = False

    def scaled(self, scale: float) -> Faults:
        """The same for time-outs that are so much longer."""
        return replace(
            self,
            spike_s=self.spike_s * scale,
            stall_s=self.stall_s * scale,
            stall_every_s=self.stall_every_s * scale,
        )


class Wire:
    """Carries frames from one end to the other.

    Args:
        dice: Every choice comes from it.
        faults: May be replaced at any time.
        deliver: Takes what arrives.

    Attributes:
        sent: Frames that went in.
        intact: Those that came out as they went in, each copy counted.
    """

    def __init__(self, dice: Random, faults: Faults, deliver: Callable[[bytes], None]) -> None:
        self._loop = asyncio.get_running_loop()
        self._dice = dice
        self._deliver = deliver
        self._waiting = bytearray()  # what is not a whole frame yet
        self._last_at = -math.inf
        self.faults = faults
        self.sent = 0
        self.intact = 0

    def write(self, data: bytes | bytearray | memoryview) -> None:
        """Take bytes of undamaged frames, in whatever pieces."""
        self._waiting += data
        while len(self._waiting) >= 3:
            length = self._waiting[1] | (self._waiting[2] & 0x03) << 8
            if len(self._waiting) < length:
                return
            frame = bytes(self._waiting[:length])
            del self._waiting[:length]
            self._carry(frame)

    def _carry(self, frame: bytes) -> None:
        faults, dice = self.faults, self._dice
        self.sent += 1
        if dice.random() < faults.loss:
            return
        for _ in range(2 if dice.random() < faults.duplicates else 1):
            arriving = self._damaged(frame)
            self._loop.call_at(self._arrival(), self._arrive, arriving, arriving == frame)

    def _arrival(self) -> float:
        """When the next frame comes out."""
        faults, at = self.faults, self._loop.time()
        if self._dice.random() < faults.spikes:
            at += self._dice.random() * faults.spike_s
        since = at % faults.stall_every_s
        if since < faults.stall_s:
            at += faults.stall_s - since
        if not faults.overtaking:
            at = self._last_at = max(at, self._last_at + _APART_S)
        return at

    def _damaged(self, frame: bytes) -> bytes:
        rate = self.faults.bit_errors
        if not rate:
            return frame
        arriving, at = bytearray(frame), -1
        while True:
            # How far it is to the next wrong bit, instead of a throw for each.
            at += 1 + int(math.log(1.0 - self._dice.random()) / math.log(1.0 - rate))
            if at >= 8 * len(frame):
                return bytes(arriving)
            arriving[at >> 3] ^= 1 << (at & 7)

    def _arrive(self, data: bytes, is_intact: bool) -> None:
        self.intact += is_intact
        # Reads end anywhere.
        cut = self._dice.randrange(len(data)) if self._dice.random() < 0.3 else 0
        if cut:
            self._deliver(data[:cut])
        self._deliver(data[cut:])
