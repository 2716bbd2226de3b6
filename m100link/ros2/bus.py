"""The only place that knows zenoh: a session, and what comes in by it.

What the network sends waits in rings of zenoh's own, outside of Python: a flood costs the oldest,
and nothing of this process runs before it is taken. Nothing here waits.
"""

from __future__ import annotations

import asyncio
import logging
import os
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from m100link.errors import UsageError

if TYPE_CHECKING:
    import zenoh

__all__ = [
    "MOST_BYTES",
    "MOST_TOKENS",
    "Bus",
    "Inbox",
    "Outlet",
    "Received",
    "Request",
    "TokenChange",
    "ZenohBus",
    "open_bus",
]

_logger = logging.getLogger(__name__)

T = TypeVar("T")

MOST_TOKENS = 1024
"""Changes of the graph that wait at most."""

MOST_BYTES = 32768
"""Of a payload that is read: a mission of 500 places has 20,000."""

_ANSWER_S = 2.0
"""Seconds for which an answer of a session is waited for."""

_MOST_ANSWERS = 256
"""Of one session to one question: more of them would wait in zenoh until the question ends."""

_SESSION = {
    "mode": '"peer"',
    "connect/endpoints": '["tcp/localhost:7447"]',
    "connect/exit_on_failure": "false",
    "listen/endpoints": '["tcp/localhost:0"]',
    "scouting/multicast/enabled": "false",
    "timestamping/enabled": '{"router": true, "peer": true, "client": true}',
    # As rmw_zenoh's, and not below that of its router: who stands still for longer than ours and
    # shorter than the router's gives up this session and is told of no way back to it.
    "transport/link/tx/lease": "60000",
    # Nothing that a node hears is longer, and zenoh would put a gigabyte together.
    "transport/link/rx/max_message_size": "1048576",
}
"""rmw_zenoh's session, where it differs from zenoh's default."""

_CONFIG, _OVERRIDE = "ZENOH_SESSION_CONFIG_URI", "ZENOH_CONFIG_OVERRIDE"


@dataclass(frozen=True, slots=True)
class Received:
    """A sample.

    Attributes:
        payload: CDR; empty when it is longer than :data:`MOST_BYTES`.
        attachment: See :func:`m100link.ros2.graph.read_attachment`.
    """

    payload: bytes
    attachment: bytes


@dataclass(frozen=True, slots=True)
class Request:
    """A request to a service.

    Attributes:
        payload: As in :class:`Received`; empty, too, when more than this service was asked.
        attachment: As in :class:`Received`.
        answer: Takes payload and attachment of the answer, once.
        drop: Ends it without an answer.
    """

    payload: bytes
    attachment: bytes
    answer: Callable[[bytes, bytes], None]
    drop: Callable[[], None]


@dataclass(frozen=True, slots=True)
class TokenChange:
    """A token appeared, or is gone.

    Attributes:
        key: The token.
        is_there: Which of both.
    """

    key: str
    is_there: bool


class Outlet(Protocol):
    """Where the messages of a topic go."""

    def put(self, payload: bytes, attachment: bytes) -> None:
        """Send one; never waits."""

    def is_wanted(self) -> bool:
        """Whether anybody listens."""
        ...


class Inbox(Protocol[T]):
    """What has come and waits."""

    def take(self) -> list[T]:
        """All of it, oldest first; never waits."""
        ...


class Bus(Protocol):
    """What a node needs of a network."""

    @property
    def session(self) -> str:
        """Id of the session."""
        ...

    def publish(self, key: str, *, kept: int = 0) -> Outlet:
        """Offer a topic.

        Args:
            key: Where.
            kept: How many messages are kept for who comes late.
        """
        ...

    def subscribe(self, key: str, depth: int) -> Inbox[Received]:
        """Listen to a topic; of what is not taken in time the newest ``depth`` stay."""
        ...

    def serve(self, key: str, depth: int) -> Inbox[Request]:
        """Offer a service; what is too much is not answered."""
        ...

    def declare(self, token: str) -> None:
        """Show a token as long as the session is there."""

    def watch(self, pattern: str) -> Inbox[TokenChange]:
        """See tokens come and go, those first that are there."""
        ...

    def ask(self, session: str) -> Inbox[bool]:
        """Ask another session whether it is there; something is in the inbox if it is."""
        ...


