"""The list of revoked names at an agent, and how a newer one comes to it.

The agent reads it at its start, from the folder of its certificates. Later, a newer one comes as a
new file, or over the network. Bringing it needs no right beyond the router's: the authority has
signed it.
"""

from __future__ import annotations

import asyncio
import base64
import json
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.hashes import SHA256

from m100link.apps.agent.background import TaskSet, goes_on
from m100link.apps.agent.messages import MessageError
from m100link.apps.bus.network import Bus, Question
from m100link.apps.fleet.asking import believed, nobody_there
from m100link.apps.fleet.identity import Rights
from m100link.apps.fleet.keys import NAME, Keys, session_in
from m100link.apps.fleet.payloads import VERSION, OrderReply, body, pack
from m100link.errors import M100Error, OutcomeUnknown, UsageError
from m100link.errors.texts import read_json
from m100link.errors.usage import unread
from m100link.link.keyfile import replace_file

AUTHORITY = "ca.pem"
"""The file whose key signs lists."""

LIST = "revoked.list"
"""Where a list is kept, beside it."""

_LOOK_S = 1.0
_MOST_WAITING = 8
_ANSWER_S = 1.5
_TRIES = 4
_AGAIN_S = 0.2


# -- names that are shut out before their certificates end: a list that the authority signs --------
# A list is two lines: what it says, as JSON, and the authority's signature over that line with its
# line feed (ECDSA over P-256 with SHA-256, as base64), so that ``openssl`` verifies it, too. It
# holds every name that was ever revoked and a number; one with a smaller number never takes its
# place. Pure logic.


LARGEST = 32 * 1024
"""Bytes of a list at most: some 700 names."""

_KIND = "revoked 1"
_MOST_NUMBER = 1 << 53
_MOST_DATE = 32


class BadRevoked(
    UsageError,
    code="M100-BAD-REVOKED",
    cause="another authority made the list, it was changed, or a newer one is in force",
    remedy="`m100link fleet pki push` brings the list of the authority",
):
    """A list of revoked names that an agent does not accept; the earlier one stays in force."""


@dataclass(frozen=True, slots=True)
class Revoked:
    """The content of a list."""

    number: int  # greater than that of every list before, from 1; 0 for none
    names: Mapping[str, str]  # who is revoked, and since which day, in words
    data: bytes = b""  # the bytes as they were signed; empty for no list

    @classmethod
    def verified(cls, data: bytes, authority: x509.Certificate) -> Self:
        """Read and verify a list of this authority.

        Raises:
            BadRevoked: It is not a list of this authority.
        """
        if len(data) > LARGEST:
            raise BadRevoked(f"a list of revoked names has at most {LARGEST} bytes")
        line, _, signature = data.partition(b"\n")
        try:
            key = authority.public_key()
            if not isinstance(key, ec.EllipticCurvePublicKey):
                raise BadRevoked("the authority has no key that signs lists of revoked names")
            signed = base64.b64decode(signature.strip(), validate=True)
            key.verify(signed, line + b"\n", ec.ECDSA(SHA256()))
        except (InvalidSignature, UnsupportedAlgorithm, ValueError) as error:
            if isinstance(error, BadRevoked):
                raise
            raise BadRevoked(
                "the signature of a list of revoked names is not that of the authority",
                cause="another authority made it, or it was changed on its way",
            ) from error
        return cls(*_read(line), data)


def sign_revoked(number: int, names: Mapping[str, str], key: ec.EllipticCurvePrivateKey) -> bytes:
    content = {"m100link": _KIND, "number": number, "names": dict(names)}
    line = json.dumps(content).encode() + b"\n"
    data = line + base64.b64encode(key.sign(line, ec.ECDSA(SHA256()))) + b"\n"
    if len(data) > LARGEST:
        raise BadRevoked(
            f"{len(names)} names are too many for a list",
            cause="names stay in it for good",
            remedy="make a new authority, and issue all certificates again",
        )
    return data


