"""The one place that knows zenoh: a session, its senders and its receivers.

zenoh runs on threads of its own. They put the messages of a :class:`~m100link.apps.bus.network.Bus`
into a bounded queue, and the event loop takes them; those of a
:class:`~m100link.apps.bus.network.PolledBus` wait in rings of zenoh's own, outside of Python.
Nothing here blocks those threads, and a flood costs the oldest.
"""

from __future__ import annotations

import asyncio
import atexit
import logging
import threading
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

from m100link.apps.bus import network
from m100link.errors import M100Error, NoRouter, PortBusy, UsageError
from m100link.errors.texts import read_json
from m100link.errors.usage import of_extra

if TYPE_CHECKING:
    import zenoh


_logger = logging.getLogger(__name__)

LARGEST = 1 << 20
"""Bytes of the longest message that a session puts together: zenoh's own limit is a gigabyte."""

_AGAIN_S = 0.5
_CLOSE_S = 1.0
_BESIDE = "m100link: beside zenoh"
_MOST_ANSWERS = 256
"""Of one probe: more of them would wait in zenoh until the question ends."""


@dataclass(frozen=True, slots=True)
class Opening:
    """How a session is opened, and in whose words it is refused."""

    purpose: str  # what needs it, such as ``a fleet``
    extra: str  # the extra of this package that brings zenoh
    # Of zenoh, by name, as JSON: where it differs from the default or the file.
    options: Mapping[str, str]
    # Configuration that is read first, and the option that names it; none by default.
    file: tuple[str, str] | None = None
    largest: int = LARGEST  # bytes of the longest payload that is read
    patience_s: float = 0.0  # seconds in which a client that found no router tries again
    is_patient: bool = False  # it tries as long as it takes
    # The remedy where no session can be, by the mode; ``""`` for all others.
    remedies: Mapping[str, str] = field(default_factory=dict)


class _Declared:
    __slots__ = ("_declared",)

    def __init__(self, declared: Any) -> None:
        self._declared: Any = declared

    def close(self) -> None:
        declared, self._declared = self._declared, None
        if declared is not None:
            _unless_closed(declared.undeclare)


class _Outlet(_Declared, network.Outlet):
    # Of hundreds of aircraft none is in the processor's caches: one object is a third of four.
    __slots__ = ("_bundle", "_ended", "_first", "_is_matching", "_listener", "_within")

    def __init__(
        self, declared: Any, *, is_kept: bool, bundle: network.Bundle, within: float = 0.0
    ) -> None:
        import zenoh

        super().__init__(declared)
        self._bundle, self._within = bundle, within
        self._ended = zenoh.ZError
        self._first = is_kept  # by a late listener
        self._is_matching: bool | None = None
        self._listener: Any = None
        if not is_kept:
            # To ask costs 20 µs where a session has a thousand keys, and is asked a hundred times
            # a second. The listener, which is there, reports what changes after the question.
            self._listener = declared.declare_matching_listener(self._matching)
            self._first = bool(declared.matching_status.matching)

    def _matching(self, status: Any) -> None:
        self._is_matching = bool(status.matching)  # no bool, whatever its stub says

    def put(self, payload: bytes, attachment: bytes | None = None) -> None:
        if self._declared is None:
            return
        # Hundreds of times a second: what _unless_closed does, without what it costs.
        try:
            self._declared.put(payload, attachment=attachment)
        except self._ended as error:
            _logger.debug("not sent: %s", error)

    def put_later(self, make: Callable[..., bytes], *what: Any) -> None:
        if self._within:
            self._bundle.put(self._within, self.put, make, *what)
        else:
            super().put_later(make, *what)

    def is_wanted(self) -> bool:
        if self._declared is None:
            return False
        return self._first if self._is_matching is None else self._is_matching

    def close(self) -> None:
        self._bundle.flush()
        listener, self._listener = self._listener, None
        if listener is not None:
            _unless_closed(listener.undeclare)
        super().close()


def _unless_closed(send: Callable[..., object], *what: Any, **more: Any) -> None:
    """Send; on a session that has ended, or to a peer that has gone, nothing happens."""
    import zenoh

    try:
        send(*what, **more)
    except zenoh.ZError as error:
        _logger.debug("not sent: %s", error)