def _unless_closed(send: Callable[..., object], *what: Any, **more: Any) -> None:
    """Send; on a session that has ended, or to who has gone, nothing happens."""
    import zenoh

    try:
        send(*what, **more)
    except zenoh.ZError as error:
        _logger.debug("not sent: %s", error)


class _Outlet:
    def __init__(self, publisher: zenoh.Publisher) -> None:
        import zenoh

        self._publisher, self._ended = publisher, zenoh.ZError

    def put(self, payload: bytes, attachment: bytes) -> None:
        # Hundreds of times a second: what _unless_closed does, without what it costs.
        try:
            self._publisher.put(payload, attachment=attachment)
        except self._ended as error:
            _logger.debug("not sent: %s", error)

    def is_wanted(self) -> bool:
        status: Any = self._publisher.matching_status  # no bool, whatever its stub says
        return bool(status.matching)


class _Latched:
    """What keeps its last messages: rmw_zenoh asks for them by zenoh's advanced subscriber."""

    def __init__(self, publisher: Any) -> None:
        self._publisher = publisher

    def put(self, payload: bytes, attachment: bytes) -> None:
        _unless_closed(self._publisher.put, payload, attachment=attachment)

    def is_wanted(self) -> bool:
        return True  # by who comes later


class _Ring(Inbox[T]):
    """A ring of zenoh's with room for ``depth``, and what is made of each thing in it."""

    def __init__(self, declared: Any, make: Callable[[Any], T], depth: int) -> None:
        import zenoh

        self._declared, self._make, self._depth = declared, make, depth
        self._ended = zenoh.ZError

    def take(self) -> list[T]:
        found: list[T] = []
        try:
            # A flood fills it as fast as it is emptied: what comes meanwhile waits.
            while len(found) < self._depth and (one := self._declared.try_recv()) is not None:
                found.append(self._make(one))
        except self._ended:
            pass  # the session is closed: nothing comes any more
        return found


def _bytes(data: zenoh.ZBytes | None) -> bytes:
    return b"" if data is None or len(data) > MOST_BYTES else data.to_bytes()


def _received(sample: zenoh.Sample) -> Received:
    return Received(_bytes(sample.payload), _bytes(sample.attachment))


def _request(query: zenoh.Query, key: str) -> Request:
    def answer(payload: bytes, attachment: bytes) -> None:
        _unless_closed(query.reply, query.key_expr, payload, attachment=attachment)
        drop()

    drop: Callable[[], None] = query.drop
    # A question with a wildcard would take off, land and disarm at once.
    payload = _bytes(query.payload) if str(query.key_expr) == key else b""
    return Request(payload, _bytes(query.attachment), answer, drop)