def _read(line: bytes) -> tuple[int, dict[str, str]]:
    """Number and names of a line that the authority has signed."""
    try:
        found: Any = read_json(line)
        number, names = found["number"], found["names"]
        if found["m100link"] != _KIND:
            raise ValueError(f"it is {found['m100link']!r}")
        if type(number) is not int or not 0 < number < _MOST_NUMBER:
            raise ValueError("its number is none")
        for name, since in names.items():
            if not NAME.fullmatch(name) or type(since) is not str or len(since) > _MOST_DATE:
                raise ValueError(f"{name!r} is no name")
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise BadRevoked(
            f"this release cannot read a list of revoked names: {error}",
            cause="the authority has a newer release, or signed something else",
            remedy="install the same release on both",
        ) from error
    return number, names


# -- the list in force, and how a newer one comes ------------------------------------------------


def read_certificate(data: bytes) -> x509.Certificate:
    """The certificate in a PEM file. Raises ValueError: there is none."""
    try:
        return x509.load_pem_x509_certificate(data)
    except x509.InvalidVersion as error:
        raise ValueError(str(error)) from error


class Revocations:
    """The list in force."""

    def __init__(
        self,
        authority: x509.Certificate,  # whose lists are believed
        path: Path | None = None,  # where the list is kept; None: nowhere
        rights: Rights | None = None,  # the fleet file beside it; answers have its digest
    ) -> None:
        self.authority = authority
        self._path, self.rights = path, rights
        self._seen: object = None
        self._kept = b""
        self._keeping = asyncio.Lock()
        self.revoked = Revoked(0, {})
        self.on_change: list[Callable[[], None]] = []  # called when a newer one is in force

    @classmethod
    def of_folder(cls, folder: Path, rights: Rights | None = None) -> Revocations:
        """Those of a folder with certificates: ``ca.pem``, and ``revoked.list`` if there is one.

        Raises:
            UsageError: There is no authority, or the list cannot be verified: without the list,
                revoked names could give orders again.
        """
        place = folder / AUTHORITY
        try:
            authority = read_certificate(place.read_bytes())
        except OSError as error:
            raise UsageError(
                f"{place} cannot be read: {error.strerror}",
                remedy="name the folder with it and with your certificate",
            ) from error
        except ValueError as error:
            raise UsageError(
                f"{place} has no certificate", remedy="copy it anew from the authority's folder"
            ) from error
        found = cls(authority, folder / LIST, rights)
        found.read()
        return found

    @property
    def number(self) -> int:
        """Number of the list in force; 0 without one."""
        return self.revoked.number

    def since(self, name: str) -> str:
        """Since when a name is revoked; empty if it is not."""
        return self.revoked.names.get(name, "")

    def take_in(self, data: bytes) -> bool:
        """Put a list into force, if it is newer; whether it is.

        Raises:
            BadRevoked: It is not the authority's, or older than the one in force.
        """
        if data == self.revoked.data:
            return False
        found, now = Revoked.verified(data, self.authority), self.number
        if found.number <= now:
            raise BadRevoked(
                f"list {found.number} of revoked names came, and list {now} is in force",
                cause="somebody pushed an old one, or two lists were made from the same one",
            )
        self.revoked = found
        for callback in list(self.on_change):
            callback()
        return True

    def read(self) -> bool:
        """Believe the file, if it was written anew; returns whether that is a newer list.

        Raises:
            BadRevoked: It is not to be believed.
            UsageError: It cannot be read.
        """
        data = self._written()
        return data is not None and self.take_in(data)

    def _written(self) -> bytes | None:
        """The bytes written since the last look; None: nothing."""
        if self._path is None:
            return None
        try:
            with self._path.open("rb") as file:
                status = os.fstat(file.fileno())
                seen = status.st_ino, status.st_mtime_ns, status.st_size
                if seen == self._seen:
                    return None
                self._seen = seen
                return file.read(LARGEST + 1)
        except FileNotFoundError:
            return None  # nobody was ever revoked
        except OSError as error:
            raise unread(self._path, error) from error

    async def look(self) -> bool:
        """As :meth:`read`, beside the loop: a disk may stand still."""
        async with self._keeping:
            data = await asyncio.to_thread(self._written)
        return data is not None and self.take_in(data)

    async def keep(self) -> None:
        """Write the list in force where the agent after this one reads it.

        Raises:
            UsageError: The disk does not take it.
        """
        path = self._path
        async with self._keeping:
            data = self.revoked.data
            if path is None or data == self._kept:
                return
            try:
                await asyncio.to_thread(replace_file, path, data, mode=0o666)  # no secret
                self._kept = data
            except OSError as error:
                raise UsageError(
                    f"{path}: {error.strerror or error}",
                    cause="the list is in force, but the agent loses it when it restarts",
                    remedy="make the folder writable, and push the list again",
                ) from error


