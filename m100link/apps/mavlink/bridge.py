"""Datagrams in, datagrams out: vehicles of one process, and the peers that they share.

The bridge reads each datagram by itself. A peer is obeyed and answered after a heartbeat
of its own, and telemetry goes to those alone, and to addresses that the settings name.
"""

from __future__ import annotations

import asyncio
import hashlib
import json
import socket
import struct
import time
from collections.abc import AsyncIterator, Callable, Iterable, Mapping
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit
from zlib import crc32

from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.control_session import ControlSession
from m100link.apps.mavlink.order_executor import OrderExecutor
from m100link.apps.mavlink.translator.codec import (
    LAST_SIGNATURE,
    MOST_PEERS,
    NEW_WITHIN,
    Address,
    MavlinkMessage,
    MessageReader,
    PacketSigner,
    Peer,
    Sender,
    ending_command,
    write_frame,
)
from m100link.apps.mavlink.translator.numbers import AUTOPILOT_PX4
from m100link.apps.mavlink.translator.vehicle import COMPONENT, MavlinkVehicle
from m100link.errors import UsageError
from m100link.errors.texts import read_json
from m100link.link.keyfile import replace_file

STEP_S = 0.02  # seconds between two steps: of setpoints, and of telemetry that is due

IDLE_STEP_S = 0.05
"""The same while nothing waits, no setpoints are flown, and nobody wants more than 20 Hz: most of
what a step costs is to wake up."""

HIGHEST_SYSTEM = 250  # the greatest system id of an aircraft: those above are ground stations
_LARGEST = 1400  # bytes of a datagram that no network cuts up

_READ_PER_STEP = 32768
"""Bytes of frames that are read and answered in :data:`STEP_S`, shared out evenly among the
addresses of peers, and one share for all strangers: a flood is dropped, and holds up neither
setpoints nor others. Noise that does not look like a frame hardly counts: to read it costs little
more than to drop it, and no command that comes between much noise is dropped."""

_SKIPPED = 32  # bytes of a datagram that take as long to be skipped as one of a frame to be read

_MESSAGE_COST = 60
"""The cost of a message beside its bytes: the shortest ones take as long to read as others."""

_STOOD_STILL_S = 1.0  # seconds without a step after which what waits to be read is old
_SINCE_2015 = 1_420_070_400
LOST_AFTER = 3.0  # seconds without a heartbeat after which a ground station counts as lost
FORGOTTEN_AFTER = 10.0  # seconds after which nothing is sent to it any more


class Peers:
    """Those that have been heard, by address and system id."""

    def __init__(self, always: tuple[Address, ...] = ()) -> None:
        self._always = always
        self._heard: dict[Peer, float] = {}
        self.refused = 0

    def heartbeat(self, peer: Peer, now: float) -> bool:
        """It is there, and one of the peers unless these are too many; True if it is a new one.

        ``now``: s.
        """
        if peer not in self._heard and len(self._heard) >= MOST_PEERS:
            self.forget(now)
            if len(self._heard) >= MOST_PEERS:
                self.refused += 1
                return False
        is_new = not self.knows(peer, now)
        self._heard[peer] = now
        return is_new

    def knows(self, peer: Peer, now: float) -> bool:
        """Whether it has been heard lately: others are not obeyed, and not answered."""
        return now - self._heard.get(peer, -FORGOTTEN_AFTER) < FORGOTTEN_AFTER

    def is_lost(self, peer: Peer, now: float) -> bool:
        return now - self._heard.get(peer, -LOST_AFTER) >= LOST_AFTER

    def is_known(self, address: Address) -> bool:
        return any(one.address == address for one in self._heard)

    def forget(self, now: float) -> None:
        for peer, at in tuple(self._heard.items()):
            if now - at >= FORGOTTEN_AFTER:
                del self._heard[peer]

    def audience(self, now: float) -> dict[Address, tuple[Peer, ...]]:
        """Where telemetry goes, with the peers that are there."""
        self.forget(now)
        found: dict[Address, tuple[Peer, ...]] = dict.fromkeys(self._always, ())
        for peer in self._heard:
            found[peer.address] = (*found.get(peer.address, ()), peer)
        return found


