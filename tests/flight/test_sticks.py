"""Sticks as channels, and the pace of the settings."""

from __future__ import annotations

import pytest

from m100link import UsageError
from m100link.flight.tasks import CENTRED, GESTURE, SETTINGS_INTERVAL_S, Deflections, SettingsPace
from m100link.protocol.commands.virtual_rc import VirtualRcSettings
from tests.rig import rig

REST = (1324, 1024, 1552) + (1024,) * 9  # gear down, no go-home button, mode P


@pytest.mark.parametrize(
    ("sticks", "channels"),
    [
        (CENTRED, (1024, 1024, 1024, 1024)),
        (Deflections(roll=1.0), (1684, 1024, 1024, 1024)),
        (Deflections(pitch=-1.0), (1024, 364, 1024, 1024)),
        (Deflections(throttle=0.5), (1024, 1024, 1354, 1024)),
        (Deflections(yaw=-0.5), (1024, 1024, 1024, 694)),
        (GESTURE, (364, 364, 364, 1684)),
    ],
)
def test_sticks_as_channels(sticks: Deflections, channels: tuple[int, ...]) -> None:
    assert sticks.encoded().channels == channels + REST


@pytest.mark.parametrize(
    ("sticks", "is_corner"),
    [
        (CENTRED, False),
        (GESTURE, True),
        (Deflections(1.0, -1.0, -1.0, -1.0), True),
        (Deflections(-0.92, -0.92, -0.92, 0.92), True),
        (Deflections(-0.92, -0.92, -0.92, 0.8), False),
        (Deflections(-1.0, 1.0, -1.0, 1.0), False),
        (Deflections(-1.0, -1.0, 1.0, 1.0), False),
    ],
)
def test_the_corner_is_wider_than_the_aircrafts(sticks: Deflections, is_corner: bool) -> None:
    assert sticks.are_in_corner is is_corner


@pytest.mark.anyio
async def test_settings_that_come_too_soon_are_refused_and_what_was_not_sent_does_not_count(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async with rig(firmware="3.1") as flown:
        commander = flown.aircraft._commander
        pace = SettingsPace(lambda: flown.now)
        off = VirtualRcSettings(False)
        for _ in range(2):
            with pytest.raises(UsageError, match=r"it is 2\.2 s too soon"):
                pace.send(commander, off)
            began_at = flown.now
            await pace.wait()
            assert flown.now - began_at == pytest.approx(SETTINGS_INTERVAL_S)
            with monkeypatch.context() as patched:
                patched.setattr(flown.aircraft.link, "push", lambda *_, **__: False)
                assert not pace.send(commander, off)
            assert pace.send(commander, off)