class ZenohBus:
    """A session of zenoh.

    Args:
        session: The session.
    """

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        # Tokens and publishers end when nobody holds them.
        self._held: list[object] = []

    @property
    def session(self) -> str:
        """Id of the session."""
        return str(self._session.zid())

    def publish(self, key: str, *, kept: int = 0) -> Outlet:
        """Offer a topic."""
        import zenoh

        if kept:
            try:
                latched = zenoh.ext.declare_advanced_publisher(
                    self._session,
                    key,
                    congestion_control=zenoh.CongestionControl.DROP,
                    cache=zenoh.ext.CacheConfig(max_samples=kept),
                    publisher_detection=True,
                )
            except zenoh.ZError as error:
                raise UsageError(
                    f"this session of zenoh keeps nothing for who comes late: {error}",
                    remedy=f"let {_CONFIG} enable timestamping, as rmw_zenoh's own file does",
                ) from error
            return _Latched(latched)
        return _Outlet(
            self._session.declare_publisher(key, congestion_control=zenoh.CongestionControl.DROP)
        )

    def subscribe(self, key: str, depth: int) -> Inbox[Received]:
        """Listen to a topic."""
        import zenoh

        ring: Any = zenoh.handlers.RingChannel(depth)
        return _Ring(self._session.declare_subscriber(key, ring), _received, depth)

    def serve(self, key: str, depth: int) -> Inbox[Request]:
        """Offer a service."""
        import zenoh

        ring: Any = zenoh.handlers.RingChannel(depth)
        declared = self._session.declare_queryable(key, ring, complete=True)
        return _Ring(declared, lambda query: _request(query, key), depth)

    def declare(self, token: str) -> None:
        """Show a token."""
        self._held.append(self._session.liveliness().declare_token(token))

    def watch(self, pattern: str) -> Inbox[TokenChange]:
        """See tokens come and go."""
        import zenoh

        ring: Any = zenoh.handlers.RingChannel(MOST_TOKENS)
        declared = self._session.liveliness().declare_subscriber(pattern, ring, history=True)
        put = zenoh.SampleKind.PUT

        def change(one: zenoh.Sample) -> TokenChange:
            return TokenChange(str(one.key_expr), one.kind == put)

        return _Ring(declared, change, MOST_TOKENS)

    def ask(self, session: str) -> Inbox[bool]:
        """Ask another session whether it is there: by its admin space, which it may not have."""
        import zenoh

        # No ring, which is emptied when the question has ended.
        queue: Any = zenoh.handlers.FifoChannel(_MOST_ANSWERS)
        asked = self._session.get(f"@/{session}/*", queue, timeout=_ANSWER_S)
        return _Ring(asked, lambda reply: reply.ok is not None, _MOST_ANSWERS)


def _config(environment: Mapping[str, str]) -> zenoh.Config:
    """The configuration of a session, from where rmw_zenoh takes it.

    Raises:
        UsageError: It cannot be read.
    """
    import zenoh

    path = environment.get(_CONFIG)
    try:
        config = zenoh.Config.from_file(path) if path else zenoh.Config()
    except (zenoh.ZError, OSError) as error:
        raise UsageError(f"{_CONFIG}: {path} cannot be read: {error}") from error
    given = {} if path else dict(_SESSION)
    for rule in environment.get(_OVERRIDE, "").split(";"):
        name, sign, value = rule.partition("=")
        if rule.strip() and not sign:
            raise UsageError(f"{_OVERRIDE}: {rule!r} is not name=value")
        if sign:
            given[name.strip()] = value.strip()
    for name, value in given.items():
        try:
            config.insert_json5(name, value)
        except zenoh.ZError as error:
            raise UsageError(f"{name}={value} cannot be in a session: {error}") from error
    return config


@asynccontextmanager
async def open_bus(environment: Mapping[str, str] = os.environ) -> AsyncIterator[ZenohBus]:
    """A session while the block runs, configured as rmw_zenoh's are.

    Without a router it waits for one; who listens is found when that is there.

    Args:
        environment: Has ``ZENOH_SESSION_CONFIG_URI`` and ``ZENOH_CONFIG_OVERRIDE``.

    Raises:
        UsageError: The package is missing, or the configuration cannot be.
    """
    try:
        import zenoh
        import zenoh.ext  # which the package does not load by itself
    except ModuleNotFoundError as error:
        raise UsageError(
            f"ROS 2 needs {error.name}, which is not installed",
            remedy="pip install 'm100link[ros2]'",
        ) from None
    config = _config(environment)
    try:
        session = await asyncio.to_thread(zenoh.open, config)
    except zenoh.ZError as error:
        raise UsageError(
            f"no session of zenoh: {error}",
            remedy=f"check {_CONFIG} and {_OVERRIDE}, and that the port is free",
        ) from error
    try:
        yield ZenohBus(session)
    finally:
        await asyncio.to_thread(session.close)
