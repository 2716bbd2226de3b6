"""The one road down: requests that are answered, pushes that are not, and typed refusals."""

from __future__ import annotations

import asyncio
import logging
import math
from typing import TYPE_CHECKING, TypeVar

from m100link.errors import (
    AckTimeout,
    BadAck,
    CommandNotSupported,
    CommandRefused,
    KeyRejected,
    LevelTooLow,
    LineBlocked,
    NoAnswer,
    NotActivated,
    NoValidFrame,
    SilentLine,
    UsageError,
)
from m100link.protocol.codes import AckCode, SystemCode
from m100link.protocol.command import Command, Movement, Push, Request
from m100link.protocol.commands.activation import GetVersion, Version
from m100link.protocol.firmware import FIRMWARE_1_0, FirmwareProfile, names_hardware, reads_unknown
from m100link.wire.cipher import Cipher
from m100link.wire.frame import encode_frame

if TYPE_CHECKING:
    from m100link.link import Latency, Link, LinkStatistics

__all__ = ["Requests"]

_logger = logging.getLogger(__name__)

_PROBE_TIMEOUT = 0.3
_SILENT_S = 3.0  # until an aircraft has to be heard, by a cable
FIRST_BYTES_S = 8.0  # and by a network, whose first bytes take as long as all others
LONGEST_S = 15.0  # until one that is heard has to answer: 5 s each way, and lost frames
_VERSION_TIMEOUT, _VERSION_TRIES = 0.2, 3

A = TypeVar("A")


