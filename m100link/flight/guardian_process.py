"""The guardian of a flight, a process of its own: it sends prepared bytes when the program cannot.

It runs as a script (``python -I -S``), so that the program cannot break what it depends on. It has
a copy of the line, one end of a socket and a page of shared memory. It ignores every signal that
can be ignored, and imports nothing once it has reported that it is ready. It knows no protocol: the
program keeps the frames in the page up to date, in order and with the pauses between them.

The page has words, then two halves that the program writes in turn. The guardian takes the newer
half whose checksum is right: a program that is killed during an update leaves the previous half.
The guardian keeps what it read last, so junk in the page changes nothing.
"""

from __future__ import annotations

import os
import select
import signal
import sys
import time
from struct import Struct
from zlib import crc32

HOLD, TOKEN, UNSENT = range(3)
"""Places of the words of 32 bits: who may write (the guardian says), when the program lived last
(:func:`milliseconds`), and how many bytes of its newest writes may be missing on the line."""

FREE, MID_FRAME, TAKEN = range(3)
"""The one writer: the program; for a moment the guardian; the guardian alone, and for good."""

READY, OVER, WAKE = b"r", b"o", b"w"
"""Words over the socket: the guardian watches; it is not needed any more; look at the page."""

STALLED_MS = 300
"""Age of the token from which on a setpoint counts as abandoned: beyond its usual lifetime."""

HALVES_AT = 64
HALF_SIZE = 16384
PAGE_SIZE = HALVES_AT + 2 * HALF_SIZE

_HEAD = Struct("<IIII")  # checksum of what follows, generation, patience in ms, size of the steps
_STEP = Struct("<BBHI")  # 0: when it stalls, 1: at the end; how often; size of the frame; pause, ms
_WORD = 0xFFFFFFFF

_LONGEST_FRAME = 1023
_ROOM_WITHIN_S = (1.0, 30.0)  # in which a full line has to take a frame: stalled, at the end
_IDLE_MS = 60_000

_Frames = list[tuple[int, bytes]]  # pause before it in ms, bytes

_CLOCK = getattr(time, "CLOCK_BOOTTIME", 0)  # of Linux: it goes on while the computer sleeps


def milliseconds() -> int:
    """Return the time by which both sides measure, a word that wraps."""
    return int(time.clock_gettime(_CLOCK) * 1000) & _WORD


def sealed(generation: int, patience_ms: int, steps: list[tuple[int, int, int, bytes]]) -> bytes:
    """A half of the page, or ValueError: it does not fit.

    ``generation``: one more than that of the other half. ``patience_ms``: age of the token at which
    the guardian takes over for good. ``steps``: 0 (when it stalls) or 1 (at the end), pause before
    each in ms, how often, frame.
    """
    packed = b"".join(
        _STEP.pack(end, count, len(data), gap) + data for end, gap, count, data in steps
    )
    body = _HEAD.pack(0, generation & _WORD, patience_ms, len(packed))[4:] + packed
    if len(body) + 4 > HALF_SIZE:
        raise ValueError(f"{len(body)} bytes do not fit into half a page")
    return crc32(body).to_bytes(4, "little") + body


def opened(half: bytes) -> tuple[int, int, _Frames, _Frames] | None:
    """Generation, patience and frames of a half; None when it was not written to its end."""
    checksum, generation, patience, size = _HEAD.unpack_from(half)
    end = _HEAD.size + size
    if not patience or end > len(half) or crc32(half[4:end]) != checksum:
        return None
    frames: tuple[_Frames, _Frames] = [], []
    at = _HEAD.size
    while at < end:
        if end - at < _STEP.size:
            return None
        which, count, length, gap = _STEP.unpack_from(half, at)
        at += _STEP.size + length
        if which > 1 or at > end:
            return None
        frames[which].extend([(gap, half[at - length : at])] * count)
    return generation, patience, *frames


class LineGone(Exception):
    """The line takes no more bytes, for good."""


