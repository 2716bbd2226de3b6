"""What a flight's log tells beside telemetry: commands and their answers, control, connection."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

from m100link.log.channels import COMMAND, EVENT, LINK
from m100link.log.curves import Curve
from m100link.log.reading import FlightLog, Message

__all__ = ["Moment", "Span", "Told", "read_told"]

_STREAMS = {"move", "virtual_rc_data", "follow_target"}  # sent many times a second
_LOOKS = {"get_version", "query_task"}  # ask, and change nothing
_HEAD = {"is_ack", "direction", "session", "sequence", "command"}
_ASIDE = {"task_sequence", "redacted"}  # numbers that say nothing to anybody
_STREAM_GAP_S = 0.5
_CLOSED = "the link was closed by this side"


class Span(NamedTuple):
    """Something that lasted.

    Attributes:
        name: What.
        begin_s, end_s: From when to when, s after the beginning of the log.
        text: More about it, for people.
    """

    name: str
    begin_s: float
    end_s: float
    text: str = ""


class Moment(NamedTuple):
    """A command that was sent, and what became of it.

    Attributes:
        at_s: When it was first sent, s after the beginning of the log.
        command: Its name.
        arguments: What was asked, by name.
        outcome: Name of the code it was answered with; None: no answer is in the log.
        after_s: Until the answer came, s; None without one.
    """

    at_s: float
    command: str
    arguments: dict[str, Any]
    outcome: str | None
    after_s: float | None

    def __str__(self) -> str:
        said = " ".join(f"{name}={value}" for name, value in self.arguments.items())
        return f"{self.command} {said}".rstrip() + f": {self.outcome or 'no answer'}"


@dataclass
class Told:
    """What was told.

    Attributes:
        began_at: Clock of the first message, s.
        began_utc: The same as POSIX time; None when there is no message.
        duration_s: From the first message to the last.
        commands: In the order in which they were sent.
        streams: When setpoints and the like were sent, by name of the command.
        control: Who had control, as far as events tell it: ``program`` or ``pilot``.
        alarms: What went wrong with control and connection.
        discarded: Bytes per second that belonged to no frame.
        round_trip_ms: Mean time until an answer, ms.
        repeats: Commands that were sent again because no answer came.
        discarded_bytes: All bytes that belonged to no frame.
        ended: Why the connection ended; None when the log does not say it.
    """

    began_at: float = 0.0
    began_utc: float | None = None
    duration_s: float = 0.0
    commands: list[Moment] = field(default_factory=list)
    streams: list[Span] = field(default_factory=list)
    control: list[Span] = field(default_factory=list)
    alarms: list[Span] = field(default_factory=list)
    discarded: Curve = field(default_factory=Curve)
    round_trip_ms: Curve = field(default_factory=lambda: Curve(gap_s=10.0))
    repeats: int = 0
    discarded_bytes: int = 0
    ended: str | None = None


def read_told(flight: FlightLog) -> Told:
    """What the messages of a log say."""
    reader: _Reader | None = None
    for message in flight.messages():
        if reader is None:
            reader = _Reader(message)
        try:
            reader.hear(message)
        except (ValueError, LookupError, TypeError, AttributeError):
            continue  # not written by us
    return Told() if reader is None else reader.end()


class _Reader:
    def __init__(self, first: Message) -> None:
        self.told = Told(began_at=first.at, began_utc=first.utc)
        # Number in `commands` and time of what waits for its answer, by session and sequence.
        self._open: dict[tuple[int, int], tuple[int, float]] = {}
        self._streams: dict[str, tuple[float, float, int]] = {}
        self._holder: tuple[str, float] = ("pilot", 0.0)
        self._counted: tuple[float, dict[str, Any]] | None = None

    def hear(self, message: Message) -> None:
        at = message.at - self.told.began_at
        self.told.duration_s = max(self.told.duration_s, at)
        if message.topic not in (COMMAND, EVENT, LINK):
            return
        content = message.content()
        if message.topic == COMMAND:
            if content["is_ack"] and content["direction"] == "rx":
                self._answer(at, content)
            elif not content["is_ack"] and content["direction"] == "tx":
                self._command(at, content)
        elif message.topic == EVENT:
            self._event(at, content)
        else:
            self._count(at, content)

    def _command(self, at: float, content: dict[str, Any]) -> None:
        name = content["command"]
        if name in _STREAMS:
            begin, last, count = self._streams.get(name, (at, at, 0))
            if at - last > _STREAM_GAP_S:
                self._stream(name)
                begin, count = at, 0
            self._streams[name] = (begin, at, count + 1)
        elif name not in _LOOKS:
            exchange = content["session"], content["sequence"]
            if exchange[0] and exchange in self._open:
                return  # the same once more
            self._open[exchange] = len(self.told.commands), at
            arguments = {key: value for key, value in content.items() if key not in _HEAD | _ASIDE}
            self.told.commands.append(Moment(at, name, arguments, None, None))

    def _stream(self, name: str) -> None:
        begin, last, count = self._streams[name]
        self.told.streams.append(Span(name, begin, last, f"{count} × {name}"))

    def _answer(self, at: float, content: dict[str, Any]) -> None:
        found = self._open.pop((content["session"], content["sequence"]), None)
        if found is None:
            return
        number, asked_at = found
        said = content.get("ack", content.get("problem"))
        outcome = said.get("name") if isinstance(said, dict) else said
        asked = self.told.commands[number]
        self.told.commands[number] = asked._replace(outcome=str(outcome), after_s=at - asked_at)

    def _event(self, at: float, content: dict[str, Any]) -> None:
        if content["event"] == "connection":
            error = content.get("error") or ""
            self.told.ended = None if content["is_connected"] else error
            if not content["is_connected"] and error != _CLOSED:
                self.told.alarms.append(Span("link_lost", at, at, error))
        elif content["event"] == "authority":
            before, after = content["before"], content["after"]
            if before == "held" and after not in ("held", "releasing"):
                reason = f"control was lost: {content.get('reason') or after}"
                self.told.alarms.append(Span("authority_lost", at, at, reason))
            holder = "program" if after in ("held", "releasing") else "pilot"
            if holder != self._holder[0]:
                self._hand_over(at)
                self._holder = holder, at

    def _hand_over(self, at: float) -> None:
        name, since = self._holder
        if at > since:
            self.told.control.append(Span(name, since, at))

    def _count(self, at: float, content: dict[str, Any]) -> None:
        if self._counted is not None:
            last, before = self._counted
            told = self.told
            seconds = max(at - last, 1e-3)
            lost = content["discarded_bytes"] - before["discarded_bytes"]
            told.discarded.add(at, max(0, lost) / seconds)
            told.repeats = content["repeats"]
            told.discarded_bytes = content["discarded_bytes"]
            acks = content["acks"] - before["acks"]
            taken_s = content["round_trips"]["total_s"] - before["round_trips"]["total_s"]
            if acks > 0:
                told.round_trip_ms.add(at, 1000.0 * taken_s / acks)
        self._counted = at, content

    def end(self) -> Told:
        for name in self._streams:
            self._stream(name)
        self.told.streams.sort(key=lambda span: span.begin_s)
        self._hand_over(self.told.duration_s)
        return self.told
