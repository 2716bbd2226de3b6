"""Keeping a connection to one aircraft: :func:`supervise`.

A connection ends with its line, and a program that wants it back would have to find out when to try
again, whether the same aircraft answers, and whether it has to be activated once more. A table of
states does that here. A flight does not go on: a control block ends with the connection that it was
begun on, and nothing here begins another.
"""

from __future__ import annotations

import asyncio
import logging
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn, Self

from m100link.aircraft.aircraft import Aircraft
from m100link.aircraft.connecting import connect
from m100link.errors import (
    AckTimeout,
    ActivationRefused,
    AnotherAircraft,
    LinkClosed,
    LinkError,
    LinkLost,
    M100Error,
    ReplayEnded,
    TelemetryError,
    UsageError,
)
from m100link.errors.usage import of_another_loop
from m100link.protocol.codes import ActivationCode
from m100link.telemetry.subscription import Hub, Latest, Newest, Policy, Subscription

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable
    from random import Random

    from m100link.protocol.commands.activation import Credentials, Version
    from m100link.protocol.firmware import FirmwareProfile
    from m100link.telemetry.sample import Sample

__all__ = [
    "BackOff",
    "Gap",
    "Supervised",
    "SupervisedTelemetry",
    "SupervisionEvent",
    "SupervisionState",
    "supervise",
]

_logger = logging.getLogger(__name__)


# -- where a connection that is kept stands, as a table; pauses between attempts -------------------
# See :func:`m100link.supervise`.


class SupervisionState(Enum):
    """Where the connection is."""

    IDLE = "idle"  # not begun
    CONNECTING = "connecting"  # the line is opened and the aircraft asked for its version
    ACTIVATING = "activating"  # it answered and is the same one; the app is activated
    CONNECTED = "connected"  # telemetry flows, control can be obtained
    WAITING = "waiting"  # until the next attempt
    REFUSED = "refused"  # no attempt would end otherwise: a person has to do something
    CLOSED = "closed"  # by this program


class SupervisionInput(Enum):
    """The inputs of the table."""

    START = "the block is entered"
    ANSWERED = "the same aircraft answered as before, or the first one"
    ACTIVATED = "it is activated, or need not be"
    FAILED = "an attempt failed, and a later one may not"
    LOST = "the line is gone, or the aircraft is silent"
    DEACTIVATED = "the aircraft was switched off and on meanwhile"
    REFUSED = "an attempt failed, and so would every other"
    DUE = "the pause is over"
    CLOSE = "the block is left"


_S, _I = SupervisionState, SupervisionInput

TRANSITIONS: dict[SupervisionState, dict[SupervisionInput, SupervisionState]] = {
    _S.IDLE: {_I.START: _S.CONNECTING, _I.CLOSE: _S.CLOSED},
    _S.CONNECTING: {
        _I.ANSWERED: _S.ACTIVATING,
        _I.FAILED: _S.WAITING,
        _I.REFUSED: _S.REFUSED,
        _I.CLOSE: _S.CLOSED,
    },
    _S.ACTIVATING: {
        _I.ACTIVATED: _S.CONNECTED,
        _I.FAILED: _S.WAITING,
        _I.LOST: _S.WAITING,
        _I.REFUSED: _S.REFUSED,
        _I.CLOSE: _S.CLOSED,
    },
    _S.CONNECTED: {
        _I.LOST: _S.WAITING,
        _I.DEACTIVATED: _S.ACTIVATING,
        _I.REFUSED: _S.REFUSED,  # another aircraft was plugged in behind an adapter that stayed
        _I.CLOSE: _S.CLOSED,
    },
    _S.WAITING: {_I.DUE: _S.CONNECTING, _I.CLOSE: _S.CLOSED},
    _S.REFUSED: {_I.CLOSE: _S.CLOSED},
    _S.CLOSED: {},
}
"""State, input, next state. A pair that is not in it cannot happen, or changes nothing."""

ENDED = (_S.REFUSED, _S.CLOSED)
"""States in which no aircraft comes any more."""


