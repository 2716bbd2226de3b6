"""A flight in sentences: the holder of control, each wish and its outcome, and how it ended."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any, NamedTuple

from m100link.log.channels import EVENT
from m100link.log.reading import FlightLog
from m100link.log.story import FlightSummary


class Sentence(NamedTuple):
    """Something that happened.

    Attributes:
        at_s: When, s after the beginning of the log; less than 0 for what was before it.
        kind: Its subject: ``client``, ``lease``, ``control``, ``order``, ``setpoints``, ``plan``,
            ``journal``, ``text``, ``flight``, ``alarm``, ``sent`` or ``line``.
        who: The client or person that acted; empty where the log does not say it.
        text: The sentence.
    """

    at_s: float
    kind: str
    who: str
    text: str


def report(flight: FlightLog, story: FlightSummary) -> list[Sentence]:
    """The sentences about a flight, in the order of time.

    Args:
        flight: The log. One of an earlier release has no names of clients.
        story: Its summary.
    """
    first = next(flight.messages(), None)
    began_at = 0.0 if first is None else first.at
    reader = _NoteReader()
    found = list(_flown(story))
    for message in flight.messages(EVENT):
        # Of another writer, or with a bit turned over: ours holds what is looked for.
        with suppress(ValueError, LookupError, TypeError, AttributeError):
            note = message.content()
            at_s = message.at - began_at - float(note.get("earlier_s", 0.0))
            for kind, who, text in reader.read(note):
                found.append(Sentence(at_s, kind, _plain(who), _plain(text)))
    return sorted(found, key=lambda one: one.at_s)


def _flown(story: FlightSummary) -> Iterator[Sentence]:
    for phase in story.phases:
        yield Sentence(phase.begin_s, "flight", "", f"The aircraft was in phase {phase.name}.")
    for alarm in story.alarms:
        lasted = f" for {alarm.end_s - alarm.begin_s:.1f} s" if alarm.end_s > alarm.begin_s else ""
        yield Sentence(alarm.begin_s, "alarm", "", f"Alarm {alarm.name}{lasted}: {alarm.text}.")
    for command in story.commands:
        yield Sentence(command.at_s, "sent", "", f"Sent to the aircraft: {command}.")
    for stream in story.streams:
        text = f"Sent for {stream.end_s - stream.begin_s:.1f} s: {stream.text}."
        yield Sentence(stream.begin_s, "sent", "", text)


class _NoteReader:
    """Makes sentences of notes."""

    def __init__(self) -> None:
        self._holder = ""
        self._readers: dict[str, Callable[[dict[str, Any]], tuple[str, str]]] = {
            "client": self._client,
            "lease": self._lease,
            "control": self._control,
            "order": self._order,
            "setpoints": self._setpoints,
            "plan": self._plan,
            "text": lambda note: (note["client"], note["text"] + "."),
            "journal": self._journal,
            "connection": self._connection,
        }

    def read(self, note: dict[str, Any]) -> Iterator[tuple[str, str, str]]:
        """Kind, actor and text; none for a note that adds nothing."""
        reader = self._readers.get(note["event"])
        who, text = reader(note) if reader is not None else ("", "")
        if text:
            yield ("line" if note["event"] == "connection" else note["event"]), who, text

    def _client(self, note: dict[str, Any]) -> tuple[str, str]:
        name = note["name"]
        return name, f"{name} came." if note["is_there"] else f"{name} left: {note['reason']}."

    def _lease(self, note: dict[str, Any]) -> tuple[str, str]:
        before, self._holder = self._holder, note["holder"]
        if self._holder:
            whom = f" from {before}" if before and note["why"] == "taken over" else ""
            return self._holder, f"{self._holder} has the lease ({note['why']}{whom})."
        return before, f"{before} has the lease no more ({note['why']})." if before else ""

    def _control(self, note: dict[str, Any]) -> tuple[str, str]:
        if note["after"] == "held":
            return self._holder, f"Control authority was obtained for {self._holder or 'nobody'}."
        if note["before"] == "held":
            return self._holder, f"Control authority ended: {note['why']}."
        return "", ""

    def _order(self, note: dict[str, Any]) -> tuple[str, str]:
        who, what, stage = note["by"] or note["client"], note["order"], note["stage"]
        said = ", ".join(
            f"{name} {value}" for name, value in note.get("arguments", {}).items() if value != ""
        )
        what += f" ({said})" if said else ""
        if stage == "failed":
            return who, f"{who} did not get {what}: {note['seen']}."
        ends = {"asked": "asked for {}", "accepted": "began {}", "done": "got {}"}
        return who, f"{who} {ends[stage].format(what)}."

    def _setpoints(self, note: dict[str, Any]) -> tuple[str, str]:
        who = note["by"] or note["client"]
        if note.get("stage") == "refused":
            return who, f"Setpoints of {who} were refused: {note['seen']}."
        one = note["setpoint"]
        values = f"{one['x']:g}, {one['y']:g}, {one['z']:g}, yaw {one['yaw']:g}"
        return who, f"{who} began to send setpoints ({one['mode']['horizontal']}: {values})."

    def _plan(self, note: dict[str, Any]) -> tuple[str, str]:
        count, name = len(note["waypoints"]), note["name"]
        return name, f"{name} uploaded a plan of {count} waypoints." if count else ""

    def _journal(self, note: dict[str, Any]) -> tuple[str, str]:
        return "", f"{note['text'][:1].upper()}{note['text'][1:]}."

    def _connection(self, note: dict[str, Any]) -> tuple[str, str]:
        seen = str(note.get("error") or "").partition("\n")[0]
        return "", "" if note["is_connected"] else f"The connection ended: {seen}."


def _plain(text: str) -> str:
    """Strangers' names are in it, and a terminal obeys some characters."""
    return "".join(one if one.isprintable() else "�" for one in text)
