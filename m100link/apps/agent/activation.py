"""The activation of the aircraft for one app, and how the last one went."""

from __future__ import annotations

from collections.abc import Callable

from m100link.aircraft import Aircraft
from m100link.aircraft.activation import ActivationProgress
from m100link.apps.agent.journal import Journal
from m100link.errors import M100Error, UsageError
from m100link.protocol.codes import ActivationCode
from m100link.protocol.commands.activation import Credentials, Version

__all__ = ["Activation"]


class Activation:
    """What activates the aircraft.

    Args:
        credentials: App id and key; without them the aircraft can only be watched.
        journal: Where it is told what happens.

    Attributes:
        code: Last answer to an activation, None before the first.
        error: Why the last one failed, with remedy; None when it did not.
        on_code: Called with each answer to an activation.
    """

    def __init__(self, credentials: Credentials | None, journal: Journal) -> None:
        self._credentials = credentials
        self._journal = journal
        self.code: ActivationCode | None = None
        self.error: M100Error | None = None
        self.on_code: list[Callable[[ActivationCode], None]] = []

    def adopt(self, aircraft: Aircraft) -> None:
        """Use the key on an aircraft that is active: it needs no new activation (DJI's node)."""
        if self._credentials is not None:
            aircraft.use_key(self._credentials)

    async def activate(self, aircraft: Aircraft) -> Version:
        """Activate the aircraft.

        Raises:
            UsageError: There are no credentials.
            ActivationRefused, AckTimeout, LinkError: See each class.
        """
        if self._credentials is None:
            raise UsageError(
                "this station has no app id and key",
                remedy="start it with --app-id and --key-file",
            )
        self._journal.note("activating")
        try:
            version = await aircraft.activate(self._credentials, progress=self._progress)
        except M100Error as error:
            self.error = error
            self._journal.note(f"activation failed: {error.seen}", "error")
            raise
        self.error = None
        self._journal.note("activated")
        return version

    def _progress(self, progress: ActivationProgress) -> None:
        self.code = progress.code
        for callback in self.on_code:
            callback(progress.code)
