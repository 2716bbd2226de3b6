"""Whose setpoints are flown, of all who send some (pure logic, ``now`` is an argument).

One publisher has the stick at a time. It gets it by beginning to send while nobody has it, or by
being the only one that sends when control is obtained; it loses it by silence, and when control
ends. Whoever is refused has to be silent first: nobody's setpoints begin to fly because another
publisher has died.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from m100link.apps.agent.way_time import MAX_LATE, WayTime

__all__ = ["SILENCE_S", "Stick"]

SILENCE_S = 0.5
"""Seconds without a setpoint after which a publisher has let go."""

_JITTER_S = 0.1
"""By how much a pause may be shorter where it is made than where it is heard."""

_MOST_SENDERS = 32


@dataclass(slots=True)
class _Sender:
    """A publisher of setpoints.

    Attributes:
        heard_at: When it was heard last, s.
        sent_at: When that was sent, s, by the clock of its sender.
        sequence: How many it had sent by then, as it counts.
        way: How long its setpoints are on their way.
    """

    heard_at: float = -math.inf
    sent_at: float = -math.inf
    sequence: int = 0
    way: WayTime = field(default_factory=WayTime)


class Stick:
    """Who has it.

    Attributes:
        holder: Id of who has it; None for nobody.
        is_open: Whether anybody may have it: control is held.
        refused: Setpoints that were not flown, by the reason.
    """

    def __init__(self) -> None:
        self.holder: bytes | None = None
        self.is_open = False
        self.refused = {"late": 0, "other": 0, "closed": 0}
        self._senders: dict[bytes, _Sender] = {}  # who was heard last stands last
        # More of them send than are known: until then nobody counts as beginning.
        self._crowded_until = -math.inf

    def begin(self, now: float) -> None:
        """Control was obtained: who sends alone has the stick."""
        self.is_open = True
        sending = [one for one, sender in self._senders.items() if self._sends(sender, now)]
        is_alone = len(sending) == 1 and now >= self._crowded_until
        self.holder = sending[0] if is_alone else None

    def end(self) -> None:
        """Control has ended, or somebody pressed STOP."""
        self.is_open, self.holder = False, None

    def hear(self, sender: bytes, sent_at: float, now: float, sequence: int = 0) -> str:
        """A setpoint came. Returns why it is not flown, empty where it is.

        Args:
            sender: Id of its publisher.
            sent_at: When it was sent, s, by the clock of its sender.
            now: s.
            sequence: Its number, as its sender counts.
        """
        known = self._senders.pop(sender, None)
        if known is None:
            if not self._has_room(now):
                self._crowded_until = now + SILENCE_S
                return self._refuse("other" if self.is_open else "closed")
            known = _Sender()
        self._senders[sender] = known
        self.look(now)
        begins = self._begins(known, sent_at, now, sequence) and now >= self._crowded_until
        known.heard_at, known.sent_at, known.sequence = now, sent_at, sequence
        late = known.way.late(sent_at, now)
        if not self.is_open:
            return self._refuse("closed")
        if self.holder is None and begins:
            self.holder = sender
        if self.holder != sender:
            return self._refuse("other")
        return self._refuse("late") if late > MAX_LATE else ""

    def _begins(self, known: _Sender, sent_at: float, now: float, sequence: int) -> bool:
        """Whether it was silent by its own account, too.

        Who went on sending while its way was cut does not fly on when that is whole again: then
        numbers are missing, or what waited was sent without a pause.
        """
        if self._sends(known, now):
            return False
        was_silent = sent_at - known.sent_at >= SILENCE_S - _JITTER_S
        return known.heard_at == -math.inf or (was_silent and sequence <= known.sequence + 1)

    def _has_room(self, now: float) -> bool:
        """Whether one more can be known, once those who fell silent are forgotten."""
        while len(self._senders) >= _MOST_SENDERS:
            oldest, sender = next(iter(self._senders.items()))
            if self._sends(sender, now):
                return False
            del self._senders[oldest]
        return True

    def look(self, now: float) -> None:
        """Let time pass: who is silent lets go."""
        if self.holder is not None:
            holder = self._senders.get(self.holder)
            if holder is None or not self._sends(holder, now):
                self.holder = None

    def _refuse(self, why: str) -> str:
        self.refused[why] += 1
        return why

    @staticmethod
    def _sends(sender: _Sender, now: float) -> bool:
        return now - sender.heard_at < SILENCE_S
