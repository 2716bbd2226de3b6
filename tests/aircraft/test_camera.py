"""The camera: sent, and nobody confirms."""

from __future__ import annotations

import asyncio

import pytest

from m100link import CommandNotSupported, LineBlocked, LinkClosed, NotActivated
from m100link.sim import VirtualClockEventLoop
from tests.rig import rig

pytestmark = pytest.mark.anyio


@pytest.fixture
def anyio_backend() -> object:
    return "asyncio", {"loop_factory": VirtualClockEventLoop}


@pytest.mark.parametrize("firmware", ["2.3", "3.1"])
async def test_photographs_and_video_reach_the_camera_without_authority(firmware: str) -> None:
    async with rig(firmware=firmware) as flown:
        camera, virtual = flown.aircraft.camera, flown.virtual.vehicle.camera
        began_at = flown.now
        await camera.take_photo()
        await camera.start_video()
        assert flown.now == began_at  # nobody is waited for
        await asyncio.sleep(0.1)
        assert (virtual.photos, virtual.is_recording) == (1, True)
        await camera.stop_video()
        await asyncio.sleep(0.1)
        assert not virtual.is_recording
        assert not flown.virtual.vehicle.authority.is_requested


async def test_what_would_be_lost_in_silence_is_refused() -> None:
    async with rig(firmware="3.1", activated=False) as flown:
        with pytest.raises(NotActivated, match="take_photo was not sent"):
            await flown.aircraft.camera.take_photo()
    async with rig(firmware="1.0") as flown:
        with pytest.raises(CommandNotSupported, match="nothing was sent"):
            await flown.aircraft.camera.start_video()


async def test_a_line_that_does_not_drain_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    async with rig(firmware="3.1") as flown:
        monkeypatch.setattr(flown.aircraft.link, "push", lambda *_, **__: False)
        with pytest.raises(LineBlocked, match="take_photo was not sent: the line takes no more"):
            await flown.aircraft.camera.take_photo()
        monkeypatch.undo()
        await flown.aircraft.aclose()
        with pytest.raises(LinkClosed):
            await flown.aircraft.camera.take_photo()
