"""Telemetry packages: a flag word and the items whose bits are set (document 2.2.3.1).

Items follow in bit order and without gaps, so their places depend on the flags. Their layouts stand
in :mod:`m100link.protocol.items`; here they become the records of :mod:`m100link.protocol.records`,
when they are asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from operator import itemgetter
from struct import Struct
from typing import Any, TypeVar

from m100link.errors import LayoutMismatch
from m100link.protocol.firmware import PROFILES, FirmwareProfile
from m100link.protocol.items import BY_RECORD, ITEMS, Item, ItemLayout, RecordViews

__all__ = [
    "TelemetryPacket",
    "encode_telemetry",
    "field_span",
    "fitting_profiles",
    "telemetry_size",
]


_BITS = {record: item.bit for record, item in BY_RECORD.items()}

R = TypeVar("R", bound=tuple[Any, ...])
_Values = tuple[Any, ...]
_Pick = Callable[[_Values], _Values]
_new = tuple.__new__

# Behind the unpacked values stand what a layout lacks, None, and what the profile itself says.
_FROM_PROFILE = tuple(dict.fromkeys(name for item in ITEMS for name in item.profile_fields))
_LACKING = -1 - len(_FROM_PROFILE)


def _picker(item: Item, layout: ItemLayout, start: int) -> _Pick:
    """How the fields of a record are picked out of unpacked values, those of the item at start."""
    places = [
        start + layout.fields.index(name) if name in layout.fields else _LACKING
        for name in item.fields
    ]
    places += [_FROM_PROFILE.index(name) - len(_FROM_PROFILE) for name in item.profile_fields]
    first, end = places[0], places[0] + len(places)
    if places == list(range(first, end)):
        return itemgetter(slice(first, end))
    return itemgetter(*places)


class _Plan:
    """Where everything is in a packet with one set of flags under one profile.

    Attributes:
        size: Bytes of the packet.
        pack: Makes a packet of flag word and values.
        unpack: Reads all of them at once.
        extras: What has to follow unpacked values before records are picked out of them.
        items: Per item its offset, how to read it alone, and how to pick its record.
        records: Record class per item, and how to pick it out of all values.
    """

    __slots__ = ("extras", "items", "pack", "records", "size", "unpack")

    def __init__(self, flags: int, profile: FirmwareProfile) -> None:
        self.extras = (None, *(getattr(profile, name) for name in _FROM_PROFILE))
        self.items: dict[int, tuple[int, Callable[[bytes, int], _Values], _Pick]] = {}
        self.records: list[tuple[type[Any], _Pick]] = []
        whole, start = Struct("<H"), 1
        for item in ITEMS:
            if flags >> item.bit & 1:
                layout = profile.items[item.name]
                alone = Struct("<" + layout.format)
                self.items[item.bit] = (whole.size, alone.unpack_from, _picker(item, layout, 0))
                self.records.append((item.record, _picker(item, layout, start)))
                whole = Struct(whole.format + layout.format)
                start += len(layout.fields)
        self.size, self.pack, self.unpack = whole.size, whole.pack, whole.unpack


@lru_cache(maxsize=4 * 4096)
def _plan(flags: int, profile: FirmwareProfile) -> _Plan:
    """The plan for flags that are all among ``profile.item_flags``."""
    return _Plan(flags, profile)


def telemetry_size(flags: int, profile: FirmwareProfile) -> int:
    """Bytes of a telemetry value with these flags, flag word included.

    Bits of items that the firmware does not have are left out.
    """
    return _plan(flags & profile.item_flags, profile).size


def field_span(record: type[Any], field: str, flags: int, profile: FirmwareProfile) -> slice | None:
    """Which bytes of a telemetry value are a field's, for who reads nothing else of it.

    Args:
        record: Record class of the item.
        field: Wire name of the field.
        flags: Flag word of the value.
        profile: Firmware profile of the sender.

    Returns:
        None where packages with these flags lack the item, or the firmware lacks the field.
    """
    item = BY_RECORD[record]
    place = _plan(flags & profile.item_flags, profile).items.get(item.bit)
    if place is None or field not in profile.items[item.name].fields:
        return None
    span = profile.items[item.name].span(field)
    return slice(place[0] + span.start, place[0] + span.stop)


def _fits(value: bytes, profile: FirmwareProfile) -> bool:
    flags = value[0] | value[1] << 8
    return not flags & ~profile.item_flags and telemetry_size(flags, profile) == len(value)


def fitting_profiles(value: bytes) -> list[str]:
    """Names of the profiles under which a telemetry value has the right flags and length."""
    return [p.name for p in PROFILES.values() if _fits(value, p)] if len(value) >= 2 else []


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
        size = len(value)
        known = profile.item_flags
        flags = value[0] | value[1] << 8 if size >= 2 else ~known
        plan = _plan(flags & known, profile)
        if flags & ~known or size != plan.size:
            raise _mismatch(value, profile)
        self.value = value
        self.profile = profile
        self.flags = flags
        self._plan = plan

    @property
    def indices(self) -> Iterable[int]:
        """Bit numbers of the items that the packet carries, ascending."""
        return self._plan.items

    def get(self, record: type[R]) -> R | None:
        """The record of that class, None when the packet does not carry it."""
        plan = self._plan
        place = plan.items.get(_BITS[record])
        if place is None:
            return None
        offset, unpack, pick = place
        return _new(record, pick(unpack(self.value, offset) + plan.extras))

    def row(self) -> tuple[float, ...]:
        """Every raw value that the packet carries, in wire order, named by :attr:`columns`.

        The fastest way to read a whole packet, for logs and arrays.
        """
        return self._plan.unpack(self.value)[1:]

    @property
    def columns(self) -> tuple[str, ...]:
        """Name of each value of :meth:`row`: item and wire field, such as ``position.height``."""
        return tuple(
            f"{name}.{field}" for name, layout, *_ in self._layouts() for field in layout.fields
        )

    def _layouts(self) -> Iterator[tuple[str, ItemLayout, _Values]]:
        for bit, (offset, unpack, _) in self._plan.items.items():
            name = ITEMS[bit].name
            yield name, self.profile.items[name], unpack(self.value, offset)

    def records(self) -> list[Any]:
        """Every record that the packet carries, in bit order."""
        plan = self._plan
        values = plan.unpack(self.value) + plan.extras
        return [_new(record, pick(values)) for record, pick in plan.records]

    def raw_items(self) -> dict[str, dict[str, Any]]:
        """Raw values by item name and wire field name, for dumps and golden vectors."""
        return {
            name: dict(zip(layout.fields, values, strict=True))
            for name, layout, values in self._layouts()
        }

    def __repr__(self) -> str:
        return f"TelemetryPacket({', '.join(map(repr, self.records()))})"


def _mismatch(value: bytes, profile: FirmwareProfile) -> LayoutMismatch:
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
