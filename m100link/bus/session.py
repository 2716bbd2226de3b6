"""A session of zenoh for a fleet.

zenoh calls back on threads of its own: what comes is put into a bounded queue there, and taken in
the event loop. Nothing here blocks them, and a flood costs the oldest.
"""

from __future__ import annotations

import asyncio
import json
import logging
from collections import deque
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Any

from m100link.bus.network import DEPTH, Answer, Held, Outlet, Question
from m100link.errors import UsageError

if TYPE_CHECKING:
    import zenoh

__all__ = ["LEASE_MS", "FleetSession", "open_session", "session_config"]

_logger = logging.getLogger(__name__)

LEASE_MS = 1500
"""Milliseconds after which a silent end of a connection counts as gone; zenoh's own 10 s would
leave an aircraft on the wall that long after its cable was cut."""

LARGEST = 1 << 20
"""Bytes of the longest message that is taken."""

FIRST_MS = 2000
"""Milliseconds in which a router has to answer the first time."""

_AGAIN_S = 0.5
_AT_ONCE = 256
"""What is taken from one queue before others have their turn."""


class _Queue:
    """From threads of zenoh into the event loop."""

    def __init__(
        self, loop: asyncio.AbstractEventLoop, take: Callable[..., None], depth: int
    ) -> None:
        self._loop, self._take = loop, take
        self._waiting: deque[tuple[Any, ...]] = deque(maxlen=depth)
        self._is_due = False

    def put(self, *what: Any) -> None:
        """Called by other threads."""
        self._waiting.append(what)
        if not self._is_due:
            self._is_due = True
            try:
                self._loop.call_soon_threadsafe(self._empty)
            except RuntimeError:
                _logger.debug("the event loop has ended: nobody takes this")

    def _empty(self) -> None:
        self._is_due = False
        for _ in range(_AT_ONCE):
            if not self._waiting:
                return
            try:
                self._take(*self._waiting.popleft())
            except Exception:
                # What one message leads to does not happen to the next one.
                _logger.exception("a message was not taken")
        if not self._is_due:
            self._is_due = True
            self._loop.call_soon(self._empty)


class _Declared:
    """Something of zenoh's that is declared until it is closed."""

    def __init__(self, declared: Any) -> None:
        self._declared: Any = declared

    def close(self) -> None:
        declared, self._declared = self._declared, None
        if declared is not None:
            _unless_closed(declared.undeclare)


class _Outlet(_Declared, Outlet):
    def put(self, payload: bytes) -> None:
        if self._declared is not None:
            _unless_closed(self._declared.put, payload)

    def is_wanted(self) -> bool:
        return self._declared is not None and bool(self._declared.matching_status.matching)


def _unless_closed(send: Callable[..., object], *what: Any) -> None:
    """Send; on a session that has ended, or to who has gone, nothing happens."""
    import zenoh

    try:
        send(*what)
    except zenoh.ZError as error:
        _logger.debug("not sent: %s", error)


def _bytes(data: zenoh.ZBytes | None) -> bytes:
    """The bytes; of what is longer than anything of a fleet nothing, which nobody can read."""
    return b"" if data is None or len(data) > LARGEST else data.to_bytes()


def _question(query: zenoh.Query) -> Question:
    drop: Callable[[], None] = query.drop

    def answer(key: str, payload: bytes) -> None:
        _unless_closed(query.reply, key, payload)
        drop()

    return Question(str(query.key_expr), _bytes(query.payload), answer, drop)