@dataclass(frozen=True, slots=True)
class BackOff:
    """How long to wait before each attempt.

    Raises:
        UsageError: One of them is out of its range.
    """

    first: float = 0.5  #: Seconds before the first repetition, above 0.
    factor: float = 2.0  #: By which each pause is longer than the one before, 1 or more.
    most: float = 15.0  #: Longest pause, s.
    #: Share by which a pause is longer or shorter by chance, 0 to below 1, so that many programs do
    #: not come back at the same moment.
    jitter: float = 0.2

    def __post_init__(self) -> None:
        if not (0 < self.first <= self.most < float("inf") and 1 <= self.factor < float("inf")):
            raise UsageError(
                f"{self} never ends or never begins", remedy="0 < first <= most, and factor >= 1"
            )
        if not 0 <= self.jitter < 1:
            raise UsageError(f"a jitter of {self.jitter} is not from 0 to below 1")

    def pause(self, attempt: int, random: Random) -> float:
        """Seconds before the attempt of that number, from 1."""
        # A power of it would overflow in a day of attempts.
        pause = self.first
        for _ in range(attempt - 1):
            pause *= self.factor
            if pause >= self.most or self.factor == 1:
                break
        return min(pause, self.most) * random.uniform(1.0 - self.jitter, 1.0 + self.jitter)


class SupervisionEvent(NamedTuple):
    """The connection passed from one state to another."""

    before: SupervisionState  #: State before.
    after: SupervisionState  #: State now.
    error: M100Error | None  #: Why, where something failed.
    next_attempt_in: float | None  #: Seconds until the next attempt, while one is waited for.


class Gap(NamedTuple):
    """Stands in a stream of telemetry for the time without a connection."""

    lost_at: float  #: Time of the event loop when the stream ended, s.
    back_at: float  #: When it went on, s.
    error: M100Error  #: Why it had ended.


# -- supervising -----------------------------------------------------------------------------------

CHECK_INTERVAL = 2.0
"""Seconds between two questions whether the aircraft is still there and still activated."""

SILENCE = 3.0
"""Seconds without an answer or a byte after which a connection counts as lost."""

_MOST_PASSED_OVER = 2
"""Looks that are left out while commands wait; then it is asked, lest one that was switched off and
on is never noticed by a program that asks without a pause."""

_GAP_S = 0.01

_ANSWER_S = 1.5
"""Seconds that the one question is waited for: a line by radio or network takes its time."""

_EVENTS = 100


# Codes behind which nothing is wrong with the app: the phone, its network, or the first time.
_PASSING = (
    ActivationCode.NEW_DEVICE,
    ActivationCode.APP_NOT_CONNECTED,
    ActivationCode.NO_INTERNET,
)