class Watch:
    """Watches one program, ``parent``, and ends its flight when the program cannot."""

    def __init__(self, line: int, socket: int, page: int, parent: int) -> None:
        # Descriptors, of which that of the line does not block, and a process.
        self._line, self._socket, self._page, self._parent = line, socket, page, parent
        self._is_dead = self._is_over = False
        self._generation = -1
        self._patience = _IDLE_MS
        self._stalled: _Frames = []
        self._last: _Frames = []
        self._neutral_for = -1  # the token for which what is sent when it stalls was sent
        self._torn = 0  # bytes that a frame of ours, cut off, may lack
        self._news = select.poll()
        self._news.register(socket, select.POLLIN)
        try:
            self._process = os.pidfd_open(parent)
            self._news.register(self._process, select.POLLIN)
        except (AttributeError, OSError):
            self._process = -1  # an old kernel: the socket's end tells, unless a child holds it
        self._room = select.poll()
        self._room.register(line, select.POLLOUT)
        self._input = select.poll()
        self._input.register(line, select.POLLIN)

    def run(self) -> None:
        """Until the program is done, or the flight has been ended for it."""
        while True:
            self._refresh()
            age, token = self._age()
            if self._is_over or (self._is_dead and not self._last):
                return
            if self._last and (self._is_dead or age >= self._patience):
                self._take_over()
                return
            is_owed = bool(self._stalled) and token != self._neutral_for
            if is_owed and age >= STALLED_MS:
                # Once for each standstill; then silence, on which the aircraft hovers (DJI says).
                self._neutral_for = token
                self._play_stalled(token)
                continue
            due = self._patience if self._last else age + _IDLE_MS
            if is_owed:
                due = min(due, STALLED_MS)
            self._listen(due - age)

    # -- the program ------------------------------------------------------------------------------

    def _word(self, which: int) -> int:
        return int.from_bytes(os.pread(self._page, 4, 4 * which), "little")

    def _hold(self, who: int) -> None:
        os.pwrite(self._page, who.to_bytes(4, "little"), 4 * HOLD)

    def _age(self) -> tuple[int, int]:
        """Milliseconds since the program lived last, and the token that says so."""
        token = self._word(TOKEN)
        age = (milliseconds() - token) & _WORD
        if age > _WORD - 1000:  # renewed since the clock was read
            age = 0
        return age, token

    def _refresh(self) -> None:
        """Take the newer of the halves that are whole, if it is news."""
        for number in range(2):
            half = os.pread(self._page, HALF_SIZE, HALVES_AT + number * HALF_SIZE)
            found = opened(half)
            if found is None:
                continue
            # The counter wraps: newer is a half that lies less than half its range ahead.
            ahead = (found[0] - self._generation) & _WORD
            if self._generation < 0 or 0 < ahead < _WORD // 2:
                self._generation, self._patience, self._stalled, self._last = found

    def _listen(self, timeout_ms: float) -> None:
        """Wait for so long, or until the program says something or is gone."""
        for descriptor, _ in self._news.poll(max(0, timeout_ms)):
            if descriptor == self._process:
                self._is_dead = True
            elif not (said := os.read(self._socket, 64)):
                self._is_dead = True  # gone, or another program runs in its process (execv)
            elif OVER in said:
                self._is_over = True
        # For a kernel without pidfd: an orphan has another parent.
        if os.getppid() != self._parent:
            self._is_dead = True
        if self._is_dead:
            self._news = select.poll()  # what has ended is ready for ever

    # -- the line ---------------------------------------------------------------------------------

    def _play_stalled(self, token: int) -> None:
        """Send the end of a setpoint's life, as long as the program stands still."""
        self._mend()
        for gap, frame in self._stalled:
            self._listen(gap)
            if self._is_dead or self._is_over or self._word(TOKEN) != token:
                break
            # The program may run again at any moment, and must not write into this frame.
            self._hold(MID_FRAME)
            self._write(frame, is_last=False)
            self._hold(FREE)

    def _take_over(self) -> None:
        """End the flight. The program never writes again."""
        # First: after this the program changes nothing, and the plan that is read next is its last.
        self._hold(TAKEN)
        self._refresh()
        self._mend()
        for gap, frame in self._last:
            self._pass(gap / 1000)
            self._write(frame, is_last=True)

    def _mend(self) -> None:
        """Complete a frame that was cut off, with zeros."""
        # Otherwise the aircraft takes the next frame for its rest; between frames it ignores zeros.
        missing = min(max(self._word(UNSENT), self._torn), _LONGEST_FRAME)
        if missing:
            self._write(bytes(missing), is_last=self._word(HOLD) == TAKEN)

    def _pass(self, seconds: float) -> None:
        """Let time pass, and read in place of a dead program: the input must not jam the line."""
        until = time.monotonic() + seconds
        while (rest := until - time.monotonic()) > 0:
            if not self._is_dead:
                self._listen(min(rest, 1.0) * 1000)
                continue
            self._drain(rest)

    def _drain(self, seconds: float) -> None:
        for _, events in self._input.poll(seconds * 1000):
            try:
                is_gone = not events & select.POLLIN or not os.read(self._line, 4096)
            except BlockingIOError:
                return
            except OSError:
                is_gone = True
            if is_gone:
                raise LineGone

    def _write(self, frame: bytes, *, is_last: bool) -> None:
        """The whole frame, whatever the line takes at once; given up only on a full line."""
        until = time.monotonic() + _ROOM_WITHIN_S[is_last]
        rest = frame
        while rest:
            try:
                rest = rest[os.write(self._line, rest) :]
            except BlockingIOError:
                if time.monotonic() >= until:
                    break
                self._room.poll(50)
            except OSError as error:
                raise LineGone from error
        self._torn = len(rest) if len(rest) < len(frame) else self._torn if rest else 0


def main(line: int, socket: int, page: int, parent: int) -> None:
    """Say that it is ready, and watch."""
    for number in signal.valid_signals():
        try:
            signal.signal(number, signal.SIG_IGN)
        except (OSError, ValueError):
            continue  # SIGKILL, SIGSTOP
    os.chdir("/")
    try:
        with open("/proc/self/comm", "w", encoding="ascii") as name:  # noqa: PTH123 (no pathlib)
            name.write("m100link-guard")  # GUARDIAN_NAME, which lists of processes show
    except OSError:
        pass  # it has another name
    watch = Watch(line, socket, page, parent)
    os.write(socket, READY)
    try:
        watch.run()
    except LineGone:
        os._exit(1)  # nobody is there to hear why
    os._exit(0)  # at once: the next program that opens the line has to find it free


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
