"""Which command an address stands for.

A module is imported when a command in it is asked for: there are many, and a program that decodes
one frame needs one of them.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Mapping
from functools import cache
from importlib import import_module
from operator import itemgetter
from typing import Any

from m100link.protocol.command import Address, Command, Unrecognised
from m100link.protocol.firmware import FirmwareProfile

# Where the classes are: the module of a command set, from an id on.
_MODULES = (
    (Address(0x00, 0x00), "activation"),
    (Address(0x01, 0x00), "control"),
    (Address(0x01, 0x10), "gimbal"),
    (Address(0x02, 0x00), "monitor"),
    (Address(0x02, 0x03), "missions"),
    (Address(0x03, 0x00), "waypoint"),
    (Address(0x03, 0x20), "hotpoint"),
    (Address(0x04, 0x00), "virtual_rc"),
)


@cache
def _in_module(name: str) -> dict[Address, type[Command]]:
    """The classes of a module that have an address, by that."""
    module = import_module(f"{__package__}.{name}")
    kinds: list[Any] = [one for one in vars(module).values() if isinstance(one, type)]
    own = [one for one in kinds if one.__module__ == module.__name__ and "ADDRESS" in vars(one)]
    return {kind.ADDRESS: kind for kind in sorted(own, key=lambda kind: kind.ADDRESS)}


class _Commands(Mapping[Address, type[Command]]):
    """The classes by address, each imported when it is asked for."""

    __slots__ = ("_known",)

    def __init__(self) -> None:
        self._known: dict[Address, type[Command]] = {}

    def __getitem__(self, address: Address) -> type[Command]:
        command = self._known.get(address)
        if command is None:
            # Above the last set, too, a module is found: it has no such address.
            place = bisect_right(_MODULES, address, key=itemgetter(0)) - 1
            command = self._known[address] = _in_module(_MODULES[place][1])[address]
        return command

    def __iter__(self) -> Iterator[Address]:
        for _, module in _MODULES:
            yield from _in_module(module)

    def __len__(self) -> int:
        return sum(len(_in_module(module)) for _, module in _MODULES)


COMMANDS: Mapping[Address, type[Command]] = _Commands()
"""Every command and push by its address."""


def address_of(data: bytes) -> Address | None:
    """Command set and id of the data of a frame that is not an ack; None when it is too short."""
    return Address(data[0], data[1]) if len(data) >= 2 else None


def parse_command(data: bytes, profile: FirmwareProfile) -> Command | Unrecognised:
    """Read the data of a frame that is not an ack. Never raises: what cannot be read says why."""
    address = address_of(data)
    if address is None:
        return Unrecognised(None, data, "too short for a command set and id")
    command = COMMANDS.get(address)
    if command is None:
        return Unrecognised(address, data[2:], f"{address} is not a command of the document")
    try:
        return command.parse(data[2:], profile)
    except ValueError as error:
        reason = getattr(error, "seen", None) or str(error)
        return Unrecognised(address, data[2:], reason)
