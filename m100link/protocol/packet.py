"""Telemetry packages: a flag word and the items whose bits are set (document 2.2.3.1).

Items follow in bit order and without gaps, so their places depend on the flags. Their layouts stand
in :mod:`m100link.protocol.items`; here they become the records of :mod:`m100link.protocol.records`,
when they are asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from operator import itemgetter
from struct import Struct, calcsize
from typing import Any, TypeVar

from m100link.errors import LayoutMismatch
from m100link.protocol.firmware import PROFILES, FirmwareProfile
from m100link.protocol.items import BY_RECORD, ITEMS, Item, ItemLayout, RecordViews
from m100link.protocol.records import ControlDevice, FlightStatus, RemoteControl, Time
from m100link.wire.frame import maker

R = TypeVar("R", bound=tuple[Any, ...])
K = TypeVar("K")
V = TypeVar("V")
_Values = tuple[Any, ...]
_Reader = Callable[[bytes, int], Any]

_FLAGS_SIZE = 2
_MOST_FLAG_WORDS = 256  # an aircraft sends some dozens, a hostile line all 4096
_UNSIGNED = {1: "B", 2: "H", 4: "I", 8: "Q"}

_span = lru_cache(maxsize=64)(ItemLayout.span)


def _reader(items: Sequence[Item], profile: FirmwareProfile, result: str) -> _Reader:
    """A function that reads the records of these items, which follow each other from an offset.

    It is written out and compiled, like the constructor of a named tuple: values go from the bytes
    into their record without a slice or a place looked up in between. For two items::

        def read(value, offset):
            (time_tick, battery_percent,) = unpack(value, offset)
            return [time((time_tick, None, None, tick_hz)), battery((battery_percent,))]

    ``result``: source of what it returns, with ``{}`` where the records go.
    """
    # Every name in the source is one of the table of items: no text from outside is compiled.
    names: dict[str, Any] = {}
    values, records, formats = [], [], ["<"]
    for item in items:
        layout = profile.items[item.name]
        formats.append(layout.format)
        values += [f"{item.name}_{field}, " for field in layout.fields]
        fields = [f"{item.name}_{f}" if f in layout.fields else "None" for f in item.fields]
        records.append(f"{item.name}(({', '.join((*fields, *item.profile_fields))},))")
        names[item.name] = maker(item.record)
        names |= {name: getattr(profile, name) for name in item.profile_fields}
    names["unpack"] = Struct("".join(formats)).unpack_from
    source = f"""
def read(value, offset):
    ({"".join(values)}) = unpack(value, offset)
    return {result.format(", ".join(records))}
