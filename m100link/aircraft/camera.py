"""The camera's shutter and recorder, as far as commands reach them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from m100link.protocol.commands.camera import StartVideo, StopVideo, TakePhoto

if TYPE_CHECKING:
    from m100link.link.requests import Requests


class AircraftCamera:
    """The camera of a connected aircraft: ``aircraft.camera``. Firmware 2.3 on, level 1.

    **Sent, and nobody confirms.** Each method returns when its command is sent. No firmware says
    whether a picture was taken or a video runs: not by an ack, not by telemetry. A lost command is
    lost in silence, so look at the card, or at the app's picture.
    """

    def __init__(self, requests: Requests) -> None:
        self._requests = requests

    async def take_photo(self) -> None:
        """Take one photograph: sent, nobody confirms. It takes about a second.

        Raises:
            NotActivated, LevelTooLow, CommandNotSupported, UsageError, LinkError: Nothing was sent.
        """
        await self._requests.send(TakePhoto())

    async def start_video(self) -> None:
        """Start recording: sent, nobody confirms. While it records, this changes nothing.

        Raises: as :meth:`take_photo`.
        """
        await self._requests.send(StartVideo())

    async def stop_video(self) -> None:
        """Stop recording: sent, nobody confirms. While it does not record, this changes nothing.

        Raises: as :meth:`take_photo`.
        """
        await self._requests.send(StopVideo())
