"""What the virtual aircraft does with a command follows from what the command declares."""

from __future__ import annotations

from typing import Any

import pytest

from m100link.protocol import (
    PROFILES,
    Activate,
    Command,
    FirmwareProfile,
    GetVersion,
    Move,
    Movement,
    Notification,
    Push,
    Request,
    SystemCode,
    encode_code,
)
from m100link.protocol.commands.missions import COMMAND_SET
from m100link.protocol.commands.registry import COMMANDS

from .host import Host

# Missions are refused as a whole, in the shape of their acks.
SENT = [
    kind
    for address, kind in COMMANDS.items()
    if not issubclass(kind, Notification) and address.command_set != COMMAND_SET
]
REQUESTS: list[type[Request[Any]]] = [kind for kind in SENT if issubclass(kind, Request)]
UNREADABLE = bytes(101)  # no command takes so many bytes, but those that take any


def code_of(host: Host, kind: type[Command], value: bytes = UNREADABLE) -> int | None:
    """The code of the ack, None when there is no ack."""
    ack = host.ask_raw(bytes(kind.ADDRESS) + value, encrypted=False)
    return None if ack is None else int.from_bytes(ack.data[:2], "little")


@pytest.mark.parametrize("kind", SENT)
@pytest.mark.parametrize("firmware", PROFILES)
def test_every_command_is_known_from_its_firmware_on(firmware: str, kind: type[Command]) -> None:
    host = Host(firmware=firmware)
    host.activate()
    known = host.autopilot._commands.knows(bytes(kind.ADDRESS))
    assert known is kind.is_known_to(host.profile)
    if not known:
        assert code_of(host, kind) == SystemCode.NOT_SUPPORTED


@pytest.mark.parametrize("kind", SENT)
def test_commands_that_need_activation_are_refused_before_it(kind: type[Command]) -> None:
    code = code_of(Host(firmware="3.1"), kind)
    if not issubclass(kind, Request):
        assert code is None
    elif kind is not GetVersion:  # its answer says whether the aircraft is activated
        assert (code == SystemCode.NOT_ACTIVATED) is kind.NEEDS_ACTIVATION


@pytest.mark.parametrize("kind", REQUESTS)
@pytest.mark.parametrize("level", [0, 1, 2])
def test_a_level_below_the_declared_one_is_refused(level: int, kind: type[Request[Any]]) -> None:
    host = Host(firmware="2.3", level=level)
    host.activate(host.aircraft.credentials)
    if kind.is_known_to(host.profile):
        is_refused = code_of(host, kind) == SystemCode.LEVEL_TOO_LOW
        assert is_refused is (level < kind.LEVEL and kind.NEEDS_ACTIVATION)


@pytest.mark.parametrize(
    ("firmware", "kind"),
    [
        (name, kind)
        for name, firmware in PROFILES.items()
        for kind in REQUESTS
        if kind.is_known_to(firmware) and kind is not GetVersion  # which takes any value
    ],
)
def test_an_unreadable_value_is_answered_as_declared(
    firmware: str, kind: type[Request[Any]]
) -> None:
    host = Host(firmware=firmware).ready()
    assert code_of(host, kind) == kind.unreadable(host.profile)
    assert host.autopilot.received_commands[-1].command is None


@pytest.mark.parametrize("kind", [k for k in SENT if issubclass(k, (Push, Movement))])
@pytest.mark.parametrize("value", [b"", UNREADABLE])
def test_what_has_no_ack_is_never_answered(kind: type[Command], value: bytes) -> None:
    host = Host(firmware="3.1").ready()
    assert code_of(host, kind, value) is None


@pytest.mark.parametrize("kind", REQUESTS)
def test_an_ack_is_encrypted_as_its_request_unless_declared_plain(kind: type[Request[Any]]) -> None:
    host = Host(firmware="3.1").ready()
    ack = host.ask_raw(bytes(kind.ADDRESS) + UNREADABLE, encrypted=True)
    assert ack is not None
    assert ack.encrypted is not kind.ACK_IS_PLAIN


def test_activation_must_come_plain_whatever_it_says() -> None:
    host = Host().ready()
    for value in (UNREADABLE, host.activation().value(host.profile)):
        ack = host.ask_raw(bytes(Activate.ADDRESS) + value, encrypted=True)
        assert ack is not None
        assert ack.data == encode_code(2)


def test_movement_is_read_once_while_it_repeats(monkeypatch: pytest.MonkeyPatch) -> None:
    host = Host().flying()
    read: list[bytes] = []
    parse = Move.parse

    def noted(value: bytes, firmware: FirmwareProfile) -> Move:
        read.append(value)
        return parse(value, firmware)

    monkeypatch.setattr(Move, "parse", noted)
    for command in (Move(0x48, 1.0, 0.0, 0.0, 0.0), Move(0x48, 2.0, 0.0, 0.0, 0.0)):
        for _ in range(10):
            host.send(command.encode(host.profile), session=0, cipher=host.cipher)
    assert len(read) == 2
    assert len(host.autopilot.received_movements) == 20
