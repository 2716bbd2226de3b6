"""The answering side of a session: deliver once, answer repeats from memory (document 1.4)."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from m100link.errors import UsageError
from m100link.session.events import SessionStatistics
from m100link.session.sender import ACK_ONCE_SESSION, NO_ACK_SESSION
from m100link.wire.cipher import Cipher
from m100link.wire.frame import Frame, encode_frame


@dataclass(slots=True)
class _Memory:
    """The last command of one session, and its ack once there is one."""

    sequence: int  # number of the command; another number means another command
    # The frame of its ack, to be sent again as it is; None while it is carried out.
    wire: bytes | None = None
    stored_at: float = 0.0  # when the ack was made, which is when forgetting begins to count


class Receiver:
    """Delivers commands and remembers the last ack of each of the sessions 2 to 31.

    "Nothing stored yet" is a state of its own: the first command of a session is delivered
    whatever its number is.

    Args:
        forget_after: Seconds after which a stored ack is forgotten. None, the document's rule,
            keeps it until a new sequence number comes.
        statistics: Counters to use; shared with the sender of the same end.

    Attributes:
        cipher: Encrypts acks that ask for it. May be set at any time.
        output: Frames to write, oldest first; whoever writes takes them out.
    """

    def __init__(
        self,
        *,
        forget_after: float | None = None,
        statistics: SessionStatistics | None = None,
    ) -> None:
        self.cipher: Cipher | None = None
        self.forget_after = forget_after
        self.statistics = statistics or SessionStatistics()
        self._memories: dict[int, _Memory] = {}  # per session; none is a state of its own
        self.output: deque[bytes] = deque()

    def receive_command(self, frame: Frame, now: float) -> Frame | None:
        """Take a command frame; None when it repeats one that was delivered before."""
        if frame.session > ACK_ONCE_SESSION:
            memory = self._memories.get(frame.session)
            if memory is not None and self._is_repeat(memory, frame, now):
                if memory.wire is None:
                    self.statistics.unanswered_repeats += 1
                else:
                    self.statistics.repeated_commands += 1
                    self.output.append(memory.wire)
                return None
            self._memories[frame.session] = _Memory(frame.sequence)
        self.statistics.commands += 1
        return frame

    def _is_repeat(self, memory: _Memory, frame: Frame, now: float) -> bool:
        if memory.sequence != frame.sequence:
            return False
        if self.forget_after is None or memory.wire is None:
            return True
        return now - memory.stored_at < self.forget_after

    def acknowledge(
        self, command: Frame, payload: bytes, *, now: float, encrypted: bool | None = None
    ) -> None:
        """Answer a delivered command. On session 0 nobody waits and nothing is sent.

        Args:
            command: The frame that was delivered.
            payload: Data of the ack.
            now: Present time, s.
            encrypted: Encrypt the ack; by default as the command was (errata, encryption of acks).

        Raises:
            UsageError: Encryption without a key.
            PayloadTooLarge: See :func:`~m100link.wire.encode_frame`.
        """
        if command.session == NO_ACK_SESSION:
            return
        encrypt = command.encrypted if encrypted is None else encrypted
        if encrypt and self.cipher is None:
            raise UsageError("an encrypted ack was asked for and there is no key")
        wire = encode_frame(
            payload,
            session=command.session,
            sequence=command.sequence,
            is_ack=True,
            cipher=self.cipher if encrypt else None,
        )
        if command.session > ACK_ONCE_SESSION:
            memory = self._memories.get(command.session)
            if memory is None or memory.sequence != command.sequence:
                self.statistics.stale_replies += 1
                return
            memory.wire = wire
            memory.stored_at = now
        self.output.append(wire)

    def forget(self) -> None:
        """Lose all memory, as at power-on."""
        self._memories.clear()

    def forget_answered(self) -> None:
        """Lose what was answered. What is at work is not among it: its answer is still to be given.

        Of frames that come together the later ones are at work as the first one is carried out.
        """
        at_work = {s: memory for s, memory in self._memories.items() if memory.wire is None}
        self._memories = at_work

    def next_output(self) -> bytes | None:
        """The next bytes to write, oldest first."""
        return self.output.popleft() if self.output else None