"""
    exec(source, names)
    read: _Reader = names["read"]
    return read


@lru_cache(maxsize=256)
def _item_reader(bit: int, profile: FirmwareProfile) -> _Reader:
    return _reader((ITEMS[bit],), profile, "{}")  # the record itself


def _bytes_at(*spans: slice) -> Callable[[bytes], object]:
    """A function that takes these bytes of a packet: one number, or several in a row."""
    # Byte by byte: small numbers exist already, slices would be made.
    places: list[Any] = [at for span in spans for at in range(span.start, span.stop)]
    return itemgetter(*(places or [slice(0)]))


class _Plan:
    """Where everything is in a packet with one set of flags under one profile.

    ``pack``: makes a packet of flag word and values. ``unpack``: reads all values at once, without
    the flag word.

    Of each package that arrives, three things are asked for, of all lines by one plan. ``tick``
    reads that of the clock; None: there is none. ``control`` takes the bytes that show who controls
    the aircraft, to be compared. ``status`` takes the flight status; None: there is none.
    """

    __slots__ = (
        *("control", "flags", "items", "pack", "places", "profile", "read", "size", "status"),
        *("tick", "unpack"),
    )

    def __init__(self, flags: int, profile: FirmwareProfile) -> None:
        self.flags, self.profile = flags, profile
        # Per bit the offset of the item and how to read its values.
        self.items: dict[int, tuple[int, Callable[[bytes, int], _Values]]] = {}
        # Per record class the offset of its item and how to read the record.
        self.places: dict[type[Any], tuple[int, _Reader]] = {}
        # Reads all records at once; None until somebody asks for them.
        self.read: _Reader | None = None
        whole = ""
        for item in ITEMS:
            if flags >> item.bit & 1:
                layout = profile.items[item.name]
                offset = calcsize("<H" + whole)
                self.items[item.bit] = offset, Struct("<" + layout.format).unpack_from
                self.places[item.record] = offset, _item_reader(item.bit, profile)
                whole += layout.format
        self.pack, self.unpack = Struct("<H" + whole).pack, Struct("<2x" + whole).unpack
        self.size = calcsize("<H" + whole)  # bytes of the packet
        tick, status = self.span(Time, "tick"), self.span(FlightStatus, "status")
        self.tick: Callable[[bytes], tuple[int]] | None = None
        if kind := _UNSIGNED.get(tick.stop - tick.start):
            self.tick = Struct(f"<{tick.start}x{kind}").unpack_from
        self.status = _bytes_at(status) if status.stop else None
        mode, device = self.span(RemoteControl, "mode"), self.span(ControlDevice, "control")
        self.control = _bytes_at(mode, device)

    def span(self, record: type[Any], field: str) -> slice:
        """The bytes that are a field's: none where the packet or the firmware lacks it."""
        item = BY_RECORD[record]
        place, layout = self.items.get(item.bit), self.profile.items.get(item.name)
        if place is None or layout is None or field not in layout.fields:
            return slice(0, 0)
        span = _span(layout, field)
        return slice(place[0] + span.start, place[0] + span.stop)

    def compile(self) -> _Reader:
        """Make :attr:`read`."""
        self.read = _reader([ITEMS[bit] for bit in self.items], self.profile, "[{}]")
        return self.read


def remember(memory: dict[K, V], key: K, value: V) -> V:
    """Keep a value for a flag word or its plan; of more than aircraft send, the newest."""
    if len(memory) >= _MOST_FLAG_WORDS:
        memory.clear()
    memory[key] = value
    return value


def _plan(flags: int, profile: FirmwareProfile) -> _Plan:
    """The plan for flags that are all among ``profile.item_flags``, remembered by the profile."""
    plan: _Plan | None = profile.plans.get(flags)
    return plan or remember(profile.plans, flags, _Plan(flags, profile))


def telemetry_size(flags: int, profile: FirmwareProfile) -> int:
    """Bytes of a telemetry value with these flags, flag word included.

    Bits of items that the firmware does not have are left out.
    """
    return _plan(flags & profile.item_flags, profile).size


def fits(value: bytes, profile: FirmwareProfile) -> bool:
    """Whether a telemetry value has the right flags and length under a profile."""
    flags = value[0] | value[1] << 8 if len(value) >= _FLAGS_SIZE else ~0
    plan: _Plan | None = profile.plans.get(flags)
    if plan is None:
        plan = None if flags & ~profile.item_flags else _plan(flags, profile)
    return plan is not None and plan.size == len(value)


def fitting_profiles(value: bytes) -> list[str]:
    """Names of the profiles under which a telemetry value has the right flags and length."""
    return [p.name for p in PROFILES.values() if fits(value, p)]