class FleetSession:
    """A session; see :class:`m100link.bus.network.Bus`.

    Args:
        session: Of zenoh.
    """

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._loop = asyncio.get_running_loop()

    def publish(self, key: str) -> Outlet:
        """Offer messages under a key."""
        import zenoh

        drop = zenoh.CongestionControl.DROP
        return _Outlet(self._session.declare_publisher(key, congestion_control=drop))

    def subscribe(
        self, pattern: str, take: Callable[[str, bytes], None], *, depth: int = DEPTH
    ) -> Held:
        """Hear messages."""
        queue = _Queue(self._loop, take, depth)

        def heard(sample: zenoh.Sample) -> None:
            queue.put(str(sample.key_expr), _bytes(sample.payload))

        return _Declared(self._session.declare_subscriber(pattern, heard))

    def serve(self, key: str, take: Callable[[Question], None], *, depth: int = DEPTH) -> Held:
        """Hear questions."""
        queue = _Queue(self._loop, take, depth)

        def heard(query: zenoh.Query) -> None:
            queue.put(_question(query))

        return _Declared(self._session.declare_queryable(key, heard))

    async def ask(self, key: str, payload: bytes = b"", *, timeout: float) -> list[Answer]:
        """Ask everybody who serves it."""
        import zenoh

        def get(handler: Any) -> None:
            self._session.get(
                key,
                handler,
                payload=payload,
                timeout=timeout,
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
            )

        return [
            Answer(str(one.key_expr), _bytes(one.payload))
            for one in await self._replies(get, timeout)
        ]

    async def _replies(self, get: Callable[[Any], None], timeout: float) -> list[zenoh.Sample]:
        """What is answered until zenoh says that no more comes, or the time is over."""
        import zenoh

        found: list[zenoh.Sample] = []
        ended = asyncio.Event()

        def heard(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                found.append(reply.ok)

        def end() -> None:
            try:
                self._loop.call_soon_threadsafe(ended.set)
            except RuntimeError:
                _logger.debug("the event loop has ended: nobody waits for an answer")

        try:
            get(zenoh.handlers.Callback(heard, end))
        except zenoh.ZError as error:
            _logger.debug("not asked: %s", error)
            return []
        try:
            async with asyncio.timeout(timeout + 1.0):
                await ended.wait()
        except TimeoutError:
            _logger.warning("zenoh did not end a question in its time")
        return found

    def declare(self, token: str) -> Held:
        """Show a token."""
        return _Declared(self._session.liveliness().declare_token(token))

    def watch(self, pattern: str, take: Callable[[str, bool], None]) -> Held:
        """See tokens come and go."""
        import zenoh

        queue = _Queue(self._loop, take, DEPTH)
        put = zenoh.SampleKind.PUT

        def heard(sample: zenoh.Sample) -> None:
            queue.put(str(sample.key_expr), sample.kind == put)

        return _Declared(
            self._session.liveliness().declare_subscriber(pattern, heard, history=True)
        )

    async def tokens(self, pattern: str, *, timeout: float) -> list[str]:
        """The tokens that are there."""

        def get(handler: Any) -> None:
            self._session.liveliness().get(pattern, handler, timeout=timeout)

        return [str(one.key_expr) for one in await self._replies(get, timeout)]


def session_config(
    mode: str, *, connect: tuple[str, ...] = (), listen: tuple[str, ...] = ()
) -> dict[str, str]:
    """How a session of a fleet differs from zenoh's default: names of options, and JSON.

    Nobody is looked for by multicast or gossip: who is not named is not met.

    Args:
        mode: ``client`` or ``router``.
        connect: Where to connect to, such as ``tcp/127.0.0.1:7447``.
        listen: Where to be connected to.
    """
    return {
        "mode": json.dumps(mode),
        "connect/endpoints": json.dumps(list(connect)),
        # Of the first connection; a router that is lost later is looked for without end.
        "connect/timeout_ms": str(FIRST_MS),
        "listen/endpoints": json.dumps(list(listen)),
        "scouting/multicast/enabled": "false",
        "scouting/gossip/enabled": "false",
        "transport/link/tx/lease": str(LEASE_MS),
        "transport/link/rx/max_message_size": str(LARGEST),
    }


@asynccontextmanager
async def open_session(
    options: Mapping[str, str], *, is_patient: bool = False
) -> AsyncIterator[FleetSession]:
    """A session while the block runs; a router that is lost meanwhile is found again.

    Args:
        options: Of :func:`session_config`, and more of zenoh's.
        is_patient: Wait for the first router as long as it takes.

    Raises:
        UsageError: The package is missing, an option cannot be, a port is taken, or no router
            answered.
    """
    try:
        import zenoh
    except ModuleNotFoundError as error:
        raise UsageError(
            f"a fleet needs {error.name}, which is not installed",
            remedy="pip install 'm100link[fleet]'",
        ) from None
    config = zenoh.Config()
    for name, value in options.items():
        try:
            config.insert_json5(name, value)
        except zenoh.ZError as error:
            raise UsageError(f"{name}={value} cannot be in a session: {error}") from error
    session = await _opened(config, options, is_patient=is_patient)
    try:
        yield FleetSession(session)
    finally:
        await asyncio.to_thread(session.close)


async def _opened(
    config: zenoh.Config, options: Mapping[str, str], *, is_patient: bool
) -> zenoh.Session:
    import zenoh

    is_client = options.get("mode") == '"client"'
    is_told = False
    while True:
        try:
            return await asyncio.to_thread(zenoh.open, config)
        except zenoh.ZError as error:
            if not (is_client and is_patient):
                raise _refused(error, options, is_client=is_client) from error
            if not is_told:
                _logger.warning("no router answers yet at %s", options["connect/endpoints"])
            is_told = True
        await asyncio.sleep(_AGAIN_S)


def _refused(error: Exception, options: Mapping[str, str], *, is_client: bool) -> UsageError:
    # What zenoh says ends with the place in its source.
    seen = str(error).partition(" at /")[0].strip()
    if not is_client:
        return UsageError(
            f"no router can be here: {seen}",
            remedy="check where it listens, and that the port is free",
        )
    return UsageError(
        f"no router answered: {seen}",
        cause="none runs there, a firewall is between, or it asks for a certificate: the "
        "network does not say which",
        remedy="m100link fleet router --listen tcp/127.0.0.1:7447",
    )
