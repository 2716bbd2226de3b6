"""First contact: an owner's first hour with an aircraft, propellers off, that measures.

No source describes some points of the protocol. The virtual aircraft follows an assumption on each;
this finds what a real one does. It sends version queries, the activation and requests for control
authority, and no command that arms, takes off or moves. The person does the rest by hand.
"""

from __future__ import annotations

import asyncio
import math
from collections import Counter
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from enum import Enum
from statistics import median
from typing import Any, NamedTuple

from m100link.aircraft import Aircraft, connect
from m100link.apps.doctor.diagnosis import TELEMETRY_S
from m100link.errors import AuthorityRefused, LinkError, M100Error
from m100link.flight.cancellation import SIGNALS, new_task, undisturbed
from m100link.flight.tasks import stands
from m100link.link import Direction, Tap
from m100link.protocol.codes import AuthorityCode
from m100link.protocol.commands.activation import RATES_HZ, Credentials
from m100link.protocol.commands.control import RequestAuthority
from m100link.protocol.commands.monitor import AuthorityChanged
from m100link.protocol.firmware import Generation
from m100link.protocol.items import BY_RECORD
from m100link.protocol.records import (
    Acceleration,
    ControlDevice,
    Device,
    Position,
    RcMode,
    RemoteControl,
    Velocity,
)
from m100link.telemetry.subscription import Newest
from m100link.wire import FrameDecoder

Ask = Callable[[str], Awaitable[bool]]
"""Asks the person to do something; returns when it is done. False: it was not done."""

_QUERIES = 20
_QUIET_S = 2.0  # in which a push at 1 Hz, or a notification, comes
_REST_S = 4.0  # in which an aircraft at rest shows its acceleration mode at any rate
_PAUSE_S = 0.1  # between two requests for authority
_STEP_S, _LIFT_S = 0.1, 6.0  # of the path that is kept, and how long a rise takes at most
_LIFTED_M = 0.5  # least change of the barometer's altitude
_SHARE = 0.3  # least part of it that the velocity has to show, either way
_MOVED = 300  # of 10000: a stick that somebody moves
_HELD = 5000  # a stick that is held all the way, or nearly


class Topic(Enum):
    """A point that is found out: the question, and the assumption of the virtual aircraft."""

    VERSION = "version text", "of a known firmware"
    ITEM_RATES = "telemetry items, Hz", "as in the document"
    LATENCY = "answers after", "within 0.1 s"
    ACCELERATION = "acceleration at rest", "fused"
    MISSION_STATUS = "mission status while no mission flies", "sent"
    VERTICAL_VELOCITY = "vertical velocity is positive", "up"
    RC_LOST = "RC channels once the remote control is off", "zeros"
    OBTAIN_P = "answers to obtaining in P", "refused"
    OBTAIN_A = "answers to obtaining in A", "refused"
    OBTAIN_F = "answers to obtaining in F", "obtained"
    OBTAIN_AGAIN = "answer to obtaining while it is held", "2"
    RELEASE = "answers to releasing", "released"
    OWN_RELEASE = "notification of an own release", "none"

    @property
    def question(self) -> str:
        return self.value[0]

    @property
    def assumed(self) -> str:
        """The behaviour of the virtual aircraft."""
        return self.value[1]


@dataclass(frozen=True, slots=True)
class Observation:
    """One topic as it was seen."""

    topic: Topic  #: which
    found: str  #: in the words of the assumption; empty when it was not seen
    seen: str  #: the figures, or why it was not seen

    @property
    def is_seen(self) -> bool:
        return bool(self.found)

    @property
    def differs(self) -> bool:
        """Whether the aircraft does otherwise than the virtual one."""
        return self.is_seen and self.found != self.topic.assumed

    def to_json(self) -> dict[str, Any]:
        return {
            "topic": self.topic.name.lower(),
            "asked": self.topic.question,
            "assumed": self.topic.assumed,
            "found": self.found or None,
            "differs": self.differs,
            "seen": self.seen,
        }