class RevocationService:
    """One aircraft's end: a list comes here, and shuts out its names at once."""

    def __init__(
        self,
        bus: Bus,
        keys: Keys,
        boot: str,  # which run of the agent this is
        revocations: Revocations,  # what is believed; agents in one process share it
        *,
        # Called in turn when there is a newer list: its names steer no more.
        shut_out: Sequence[Callable[[], None]],
        note: Callable[[str, str], None],  # tells people, at a level
    ) -> None:
        self._bus, self._keys, self._boot = bus, keys, boot
        self._revocations = revocations
        self._shut_out, self._note = shut_out, note
        self._background = TaskSet()
        self._waiting = 0

    async def run(self) -> None:
        """Answer, and look at the file, until this is cancelled."""
        with ExitStack() as stack:
            stack.callback(self._background.cancel)
            served = self._bus.serve(self._keys.revoked, self._on_question, depth=_MOST_WAITING)
            stack.callback(served.close)
            self._revocations.on_change.append(self._changed)
            stack.callback(self._revocations.on_change.remove, self._changed)
            while True:
                await asyncio.sleep(_LOOK_S)
                with goes_on("the look at the list of revoked names"):
                    try:
                        await self._revocations.look()
                    except M100Error as error:
                        self._note(f"{LIST}: {error.seen}", "error")

    def _changed(self) -> None:
        for shut_out in self._shut_out:
            shut_out()
        found = self._revocations.revoked
        names = ", ".join(found.names)
        self._note(f"list {found.number} of revoked names is in force: {names}", "warning")

    def _on_question(self, question: Question) -> None:
        if self._waiting >= _MOST_WAITING or len(question.payload) > LARGEST + 1:
            question.drop()
            return
        self._waiting += 1
        self._background.spawn(self._answer(question), "list of revoked names")

    async def _answer(self, question: Question) -> None:
        fault: M100Error | None = None
        try:
            data = body(question.payload)
            if data:  # else it is asked which one is in force
                self._revocations.take_in(data)
                await self._revocations.keep()
        except (BadRevoked, MessageError, UsageError) as error:
            fault = error
        finally:
            self._waiting -= 1
        found = self._revocations
        rights = "" if found.rights is None else found.rights.digest
        more: dict[str, Any] = {"number": found.number, "text": rights}
        reply = OrderReply.done("", self._keys.name, self._boot, fault, **more)
        question.answer(self._keys.revoked, pack(reply))


async def in_force(bus: Bus, keys: Keys, data: bytes = b"") -> OrderReply:
    """Ask an agent for the number of its list, and for the digest of its fleet file as the text.

    ``data``: a list, which it believes when that is newer.

    Raises:
        Unreachable: There is no such agent.
        OutcomeUnknown: It gives no answer.
        UsageError: It does not believe the list, or cannot keep it, as it says itself.
        MessageError: Its answer cannot be read.
    """
    sessions: set[str] = set()
    for attempt in range(_TRIES):
        await asyncio.sleep(attempt * _AGAIN_S)
        if not sessions:  # a router that has just read a new list lets everybody come anew
            tokens = await bus.tokens(keys.live, timeout=_ANSWER_S)
            sessions = {session_in(token) for token in tokens}
        if not sessions:
            continue
        answers = await bus.ask(keys.revoked, bytes([VERSION]) + data, timeout=_ANSWER_S)
        reply = believed(answers, keys, "", sessions)
        if isinstance(reply, MessageError):
            raise reply
        if reply is not None and reply.fault is not None:
            raise reply.fault.error()
        if reply is not None:
            return reply
    if not sessions:
        raise nobody_there(keys)
    raise OutcomeUnknown(
        f"{keys.name} does not say which list of revoked names it has",
        cause="its agent has no fleet file or an older release, the link is cut, or the "
        "router lets nothing pass: to bring a list needs the right to stop",
        remedy=f"copy {LIST} into the folder of its certificates",
    )
