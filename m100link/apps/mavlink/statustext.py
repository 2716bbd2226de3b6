"""Texts for people: why something was refused, and what happened by itself."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator

from m100link.apps.mavlink.codec import Message
from m100link.apps.mavlink.numbers import Severity

__all__ = ["Texts", "severity_of"]

_SIZE = 50
_MOST_PARTS = 4
_PER_S, _AT_ONCE = 10.0, 20.0
_AGAIN_S = 2.0

_SEVERITIES = {"info": Severity.INFO, "warning": Severity.WARNING, "error": Severity.ERROR}


def severity_of(level: str) -> Severity:
    """Of an event of the agent."""
    return _SEVERITIES.get(level, Severity.INFO)


class Texts:
    """Texts on their way out: few at once, and none twice in two seconds."""

    def __init__(self) -> None:
        self._waiting: deque[tuple[Severity, str]] = deque(maxlen=int(_AT_ONCE))
        self._told: dict[str, float] = {}
        self._count = 0
        self._allowed, self._at = _AT_ONCE, 0.0

    def tell(self, severity: Severity, text: str) -> None:
        """Send it to everybody."""
        self._waiting.append((severity, text))

    def due(self, now: float) -> Iterator[Message]:
        """The messages; a long text comes in parts of 50 characters, four at most."""
        self._allowed = min(_AT_ONCE, self._allowed + (now - self._at) * _PER_S)
        self._at = now
        self._told = {text: at for text, at in self._told.items() if now - at < _AGAIN_S}
        while self._waiting and self._allowed >= 1.0:
            severity, text = self._waiting.popleft()
            if text in self._told:
                continue
            self._told[text] = now
            self._allowed -= 1.0
            yield from self._parts(severity, text)

    def _parts(self, severity: Severity, text: str) -> Iterator[Message]:
        plain = " ".join(text.encode("ascii", "replace").decode().split())
        if len(plain) <= _SIZE:
            yield Message("STATUSTEXT", {"severity": severity, "text": plain})
            return
        self._count = self._count % 0xFFFF + 1  # 0 is a text in one part
        for number in range(_MOST_PARTS):
            part = plain[number * _SIZE : (number + 1) * _SIZE]
            fields = {"severity": severity, "text": part, "id": self._count, "chunk_seq": number}
            yield Message("STATUSTEXT", fields)
            if len(part) < _SIZE:
                return  # a part that is not full is the last one