@dataclass(slots=True)
class Contact:
    """All that was seen, in order. Neither app id, key, serial number nor place is in it."""

    firmware: str = ""  #: profile in use; empty when the aircraft did not answer
    observations: list[Observation] = field(default_factory=list)  #: one for each topic
    ended_by: str = ""  #: why it ended early
    is_cut_off: bool = False  #: whether it ended early because the line went away
    #: False while the aircraft may still have given control to this program.
    is_given_back: bool = True

    def get(self, topic: Topic) -> Observation | None:
        """The observation of a topic, None before it was looked at."""
        return next((one for one in self.observations if one.topic is topic), None)

    @property
    def differences(self) -> list[Observation]:
        """The points on which this aircraft differs from the virtual one."""
        return [one for one in self.observations if one.differs]

    @property
    def found(self) -> dict[str, str]:
        """The findings by topic, for the configuration."""
        return {one.topic.name.lower(): one.found for one in self.observations if one.is_seen}

    def note_end(self, working: asyncio.Task[None]) -> None:
        """Why it ended. Raises the error of the work, unless the line went away."""
        if working.cancelled():
            self.ended_by = "it was interrupted"
            return
        try:
            working.result()
        except LinkError as error:
            # Its text names the port or the address, which belongs into no report.
            self.is_cut_off = True
            self.ended_by = f"the line went away ({type(error).__name__})"

    def to_json(self) -> dict[str, Any]:
        return {
            "firmware": self.firmware,
            "ended_by": self.ended_by or None,
            "given_back": self.is_given_back,
            "differences": [one.topic.name.lower() for one in self.differences],
            "observations": [one.to_json() for one in self.observations],
        }


class _Witness:
    """Counts the pushes of the line by their address, whatever the library makes of them."""

    def __init__(self) -> None:
        self._decoder = FrameDecoder()
        self.pushes: Counter[bytes] = Counter()

    def tap(self, direction: Direction, data: bytes, now: float) -> None:
        if direction is Direction.RECEIVED:
            for frame in self._decoder.feed(data):
                if not frame.is_ack:
                    self.pushes[frame.data[:2]] += 1


_STATUS = b"\x02\x03"
_NOTIFIED = bytes(AuthorityChanged.ADDRESS)


async def first_contact(
    url: str,
    *,
    ask: Ask,
    credentials: Credentials | None = None,
    firmware: str | None = None,
    baud_rate: int | None = None,
    timeout: float | None = None,
    tell: Callable[[Observation], object] = lambda _: None,
    say: Callable[[str], object] = lambda _: None,
    keep: Callable[[Contact], object] = lambda _: None,
    open_aircraft: Callable[[Tap], Awaitable[Aircraft]] | None = None,
) -> Contact:
    """Find out what a real aircraft does where no source says it. Nothing moves.

    A signal such as Ctrl-C, or a cancellation, ends it early: control goes back first, however
    often it comes.

    Args:
        url: Where the aircraft is, as :func:`m100link.connect` takes it.
        ask: Has the person do something. The first question is whether the propellers are off.
        credentials: App id and key; without them nothing is activated and no authority asked for.
        firmware: Force a firmware profile.
        baud_rate: Rate when the URL has none.
        timeout: Seconds until the aircraft has to answer, as :func:`m100link.connect` takes them.
        tell: Gets each observation at once.
        say: Gets what happens meanwhile, such as that control was obtained.
        keep: Gets all that was seen at every end, before a signal acts.
        open_aircraft: Connects in place of :func:`m100link.connect`, with this tap.

    Raises:
        BadURL, UsageError, NoAircraft, PortNotFound, PortPermissionDenied, PortBusy, PortFailed:
            There is no aircraft to look at; see each class.
    """
    witness = _Witness()
    if open_aircraft is None:
        aircraft = await connect(
            url, firmware=firmware, baud_rate=baud_rate, timeout=timeout, tap=witness.tap
        )
    else:
        aircraft = await open_aircraft(witness.tap)
    meeting = _Meeting(aircraft, witness, ask, tell, say)
    working = new_task(meeting.hold(credentials), "first contact")
    stop = working.cancel
    SIGNALS.join(stop)
    cancelled: asyncio.CancelledError | None = None
    try:
        try:
            await asyncio.wait([working])
        except asyncio.CancelledError as error:
            cancelled = error
            stop()
            await undisturbed(working)
        meeting.contact.note_end(working)
    finally:
        try:
            keep(meeting.contact)
            await aircraft.aclose()
        finally:
            SIGNALS.leave(stop)  # last: a signal that came may end the process here
    if cancelled is not None:
        raise cancelled
    return meeting.contact


