"""The damage of a flight log: the damaged bytes, the number of lost messages, and their times.

Each message of a recording has a number, and the end of the file has their count. So the readable
messages show how many are missing, whatever happened to the part that held them.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

_MOST_NAMED = 3  # places, and spans of time; the others are counted


@dataclass(frozen=True)
class Damage:
    """Damaged and missing parts of a flight log. False when there are none.

    The file of a killed process has no end (``is_ended``); that alone is no damage.
    """

    #: Byte ranges of the file that cannot be read, or are not as they were written.
    places: tuple[tuple[int, int], ...] = ()
    #: Messages that are missing at least, by topic; ``""`` where no topic is known.
    missing: dict[str, int] = field(default_factory=dict)
    #: Between which messages that are there others are missing, POSIX time, s; None for the
    #: beginning and the end of the file. Messages that arrive together are written together, so a
    #: time may be half a second off.
    spans_utc: tuple[tuple[float | None, float | None], ...] = ()
    #: The checksum of the whole file is wrong, though each of its parts can be read.
    is_changed: bool = False
    is_ended: bool = True  #: Whether the end is there.
    is_written: bool = False  #: Whether a program was still writing the file without an end.
    cut_bytes: int = 0  #: Size of the unfinished record at the end of a file without one.
    #: POSIX time of the first message and of the newest, s; None when there is none.
    began_utc: float | None = None
    #: POSIX time of the first message and of the newest, s; None when there is none.
    ended_utc: float | None = None

    def __bool__(self) -> bool:
        return bool(self.places or self.missing or self.is_changed)

    @property
    def damaged_bytes(self) -> int:
        """Size of all places together."""
        return sum(end - begin for begin, end in self.places)

    @property
    def missing_messages(self) -> int:
        """Messages that are missing at least."""
        return sum(self.missing.values())

    def __str__(self) -> str:
        said = []
        if self.places:
            where = _some([f"{begin:,} to {end - 1:,}" for begin, end in self.places])
            said.append(f"{self.damaged_bytes:,} bytes are damaged (bytes {where})")
        elif self.is_changed:
            said.append("the file was changed: its checksum is wrong")
        if self.missing:
            topics = ", ".join(f"{n:,} {topic or '?'}" for topic, n in sorted(self.missing.items()))
            said.append(f"{self.missing_messages:,} messages are missing at least ({topics})")
        elif self.places or self.is_changed:
            count = "no message is" if self.is_ended else "nobody knows how many messages are"
            said.append(f"{count} missing")
        if self.spans_utc:
            said.append(f"missing is from {_some([self._said(*one) for one in self.spans_utc])}")
        if self.is_written:
            said.append("it is still being recorded")
        elif not self.is_ended:
            ended = "it ended without being closed: its process was killed, or had no more disk"
            said.append("its end is missing" if self else ended)
        return "; ".join(said) or "nothing is missing"

    def _said(self, begin: float | None, end: float | None) -> str:
        zero = self.began_utc or 0.0
        first = "the beginning" if begin is None else f"{begin - zero:.1f} s"
        return f"{first} to " + ("the end" if end is None else f"{end - zero:.1f} s")


def _some(named: list[str]) -> str:
    more = len(named) - _MOST_NAMED
    return ", ".join(named[:_MOST_NAMED]) + (f" and {more} more" if more > 0 else "")


class _Row:
    """Messages of one channel, as far as they were read; and how many holes stood before them."""

    __slots__ = ("count", "expected", "gap", "holes", "last_ns")

    def __init__(self) -> None:
        self.expected = self.count = self.gap = self.holes = 0
        self.last_ns: int | None = None


@dataclass
class _Hole:
    """Between two messages others are missing, if any are: where that is seen it counts."""

    begin_ns: int | None
    end_ns: int | None = None
    counts: bool = False


class Losses:
    """Counts while a file is read once from its beginning to its end.

    ``is_ended``: whether the end was read. ``is_changed``: whether the checksum of the whole file
    is wrong.
    """

    def __init__(self) -> None:
        # Whether messages have numbers without gaps; other programs need not count.
        self.is_numbered = True
        self.is_ended = self.is_changed = False
        self.cut_bytes = 0  # size of the unfinished record at the end
        self._places: list[tuple[int, int]] = []
        self.topics: dict[int, str] = {}  # what each channel is called
        self._rows: dict[int, _Row] = {}
        self.counts: dict[int, int] = {}  # messages of each channel, by the end of the file
        self._unnamed: Counter[int] = Counter()
        self._holes: list[_Hole] = []
        self._is_open = False  # whether no message came since the newest hole
        self._first_ns: int | None = None
        self._last_ns: int | None = None

    def place(self, begin: int, end: int) -> None:
        """These bytes cannot be read, or are not as they were written."""
        if end <= begin:
            return
        if self._places and begin <= self._places[-1][1]:
            first, last = self._places.pop()
            begin, end = min(first, begin), max(last, end)
        self._places.append((begin, end))
        if not self._is_open:
            self._holes.append(_Hole(self._last_ns))
            self._is_open = True

    def hear(self, channel: int, number: int, at_ns: int, is_known: bool) -> None:
        """A message was read.

        ``at_ns``: when it was written, POSIX time in ns. ``is_known``: whether the file names its
        topic; else it is lost.
        """
        row = self._rows.get(channel)
        if row is None:
            row = self._rows[channel] = _Row()
        if self._first_ns is None:
            self._first_ns = at_ns
        if self._is_open:
            self._holes[-1].end_ns = at_ns
            self._is_open = False
        if number > row.expected and self.is_numbered:
            row.gap += number - row.expected
            if row.holes == len(self._holes):  # of a file that was mended: nothing else shows it
                self._holes.append(_Hole(row.last_ns, at_ns))
            for hole in self._holes[row.holes :]:
                hole.counts = True
        row.expected = number + 1
        row.holes = len(self._holes)
        row.last_ns = at_ns
        if self._last_ns is None or at_ns > self._last_ns:
            self._last_ns = at_ns
        row.count += 1
        if not is_known:
            self._unnamed[channel] += 1

    def damage(self) -> Damage:
        """The damage found so far."""
        missing: Counter[str] = Counter()
        for channel in sorted(self._rows.keys() | self.counts.keys()):
            row = self._rows.get(channel) or _Row()
            lost = max(row.gap, self.counts.get(channel, 0) - row.count)
            missing[self.topics.get(channel, "")] += lost + self._unnamed[channel]
        missing = +missing
        if self._is_open and missing:
            self._holes[-1].counts = True
        spans = [(_s(one.begin_ns), _s(one.end_ns)) for one in self._holes if one.counts]
        return Damage(
            places=tuple(self._places),
            missing=dict(missing),
            spans_utc=tuple(spans),
            is_changed=self.is_changed,
            is_ended=self.is_ended,
            cut_bytes=self.cut_bytes,
            began_utc=_s(self._first_ns),
            ended_utc=_s(self._last_ns),
        )


def _s(time_ns: int | None) -> float | None:
    return None if time_ns is None else time_ns / 1e9
