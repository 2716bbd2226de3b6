"""The thread where the aircraft of a program without ``await`` lives, and members that ask it."""

from __future__ import annotations

import asyncio
import atexit
import inspect
import os
import queue
import re
import threading
from collections import deque
from collections.abc import Callable, Coroutine
from contextlib import suppress
from functools import update_wrapper
from typing import Any, Concatenate, Generic, ParamSpec, Self, TypeVar, get_type_hints, overload

from m100link.errors import LinkClosed, M100Error, UsageError
from m100link.sim.clock import LockstepEventLoop
from m100link.sync.signals import SIGNALS

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")


class Caller:
    """The thread that waits for a call: callbacks of the call run in it, not beside the aircraft.

    A callback that takes long delays nobody but the thread that gave it.

    The clock stands still while nobody waits; without one time passes by itself.
    """

    def __init__(self, clock: LockstepEventLoop | None = None) -> None:
        self._clock = clock
        # Callbacks, then error and value. Both threads touch nothing else: a lock that is written
        # in Python, as a Future has one, stays locked when a signal raises in the thread that just
        # took it, and the event loop would wait for it.
        self._inbox: queue.SimpleQueue[Any] = queue.SimpleQueue()

    def begin_waiting(self) -> None:
        """The aircraft's time passes."""
        if self._clock is not None:
            self._clock.begin_waiting()

    def end_waiting(self) -> None:
        """The thread has something to do, which takes no time of the aircraft."""
        if self._clock is not None:
            self._clock.end_waiting()

    def begin(self, method: Callable[P, R], /, *args: P.args, **kwargs: P.kwargs) -> R:
        """Call it in the event loop; its ``progress`` runs here."""
        progress: Any = kwargs.get("progress")
        if progress is not None:
            kwargs["progress"] = self.callback(progress)
        return method(*args, **kwargs)

    def callback(self, function: Callable[[T], None]) -> Callable[[T], None]:
        """For the loop, run here: a slow one gets the newest value, in lockstep all of them."""
        values: deque[T] = deque(maxlen=1 if self._clock is None else None)

        def hand_over(value: T) -> None:
            values.append(value)
            self._inbox.put(lambda: function(values.popleft()) if values else None)

        return hand_over

    async def ask(self, function: Callable[[T], R], value: T) -> R:
        """Run ``function`` here, and return what it returns."""
        loop = asyncio.get_running_loop()
        answer: asyncio.Future[R] = loop.create_future()

        def give(result: R) -> None:
            if not answer.done():  # the call may have been cancelled meanwhile
                answer.set_result(result)

        self._inbox.put(lambda: loop.call_soon_threadsafe(give, function(value)))
        self.end_waiting()
        try:
            return await answer
        finally:
            self.begin_waiting()

    def end(self, error: BaseException | None, value: object = None) -> None:
        """The call has ended; of several ends the first one counts."""
        self._inbox.put((error, value))

    def serve(self) -> Any:
        """Run callbacks until the call has ended. Returns or raises its end, or raises theirs."""
        while callable(said := self._inbox.get()):
            said()
        error, value = said
        try:
            if error is not None:
                raise error
            return value
        finally:
            del error, said  # the traceback would hold this frame, which holds the error


def _live(loop_factory: Callable[[], asyncio.AbstractEventLoop] | None, begun: Caller) -> None:
    """Run an event loop until it is stopped, then end what is left in it."""
    loop = None
    try:
        with asyncio.Runner(loop_factory=loop_factory) as runner:
            loop = runner.get_loop()
            loop.call_soon(begun.end, None, loop)
            loop.run_forever()
    except BaseException as error:
        if loop is not None:
            raise
        begun.end(error)