class _Meeting:
    def __init__(
        self,
        aircraft: Aircraft,
        witness: _Witness,
        ask: Ask,
        tell: Callable[[Observation], object],
        say: Callable[[str], object],
    ) -> None:
        self._aircraft, self._witness = aircraft, witness
        self._ask, self._tell, self._say = ask, tell, say
        self._clock = aircraft.link.clock
        self._reader = aircraft._telemetry.acceleration
        self._is_asking = False  # a request for authority has no answer yet
        self.contact = Contact()

    def _see(self, topic: Topic, found: str, seen: str) -> None:
        observation = Observation(topic, found, seen)
        self.contact.observations.append(observation)
        self._tell(observation)

    async def _asked(self, text: str) -> bool:
        """Have the person do something. Raises LinkError: the line went meanwhile."""
        is_done = await self._ask(text)
        if self._aircraft.link.failure is not None:
            raise self._aircraft.link.failure
        return is_done

    async def hold(self, credentials: Credentials | None) -> None:
        """Everything, in order. Raises LinkError: the line is gone."""
        await self._version()
        if not await self._asked(
            "Take the PROPELLERS OFF, put the aircraft on level ground with its motors off, and "
            "leave it still. Is that done?"
        ):
            self.contact.ended_by = "the propellers may be on: nothing was tried"
            return
        await self._latency()
        await self._at_rest()
        await self._lift()
        await self._rc_lost()
        await self._authority(credentials)

    # -- what needs nobody -----------------------------------------------------------------------

    async def _version(self) -> None:
        version = await self._aircraft.version()
        self.contact.firmware = self._aircraft.firmware.name
        known = version.profile is not None
        crc = "" if version.crc_matches else "; its own checksum is another"
        self._see(
            Topic.VERSION,
            Topic.VERSION.assumed if known else "unknown",
            f"{version.name!r}, read as firmware {self.contact.firmware}{crc}",
        )

    async def _latency(self) -> None:
        times, lost = [], 0
        for _ in range(_QUERIES):
            began = self._clock()
            try:
                await self._aircraft.version()
                times.append(self._clock() - began)
            except LinkError:
                raise
            except M100Error:
                lost += 1
        if not times:
            self._see(Topic.LATENCY, "", f"none of {_QUERIES} version queries was answered")
            return
        found, middle = "within 0.1 s", median(times)
        if middle > 0.1:
            found = f"{middle:.1f} s"
        seen = f"{1000 * middle:.0f} ms in the median, {1000 * max(times):.0f} ms at most"
        if lost:
            seen += f"; {lost} of {_QUERIES} not at all"
        self._see(Topic.LATENCY, found, seen)

    async def _at_rest(self) -> None:
        """Acceleration, the rates of all items, and the mission status, while nothing happens."""
        before, began = self._witness.pushes[_STATUS], self._clock()
        reader, waited = self._reader, 0.0
        while waited < _QUIET_S or (
            reader.has_arrived and reader.seen is None and waited < _REST_S + _QUIET_S
        ):
            await asyncio.sleep(TELEMETRY_S)
            waited += TELEMETRY_S
        passed = self._clock() - began
        self._rates()
        if reader.seen is not None:
            self._see(Topic.ACCELERATION, str(reader.seen), "shown by its values at rest")
        else:
            why = "its values at rest are neither" if reader.has_arrived else "it does not arrive"
            self._see(Topic.ACCELERATION, "", why)
        pushes = self._witness.pushes[_STATUS] - before
        if self._aircraft.firmware.generation < Generation.V3_1:
            self._see(Topic.MISSION_STATUS, "", "this firmware has no missions")
        else:
            found = "sent" if pushes else "not sent"
            self._see(Topic.MISSION_STATUS, found, f"{pushes} pushes in {passed:.1f} s")

    def _rates(self) -> None:
        rates, others = {}, []
        for record, item in BY_RECORD.items():
            rate = self._rate_of(record)
            rates[item.name] = rate
            is_there = item.name in self._aircraft.firmware.items
            # Values that cannot be read yet are in no sample, whatever their rate.
            if record is Acceleration and not rate and self._reader.has_arrived:
                is_there = False
            if is_there and rate != item.rate_hz:
                others.append(f"{item.name} {rate}")
        seen = ", ".join(f"{name} {rate}" for name, rate in rates.items() if rate)
        assumed = Topic.ITEM_RATES.assumed
        found = ", ".join(others) or assumed
        self._see(Topic.ITEM_RATES, found, seen or "no item arrives")

    def _rate_of(self, record: type[Any]) -> int:
        counted = self._aircraft.state.statistics(record)
        rate = counted.rate_hz or (1.0 if counted.count else 0.0)
        return min(RATES_HZ, key=lambda one: abs(math.log((one or 0.1) / max(rate, 0.1))))

    # -- what the person does --------------------------------------------------------------------

    async def _lift(self) -> None:
        samples = self._aircraft.telemetry(Velocity, Position, policy=Newest(20_000))
        did = await self._asked(
            "Lift the aircraft by hand, straight up by about one metre within two or three "
            "seconds, and hold it there. Is it up?"
        )
        path: list[_Point] = []
        altitude = speed = None
        at = way = 0.0
        async with samples:
            while (sample := samples.get_nowait()) is not None:
                velocity, position = sample.get(Velocity), sample.get(Position)
                if speed is not None:
                    way += speed * (sample.received_at - at)
                at = sample.received_at
                speed = speed if velocity is None else velocity.up_m_s
                altitude = altitude if position is None else position.altitude_m
                is_due = not path or at - path[-1].at >= _STEP_S
                if speed is not None and altitude is not None and is_due:
                    path.append(_Point(at, altitude, way))
        topic = Topic.VERTICAL_VELOCITY
        if not did:
            self._see(topic, "", "nobody lifted it")
        elif not path or not all(math.isfinite(sum(one)) for one in path):
            self._see(topic, "", "velocity and position did not arrive meanwhile")
        else:
            rise, sum_of = _steepest(path)
            figures = f"the barometer rose by {rise:z.2f} m, velocity adds up to {sum_of:+z.2f} m"
            is_shown = rise >= _LIFTED_M and _SHARE * rise <= abs(sum_of) <= rise / _SHARE
            self._see(topic, ("up" if sum_of > 0 else "down") if is_shown else "", figures)
        await self._asked("Put it back on the ground, and leave it still. Is that done?")

    async def _rc_lost(self) -> None:
        """The channels before and after the remote control is switched off, motors off."""
        topic = Topic.RC_LOST
        if not await stands(self._aircraft.state):
            self._see(topic, "", "it is not seen standing with its motors off")
            return
        if not await self._asked(
            "Put the mode switch to F. Hold the left stick all the way to the LEFT, and keep it "
            "there. Is that so?"
        ):
            self._see(topic, "", "nobody switched it off")
            return
        await asyncio.sleep(_QUIET_S)
        before = self._aircraft.state.fresh(RemoteControl)
        samples = self._aircraft.telemetry(RemoteControl, policy=Newest(20_000))
        did = await self._asked(
            "Go on holding it and switch the remote control OFF; let the stick go then, wait five "
            "seconds, and move both sticks about. Is it off?"
        )
        await asyncio.sleep(_QUIET_S)
        since = self._clock() - _QUIET_S
        async with samples:
            late = []
            while (sample := samples.get_nowait()) is not None:
                if sample.received_at >= since:
                    late.append(sample[RemoteControl])
        self._see(topic, *_lost(did, before, late))
        await self._asked("Switch the remote control on again. Is it on?")

    @property
    def _asks_twice(self) -> bool:
        """Whether code 3 means "in progress" (errata 24)."""
        return self._aircraft.firmware.authority_requests > 1

    # -- control authority -----------------------------------------------------------------------

    async def _authority(self, credentials: Credentials | None) -> None:
        why = await self._obstacle(credentials)
        if why:
            for topic in _OF_AUTHORITY:
                self._see(topic, "", why)
            return
        for topic, mode in ((Topic.OBTAIN_P, RcMode.P), (Topic.OBTAIN_A, RcMode.A)):
            await self._obtain_in(topic, mode)
        await self._obtain_in(Topic.OBTAIN_F, RcMode.F)
        for topic in _OF_AUTHORITY:
            if self.contact.get(topic) is None:
                self._see(topic, "", "control was never obtained")

    async def _obstacle(self, credentials: Credentials | None) -> str:
        """Why authority is not asked for; empty when it may be."""
        if credentials is None:
            return "no app id and key were given"
        if not self._aircraft._requests.knows_firmware:
            return "its firmware is unknown: nothing is asked of it"
        if not await stands(self._aircraft.state):
            return "it is not seen standing with its motors off"
        if not await self._asked(
            "May I ask the aircraft for control authority, in P, A and F? Nothing moves, and I "
            "give it back at once."
        ):
            return "the person did not want it"
        try:
            await self._aircraft.activate(credentials, timeout=20.0)
        except LinkError:
            raise
        except M100Error as error:
            # Whose app it is belongs into no report.
            return error.seen.replace(f" of app {credentials.app_id}", "")
        return ""

    async def _obtain_in(self, topic: Topic, mode: RcMode) -> None:
        await self._asked(f"Put the mode switch to {mode.name}. Is it there?")
        await asyncio.sleep(_QUIET_S)
        rc = self._aircraft.state.fresh(RemoteControl)
        if rc is None or rc.mode_switch is not mode:
            shown = "not told" if rc is None else f"in {rc.mode_switch.name}"
            self._see(topic, "", f"the switch is {shown}")
            return
        if not await stands(self._aircraft.state):
            self._see(topic, "", "it is not seen standing with its motors off")
            return
        codes: list[int] = []
        try:
            error = await self._requested(codes, is_wanted=True)
            if AuthorityCode.OBTAINED in codes:
                self._say("control authority is OBTAINED; nothing moves, and it goes back now")
                if mode is RcMode.F:
                    await self._again()
        finally:
            # Also after no answer, or one that it is in progress: it may have it by now. A refusal
            # says nothing of a later request that was not answered.
            refusals = [AuthorityCode.NOT_IN_F, AuthorityCode.IOC_ON]
            if not self._asks_twice:
                refusals.append(AuthorityCode.NOT_CHANGED)
            if self._is_asking or not codes or codes[-1] not in refusals:
                back = new_task(self._give_back(is_held=AuthorityCode.OBTAINED in codes), "release")
                if (cancelled := await undisturbed(back)) is not None:
                    raise cancelled
                back.result()
        answers = ", ".join(map(str, codes)) or "none"
        if error:
            answers += f"; {error}"
        found = "obtained" if AuthorityCode.OBTAINED in codes else "refused" if codes else ""
        if codes[-1:] == [AuthorityCode.NOT_CHANGED] and self._asks_twice:
            found = "in progress for ever"
        self._see(topic, found, answers)

    async def _again(self) -> None:
        codes: list[int] = []
        error = await self._requested(codes, is_wanted=True, most=1)
        self._see(Topic.OBTAIN_AGAIN, ", ".join(map(str, codes)), error or "one request")

    async def _give_back(self, *, is_held: bool) -> None:
        """Release; it is not over before the aircraft says so."""
        before, codes = self._witness.pushes[_NOTIFIED], list[int]()
        self.contact.is_given_back = False
        try:
            error = await self._requested(codes, is_wanted=False)
            await asyncio.sleep(_QUIET_S)
        finally:
            holder = self._aircraft.state.fresh(ControlDevice)
            is_ours = holder is not None and holder.device is Device.ONBOARD
            self.contact.is_given_back = AuthorityCode.RELEASED in codes and not is_ours
            self._say(_BACK if self.contact.is_given_back else _NOT_BACK)
        if not is_held:
            return
        answers = ", ".join(map(str, codes)) or "none"
        if error:
            answers += f"; {error}"
        if self.contact.get(Topic.RELEASE) is None:
            found = "released" if self.contact.is_given_back else "not released"
            self._see(Topic.RELEASE, found, answers)
            pushes = self._witness.pushes[_NOTIFIED] - before
            self._see(
                Topic.OWN_RELEASE,
                "sent" if pushes else "none",
                f"{pushes} notifications in {_QUIET_S:g} s",
            )

    async def _requested(self, codes: list[int], *, is_wanted: bool, most: int = 6) -> str:
        """Ask until it is so, or is refused; the codes go into the list. Returns an error's text.

        Raises LinkError: the line is gone.
        """
        goal = AuthorityCode.OBTAINED if is_wanted else AuthorityCode.RELEASED
        going = (AuthorityCode.NOT_CHANGED, AuthorityCode.RELEASING)
        for attempt in range(most):
            if attempt:
                await asyncio.sleep(_PAUSE_S)
            self._is_asking = True
            try:
                code = await self._aircraft.execute(
                    RequestAuthority(obtain=is_wanted),
                    timeout=1.0,
                    tries=2,
                    refusal=AuthorityRefused,
                )
            except LinkError:
                raise
            except M100Error as error:
                return error.seen
            self._is_asking = False
            codes.append(int(code))
            if code == goal or code not in going:
                break
        return ""


