"""MAVLink as a front of the station: its sockets, its key, its aircraft."""

from __future__ import annotations

import asyncio
import logging
import socket
from collections.abc import AsyncIterator, Callable, Iterator, Mapping, Sequence
from contextlib import AsyncExitStack, asynccontextmanager, suppress

from m100link.apps.agent.client import AgentClient
from m100link.apps.mavlink.bridge import (
    Bridge,
    SignatureMemory,
    Snapshot,
    read_address,
    serving,
    signature_time,
)
from m100link.apps.mavlink.translator.codec import LONGEST_COMMAND, Address, PacketSigner
from m100link.apps.mavlink.translator.numbers import AUTOPILOT_GENERIC, AUTOPILOT_PX4
from m100link.apps.station.config import Settings
from m100link.apps.station.listeners import Fronts, beside, bound
from m100link.apps.station.web.access_control import is_loopback
from m100link.errors import UsageError
from m100link.link.keyfile import read_key
from m100link.log.folder import state_folder

_logger = logging.getLogger(__name__)

AUTOPILOTS = {"px4": AUTOPILOT_PX4, "generic": AUTOPILOT_GENERIC}  # what the heartbeat may say

_MOST_WAYS = 64
_MOST_WAITING = 100_000
_REMEMBERED_S = 0.1

_ANY: Address = ("127.0.0.1", 0)


def prepare(stack: AsyncExitStack, settings: Settings) -> list[socket.socket]:
    """The sockets that the settings ask for; closed with the stack.

    Raises ``UsageError``: something in the settings cannot be, or other machines would be let in
    and their messages are unsigned. Raises ``PortBusy, PortFailed``: a port is taken, or an
    address cannot be bound.
    """
    if settings.autopilot not in AUTOPILOTS:
        raise UsageError(
            f"there is no autopilot {settings.autopilot!r}", remedy=" or ".join(AUTOPILOTS)
        )
    addresses = [read_address(one) for one in settings.mavlink]
    for one in [*addresses, *map(read_address, settings.mavlink_to)]:
        if not is_loopback(one[0]) and settings.signing_key_file is None:
            raise UsageError(
                f"{one[0]} lets other machines fly the aircraft, and their messages are unsigned",
                remedy="give --signing-key-file, or an address of this machine: 127.0.0.1",
            )
    _signer(settings)
    if settings.mavlink_to and not addresses:
        addresses = [_ANY]
    words = {
        "busy": "a ground station, or another bridge, listens there",
        "remedy": "end it, choose another --listen, or reach a listening station by --to",
    }
    return [bound(stack, address, socket.SOCK_DGRAM, **words) for address in addresses]


def _signer(settings: Settings) -> PacketSigner | None:
    path = settings.signing_key_file
    return None if path is None else PacketSigner(read_key(path).reveal())


async def serve(fronts: Fronts) -> None:
    agents = await fronts.reached("mavlink")
    bridge = serving_mavlink(agents, fronts.settings, fronts.take("mavlink"))
    await fronts.stack.enter_async_context(bridge)


@asynccontextmanager
async def serving_mavlink(
    agents: Mapping[str, AgentClient], settings: Settings, sockets: Sequence[socket.socket]
) -> AsyncIterator[Bridge]:
    """Serve while the block runs.

    Raises ``UsageError``: there are more aircraft than system ids.
    """
    by_system = dict(enumerate(agents.values(), settings.sysid))
    ways: dict[Address, Callable[[bytes, Address], None]] = {}
    senders: list[Callable[[bytes, Address], None]] = []

    def send(data: bytes, address: Address) -> None:
        # Answers go out where the question came in.
        ways.get(address, senders[0])(data, address)

    def drain() -> list[tuple[bytes, Address]]:
        return [came for one in sockets for came in _drained(one)]

    signer = _signer(settings)
    bridge = Bridge(
        by_system,
        send,
        drain=drain,
        to=tuple(map(read_address, settings.mavlink_to)),
        signer=signer,
        autopilot=AUTOPILOTS[settings.autopilot],
        logs=None if settings.no_record else settings.record,
    )

    drain()

    def receiver(place: int) -> Callable[[bytes, Address], None]:
        def received(data: bytes, address: Address) -> None:
            if place and bridge.peers.is_known(address):
                if len(ways) > _MOST_WAYS:
                    ways.clear()
                ways[address] = senders[place]
            bridge.received(data, address)

        return received

    async with AsyncExitStack() as stack:
        if signer is not None:
            await stack.enter_async_context(_remembering(signer, bridge))
        for place, one in enumerate(sockets):
            senders.append(await stack.enter_async_context(serving(one, receiver(place))))
        async with beside({"m100link station: MAVLink": bridge.run()}):
            yield bridge


@asynccontextmanager
async def _remembering(signer: PacketSigner, bridge: Bridge) -> AsyncIterator[None]:
    """Keep on disk what was signed; warn once where that cannot be, and go on flying."""
    memory = SignatureMemory(state_folder() / "mavlink", signer)
    reported = await asyncio.to_thread(memory.recall, signature_time())

    def tell(why: str) -> None:
        nonlocal reported
        if why and why != reported:
            _logger.warning("signatures are not remembered: %s", why)
            for vehicle in bridge.vehicles:
                vehicle.tell(f"signatures are not remembered: {why}")
        reported = why

    reported, why = "", reported
    tell(why)

    async def write(snapshot: Snapshot | None) -> None:
        if snapshot is not None:
            try:
                await asyncio.to_thread(memory.write, snapshot)
            except OSError as error:
                tell(f"{memory.path}: {error.strerror or error}")

    async def watch() -> None:
        while True:
            await write(memory.due())
            await asyncio.sleep(_REMEMBERED_S)

    watching = asyncio.create_task(watch(), name="m100link station: MAVLink signatures")
    try:
        yield
    finally:
        watching.cancel()
        await asyncio.wait([watching])
        await write(memory.last())


def _drained(one: socket.socket) -> Iterator[tuple[bytes, Address]]:
    """Datagrams that came while nobody read, as far as they may be one command, and from where."""
    with suppress(OSError):  # nothing waits any more
        for _ in range(_MOST_WAITING):
            yield one.recvfrom(LONGEST_COMMAND + 1)