class TelemetryPacket(RecordViews):
    """One telemetry package. Items are read from the bytes when they are asked for.

    Args:
        value: The command value: flag word and items.
        profile: Firmware profile of the sender.

    Raises:
        LayoutMismatch: The length does not fit the flags under this profile, or bits are set that
            belong to none of its items. (It is also what :meth:`Command.parse` callers see as a
            ``ValueError``.)
    """

    __slots__ = ("_plan", "flags", "profile", "value")

    def __init__(self, value: bytes, profile: FirmwareProfile) -> None:
        try:
            plan: _Plan = profile.plans[value[0] | value[1] << 8]
        except LookupError:
            plan = plan_of(value, profile)
        if plan.size != len(value):
            raise mismatch(value, profile)
        self._plan = plan
        self.flags = plan.flags
        self.profile = profile
        self.value = value

    @property
    def indices(self) -> Iterable[int]:
        """Bit numbers of the items that the packet carries, ascending."""
        return self._plan.items

    def get(self, record: type[R]) -> R | None:
        """The record of that class, None when the packet does not carry it."""
        place = self._plan.places.get(record)
        if place is None:
            if record not in BY_RECORD:
                raise KeyError(record)
            return None
        offset, read = place
        found: R = read(self.value, offset)
        return found

    def row(self) -> tuple[float, ...]:
        """Every raw value that the packet carries, in wire order, named by :attr:`columns`.

        The fastest way to read a whole packet, for logs and arrays.
        """
        return self._plan.unpack(self.value)

    @property
    def columns(self) -> tuple[str, ...]:
        """Name of each value of :meth:`row`: item and wire field, such as ``position.height``."""
        return tuple(
            f"{name}.{field}" for name, layout, *_ in self._layouts() for field in layout.fields
        )

    def _layouts(self) -> Iterator[tuple[str, ItemLayout, _Values]]:
        for bit, (offset, unpack) in self._plan.items.items():
            name = ITEMS[bit].name
            yield name, self.profile.items[name], unpack(self.value, offset)

    def records(self) -> list[Any]:
        """Every record that the packet carries, in bit order."""
        plan = self._plan
        found: list[Any] = (plan.read or plan.compile())(self.value, _FLAGS_SIZE)
        return found

    def raw_items(self) -> dict[str, dict[str, Any]]:
        """Raw values by item name and wire field name, for dumps and golden vectors."""
        return {
            name: dict(zip(layout.fields, values, strict=True))
            for name, layout, values in self._layouts()
        }

    def __repr__(self) -> str:
        return f"TelemetryPacket({', '.join(map(repr, self.records()))})"


def plan_of(value: bytes, profile: FirmwareProfile) -> _Plan:
    """The plan that the flags of a value ask for.

    Raises ``LayoutMismatch``: see :class:`TelemetryPacket`.
    """
    flags = value[0] | value[1] << 8 if len(value) >= _FLAGS_SIZE else ~0
    if flags & ~profile.item_flags:
        raise mismatch(value, profile)
    return _plan(flags, profile)


def mismatch(value: bytes, profile: FirmwareProfile) -> LayoutMismatch:
    """The error for a value that does not fit its flags under the profile."""
    others = [name for name in fitting_profiles(value) if name != profile.name]
    if len(value) < 2:
        seen = f"a telemetry value of {len(value)} byte(s) has no flag word"
    else:
        flags = value[0] | value[1] << 8
        seen = (
            f"telemetry with flags 0x{flags:04X} takes {telemetry_size(flags, profile)} bytes "
            f"under firmware {profile}, there are {len(value)}"
        )
        if flags & ~profile.item_flags:
            seen = (
                f"telemetry flags 0x{flags:04X} have bits set that firmware {profile} has reserved"
            )
    return LayoutMismatch(
        seen,
        cause=f"the aircraft speaks firmware {' or '.join(others)}" if others else "",
        remedy=f"choose firmware={others[0]!r}" if others else "compare the firmware version",
    )


def encode_telemetry(items: Mapping[str, Sequence[float]], profile: FirmwareProfile) -> bytes:
    """Build a telemetry value.

    Args:
        items: Raw values per item name in wire order.
        profile: Layout to use.

    Raises:
        struct.error: Values that do not fit the layout.
        KeyError: An item name that does not exist under this profile.
    """
    unknown = set(items) - set(profile.items)
    if unknown:
        raise KeyError(unknown.pop())
    flags = 0
    values: list[float] = []
    for item in ITEMS:
        if item.name in items:
            flags |= 1 << item.bit
            values += items[item.name]
    return _plan(flags, profile).pack(flags, *values)