class Supervised:
    """A connection that comes back: see :func:`supervise`.

    Attributes:
        aircraft: The aircraft while it is connected, else None. After a loss it is another object.
        version: The newest version answer, None before the first.
        error: Why it is not connected; None while it is.
        attempts: Attempts since it was last connected.
        round_trip: Seconds that the newest question and its answer took, one every
            two seconds; None when it was not answered, or there was none yet.
    """

    def __init__(
        self,
        open_aircraft: Callable[[], Awaitable[Aircraft]],
        *,
        credentials: Credentials | None,
        back_off: BackOff,
        random: Random,
    ) -> None:
        self._open = open_aircraft
        self._credentials = credentials
        self._back_off = back_off
        self._random = random
        self._state = _S.IDLE
        self._hub: Hub[SupervisionEvent] = Hub()
        self._task: asyncio.Task[None] | None = None
        # Replaced with each change of state: who waits for one waits for it.
        self._changed: asyncio.Future[None] | None = None
        self._identity: str | None = None  # of the first aircraft that answered
        self.aircraft: Aircraft | None = None
        self.version: Version | None = None
        self.error: M100Error | None = None
        self.attempts = 0
        self.round_trip: float | None = None

    def __repr__(self) -> str:
        why = f": {self.error.seen}" if self.error is not None else ""
        return f"<supervised aircraft, {self._state.value}{why}>"

    @property
    def state(self) -> SupervisionState:
        """Where the connection is."""
        return self._state

    async def __aenter__(self) -> Self:
        if self._state is not _S.IDLE:
            raise UsageError(f"{self!r} was begun before", remedy="call supervise(...) again")
        self._feed(_I.START)
        self._task = asyncio.create_task(self._keep(), name="m100link supervision")
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.aclose()

    async def aclose(self) -> None:
        """Close the connection for good. May be called any number of times."""
        task, self._task = self._task, None
        self._feed(_I.CLOSE)
        if task is not None:
            task.cancel()
            # Not awaited itself: a cancellation of this call must not be taken for the task's, and
            # the task ends all the same.
            await asyncio.wait([task])
            if not task.cancelled():
                task.result()

    # -- waits of a program ----------------------------------------------------------------------

    async def connected(self) -> Aircraft:
        """The aircraft, as soon as it is connected. ``asyncio.timeout`` limits the wait.

        Raises:
            M100Error: No attempt would succeed; it says why.
            LinkClosed: The block was left.
        """
        # One whose line is gone is still there until this has been noticed: nobody wants that one,
        # and who iterates over its end would not let the task run that notices it.
        while (aircraft := self.aircraft) is None or not aircraft.is_connected:
            self._raise_if_ended()
            await self._change()
        return aircraft

    def events(self) -> Subscription[SupervisionEvent]:
        """Each change of state, from now on."""
        return self._hub.subscribe(Newest(_EVENTS))

    def telemetry(
        self, *records: type[Any], policy: Policy | None = None, rate_hz: float | None = None
    ) -> SupervisedTelemetry:
        """Telemetry across losses of the connection; each is marked by a :class:`Gap`.

        Args:
            records: As in :meth:`m100link.Aircraft.telemetry`.
            policy: As there.
            rate_hz: As there.

        Raises (while iterating):
            TelemetryOverflow: A ``Lossless`` consumer fell behind.
            M100Error: No attempt to connect would succeed; it says why.
        """
        return SupervisedTelemetry(self, records, policy or Latest(), rate_hz)

    def _raise_if_ended(self) -> None:
        if self._state is _S.CLOSED:
            raise LinkClosed("the supervision was ended by this side")
        if self._state is _S.REFUSED and self.error is not None:
            raise self.error.again()
        if self._state is _S.IDLE:
            raise UsageError("the supervision has not begun", remedy="async with supervise(...)")

    async def _change(self) -> None:
        loop = asyncio.get_running_loop()
        if self._task is not None and self._task.get_loop() is not loop:
            raise of_another_loop()
        if self._changed is None:
            self._changed = loop.create_future()
        await asyncio.wait([self._changed])

    # -- the machine -----------------------------------------------------------------------------

    def _feed(
        self,
        happened: SupervisionInput,
        error: M100Error | None = None,
        pause: float | None = None,
    ) -> None:
        after = TRANSITIONS[self._state].get(happened)
        if after is None:
            return
        before, self._state = self._state, after
        if error is not None:
            self.error = error
        event = SupervisionEvent(before, after, error, pause)
        why = "" if error is None else f" ({error.seen})"
        _logger.info("supervision: %s → %s%s", before.value, after.value, why)
        self._hub.publish(event, asyncio.get_running_loop().time())
        changed, self._changed = self._changed, None
        if changed is not None and not changed.done():
            changed.set_result(None)

    async def _keep(self) -> None:
        """Connect, watch, wait, and again, until that cannot succeed."""
        try:
            while self._state not in ENDED:
                pause = await self._hold()
                if self._state is _S.WAITING:
                    await asyncio.sleep(pause)
                    self._feed(_I.DUE)
        finally:
            if self._state is not _S.REFUSED:
                self._feed(_I.CLOSE)  # whatever ended it, nobody may wait for it for ever

    async def _hold(self) -> float:
        """Connect once, and stay until it is lost; returns how long to wait then."""
        self.attempts += 1
        aircraft: Aircraft | None = None
        try:
            aircraft = await self._open()
            self._identify(await aircraft.version())
            self._feed(_I.ANSWERED)
            await self._activate(aircraft)
            self.aircraft, self.error, self.attempts = aircraft, None, 0
            self._feed(_I.ACTIVATED)
            await self._watch(aircraft)
        except M100Error as error:
            self.aircraft = self.round_trip = None
            return self._fail(error)  # reported first: to close a dead line may take a second
        finally:
            self.aircraft = self.round_trip = None
            if aircraft is not None:
                await aircraft.aclose()

    def _fail(self, error: M100Error) -> float:
        """An attempt or a connection ended; returns how long to wait."""
        if _is_final(error):
            self._feed(_I.REFUSED, error)
            return 0.0
        pause = self._back_off.pause(max(1, self.attempts), self._random)
        happened = _I.LOST if self._state is _S.CONNECTED else _I.FAILED
        self._feed(happened, error, pause)
        return pause

    def _identify(self, version: Version) -> None:
        """Raise ``AnotherAircraft`` unless serial number or else version is that of the first."""
        identity = version.serial or version.name
        if self._identity is None:
            self._identity = identity
        elif identity != self._identity:
            raise AnotherAircraft(
                f"{identity} answers where {self._identity} was",
                expected=self._identity,
                found=identity,
                cause="the cable was plugged into another aircraft, or its firmware was changed",
                remedy="plug it back, or begin the program anew",
            )
        self.version = version

    async def _activate(self, aircraft: Aircraft) -> None:
        if self._credentials is not None:
            await aircraft.activate(self._credentials)

    async def _watch(self, aircraft: Aircraft) -> NoReturn:
        """Ask now and then whether it is there and activated; raises when it is not there.

        A line may stay open while the aircraft behind it is switched off.
        """
        clock = asyncio.get_running_loop().time
        heard_at = clock()
        passed_over = 0
        while True:
            try:
                async with asyncio.timeout(CHECK_INTERVAL):
                    error = await aircraft.wait_closed()
                raise error or LinkLost("the line went away")
            except TimeoutError:
                pass
            last = _latest(aircraft, heard_at)
            is_heard = clock() - last < CHECK_INTERVAL
            if is_heard and passed_over < _MOST_PASSED_OVER and not await _gap(aircraft):
                heard_at, passed_over = last, passed_over + 1
                continue
            passed_over = 0
            asked_at = clock()
            try:
                version = await aircraft._requests.query_version(timeout=_ANSWER_S, tries=1)
            except AckTimeout as error:
                self.round_trip = None
                heard_at = _latest(aircraft, heard_at)
                if clock() - heard_at > SILENCE:
                    raise LinkLost(
                        f"the aircraft is silent for {clock() - heard_at:.0f} s",
                        cause="it was switched off, or a wire came loose",
                        remedy="check its power and the cable; it is tried again",
                    ) from error
                continue
            heard_at = clock()
            self.round_trip = heard_at - asked_at
            self._identify(version)
            if self._credentials is not None and not version.is_activated:
                await self._activate_again(aircraft)

    async def _activate_again(self, aircraft: Aircraft) -> None:
        """It was switched off and on faster than its silence was noticed."""
        self.aircraft = None
        self._feed(_I.DEACTIVATED)
        await self._activate(aircraft)
        self.aircraft = aircraft
        self._feed(_I.ACTIVATED)