class Requests:
    """Sends commands over a link: encrypted where there is a key, in the layout of the firmware."""

    def __init__(self, link: Link, firmware: FirmwareProfile | None = None) -> None:
        self._link = link
        self._is_forced = firmware is not None
        # Whether ``firmware`` is that of the aircraft, and not only the likeliest.
        self.knows_firmware = self._is_forced
        self._is_fixed = False  # a control block flies: no answer changes what it sends
        self._proven_cipher: Cipher | None = None  # the key that the aircraft understood once
        self._known_pushes: set[type[Command]] = set()  # that the firmware was found to have
        # Profile that the version answer does not change; by default it chooses.
        self.firmware = firmware or FIRMWARE_1_0  # profile in whose layout commands are encoded
        # Level that this program activated with, None when nobody here knows it.
        self.level: int | None = None
        # Whether telemetry can be read by ``firmware``: it is forced, or chosen by a version
        # answer.
        self.knows_layout = self._is_forced
        # Newest answer to the version query, None before the first.
        self.version: Version | None = None

    @property
    def latency(self) -> Latency:
        """How long answers take on this line, as measured."""
        return self._link.latency

    def fix_firmware(self) -> None:
        """Keep the firmware until :meth:`free_firmware`, whatever a version answer says.

        An aircraft does not change its firmware in flight. Another answer would change the meaning
        of the setpoints that are on their way, or refuse the neutral and the landing.

        Raises ``UsageError``: the firmware is unknown.
        """
        self._require_known("control authority")
        self._is_fixed = True

    def free_firmware(self) -> None:
        """From here on the newest version answer chooses again."""
        was_fixed, self._is_fixed = self._is_fixed, False
        if was_fixed and self.version is not None:
            self._choose_firmware(self.version)

    async def execute(
        self,
        request: Request[A],
        *,
        timeout: float = 0.5,  # seconds to wait for the ack of one transmission
        tries: int = 3,
        encrypted: bool | None = None,  # by default as the request declares, once there is a key
        # Class of the error for system codes that have no class of their own.
        refusal: type[CommandRefused] = CommandRefused,
    ) -> A:
        """Send a request until it is answered, and return what its ack says.

        Raises ``NotActivated, LevelTooLow, CommandNotSupported``: system codes, or the firmware is
        known not to know it. Raises ``KeyRejected``: encrypted and refused or unanswered, while
        plain requests are answered. Raises ``UsageError``: not a request, or the firmware is
        unknown. Raises ``AckTimeout, BadAck, LinkError``: see each class.
        """
        if not isinstance(request, Request):  # a movement must not be sent three times
            raise UsageError(
                f"{request!r} has no ack to wait for", remedy="push it, or fly in a control block"
            )
        self._require_firmware(request)
        cipher = self._link.cipher
        if encrypted is None:
            encrypted = request.ENCRYPTED and cipher is not None
        # A key that was understood once is right; a lost frame does not make it wrong.
        may_be_wrong = encrypted and cipher is not self._proven_cipher
        try:
            payload = await self._link.request(
                request.encode(self.firmware),
                name=request.NAME,
                mode=request.SESSION_MODE,
                encrypted=encrypted,
                timeout=timeout,
                tries=tries,
            )
        except AckTimeout as error:
            if may_be_wrong and await self._answers_plain():
                raise _key_rejected(request.NAME) from error
            raise
        try:
            answer = request.parse_ack(payload)
        except BadAck as error:
            if may_be_wrong:  # what a wrong key makes of an ack is sometimes well-formed, and short
                raise _key_rejected(request.NAME) from error
            raise
        code = request.code_of(answer)
        if code is not None and code.is_system:
            raise _system_error(request.NAME, code, may_be_wrong, refusal)
        if encrypted:
            self._proven_cipher = cipher
        return answer

    def push(self, command: Push | Movement) -> bool:
        """Send a command that has no ack. False when the line does not drain.

        Raises ``UsageError``: the firmware is unknown. Raises ``CommandNotSupported``: the firmware
        does not know it. Raises ``LinkError``: the line is gone.
        """
        if type(command) not in self._known_pushes:  # movement comes fifty times a second
            self._require_firmware(command)
            self._known_pushes.add(type(command))
        link = self._link
        encrypted = command.ENCRYPTED and link.cipher is not None
        return link.push(command.encode(self.firmware), encrypted=encrypted)

    def prepared(self, command: Command, *, session: int = 0, sequence: int = 0) -> bytes:
        """The frame of a command, which somebody else sends when this program cannot."""
        cipher = self._link.cipher if command.ENCRYPTED else None
        return encode_frame(
            command.encode(self.firmware), session=session, sequence=sequence, cipher=cipher
        )

    async def admit(self, command: Push | Movement) -> None:
        """Refuse a command that nobody answers and that the aircraft would ignore in silence.

        Raises ``NotActivated, LevelTooLow, CommandNotSupported``: it would. Raises ``UsageError``:
        the firmware is unknown. Raises ``AckTimeout, LinkError``: see each class.
        """
        self._require_firmware(command)
        if self._link.cipher is None and command.NEEDS_ACTIVATION:
            if self.version is None or not self.version.is_activated:  # another program may have
                await self.query_version()
            if self.version is None or not self.version.is_activated:
                raise _ignored(NotActivated, command, SystemCode.NOT_ACTIVATED)
        if self.level is not None and self.level < command.LEVEL:
            raise _ignored(LevelTooLow, command, SystemCode.LEVEL_TOO_LOW)

    async def send(self, command: Push) -> None:
        """Send a command that nobody answers, unless it would be ignored.

        Raises: as :meth:`admit`, and LineBlocked when the line takes no more.
        """
        await self.admit(command)
        if not self.push(command):
            raise LineBlocked.usual(f"{command.NAME} was not sent: the line takes no more bytes")

    async def find_aircraft(self, timeout: float | None) -> Version:
        """Ask for the version until the deadline; if none comes, say how far the line reaches.

        ``timeout``: seconds; by default 15 for an aircraft that is heard, which takes 3 s by a
        cable and 8 s by a network. It is one question under one number, repeated: an answer counts
        however late it comes. Raises ``SilentLine, NoValidFrame, NoAnswer``: no aircraft; each
        names the cause. Raises ``UsageError``: no such time. Raises ``LinkError, BadAck``: see each
        class.
        """
        if timeout is not None and not 0.0 < timeout < math.inf:
            raise UsageError(
                f"no aircraft can answer within {timeout} s", remedy="give seconds, above 0"
            )
        loop = asyncio.get_running_loop()
        began_at = loop.time()
        longest = LONGEST_S if timeout is None else timeout
        tries = math.ceil(longest / _PROBE_TIMEOUT) + 1
        try:
            async with asyncio.timeout(longest) as limit:

                def look() -> None:
                    if not _hears_aircraft(self._link.statistics()):
                        limit.reschedule(loop.time())

                heard_by = _SILENT_S if self._link.is_serial else FIRST_BYTES_S
                looking = loop.call_later(heard_by, look) if timeout is None else None
                try:
                    return await self.query_version(timeout=_PROBE_TIMEOUT, tries=tries)
                finally:
                    if looking is not None:
                        looking.cancel()
        except (TimeoutError, AckTimeout):
            raise _no_aircraft(self._link, loop.time() - began_at) from None

    def take_recorded(self, version: Version | None, firmware: FirmwareProfile) -> None:
        """Take the recorded answer, and the recorded firmware unless one is forced."""
        self.version = version
        self.firmware = self.firmware if self._is_forced else firmware
        self.knows_firmware = self.knows_layout = True

    async def query_version(
        self, *, timeout: float = _VERSION_TIMEOUT, tries: int = _VERSION_TRIES
    ) -> Version:
        """Ask for the version and let it choose the firmware, unless one is forced or fixed.

        Raises ``AckTimeout, LinkError, BadAck``: see each class.
        """
        if self._link.is_recorded and self.version is not None:
            return self.version  # what it answered then
        version = await self.execute(GetVersion(), timeout=timeout, tries=tries)
        self.version = version
        self.knows_layout = True
        self._choose_firmware(version)
        return version

    def _choose_firmware(self, version: Version) -> None:
        found = version.profile
        if self._is_forced or (self.knows_firmware and found is self.firmware):
            return
        if self._is_fixed:
            _logger.error(
                "the version answer %r is not that of firmware %s, which is flying: kept",
                version.name,
                self.firmware,
            )
            return
        self.knows_firmware = found is not None
        self._known_pushes.clear()
        # An unknown firmware gets telemetry only; packets that do not fit are refused and counted.
        likeliest = reads_unknown(has_serial=version.serial is not None)
        self.firmware = found or likeliest
        if found is None:
            _logger.warning(
                "unknown firmware %r: telemetry only, read as %s", version.name, likeliest
            )
        elif not names_hardware(version.name):
            _logger.warning(
                "the version %r names no hardware: taken for firmware %s, whose document shows "
                "such a text; force another with connect(..., firmware=...)",
                version.name,
                found,
            )

    def _require_known(self, what: str) -> None:
        if not self.knows_firmware:
            name = self.version.name if self.version else "unknown"
            raise UsageError(
                f"{what} is not asked of an unknown firmware ({name})",
                cause="the order of movement values and the handshakes differ between firmwares",
                remedy="if you know that it fits, force it: connect(..., firmware='3.1')",
            )

    def _require_firmware(self, command: Command) -> None:
        if command.needs_known_firmware:
            self._require_known(command.NAME)
        self.require_support(command)

    def require_support(self, command: Command | type[Command]) -> None:
        """Raise for what the firmware does not know, before anything else is looked at.

        Raises ``CommandNotSupported``: the command came later.
        """
        if not command.is_known_to(self.firmware):
            raise CommandNotSupported(
                f"firmware {self.firmware} does not know {command.NAME}; nothing was sent",
                command=command.NAME,
                cause=f"the command came with firmware {command.SINCE}",
                remedy="use an aircraft with later firmware, or sim://?firmware=3.1",
            )

    async def _answers_plain(self) -> bool:
        try:
            await self.query_version()
        except AckTimeout:
            return False
        return True