class ZenohBus:
    """A session of zenoh.

    It is a :class:`m100link.apps.bus.network.Bus` and a
    :class:`m100link.apps.bus.network.PolledBus`, and reads payloads of up to ``largest`` bytes.
    """

    def __init__(self, session: zenoh.Session, largest: int = LARGEST) -> None:
        import zenoh  # loaded already by the opening of the session

        self._zenoh = zenoh
        self._session, self._largest = session, largest
        self._loop = asyncio.get_running_loop()
        self._bundle = network.Bundle(self._loop)

    @property
    def session(self) -> str:
        return str(self._session.zid())

    def _bytes(self, data: zenoh.ZBytes | None) -> bytes:
        """The bytes; none of a message that is too long, and nobody can read an empty one."""
        return b"" if data is None or len(data) > self._largest else data.to_bytes()

    def publish(self, key: str, *, kept: int = 0, within: float = 0.0) -> network.Outlet:
        """Offer messages under a key; UsageError where they are kept, and this session cannot."""
        drop = self._zenoh.CongestionControl.DROP
        if not kept:
            # Remote: whether this session has to hear it itself would be looked for with each.
            publisher = self._session.declare_publisher(
                key, congestion_control=drop, allowed_destination=self._zenoh.Locality.REMOTE
            )
            return _Outlet(publisher, is_kept=False, bundle=self._bundle, within=within)
        import zenoh.ext  # which the package does not load by itself

        try:
            # rmw_zenoh asks for what was kept by zenoh's advanced subscriber.
            latched: Any = self._zenoh.ext.declare_advanced_publisher(
                self._session,
                key,
                congestion_control=drop,
                cache=self._zenoh.ext.CacheConfig(max_samples=kept),
                publisher_detection=True,
            )
        except zenoh.ZError as error:
            raise UsageError(
                f"this session of zenoh keeps nothing for late listeners: {error}",
                remedy="let its configuration enable timestamping, as rmw_zenoh's own does",
            ) from error
        return _Outlet(latched, is_kept=True, bundle=self._bundle)

    def declare(self, token: str) -> network.Held:
        return _Declared(self._session.liveliness().declare_token(token))

    def _received(self, sample: zenoh.Sample) -> network.Received:
        return network.Received(self._bytes(sample.payload), self._bytes(sample.attachment))

    def _question(self, query: zenoh.Query) -> network.Question:
        drop: Callable[[], None] = query.drop

        def answer(key: str, payload: bytes, attachment: bytes | None = None) -> None:
            _unless_closed(query.reply, key, payload, attachment=attachment)
            drop()

        payload, attachment = self._bytes(query.payload), self._bytes(query.attachment)
        return network.Question(str(query.key_expr), payload, answer, drop, attachment)

    # -- handed over -----------------------------------------------------------------------------

    def subscribe(
        self,
        pattern: str,
        take: Callable[[str, bytes], None],
        *,
        depth: int = network.DEPTH,
        within: float = 0.0,
    ) -> network.Held:
        if within:
            return self._look(pattern, take, depth, within)
        queue = network.ThreadQueue(self._loop, take, depth)

        def heard(sample: zenoh.Sample) -> None:
            queue.put(str(sample.key_expr), self._bytes(sample.payload))

        return _Declared(self._session.declare_subscriber(pattern, heard))

    def _look(
        self, pattern: str, take: Callable[[str, bytes], None], depth: int, within: float
    ) -> network.Held:
        channel: Any = self._zenoh.handlers.RingChannel(depth)
        declared: Any = self._session.declare_subscriber(pattern, channel)

        def made(sample: zenoh.Sample) -> tuple[str, bytes]:
            return str(sample.key_expr), self._bytes(sample.payload)

        ring = network.Ring(declared, made, min(depth, network.AT_ONCE), self._zenoh.ZError)
        return network.PollingReader(_Declared(declared), ring, take, within)

    def serve(
        self,
        key: str,
        take: Callable[[network.Question], None],
        *,
        depth: int = network.DEPTH,
        is_first: Callable[[network.Question], bool] = lambda _: False,
    ) -> network.Held:
        queue = network.ThreadQueue(self._loop, take, depth, is_first)

        def heard(query: zenoh.Query) -> None:
            queue.put(self._question(query))

        return _Declared(self._session.declare_queryable(key, heard))

    def watch(self, pattern: str, take: Callable[[str, bool], None]) -> network.Held:
        queue = network.ThreadQueue(self._loop, take, network.DEPTH)
        put = self._zenoh.SampleKind.PUT

        def heard(sample: zenoh.Sample) -> None:
            queue.put(str(sample.key_expr), sample.kind == put)

        return _Declared(
            self._session.liveliness().declare_subscriber(pattern, heard, history=True)
        )

    def inbox(self, pattern: str, depth: int) -> network.Inbox[network.Received]:
        ring: Any = self._zenoh.handlers.RingChannel(depth)
        return network.Ring(
            self._session.declare_subscriber(pattern, ring),
            self._received,
            depth,
            self._zenoh.ZError,
        )

    def questions(self, key: str, depth: int) -> network.Inbox[network.Question]:
        ring: Any = self._zenoh.handlers.RingChannel(depth)
        # Complete: a client of rmw_zenoh asks those alone that answer for the whole key.
        declared = self._session.declare_queryable(key, ring, complete=True)
        return network.Ring(declared, self._question, depth, self._zenoh.ZError)

    def changes(self, pattern: str) -> network.Inbox[network.TokenChange]:
        ring: Any = self._zenoh.handlers.RingChannel(network.DEPTH)
        declared = self._session.liveliness().declare_subscriber(pattern, ring, history=True)
        put = self._zenoh.SampleKind.PUT

        def change(one: zenoh.Sample) -> network.TokenChange:
            return network.TokenChange(str(one.key_expr), one.kind == put)

        return network.Ring(declared, change, network.DEPTH, self._zenoh.ZError)

    def is_alone(self) -> bool:
        info = self._session.info
        return not (info.routers_zid() or info.peers_zid())

    def probe(self, key: str, *, timeout: float) -> network.Inbox[bool]:
        # No ring, which is emptied when the question has ended.
        queue: Any = self._zenoh.handlers.FifoChannel(_MOST_ANSWERS)
        asked = self._session.get(key, queue, timeout=timeout)
        return network.Ring(
            asked, lambda reply: reply.ok is not None, _MOST_ANSWERS, self._zenoh.ZError
        )

    # -- waited for ------------------------------------------------------------------------------

    async def ask(
        self,
        key: str,
        payload: bytes = b"",
        *,
        timeout: float,
        attachment: bytes = b"",
        settles: network.Settles | None = None,
    ) -> list[network.QueryAnswer]:

        def get(handler: Any) -> None:
            self._session.get(
                key,
                handler,
                payload=payload,
                attachment=attachment or None,
                timeout=timeout,
                target=self._zenoh.QueryTarget.ALL,
                consolidation=self._zenoh.ConsolidationMode.NONE,
            )

        def answer(session: str, one: zenoh.Sample) -> network.QueryAnswer:
            return network.QueryAnswer(str(one.key_expr), self._bytes(one.payload), session)

        def settled(*reply: Any) -> bool:
            return settles is not None and settles(answer(*reply))

        found = await self._replies(get, timeout, settled if settles else None)
        return [answer(*reply) for reply in found]

    async def tokens(self, pattern: str, *, timeout: float) -> list[str]:

        def get(handler: Any) -> None:
            self._session.liveliness().get(pattern, handler, timeout=timeout)

        return [str(one.key_expr) for _, one in await self._replies(get, timeout)]

    async def _replies(
        self,
        get: Callable[[Any], None],
        timeout: float,
        settles: Callable[..., bool] | None = None,
    ) -> list[tuple[str, zenoh.Sample]]:
        """The answers with their names, until zenoh says that no more come, or the time is over."""
        found: list[tuple[str, zenoh.Sample]] = []
        ended = asyncio.Event()

        def heard(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                who = reply.replier_id
                found.append(("" if who is None else str(who.zid), reply.ok))
                if settles is not None:
                    in_loop(look, *found[-1])

        def look(*reply: Any) -> None:
            if settles is not None and settles(*reply):
                self._loop.call_later(network.SETTLED_S, ended.set)

        def end() -> None:
            in_loop(ended.set)

        def in_loop(do: Callable[..., object], *what: Any) -> None:
            try:
                self._loop.call_soon_threadsafe(do, *what)
            except RuntimeError:
                _logger.debug("the event loop has ended: nobody waits for an answer")

        try:
            get(self._zenoh.handlers.Callback(heard, end))
        except self._zenoh.ZError as error:
            _logger.debug("not asked: %s", error)
            return []
        try:
            async with asyncio.timeout(timeout + 1.0):
                await ended.wait()
        except TimeoutError:
            _logger.warning("zenoh did not end a question in its time")
        return found


@asynccontextmanager
async def open_session(opening: Opening) -> AsyncIterator[ZenohBus]:
    """A session while the block runs; a router that is lost meanwhile is found again.

    Raises UsageError: the package is missing, the file or an option cannot be, a port is taken, or
    no router answered.
    """
    of_extra("zenoh", opening.purpose, opening.extra)
    import zenoh

    config = _config(opening)
    mode = str(read_json(config.get_json("mode") or "null") or "peer")
    is_reported = False
    clock = asyncio.get_running_loop().time
    until = clock() + opening.patience_s
    while True:
        try:
            session = await _opened(config)
            break
        except zenoh.ZError as error:
            if not (mode == "client" and (opening.is_patient or clock() < until)):
                raise _refused(error, mode, opening) from error
            if not is_reported and opening.is_patient:
                places = config.get_json("connect/endpoints")
                remedy = opening.remedies.get(mode, "")
                _logger.warning("no router answers yet at %s: %s", places, remedy)
                is_reported = True
        await asyncio.sleep(_AGAIN_S)
    try:
        yield ZenohBus(session, opening.largest)
    finally:
        await _closed(session)


def _beside(
    work: Callable[[], Any], unwanted: Callable[[Any], object] = lambda _: None
) -> asyncio.Future[Any]:
    """Work on a thread. ``unwanted`` takes there what came when nobody waited any more.

    It is none of the executor's threads: the loop would wait for it as it ends.
    """
    loop = asyncio.get_running_loop()
    found: asyncio.Future[Any] = loop.create_future()

    def settle(end: Callable[[Any], None], value: Any) -> None:
        if not found.done():
            end(value)
        elif end == found.set_result:
            _beside(partial(unwanted, value))

    def run() -> None:
        end: Callable[[Any], None] = found.set_result
        try:
            value = work()
        except Exception as error:  # noqa: BLE001 - raised again where it is waited for
            end, value = found.set_exception, error
        except BaseException as panic:  # noqa: BLE001 - of Rust, and no Exception
            cause = "this process may open no more files, or begin no more threads"
            panicked = M100Error(f"zenoh: {panic}", cause=cause, remedy="try ulimit -n 1024")
            end, value = found.set_exception, panicked
        try:
            loop.call_soon_threadsafe(settle, end, value)
        except RuntimeError:  # the event loop has ended
            if end == found.set_result:
                unwanted(value)

    threading.Thread(target=run, name=_BESIDE, daemon=True).start()
    return found


@atexit.register
def _wait_for_those_beside() -> None:
    """One that comes back from zenoh as Python 3.13 or older ends would abort the process."""
    for one in threading.enumerate():
        if one.name == _BESIDE:
            one.join(_CLOSE_S)


async def _opened(config: zenoh.Config) -> zenoh.Session:
    """Open a session; one that comes when nobody waits any more is closed again.

    A router that takes the connection and never answers, or refuses a certificate, holds up zenoh
    for as long as it likes: a verb that ends meanwhile must not wait for it.
    """
    import zenoh

    session: zenoh.Session = await _beside(
        partial(zenoh.open, config), lambda late: _unless_closed(late.close)
    )
    return session


async def _closed(session: zenoh.Session) -> None:
    """Close a session; one whose router does not answer is left to a thread of its own.

    There zenoh waits for its last try to connect, ten seconds long, and then raises: the caller
    that leaves the block would hear of its own error that much later, or of zenoh's instead.
    """
    _, late = await asyncio.wait(
        {_beside(partial(_unless_closed, session.close))}, timeout=_CLOSE_S
    )
    if late:
        _logger.info("a session is being closed whose router does not answer")


def _config(opening: Opening) -> zenoh.Config:
    import zenoh

    path, told_by = opening.file or ("", "")
    try:
        config = zenoh.Config.from_file(path) if path else zenoh.Config()
    except (zenoh.ZError, OSError) as error:
        raise UsageError(
            f"{told_by}: {path} cannot be read: {error}", remedy="name a JSON5 file of zenoh"
        ) from error
    for name, value in opening.options.items():
        try:
            config.insert_json5(name, value)
        except zenoh.ZError as error:
            raise UsageError(
                f"{name}={value} cannot be in a session: {error}", remedy="take it out, or mend it"
            ) from error
    return config


_NO_SESSION: dict[str, tuple[str, type[M100Error]]] = {
    "client": ("no router answered", NoRouter),
    "router": ("no router can be here", UsageError),
}


def _refused(error: Exception, mode: str, opening: Opening) -> M100Error:
    # zenoh's text ends with the place in its source.
    seen = str(error).partition(" at /")[0].strip()
    what, kind = _NO_SESSION.get(mode, ("no session of zenoh", UsageError))
    remedy = opening.remedies.get(mode, opening.remedies.get("", ""))
    if mode == "router" and "in use" in seen:
        kind = PortBusy
    return kind(f"{what}: {seen}", remedy=remedy)
