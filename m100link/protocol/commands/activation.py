"""Command set 0x00: version, activation, data to the mobile device (document 2.2.1)."""

from __future__ import annotations

from dataclasses import dataclass, field
from struct import Struct
from typing import Any, ClassVar, Self

from m100link.errors import BadAck, BadValue, PayloadTooLarge, UsageError
from m100link.protocol.codes import AckCode, ActivationCode, MobileDataCode, RatesCode, VersionCode
from m100link.protocol.command import (
    Command,
    Problem,
    Request,
    encode_code,
    exactly,
    plain,
    read_code,
)
from m100link.protocol.firmware import FirmwareProfile, Generation, recognised
from m100link.protocol.items import BY_NAME
from m100link.wire.cipher import Key
from m100link.wire.crc import frame_crc32

MOBILE_DATA_LIMIT = 100  # bytes of one transparent message, either way (document 2.2.1.3, 2.2.3.3)

BUNDLE_ID_SIZE = 32
_NAME_SIZE = 32
_SERIAL_SIZE = 11
_VERSION_PLAIN = Struct(f"<HI{_NAME_SIZE}s")
_VERSION_WITH_SERIAL = Struct(f"<HI{_SERIAL_SIZE}s{_NAME_SIZE}s")
_ACTIVATE = Struct(f"<III{BUNDLE_ID_SIZE}s")


@dataclass(frozen=True, slots=True)
class Credentials:
    """What DJI's developer site gives an app (document, "Command Authorization Levels").

    Args:
        app_id: The app id, 0 to 2³²−1.
        key: The AES key: 32 bytes or 64 hex digits. It is never sent and never shown.
        level: Authorization level 0, 1 or 2; flight control needs 2.
        app_version: Version of the app, chosen by the developer (firmware 1.0 only).
        bundle_id: Name of the app, at most 32 bytes of ASCII.

    Raises:
        UsageError, BadKey: A value that cannot be right, found before anything is sent.
    """

    app_id: int
    key: Key
    level: int = 2
    app_version: int = 1
    bundle_id: str = "12345678901234567890123456789012"

    def __init__(
        self,
        app_id: int,
        key: bytes | str | Key,
        *,
        level: int = 2,
        app_version: int = 1,
        bundle_id: str = "12345678901234567890123456789012",
    ) -> None:
        for name, number in (("app_id", app_id), ("app_version", app_version)):
            if not 0 <= number < 1 << 32:
                raise UsageError(
                    f"{name} {number} does not fit into 32 bits", remedy="0 to 4294967295"
                )
        if level not in (0, 1, 2):
            raise UsageError(f"level {level} does not exist", remedy="levels are 0, 1 and 2")
        if not bundle_id.isascii() or len(bundle_id) > BUNDLE_ID_SIZE:
            raise UsageError(
                f"the bundle id has {len(bundle_id)} characters, or some that are not ASCII",
                remedy=f"at most {BUNDLE_ID_SIZE} ASCII characters",
            )
        object.__setattr__(self, "app_id", app_id)
        object.__setattr__(self, "key", Key(key))
        object.__setattr__(self, "level", level)
        object.__setattr__(self, "app_version", app_version)
        object.__setattr__(self, "bundle_id", bundle_id)


@dataclass(frozen=True, slots=True)
class Version:
    """Answer to the version query."""

    code: VersionCode  #: Whether the aircraft is activated; the rest is filled in either way.
    crc: int  #: Checksum that the aircraft gives for ``name``.
    name: str  #: Version text, such as ``SDK-v1.0 BETA M100-03.01.01.00``.
    serial: str | None = None  #: Hardware serial, firmware 3.1 only.

    @property
    def is_activated(self) -> bool:
        """Whether the aircraft is activated for some app."""
        return self.code == VersionCode.ACTIVATED

    @property
    def crc_matches(self) -> bool:
        """Whether ``crc`` is the frame CRC32 of the name and one NUL."""
        return frame_crc32(self.name.encode("latin-1") + b"\0") == self.crc

    @property
    def profile(self) -> FirmwareProfile | None:
        """The firmware profile that this answer calls for; None for an unknown firmware."""
        return recognised(self.name, has_serial=self.serial is not None)

    def encode(self) -> bytes:
        """The data of the ack, with or without a serial."""
        name = self.name.encode("latin-1")
        if self.serial is None:
            return _VERSION_PLAIN.pack(self.code, self.crc, name)
        return _VERSION_WITH_SERIAL.pack(self.code, self.crc, self.serial.encode("latin-1"), name)


