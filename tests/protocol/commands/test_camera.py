"""Camera: whatever the byte says."""

from __future__ import annotations

import pytest

from m100link.protocol import PROFILES, Push, parse_command
from m100link.protocol.commands.camera import StartVideo, StopVideo, TakePhoto


@pytest.mark.parametrize("kind", [TakePhoto, StartVideo, StopVideo])
@pytest.mark.parametrize("value", [b"", b"\0", b"\xff", b"\1\2"])
def test_any_value_will_do(kind: type[Push], value: bytes) -> None:
    for firmware in PROFILES.values():
        command = parse_command(bytes(kind.ADDRESS) + value, firmware)
        assert isinstance(command, kind)
        assert command.raw() == {"any": value[0] if value else 0}