def _hears_aircraft(numbers: LinkStatistics) -> bool:
    """Whether good frames came, and are most of what came."""
    return bool(numbers.frames_received) and 2 * numbers.discarded_bytes <= numbers.bytes_received


def _no_aircraft(link: Link, timeout: float) -> SilentLine | NoValidFrame | NoAnswer:
    """Nobody answered the version query; says how far the line reaches."""
    numbers = link.statistics()
    where = f"{link.name}, {timeout:.3g} s"
    received = {
        "bytes_received": numbers.bytes_received,
        "frames_received": numbers.frames_received,
    }
    if not numbers.bytes_received:
        return SilentLine(
            f"not one byte arrived ({where})",
            cause="no power, TX and RX swapped, no common ground, or the wrong port",
            remedy="swap TX and RX, check ground and the port name; docs: howto/silent-line",
            **received,
        )
    garbled = "another baud rate than the one set in the PC assistant, or noise"
    try_rates = "try 230400, 115200, 921600; docs: howto/silent-line"
    if not numbers.frames_received:
        return NoValidFrame(
            f"{numbers.bytes_received} bytes arrived and not one valid frame ({where})",
            cause=garbled,
            remedy=try_rates,
            **received,
        )
    unanswered = f"{numbers.frames_received} frames arrived, but no answer to a version query"
    # Good frames that waited in the port since another program had it do not make the rate right.
    if not _hears_aircraft(numbers):
        return NoAnswer(
            f"{unanswered}, and {numbers.discarded_bytes} of {numbers.bytes_received} bytes "
            f"were part of no frame ({where})",
            cause=garbled,
            remedy=try_rates,
            **received,
        )
    return NoAnswer(
        f"{unanswered} ({where})",
        cause="the wire from our TX to the aircraft's RX, two programs on one port, or a line "
        f"whose answers take longer than {timeout:.2g} s",
        remedy="check that wire; on a slow line connect(timeout=…); docs: howto/silent-line",
        **received,
    )


def _key_rejected(name: str) -> KeyRejected:
    """Encrypted and without a usable answer, while plain requests are answered."""
    return KeyRejected(
        f"{name} was encrypted and got no usable answer, while plain requests are answered",
        command=name,
        cause="the key of this program is not the one that the aircraft was activated with",
        remedy="check the enc key of the app id, and activate again",
    )


def _ignored(kind: type[CommandRefused], command: Command, code: SystemCode) -> CommandRefused:
    seen = f"{command.NAME} was not sent, it would be ignored: {code.meaning}"
    return kind(seen, command=command.NAME, code=int(code), cause=code.cause, remedy=code.remedy)


def _system_error(
    name: str, code: AckCode, encrypted: bool, refusal: type[CommandRefused]
) -> CommandRefused | KeyRejected:
    if code == SystemCode.NOT_SUPPORTED and encrypted:
        return _key_rejected(name)
    kind = {
        SystemCode.NOT_SUPPORTED: CommandNotSupported,
        SystemCode.NOT_ACTIVATED: NotActivated,
        SystemCode.LEVEL_TOO_LOW: LevelTooLow,
    }.get(SystemCode(int(code)), refusal)
    seen = f"{name} was refused: {code.meaning} (code 0x{code:04X})"
    return kind(seen, command=name, code=int(code), cause=code.cause, remedy=code.remedy)