def _text(raw: bytes) -> str:
    return raw.split(b"\0", 1)[0].decode("latin-1")


@dataclass(frozen=True, slots=True)
class GetVersion(Request[Version], address=(0x00, 0x00), needs_activation=False):
    """0x00/0x00, get API version. The one byte of its value is arbitrary."""

    ACK_IS_PLAIN: ClassVar[bool] = True

    def value(self, profile: FirmwareProfile) -> bytes:
        """One zero byte."""
        return b"\0"

    @classmethod
    def parse(cls, value: bytes, profile: FirmwareProfile) -> Self:
        """Any value will do (errata 13)."""
        return cls()

    @classmethod
    def ack_fields(cls, answer: Version) -> dict[str, Any]:
        """The code and everything behind it, and the profile that it calls for."""
        return {
            "ack": plain(answer.code),
            "version": answer.name,
            "serial": answer.serial,
            "crc": answer.crc,
            "crc_matches": answer.crc_matches,
            "firmware": str(answer.profile) if answer.profile else None,
        }

    @classmethod
    def encode_ack(cls, answer: Version | AckCode) -> bytes:
        """As :meth:`Version.encode` does."""
        return answer.encode() if isinstance(answer, Version) else encode_code(answer)

    @classmethod
    def parse_ack(cls, payload: bytes) -> Version:
        """38 bytes, or 49 with a hardware serial."""
        code = VersionCode(read_code(cls.NAME, payload))
        if len(payload) >= _VERSION_WITH_SERIAL.size:
            _, crc, serial, name = _VERSION_WITH_SERIAL.unpack_from(payload)
            return Version(code, crc, _text(name), _text(serial))
        if len(payload) >= _VERSION_PLAIN.size:
            _, crc, name = _VERSION_PLAIN.unpack_from(payload)
            return Version(code, crc, _text(name))
        raise BadAck(
            f"the ack of {cls.NAME} has {len(payload)} bytes, it takes 38 or 49",
            command=cls.NAME,
            payload=payload,
            cause="an aircraft newer than the Matrice 100",
        )


@dataclass(frozen=True, slots=True)
class Activate(Request[ActivationCode], address=(0x00, 0x01), needs_activation=False):
    """0x00/0x01, activate API; always sent plain."""

    ACK_IS_PLAIN: ClassVar[bool] = True
    UNREADABLE: ClassVar[AckCode] = ActivationCode.INVALID_PARAMETERS

    app_id: int  #: App id.
    level: int  #: Authorization level; firmware 3.1 ignores it.
    version: int  #: The app's own version, or the firmware's version word (``activation_version``).
    bundle_id: str  #: 32 bytes, NUL padded.

    @classmethod
    def from_credentials(cls, credentials: Credentials, profile: FirmwareProfile) -> Self:
        """The request that this firmware expects of that app."""
        version = profile.activation_version
        return cls(
            app_id=credentials.app_id,
            level=credentials.level if profile.has_level else 2,
            version=credentials.app_version if version is None else version,
            bundle_id=credentials.bundle_id,
        )

    def value(self, profile: FirmwareProfile) -> bytes:
        """44 bytes."""
        return _ACTIVATE.pack(
            self.app_id, self.level, self.version, self.bundle_id.encode("latin-1")
        )

    @classmethod
    def parse(cls, value: bytes, profile: FirmwareProfile) -> Self:
        """Exactly 44 bytes (errata 19)."""
        fields = _ACTIVATE.unpack(exactly(value, _ACTIVATE.size, cls.NAME))
        app_id, level, version, bundle_id = fields
        return cls(app_id, level, version, _text(bundle_id))


RATES_HZ = (0, 1, 10, 50, 100)  # rates of a telemetry item, by their code on the wire

KEEP_RATE = 5
_RATE_BYTES = 16