_BACK = "control authority is given back"
_NOT_BACK = "the aircraft may still have it with this program: put the switch to P"
_OF_AUTHORITY = (
    *(Topic.OBTAIN_P, Topic.OBTAIN_A, Topic.OBTAIN_F),
    *(Topic.OBTAIN_AGAIN, Topic.RELEASE, Topic.OWN_RELEASE),
)


class _Point(NamedTuple):
    """The aircraft in a hand."""

    at: float  # s
    altitude: float  # by the barometer, m
    way: float  # the sum of its vertical velocity, m


def _steepest(path: list[_Point]) -> tuple[float, float]:
    """The greatest rise within a few seconds, and the way meanwhile: barometers drift."""
    found = 0.0, 0.0
    for place, end in enumerate(path):
        for begin in reversed(path[:place]):
            if end.at - begin.at > _LIFT_S:
                break
            if end.altitude - begin.altitude > found[0]:
                found = end.altitude - begin.altitude, end.way - begin.way
    return found


def _lost(did: bool, before: RemoteControl | None, late: list[RemoteControl]) -> tuple[str, str]:
    if not did:
        return "", "nobody switched it off"
    if before is None:
        return "", "the channels did not arrive before"
    if abs(before.yaw) < _HELD:
        return "", f"no stick was held: yaw {before.yaw}"
    if not late:
        return "silent", "the item stops"
    last = late[-1]
    figures = f"before {tuple(before)}, after {tuple(last)}"
    sticks = list(zip(*(one[:4] for one in late), strict=True))
    if any(max(axis) - min(axis) > _MOVED for axis in sticks):
        return "", f"sticks still move: it is on; {figures}"
    if not any(value or 0 for value in last):
        return "zeros", figures
    if abs(last.yaw - before.yaw) <= _MOVED and last.mode == before.mode:
        return "kept", figures
    if not any(last[:4]):
        return ("centred" if last[4:] == before[4:] else "other"), figures
    return "other", figures