def _latest(aircraft: Aircraft, heard_at: float) -> float:
    at = aircraft.link.last_received_at
    return heard_at if at is None else max(heard_at, at)


async def _gap(aircraft: Aircraft) -> bool:
    """Wait for a moment in which no command waits for its answer; whether there was one.

    At a version query an aircraft may forget what it has answered: the repeat of a command whose
    answer was late would be carried out a second time. So would one that begins meanwhile, where
    the query itself is repeated: it is asked once.
    """
    for _ in range(round(CHECK_INTERVAL / _GAP_S)):
        if not aircraft.link.is_asking:
            return True
        await asyncio.sleep(_GAP_S)
    return False


def _is_final(error: M100Error) -> bool:
    """Whether every other attempt would end like this one."""
    if isinstance(error, ActivationRefused):
        return error.code not in _PASSING
    return isinstance(error, UsageError | AnotherAircraft | ReplayEnded)


class SupervisedTelemetry:
    """Samples, and a :class:`Gap` for each loss: see :meth:`Supervised.telemetry`."""

    def __init__(
        self,
        supervised: Supervised,
        records: tuple[type[Any], ...],
        policy: Policy,
        rate_hz: float | None,
    ) -> None:
        self._supervised = supervised
        self._records, self._policy, self._rate_hz = records, policy, rate_hz
        self._samples: Subscription[Sample] | None = None
        # When and why the last stream ended, until the next one goes on.
        self._lost: tuple[float, M100Error] | None = None
        self._is_closed = False

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop receiving. May be called any number of times."""
        self._is_closed = True
        if self._samples is not None:
            self._samples.close()

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> Sample | Gap:
        clock = asyncio.get_running_loop().time
        while not self._is_closed:
            if self._samples is None:
                await self._subscribe()
                if self._lost is not None:
                    (lost_at, error), self._lost = self._lost, None
                    return Gap(lost_at, clock(), error)
            assert self._samples is not None
            try:
                return await anext(self._samples)
            except TelemetryError:
                raise  # of this consumer, not of the line
            except LinkError as error:
                self._samples, self._lost = None, (clock(), error)
        raise StopAsyncIteration

    async def _subscribe(self) -> None:
        try:
            aircraft = await self._supervised.connected()
        except LinkClosed:
            raise StopAsyncIteration from None
        self._samples = aircraft.telemetry(
            *self._records, policy=self._policy, rate_hz=self._rate_hz
        )


def supervise(
    url: str,
    credentials: Credentials | None = None,
    *,
    firmware: str | FirmwareProfile | None = None,
    baud_rate: int | None = None,
    timeout: float | None = None,
    back_off: BackOff | None = None,
    random: Random | None = None,
    acceleration: str | None = None,
) -> Supervised:
    """Keep a connection to one aircraft for the time of a block.

    ::

        async with m100link.supervise("/dev/ttyUSB0", credentials) as supervised:
            async for sample in supervised.telemetry(m100link.Position):
                if isinstance(sample, m100link.Gap):
                    print(f"{sample.back_at - sample.lost_at:.0f} s are missing: {sample.error}")

    A line that cannot be opened or is lost is tried again, after longer and longer pauses. It has
    to be the same aircraft, by its serial number (firmware 2.3 and later) or its version; it is
    activated again. **Control never resumes by itself**: a control block ends with the connection
    that it was begun on, and its setpoints with it; the aircraft hovers. To fly on, obtain
    control again, on :meth:`Supervised.connected`.

    Args:
        url: As :func:`m100link.connect` takes it.
        credentials: App id and key; without them the aircraft is only watched.
        firmware: As there.
        baud_rate: As there.
        timeout: As there, at each attempt.
        back_off: Pauses between attempts.
        random: Of the jitter; seed it for the same pauses again.
        acceleration: As there.

    Ends for good, with the error that says why in its attribute ``error``: another aircraft
    answers, the app is refused for a reason that does not pass by itself, the URL is none.
    """

    async def open_aircraft() -> Aircraft:
        return await connect(
            url,
            firmware=firmware,
            baud_rate=baud_rate,
            timeout=timeout,
            acceleration=acceleration,
        )

    if random is None:
        from random import Random  # which takes long to load, for what few programs do

        random = Random()
    return Supervised(
        open_aircraft,
        credentials=credentials,
        back_off=back_off or BackOff(),
        random=random,
    )