@dataclass(frozen=True, slots=True)
class SetTelemetryRates(
    Request[RatesCode], address=(0x00, 0x10), since=Generation.V3_1, needs_activation=False
):
    """0x00/0x10, telemetry rates (firmware 3.1; earlier ones are set in the PC assistant)."""

    UNREADABLE: ClassVar[AckCode] = RatesCode.INVALID_PARAMETERS

    #: Rate per item name, 0, 1, 10, 50 or 100 Hz; an item left out keeps its rate.
    rates_hz: dict[str, int] = field(default_factory=dict)
    #: The 16 bytes of another program that cannot be said in rates; None elsewhere.
    as_sent: bytes | None = None

    def value(self, profile: FirmwareProfile) -> bytes:
        """16 bytes: one per item, then zeros.

        Raises:
            UsageError: An item that does not exist.
            BadValue: A rate that does not exist.
        """
        for problem in self.problems():
            raise problem.error(self.NAME)
        return self._codes()

    def _codes(self) -> bytes:
        if self.as_sent is not None:
            return self.as_sent
        for name, rate in self.rates_hz.items():
            if name not in BY_NAME:
                raise UsageError(
                    f"no telemetry item is called {name!r}",
                    remedy=f"items: {', '.join(BY_NAME)}",
                )
            if rate not in RATES_HZ:
                raise BadValue(
                    f"{name} cannot be sent at {rate} Hz",
                    field=name,
                    value=rate,
                    limit=", ".join(map(str, RATES_HZ)) + " Hz",
                    remedy=f"rates: {RATES_HZ}",
                )
        codes = [
            RATES_HZ.index(self.rates_hz[name]) if name in self.rates_hz else KEEP_RATE
            for name in BY_NAME
        ]
        return bytes(codes).ljust(_RATE_BYTES, b"\0")

    @classmethod
    def parse(cls, value: bytes, profile: FirmwareProfile) -> Self:
        """16 bytes; codes that do not exist are kept in ``as_sent``."""
        codes = exactly(value, _RATE_BYTES, cls.NAME)[: len(BY_NAME)]
        pairs = zip(BY_NAME, codes, strict=True)
        rates = {name: RATES_HZ[code] for name, code in pairs if code < KEEP_RATE}
        is_plain = max(codes) <= KEEP_RATE and not any(value[len(BY_NAME) :])
        return cls(rates, None if is_plain else value)

    @property
    def is_taken(self) -> bool:
        """Whether the aircraft takes it: it looks at the items alone, not at the reserved bytes."""
        return max(self._codes()[: len(BY_NAME)]) <= KEEP_RATE

    def raw(self) -> dict[str, Any]:
        """16 codes: 0 to 4 for the rates, 5 keeps a rate."""
        return {"rates": list(self._codes())}

    def problems(self) -> list[Problem]:
        """Codes that do not exist, and reserved bytes that are not zero."""
        limits = [KEEP_RATE] * len(BY_NAME) + [0] * (_RATE_BYTES - len(BY_NAME))
        return [
            Problem(f"rates[{index}]", code, f"0 to {limit}" if limit else "0, reserved")
            for index, (code, limit) in enumerate(zip(self._codes(), limits, strict=True))
            if code > limit
        ]

    def fields(self) -> dict[str, Any]:
        """Hertz by item."""
        return {"rates_hz": self.rates_hz}


def check_mobile_data(data: bytes) -> bytes:
    """Data that fit into one transparent message.

    Raises ``PayloadTooLarge``: more than 100 bytes. Raises ``UsageError``: none at all.
    """
    if not data:
        raise UsageError("a message to the mobile device needs at least one byte")
    if len(data) > MOBILE_DATA_LIMIT:
        raise PayloadTooLarge(
            f"{len(data)} bytes are too many for one message to the mobile device",
            cause=f"the aircraft passes on 1 to {MOBILE_DATA_LIMIT} bytes at a time",
            remedy="split the data",
        )
    return bytes(data)


@dataclass(frozen=True, slots=True)
class MobileData(Command):
    """Transparent data to or from the mobile device, 1 to 100 bytes."""

    data: bytes

    def value(self, profile: FirmwareProfile) -> bytes:
        """The data, checked."""
        return check_mobile_data(self.data)

    @classmethod
    def parse(cls, value: bytes, profile: FirmwareProfile) -> Self:
        """1 to 100 bytes."""
        if not 1 <= len(value) <= MOBILE_DATA_LIMIT:
            raise ValueError(f"a message has 1 to {MOBILE_DATA_LIMIT} bytes, not {len(value)}")
        return cls(value)

    def fields(self) -> dict[str, Any]:
        """The data under a name of their own: ``data`` is the whole payload of a frame."""
        return {"mobile_data": self.data.hex()}


@dataclass(frozen=True, slots=True)
class SendToMobile(MobileData, Request[MobileDataCode], address=(0x00, 0xFE)):
    """0x00/0xFE, transparent data to the mobile device, 1 to 100 bytes, about 8 kB/s."""
