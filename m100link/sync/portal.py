"""The thread where the aircraft of a program without ``await`` lives, and members that ask it."""

from __future__ import annotations

import asyncio
import atexit
import inspect
import os
import queue
import re
import threading
from collections.abc import Callable, Coroutine
from concurrent.futures import Future
from functools import partial, update_wrapper
from typing import Any, Concatenate, Generic, ParamSpec, Self, TypeVar, get_type_hints, overload

from m100link.errors import LinkClosed, UsageError
from m100link.sim.clock import LockstepEventLoop

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")


class Caller:
    """The thread that waits for a call: callbacks of the call run in it, not beside the aircraft.

    A callback that takes long delays nobody but the thread that gave it.

    The clock stands still while nobody waits; without one time passes by itself.
    """

    def __init__(self, clock: LockstepEventLoop | None) -> None:
        self._clock = clock
        self._inbox: queue.SimpleQueue[Callable[[], object] | None] = queue.SimpleQueue()

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
        """``function``, to be called by the event loop and run here."""
        return lambda value: self._inbox.put(partial(function, value))

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

    def serve(self, ended: Future[Any]) -> None:
        """Run callbacks until the call has ended. Raises what a callback raises."""
        ended.add_done_callback(lambda _: self._inbox.put(None))
        while (callback := self._inbox.get()) is not None:
            callback()


def _live(
    loop_factory: Callable[[], asyncio.AbstractEventLoop] | None,
    begun: Future[asyncio.AbstractEventLoop],
) -> None:
    """Run an event loop until it is stopped, then end what is left in it."""
    try:
        with asyncio.Runner(loop_factory=loop_factory) as runner:
            loop = runner.get_loop()
            loop.call_soon(begun.set_result, loop)
            loop.run_forever()
    except BaseException as error:
        if begun.done():
            raise
        begun.set_exception(error)


def _closed() -> LinkClosed:
    return LinkClosed("the aircraft was closed by another thread while this one waited for it")


class Portal:
    """An event loop in a thread of its own, and the doors to it.

    It closes when the program ends, if nobody did it before.

    ``loop_factory`` makes the event loop; None: as asyncio does.
    """

    def __init__(self, loop_factory: Callable[[], asyncio.AbstractEventLoop] | None = None) -> None:
        begun: Future[asyncio.AbstractEventLoop] = Future()
        # No generator and no context manager waits for its end here: in the child of a fork, which
        # has no such thread, it would wait for ever.
        self._thread = threading.Thread(
            target=_live, args=(loop_factory, begun), name="m100link: aircraft", daemon=True
        )
        self._thread.start()
        self._loop = begun.result()
        # Whose clock passes only while somebody waits; None: it does not ask.
        self._lockstep = self._loop if isinstance(self._loop, LockstepEventLoop) else None
        self._process = os.getpid()  # the child of a fork has no such thread
        self._unanswered: set[Future[Any]] = set()  # what threads wait for
        self.is_open = True  # whether calls are taken

    def soon(self, function: Callable[[], object]) -> None:
        """Call it in the event loop, and do not wait for it. Allowed in a signal handler."""
        if self.is_open and self._process == os.getpid():
            self._schedule(function)

    def _schedule(self, function: Callable[[], object]) -> None:
        try:
            self._loop.call_soon_threadsafe(function)
        except RuntimeError:
            if not self._loop.is_closed():  # by another thread: `close` answers who waits
                raise

    def call(self, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Call what does not wait in the event loop, and return what it returns.

        Raises:
            UsageError: The aircraft was closed, or this runs in its thread.
        """
        done: Future[T] = self._awaited()

        def run() -> None:
            try:
                done.set_result(function(*args, **kwargs))
            except BaseException as error:  # noqa: BLE001 (it belongs to the caller)
                done.set_exception(error)

        self._schedule(run)
        return done.result()

    def wait(self, make: Callable[[Caller], Coroutine[Any, Any, T]]) -> T:
        """Await what ``make`` makes in the event loop. Ctrl-C cancels it.

        Raises:
            UsageError: The aircraft was closed, or this runs in its thread.
            LinkClosed: Another thread closed it meanwhile.
        """
        caller = Caller(self._lockstep)
        done: Future[T] = self._awaited()
        tasks: list[asyncio.Task[None]] = []  # kept: an event loop holds its tasks weakly

        async def carry_out() -> None:
            caller.begin_waiting()
            try:
                result = await make(caller)
            except BaseException as error:  # noqa: BLE001 (it belongs to the caller)
                caller.end_waiting()
                is_end = isinstance(error, asyncio.CancelledError) and not self.is_open
                done.set_exception(_closed() if is_end else error)
            else:
                caller.end_waiting()
                done.set_result(result)

        self._schedule(lambda: tasks.append(self._loop.create_task(carry_out())))
        try:
            caller.serve(done)
        except BaseException:
            self.soon(lambda: [task.cancel() for task in tasks])
            raise
        return done.result()

    def _awaited(self) -> Future[Any]:
        """A future for a thread to wait for: an answer sets it, or the end of the portal does."""
        done: Future[Any] = Future()
        # Before it is asked whether this is open: who closes looks for what waits afterwards.
        self._unanswered.add(done)
        done.add_done_callback(self._unanswered.discard)
        try:
            self._require_open()
            return done
        except UsageError:
            self._unanswered.discard(done)
            raise

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
        for done in list(self._unanswered):
            if not done.done():
                done.set_exception(_closed())

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