class Portal:
    """An event loop in a thread of its own, and the doors to it.

    It closes when the program ends, if nobody did it before.

    ``loop_factory`` makes the event loop; None: as asyncio does.
    """

    def __init__(self, loop_factory: Callable[[], asyncio.AbstractEventLoop] | None = None) -> None:
        begun = Caller()
        # No generator and no context manager waits for its end here: in the child of a fork, which
        # has no such thread, it would wait for ever.
        self._thread = threading.Thread(
            target=_live, args=(loop_factory, begun), name="m100link: aircraft", daemon=True
        )
        self._thread.start()
        self._loop: asyncio.AbstractEventLoop = begun.serve()
        # Whose clock passes only while somebody waits; None: it does not ask.
        self._lockstep = self._loop if isinstance(self._loop, LockstepEventLoop) else None
        self._process = os.getpid()  # the child of a fork has no such thread
        self._waiting: set[Caller] = set()  # for an end
        self._tasks: list[asyncio.Task[None]] = []  # of :meth:`soon_await`
        self.is_open = True  # whether calls are taken

    def soon(self, function: Callable[[], object]) -> None:
        """Call it in the event loop, and do not wait for it. Allowed in a signal handler."""
        if self.is_open and self._process == os.getpid():
            self._schedule(function)

    def _schedule(self, function: Callable[[], object]) -> None:
        with suppress(RuntimeError):  # another thread closed it: `close` answers who waits
            self._loop.call_soon_threadsafe(function)

    def soon_await(self, make: Callable[[], Coroutine[Any, Any, object]]) -> None:
        """As :meth:`soon`, where the function waits; its error ends there."""

        async def carry_out() -> None:
            with suppress(M100Error):
                await make()

        self.soon(lambda: self._tasks.append(self._loop.create_task(carry_out())))

    def call(self, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Call what does not wait in the event loop, and return what it returns.

        Raises:
            UsageError: The aircraft was closed, or this runs in its thread.
        """
        caller = Caller()

        def run() -> None:
            try:
                caller.end(None, function(*args, **kwargs))
            except BaseException as error:  # noqa: BLE001 (it belongs to the caller)
                caller.end(error)

        answer: T = self._answer_of(caller, run)
        return answer

    def wait(self, make: Callable[[Caller], Coroutine[Any, Any, T]]) -> T:
        """Await what ``make`` makes in the event loop. An exception in this thread cancels it.

        Raises:
            UsageError: The aircraft was closed, or this runs in its thread.
            LinkClosed: Another thread closed it meanwhile.
        """
        caller = Caller(self._lockstep)
        tasks: list[asyncio.Task[None]] = []  # kept: an event loop holds its tasks weakly

        async def carry_out() -> None:
            caller.begin_waiting()
            error, result = None, None
            try:
                result = await make(caller)
            except BaseException as raised:  # noqa: BLE001 (it belongs to the caller)
                error = raised
            caller.end_waiting()
            if self.is_open or not isinstance(error, asyncio.CancelledError):  # or `close` does
                caller.end(error, result)

        try:
            answer: T = self._answer_of(
                caller, lambda: tasks.append(self._loop.create_task(carry_out()))
            )
            return answer
        except BaseException:
            # It may have begun, wherever a signal raised: nobody waits for it any more.
            self.soon(lambda: [task.cancel() for task in tasks])
            raise

    def _answer_of(self, caller: Caller, function: Callable[[], object]) -> Any:
        """Call it in the event loop, and return the end that it leads to, or that of the portal."""
        # Before it is asked whether this is open: who closes looks for what waits afterwards.
        self._waiting.add(caller)
        try:
            self._require_open()
            SIGNALS.take_again()
            self._schedule(function)
            return caller.serve()
        finally:
            self._waiting.discard(caller)

    def _require_open(self) -> None:
        if not self.is_open:
            raise UsageError("the aircraft was closed", remedy="connect() again")
        if self._process != os.getpid():
            raise UsageError(
                "the aircraft belongs to the process from which this one was forked",
                remedy="fork before connect(), and fly from one process",
            )
        if threading.current_thread() is self._thread:
            raise UsageError(
                "a call that waits was made in the thread of the aircraft, and would wait for ever",
                remedy="in callbacks of the event loop use the API with await",
            )

    def close(self) -> None:
        """End the thread. May be called any number of times."""
        self.is_open = False
        if self._process == os.getpid() and self._thread.is_alive():
            self._schedule(self._loop.stop)
            self._thread.join()
        why = "the aircraft was closed by another thread while this one waited for it"
        for caller in list(self._waiting):
            caller.end(LinkClosed(why))

    def close_after(
        self, close: Callable[[], Coroutine[Any, Any, None]], on_end: Callable[[], None]
    ) -> Callable[[], None]:
        """A function that awaits ``close`` and closes this; the end of the program calls it too."""

        def end() -> None:
            if self._process != os.getpid():
                return  # it is the parent's to close
            if self.is_open:
                # Refused in its own thread, which cannot wait: it must not look closed.
                self._require_open()
                try:
                    self.wait(lambda _: close())
                finally:
                    self.close()
            atexit.unregister(end)
            on_end()

        atexit.register(end)
        return end


# -- members of a class without ``await``: what is not said here is as it is with it ---------------


_WORDS = (
    (r"async (with|for)", r"\1"),
    (r"await asyncio\.sleep", "time.sleep"),
    (r"await ", ""),
    (r"aclose", "close"),
    (r"m100link\.connect", "m100link.sync.connect"),
    (r" \(when it is entered or awaited\)", ""),
    (r"; no asyncio, but trio", ""),
)
"""Words of a docstring, and what they are here."""


def described(member: Any) -> str | None:
    """The docstring of a member with ``await`` as it reads here; None under ``python -OO``."""
    text: str | None = member.__doc__
    for word, other in _WORDS if text else ():
        text = re.sub(word, other, text or "")
    return text


def shown_as(made: Callable[..., Any], method: Callable[..., Any], returned: Any = None) -> None:
    """Give a function the parameters of one with ``await``, and its docstring if it has none."""
    doc = made.__doc__ or described(method)
    update_wrapper(made, method)
    made.__doc__ = doc
    if returned is not None:
        made.__annotations__ = {**method.__annotations__, "return": returned}
        signature = inspect.signature(method).replace(return_annotation=returned)
        made.__dict__["__signature__"] = signature


class Handed:
    """An object in the thread of a portal, for the threads of a program."""

    def __init__(self, portal: Portal, aio: Any) -> None:
        self._portal = portal
        self._aio = aio  # the one with ``await``

    def __repr__(self) -> str:
        return repr(self._aio)


class Reads(property, Generic[T]):
    """A property of the one with ``await``."""

    def __init__(self, member: Any) -> None:
        def get(self: Handed) -> Any:
            return getattr(self._aio, member.fget.__name__)

        super().__init__(update_wrapper(get, member.fget))
        self.__doc__ = described(member)

    @overload
    def __get__(self, instance: None, owner: type, /) -> Self: ...
    @overload
    def __get__(self, instance: Any, owner: type | None = None, /) -> T: ...
    def __get__(self, instance: Any, owner: type | None = None, /) -> Any:
        return super().__get__(instance, owner)


def waits(
    method: Callable[Concatenate[Any, P], Coroutine[Any, Any, R]],
) -> Callable[Concatenate[Any, P], R]:
    """A method that awaits that of the one with ``await``; ``progress`` is called by the caller."""

    def wait(self: Any, /, *args: P.args, **kwargs: P.kwargs) -> R:
        wanted = getattr(self._aio, method.__name__)
        answer: R = self._portal.wait(lambda caller: caller.begin(wanted, *args, **kwargs))
        return answer

    shown_as(wait, method)
    return wait


def calls(method: Callable[Concatenate[Any, P], R]) -> Callable[Concatenate[Any, P], R]:
    """A method that calls that of the one with ``await``, which does not wait."""

    def call(self: Any, /, *args: P.args, **kwargs: P.kwargs) -> R:
        answer: R = self._portal.call(getattr(self._aio, method.__name__), *args, **kwargs)
        return answer

    shown_as(call, method)
    return call


def like(
    method: Callable[Concatenate[Any, P], object],
) -> Callable[[Callable[..., T]], Callable[Concatenate[Any, P], T]]:
    """Give a method the arguments and the docstring of the one with ``await``."""
    wanted = inspect.signature(method)

    def marked(made: Callable[..., T]) -> Callable[Concatenate[Any, P], T]:
        def call(self: Any, /, *args: P.args, **kwargs: P.kwargs) -> T:
            wanted.bind(self, *args, **kwargs)  # a misspelt one is an error here, not in the block
            return made(self, *args, **kwargs)

        call.__doc__ = made.__doc__
        shown_as(call, method, get_type_hints(made)["return"])
        return call

    return marked