class _Craft:
    def __init__(self, agent: AgentClient, system: int, autopilot: int, logs: Path | None) -> None:
        session = ControlSession(agent, "MAVLink")
        self.vehicle = MavlinkVehicle(agent, session, system, autopilot, logs)
        flights = self.vehicle.flights
        self.executor = OrderExecutor(agent, self.vehicle.world, self.vehicle.manager, flights)
        # By address and our component: a peer that counts gaps must not count messages to another
        # one, or of another component.
        self.sequences: dict[tuple[Address, int], int] = {}
        agent.on_event.append(self.vehicle.event)
        session.on_refused = self.vehicle.manager.steer_refused
        agent.on_mission_report.append(flights.report)


class Bridge:
    """The bridge. Raises UsageError: a system id cannot be one of an aircraft."""

    def __init__(
        self,
        agents: Mapping[int, AgentClient],  # the agents of the aircraft, by system id, each entered
        send: Callable[[bytes, Address], None],  # sends a datagram; never waits
        *,
        to: tuple[Address, ...] = (),  # addresses that are spoken to first
        # Takes all that waits to be read; a datagram may be cut off behind LONGEST_COMMAND bytes.
        drain: Callable[[], Iterable[tuple[bytes, Address]]] = tuple,
        signer: PacketSigner | None = None,  # signs what goes out, and refuses what is not signed
        autopilot: int = AUTOPILOT_PX4,  # MAV_AUTOPILOT of the heartbeat
        logs: Path | None = None,  # the folder of flight logs; None where nothing is recorded
    ) -> None:
        for system in agents:
            if not 1 <= system <= HIGHEST_SYSTEM:
                raise UsageError(
                    f"{system} is not a system id of an aircraft",
                    remedy=f"choose 1 to {HIGHEST_SYSTEM}; 255 is a ground station's",
                )
        self._send = send
        self._drain = drain
        self._signer = signer
        self._clock = asyncio.get_running_loop().time
        self.peers = Peers(to)
        self._crafts = [_Craft(agent, system, autopilot, logs) for system, agent in agents.items()]
        self.vehicles = [craft.vehicle for craft in self._crafts]  # as they are translated
        for vehicle in self.vehicles:
            vehicle.files.on_answer = lambda: self._flush(self._clock())
        self._ours = {0, *agents}  # system ids of our own words, and of nobody's
        # The share still to be read of each address, and when it was shared out: not by each step,
        # whose rest is longer while nothing waits.
        self._shares: dict[Address | None, int] = {None: _READ_PER_STEP}
        self._shared_at = 0.0
        # Datagrams beyond a share that may end a flight: they wait for the next one.
        self._held: dict[tuple[Address, tuple[int, ...]], bytes] = {}
        self.dropped = 0  # datagrams that were not read because too many came
        self.unsent = 0  # messages with a number that does not fit
        self._ran_at = self._clock()
        # The rest before the next step: what ends it, when it began, and whether it is short.
        self._is_due = asyncio.Event()
        self._stepped_at = 0.0
        self._is_short = False

    def received(self, data: bytes, address: Address) -> None:
        now = self._clock()
        if self._stood_still(now, (data, address)):
            return
        self._share_out(now)
        sender = address if address in self._shares else None
        if len(data) > self._shares[sender]:
            self._hold(data, address, now)
            return
        self._read(data, address, now)
        self._flush(now)
        self._hurry()

    def _ends(self, data: bytes, address: Address, now: float) -> tuple[int, ...] | None:
        """The key of a command of a known peer that may end a flight; None of any other."""
        key = ending_command(data)
        is_ours = key and key[2] in self._ours and self.peers.knows(Peer(address, *key[:2]), now)
        return key if is_ours else None

    def _hold(self, data: bytes, address: Address, now: float) -> None:
        """Drop it, but for the newest of each command of a peer that may end a flight."""
        if (key := self._ends(data, address, now)) is not None:
            self._held.pop((address, key), None)
            self._held[address, key] = data
        else:
            self.dropped += 1

    def _read(self, data: bytes, address: Address, now: float) -> None:
        sender = address if address in self._shares else None
        most = max(self._shares[sender], len(data))
        reading = self._reader(data, most)
        for message in reading:
            self._shares[sender] -= _MESSAGE_COST
            self._take(message, Peer(address, message.system, message.component), now)
        self._shares[sender] -= reading.checked + len(data) // _SKIPPED

    def _reader(self, data: bytes, most: int) -> MessageReader:
        signed_at = signature_time() if self._signer is not None else 0
        return MessageReader(data, signer=self._signer, now=signed_at, most=most)

    def _take(self, message: MavlinkMessage, peer: Peer, now: float) -> None:
        if message.system in self._ours:
            return
        if message.name == "HEARTBEAT":
            if self.peers.heartbeat(peer, now):
                for vehicle in self.vehicles:
                    vehicle.greet(peer)
        elif self.peers.knows(peer, now):
            for vehicle in self.vehicles:
                vehicle.receive(message, peer, now)

    def _share_out(self, now: float) -> None:
        if now - self._shared_at >= STEP_S:
            self._shared_at = now
            senders = {None, *self.peers.audience(now)}
            self._shares = dict.fromkeys(senders, _READ_PER_STEP // len(senders))
            held, self._held = self._held, {}
            for (address, _), data in held.items():
                self._read(data, address, now)

    def _stood_still(self, now: float, *came: tuple[bytes, Address]) -> bool:
        """Forget what was sent while this process was stopped: nobody waits for it any more.

        A command that may end a flight leaves a hover: a stream of setpoints would go on over it.
        """
        still, self._ran_at = now - self._ran_at, now
        if still < _STOOD_STILL_S:
            return False
        is_ended = any(
            self._ends(*one, now) is not None
            and any(True for _ in self._reader(one[0], len(one[0])))
            for one in (*came, *self._drain())
        )
        why = f"{still:.1f} s of standstill: commands sent in that time are ignored"
        for vehicle in self.vehicles:
            vehicle.tell(why)
            if is_ended:
                vehicle.manager.stopped("one of these may have ended the flight")
        return True

    def step(self) -> None:
        now = self._clock()
        self._stood_still(now)
        self._share_out(now)
        audience = self.peers.audience(now)
        for craft in self._crafts:
            for key in [*craft.sequences]:
                if key[0] not in audience:
                    del craft.sequences[key]
            craft.vehicle.advance(now, audience, self.peers.is_lost)
            craft.executor.advance()
        self._flush(now)

    def _flush(self, now: float) -> None:
        """Send what waits, as few datagrams as there can be."""
        everybody: Iterable[Address] | None = None
        packed: dict[Address, bytearray] = {}
        for craft in self._crafts:
            waiting, craft.vehicle.outbox = craft.vehicle.outbox, []
            for message, to in waiting:
                if to is None:
                    addresses = everybody = everybody or self.peers.audience(now)
                else:
                    addresses = to if isinstance(to, tuple) else (to.address,)
                for address in addresses:
                    frame = self._frame(craft, message, address)
                    if frame is None:
                        break
                    if isinstance(to, Peer) and address in self._shares:
                        self._shares[address] -= len(frame)
                    data = packed.setdefault(address, bytearray())
                    if len(data) + len(frame) > _LARGEST:
                        self._send(bytes(data), address)
                        data.clear()
                    data += frame
        for address, data in packed.items():
            if data:
                self._send(bytes(data), address)

    def _frame(self, craft: _Craft, message: MavlinkMessage, address: Address) -> bytes | None:
        key = address, message.component or COMPONENT
        sequence = craft.sequences[key] = craft.sequences.get(key, 0) + 1
        try:
            return write_frame(
                message,
                system=craft.vehicle.system,
                sequence=sequence,
                signer=self._signer,
                now=signature_time() if self._signer is not None else 0,
            )
        except (struct.error, OverflowError):
            self.unsent += 1  # a number that its field does not hold: nobody could use it
            return None

    async def run(self) -> None:
        """Step for ever, until cancelled; then whatever is held is given back."""
        self._ran_at = self._clock()
        try:
            while True:
                self.step()
                await self._until_next()
        finally:
            for craft in self._crafts:
                await craft.executor.end()

    async def _until_next(self) -> None:
        self._stepped_at, self._is_short = self._clock(), False
        self._is_due.clear()
        self._hurry()
        timer = asyncio.get_running_loop().call_later(IDLE_STEP_S, self._is_due.set)
        await self._is_due.wait()
        timer.cancel()

    def _hurry(self) -> None:
        """Rest for a short time if something waits or flies."""
        if not self._is_short and any(vehicle.is_busy for vehicle in self.vehicles):
            self._is_short = True
            loop = asyncio.get_running_loop()
            loop.call_at(self._stepped_at + STEP_S, self._is_due.set)


def signature_time() -> int:
    """Time of signatures: 10 microseconds since 2015."""
    return int((time.time() - _SINCE_2015) * 1e5)


# -- the socket of the bridge, the one part that touches the network -------------------------------


_AT_ONCE = 500
_LONGEST = 65536


def read_address(url: str) -> Address:
    """Host and port of ``udp://host:port``. Raises UsageError: it is not one."""
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError:
        host = port = None
    if host is None or port is None or not url.startswith("udp://"):
        raise UsageError(
            f"{url!r} is not an address for MAVLink", remedy="udp://127.0.0.1:14550, for example"
        )
    try:
        # A number is looked up nowhere, and a name once.
        found = socket.getaddrinfo(host, port, socket.AF_INET, socket.SOCK_DGRAM)[0][4][0]
    except (OSError, UnicodeError) as error:  # the latter of a name like "a..b"
        raise UsageError(
            f"{host} has no address: {error.args[-1]}",
            remedy="check the name, or give numbers: udp://127.0.0.1:14550",
        ) from None
    return str(found), port


class _Datagrams(asyncio.DatagramProtocol):
    def __init__(self, bound: socket.socket, received: Callable[[bytes, Address], None]) -> None:
        self._bound = bound
        self._received = received

    def datagram_received(self, data: bytes, addr: Address) -> None:
        self._received(data, (addr[0], addr[1]))
        # The loop reads one each time it turns: in a flood the queue of the socket would be full
        # always, and the system drops datagrams of all senders then.
        for _ in range(_AT_ONCE):
            try:
                data, (host, port) = self._bound.recvfrom(_LONGEST)
            except OSError:
                return  # nothing waits any more, or the loop will tell
            self._received(data, (host, port))

    def error_received(self, exc: Exception) -> None:
        """Nobody listens there: missing heartbeats show that."""


@asynccontextmanager
async def serving(
    bound: socket.socket, received: Callable[[bytes, Address], None]
) -> AsyncIterator[Callable[[bytes, Address], None]]:
    """Receive while the block runs; gives what sends a datagram, and never waits."""
    loop = asyncio.get_running_loop()
    transport, _ = await loop.create_datagram_endpoint(
        lambda: _Datagrams(bound, received), sock=bound.dup()
    )
    try:
        yield transport.sendto
    finally:
        transport.close()


# -- what was signed and taken, kept on disk: what is recorded now is not obeyed after a restart ---
# The specification has the time of signatures kept, and started with at the next start. That alone
# lets a minute pass in which what was recorded is taken again, and on a computer without a clock of
# its own more. So the newest time of each sender is kept too, a little ahead of what was taken: it
# holds even if this process is killed before it is written again.


AHEAD = 2_000_00  # how far ahead times are kept while it runs, in 10 microseconds: 2 s
_LONGEST_FILE = 65536
_PARTS = 3


@dataclass(frozen=True, slots=True)
class Snapshot:
    sent: int  # newest time that was signed or taken
    newest: dict[Sender, int]  # newest time of each sender; what is not later is not taken


class SignatureMemory:
    def __init__(self, folder: Path, signer: PacketSigner) -> None:
        self._signer = signer
        named = hashlib.sha256(b"m100link MAVLink signatures" + signer.key).hexdigest()[:16]
        # The file. Its name tells which key it belongs to, and nothing of the key.
        self.path = folder / f"signatures-{named}.json"
        self._written: dict[Sender, int] = {}

    def recall(self, now: int) -> str:
        """Give the signer what was kept. Returns why that cannot be, empty where it can.

        A file that cannot be read may hide any frame signed up to now: none of them is taken.
        """
        try:
            found = _read(self.path)
        except FileNotFoundError:
            return ""
        except (OSError, ValueError) as error:
            self._signer.oldest = now
            return f"{self.path} cannot be read: {error}"
        self._signer.sent = max(self._signer.sent, found.sent)
        for sender, when in found.newest.items():
            self._signer.newest[sender] = max(self._signer.newest.get(sender, 0), when)
        self._written = found.newest
        return ""

    def due(self) -> Snapshot | None:
        """The times to write now, so that no frame that was taken is later; None for nothing.

        A sender that does not stop is written for once in two seconds.
        """
        newest = self._newest()
        if all(when <= self._written.get(sender, 0) for sender, when in newest.items()):
            return None
        return Snapshot(self._signer.sent, {one: when + AHEAD for one, when in newest.items()})

    def last(self) -> Snapshot | None:
        """The times to write at the end, as they are, so that nobody waits for them."""
        newest = self._newest()
        return Snapshot(self._signer.sent, newest) if newest else None

    def _newest(self) -> dict[Sender, int]:
        """Those that count: the reader refuses an older sender."""
        since = self._signer.sent - NEW_WITHIN
        return {one: when for one, when in self._signer.newest.items() if when > since}

    def write(self, snapshot: Snapshot) -> None:
        """Write it; takes as long as the disk takes. Raises OSError: it cannot be written."""
        self.path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        newest, sent = dict(snapshot.newest), snapshot.sent
        with suppress(OSError, ValueError):
            # Another bridge with this key may keep its senders here.
            kept = _read(self.path)
            sent = max(sent, kept.sent)
            for sender, when in kept.newest.items():
                is_ours = sender in newest and when == self._written.get(sender)
                if not is_ours and when > sent - NEW_WITHIN:
                    newest[sender] = max(when, newest.get(sender, 0))
        stamps = {".".join(map(str, one)): when for one, when in newest.items()}
        stored = {"sent": sent, "newest": stamps, "crc32": _checksum(sent, stamps)}
        replace_file(self.path, json.dumps(stored).encode())
        self._written = newest


def _checksum(sent: object, newest: dict[str, Any]) -> int:
    return crc32(json.dumps([sent, newest]).encode())


def _read(path: Path) -> Snapshot:
    """The snapshot in a file.

    Raises OSError, ValueError: it cannot be read, or is not one of these.
    """
    with path.open("rb") as file:
        data = file.read(_LONGEST_FILE + 1)
    if len(data) > _LONGEST_FILE:
        raise ValueError("it is too long")
    stored: Any = read_json(data)
    if not (isinstance(stored, dict) and isinstance(stored.get("newest"), dict)):
        raise ValueError("it is not a memory of signatures")
    # A version before this one wrote no checksum; under any other name it is damaged.
    checksum = _checksum(stored.get("sent"), stored["newest"])
    if stored.keys() - {"sent", "newest"} and stored != stored | {"crc32": checksum}:
        raise ValueError("its checksum is wrong")
    if stored.keys() - {"sent", "newest", "crc32"}:
        raise ValueError("it holds what is not known")
    newest: dict[Sender, int] = {}
    for name, when in stored["newest"].items():
        parts = [int(part) for part in str(name).split(".")]
        if len(parts) != _PARTS:
            raise ValueError(f"{name!r} is not a sender")
        newest[parts[0], parts[1], parts[2]] = _time(when)
    return Snapshot(_time(stored.get("sent")), newest)


def _time(value: object) -> int:
    if not isinstance(value, int) or not 0 <= value <= LAST_SIGNATURE + AHEAD:
        raise ValueError(f"{value!r} is not a time")
    return value
