"""Camera and gimbal: the camera protocol as component 100, and a gimbal manager of version 2.

The aircraft takes orders to both from firmware 2.3 on and confirms none. A message says what was
ordered here, or the definition's "unknown"; only the gimbal's attitude is telemetry.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from m100link.apps.agent import orders
from m100link.apps.agent.orders import CameraUse
from m100link.apps.mavlink.translator.codec import MavlinkMessage, Peer
from m100link.apps.mavlink.translator.flight_mode_manager import FlightModeManager
from m100link.apps.mavlink.translator.numbers import (
    CameraCap,
    GimbalCap,
    GimbalFlag,
    MavCommand,
    MavResult,
    Severity,
)
from m100link.apps.mavlink.translator.orders import Asked, PayloadOrder
from m100link.apps.mavlink.translator.vehicle_state import CAMERA, PayloadState, VehicleState
from m100link.errors import CommandNotSupported, M100Error, UsageError
from m100link.geodesy import LocalFrame, normalize_degrees
from m100link.protocol import records
from m100link.protocol.commands.gimbal import (
    GIMBAL_LIMITS_DEG,
    GimbalAngle,
    GimbalAngleMode,
    GimbalSpeed,
)

_MOST_WAITING = 8  # orders to the camera without an outcome
_LEAST_INTERVAL_S = 1.0  # between two photos: the camera takes about a second for one
_AGAIN_S = 3.0  # seconds in which the same photo of the same peer is the same command, repeated

_DEVICE = 1  # id of the gimbal: it is no component of its own
_USUAL_DEG_S, _MOST_DEG_S = 60.0, 180.0  # speed of a turn to an angle, and of any turn
_ROUNDED_DEG = 0.01  # radians in 32 bits are not quite -90 degrees
_BY_STICKS_DEG_S = 45.0  # of GIMBAL_MANAGER_SET_MANUAL_CONTROL at its end
_FOLLOWS_S, _FOLLOWS_DEG = 0.2, 0.5  # how often an aim that moves is looked at, and what counts
_TURNS_S = 0.25  # a turn is repeated so often: one order turns for half a second
_ABOVE_M = 0.5  # nearer than this to a place nobody can say in which direction it is

Fields = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Aim:
    """Where the gimbal is to look: angles, a turn, or a place. NaN and None leave an axis alone."""

    peer: Peer
    pitch_deg: float = math.nan  # against the horizon, up is positive
    yaw_deg: float = math.nan  # clockwise from north, or from the nose
    roll_deg: float = math.nan
    follows: bool = False  # whether yaw counts from the nose, and goes with it
    pitch_deg_s: float = math.nan  # of a turn, or on the way to an angle
    yaw_deg_s: float = math.nan
    place: tuple[float, float, float] | None = None  # latitude, longitude, m above take-off

    @property
    def is_turn(self) -> bool:
        return self.place is None and all(map(math.isnan, self.angles))

    @property
    def angles(self) -> tuple[float, float, float]:
        """Yaw, roll and pitch, in the order of the wire."""
        return self.yaw_deg, self.roll_deg, self.pitch_deg


@dataclass(slots=True)
class _Interval:
    left: int | None  # still to take; None until they are stopped
    due_at: float | None = None  # s; None until the step after the first one was taken


Done = Callable[[MavResult], None]


class Payload:
    def __init__(
        self,
        world: VehicleState,
        manager: FlightModeManager,  # gets the orders, and knows who flies
        tell: Callable[[Severity, str], None],
        answer: Callable[[Asked, MavResult], None],  # acknowledges a command that took time
        changed: Callable[[], None],  # called when the camera does something else
    ) -> None:
        self._world, self._state = world, world.payload
        self._manager, self._tell = manager, tell
        self._answer, self._changed = answer, changed
        # The command of each order without an outcome: a copy of it is no other order.
        self._pending: set[object] = set()
        # Whether time matters to it: photos, an aim, or control of the gimbal.
        self.is_at_work = False
        self._interval: _Interval | None = None
        # The newest photo of each peer: its number, when it came, and its answer once there is one.
        self._photos: dict[Peer, tuple[float, float, MavResult | None]] = {}
        self._aim: Aim | None = None
        self._asked: Asked | None = None  # the command that waits for the outcome of that aim
        self._aims_at, self._is_aiming = 0.0, False
        self._sent: GimbalAngle | None = None  # the last angle that was sent for that aim
        self.handlers: dict[str, Callable[[MavlinkMessage, Peer, float], None]] = {
            "GIMBAL_MANAGER_SET_ATTITUDE": self._streamed,
            "GIMBAL_MANAGER_SET_PITCHYAW": self._streamed,
            "GIMBAL_MANAGER_SET_MANUAL_CONTROL": self._streamed,
        }

    def _reject(self, why: str) -> MavResult:
        self._tell(Severity.WARNING, why)
        return MavResult.TEMPORARILY_REJECTED

    def _at_first(self) -> MavResult | None:
        """The answer to an order that is on its way: None where its outcome is the answer.

        The first order activates the aircraft. That takes longer than MAVSDK waits for an answer,
        and its camera and gimbal take IN_PROGRESS for a failure.
        """
        is_activated = self._world.known.view.state.is_activated
        return None if is_activated else MavResult.ACCEPTED

    # -- the camera -------------------------------------------------------------------------------

    def start_photos(self, asked: Asked, now: float) -> MavResult | None:
        """IMAGE_START_CAPTURE: one, a number of them, or until they are stopped."""
        _, interval, count, number = asked.parameters
        _require_camera(asked.parameters[0])
        if not count >= 0.0:
            raise UsageError("camera: the number of photos is missing")
        is_single = int(count) == 1
        if not is_single and not interval >= _LEAST_INTERVAL_S:
            raise UsageError(
                f"camera: a photo every {interval:g} s; {_LEAST_INTERVAL_S:g} s is the least"
            )
        if self._manager.is_others(asked.peer, "camera"):
            return MavResult.TEMPORARILY_REJECTED
        known = self._photos.get(asked.peer, (math.nan, 0.0, None))
        if is_single and known[0] == number > 0.0 and now - known[1] < _AGAIN_S:
            return known[2]
        if self._interval is not None and asked.key not in self._pending:
            return self._reject("camera: photos are being taken at an interval: stop them first")

        at_first = self._at_first()

        def taken(result: MavResult) -> None:
            if self._photos.get(asked.peer, (math.nan,))[0] == number:
                self._photos[asked.peer] = number, now, result
            if result is MavResult.ACCEPTED and not is_single:
                self.is_at_work = True
                self._interval = _Interval(int(count) - 1 if count else None)
                self._state.interval_s = interval
                self._changed()
            if at_first is None:
                self._answer(asked, result)

        result = self._use(CameraUse.PHOTO, asked.key, taken)
        self._photos.pop(asked.peer, None)
        if is_single:
            self._photos[asked.peer] = number, now, result
            while len(self._photos) > _MOST_WAITING:
                del self._photos[next(iter(self._photos))]
        return result

    def stop_photos(self, asked: Asked, now: float) -> MavResult:
        _require_camera(asked.parameters[0])
        if self._manager.is_others(asked.peer, "camera"):
            return MavResult.TEMPORARILY_REJECTED
        self._end_interval()
        return MavResult.ACCEPTED

    def _end_interval(self) -> None:
        if self._interval is not None:
            self._interval, self._state.interval_s = None, 0.0
            self._changed()

    def record(self, asked: Asked, now: float) -> MavResult | None:
        """VIDEO_START_CAPTURE, VIDEO_STOP_CAPTURE."""
        is_on = asked.command == MavCommand.VIDEO_START_CAPTURE
        if asked.parameters[0] > 1.0:  # NaN says nothing
            raise UsageError(f"camera: there is no video stream {asked.parameters[0]:g}")
        _require_camera(asked.parameters[2 if is_on else 1])
        if self._manager.is_others(asked.peer, "camera"):
            return MavResult.TEMPORARILY_REJECTED

        at_first = self._at_first()

        def done(result: MavResult) -> None:
            if result is MavResult.ACCEPTED:
                self._state.is_recording = is_on
                self._changed()
            if at_first is None:
                self._answer(asked, result)

        use = CameraUse.START_VIDEO if is_on else CameraUse.STOP_VIDEO
        return self._use(use, asked.key, done)

    def _use(self, use: CameraUse, key: object, done: Done) -> MavResult | None:
        """Ask the agent; None where the answer comes when it has one."""
        if key in self._pending:
            return self._at_first()
        if len(self._pending) >= _MOST_WAITING:
            return self._reject("camera: too many orders at once")
        if not self._world.known.view.is_heard:
            return self._reject("camera: the aircraft is not heard")
        self._pending.add(key)

        def over(error: M100Error | None) -> None:
            self._pending.discard(key)
            done(self._result(error, "camera"))

        self._manager.orders.append(PayloadOrder(orders.UseCamera(use), over))
        return self._at_first()

    def _result(self, error: M100Error | None, what: str) -> MavResult:
        if error is None:
            return MavResult.ACCEPTED
        self._tell(Severity.WARNING, f"{what}: {error.seen}")
        is_never = isinstance(error, CommandNotSupported | UsageError)
        return MavResult.DENIED if is_never else MavResult.TEMPORARILY_REJECTED

    # -- the gimbal: who has control of it --------------------------------------------------------

    def configure(self, asked: Asked, now: float) -> MavResult:
        """DO_GIMBAL_MANAGER_CONFIGURE: who has primary and secondary control."""
        _require_gimbal(asked.z)
        if self._manager.is_others(asked.peer, "gimbal"):
            return MavResult.TEMPORARILY_REJECTED
        state, own = self._state, (asked.peer.system, asked.peer.component)
        pairs = asked.parameters[:2], asked.parameters[2:]
        for present, wanted in zip((state.primary, state.secondary), pairs, strict=True):
            _controller(present, wanted, own)  # all of it or nothing
        self.is_at_work = True
        state.primary = _controller(state.primary, pairs[0], own)
        state.secondary = _controller(state.secondary, pairs[1], own)
        return MavResult.ACCEPTED

    def _may_aim(self, peer: Peer) -> bool:
        """Whether it may turn the gimbal; everybody hears why not."""
        if self._manager.is_others(peer, "gimbal"):
            return False
        holders = {self._state.primary, self._state.secondary} - {_NOBODY}
        if self._state.primary == _NOBODY or (peer.system, peer.component) in holders:
            return True
        self._reject("gimbal: {}/{} has control of it".format(*self._state.primary))
        return False

    # -- the gimbal: where it looks ---------------------------------------------------------------

    def point(self, asked: Asked, now: float) -> MavResult | None:
        """DO_GIMBAL_MANAGER_PITCHYAW, in degrees."""
        _require_gimbal(asked.z)
        flags = asked.raw_x
        if math.isnan(flags):
            flags = 0.0
        if not 0.0 <= flags <= 0xFFFFFFFF:
            raise UsageError(f"gimbal: flags {flags:g}")
        pitch, yaw, pitch_rate, yaw_rate = asked.parameters
        aim = Aim(*(asked.peer, pitch, yaw), pitch_deg_s=pitch_rate, yaw_deg_s=yaw_rate)
        return self._aim_at(self._framed(aim, int(flags)), asked, now)

    def look_at(
        self, asked: Asked, place: tuple[float, float, float], now: float
    ) -> MavResult | None:
        """DO_SET_ROI_LOCATION: look there until another order comes."""
        _require_gimbal(asked.parameters[0])
        aim = Aim(asked.peer, place=place)
        if self._world.known.view.place is None or self._world.height is None:
            return self._reject("gimbal: the position of the aircraft is unknown")
        return self._aim_at(aim, asked, now)

    def look_at_nothing(self, asked: Asked, now: float) -> MavResult:
        """DO_SET_ROI_NONE: the gimbal stays as it is."""
        _require_gimbal(asked.parameters[0])
        if not self._may_aim(asked.peer):
            return MavResult.TEMPORARILY_REJECTED
        if self._aim is not None and self._aim.place is not None:
            self._drop_aim()
        return MavResult.ACCEPTED

    def _streamed(self, message: MavlinkMessage, peer: Peer, now: float) -> None:
        """The messages for many orders a second, which have no answer but a text."""
        if not self._world.has_payload:
            return
        try:
            _require_gimbal(message["gimbal_device_id"])
            self._aim_at(self._framed(_aim_of(message, peer), message["flags"]), None, now)
        except UsageError as error:
            self._tell(Severity.WARNING, error.seen)

    def _framed(self, aim: Aim, flags: int) -> Aim:
        """The aim with yaw in the frame in which it is kept.

        Raises UsageError: the gimbal cannot look there, or it does not say where.
        """
        if flags & GimbalFlag.RETRACT:
            raise UsageError("gimbal: it cannot be retracted")
        if flags & GimbalFlag.NEUTRAL:
            return Aim(aim.peer, 0.0, 0.0, follows=True)
        both = GimbalFlag.YAW_IN_VEHICLE_FRAME | GimbalFlag.YAW_IN_EARTH_FRAME
        if flags & both == both:
            raise UsageError("gimbal: yaw in two frames")
        is_locked = bool(flags & GimbalFlag.YAW_LOCK)
        is_of_nose = bool(flags & both & GimbalFlag.YAW_IN_VEHICLE_FRAME) or not (
            flags & both or is_locked
        )
        yaw = aim.yaw_deg
        if not math.isnan(yaw) and is_of_nose == is_locked:
            heading = self._heading()
            yaw = normalize_degrees(yaw + heading if is_of_nose else yaw - heading)
        return _checked(replace(aim, yaw_deg=yaw, follows=not is_locked))

    def _heading(self) -> float:
        heading = self._world.yaw_deg
        if heading is None:
            raise UsageError("gimbal: the heading of the aircraft is unknown")
        return heading

    def _aim_at(self, aim: Aim, asked: Asked | None, now: float) -> MavResult | None:
        if not self._may_aim(aim.peer):
            return MavResult.TEMPORARILY_REJECTED
        if not self._world.known.view.is_heard:
            return self._reject("gimbal: the aircraft is not heard")
        if asked is not None and self._asked is not None and asked.key == self._asked.key:
            return None  # a copy of the command that waits
        self._drop_aim()
        at_first = self._at_first()
        self._aim, self._aims_at, self.is_at_work = aim, now, True
        self._asked = asked if at_first is None else None
        self._state.is_locked = not aim.follows
        return at_first

    def _drop_aim(self) -> None:
        """The aim is over; a command that waits for it has been replaced."""
        asked, self._asked = self._asked, None
        self._aim = self._sent = None
        if asked is not None:
            self._answer(asked, MavResult.TEMPORARILY_REJECTED)

    # -- time passes ------------------------------------------------------------------------------

    def advance(
        self, now: float, lost: Callable[[Peer, float], bool], present: Iterable[tuple[Peer, ...]]
    ) -> None:
        """Take the photos that are due, and keep the gimbal where it is to look.

        ``present``: the peers that are there, by their address.
        """
        interval = self._interval
        if interval is not None and (interval.due_at is None or now >= interval.due_at):
            self._next_photo(interval, now)
        self._forget_gone(present)
        aim, state = self._aim, self._state
        self.is_at_work = bool(
            aim or self._interval or {state.primary, state.secondary} - {_NOBODY}
        )
        if aim is None or self._is_aiming or now < self._aims_at:
            return
        if aim.is_turn and (lost(aim.peer, now) or self._manager.other_operator(aim.peer)):
            self._drop_aim()
            return
        self._aims_at = now + (_TURNS_S if aim.is_turn else _FOLLOWS_S)
        if (order := self._order_of(aim)) is not None:
            self._is_aiming = True
            self._manager.orders.append(PayloadOrder(order, partial(self._aimed, aim)))
        elif aim.place is None and not (aim.follows and math.isfinite(aim.yaw_deg)):
            self._aims_at = math.inf  # it was sent, and stays so

    def _forget_gone(self, present: Iterable[tuple[Peer, ...]]) -> None:
        """Control of the gimbal goes back when its holder has gone."""
        state = self._state
        there = {(peer.system, peer.component) for peers in present for peer in peers}
        state.primary = state.primary if state.primary in there else _NOBODY
        state.secondary = state.secondary if state.secondary in there else _NOBODY

    def _next_photo(self, interval: _Interval, now: float) -> None:
        if interval.due_at is None:
            interval.due_at = now + self._state.interval_s
            return
        if interval.left is not None:
            interval.left -= 1
        # From when it was due, so that the interval holds; not from long ago.
        is_missed = now - interval.due_at >= self._state.interval_s
        interval.due_at = (now if is_missed else interval.due_at) + self._state.interval_s

        def taken(result: MavResult) -> None:
            if result is not MavResult.ACCEPTED and self._interval is interval:
                self._tell(Severity.WARNING, "camera: no more photos at an interval")
                self._end_interval()

        taken(self._use(CameraUse.PHOTO, id(interval), taken) or MavResult.ACCEPTED)
        if interval.left == 0:
            self._end_interval()

    def _aimed(self, aim: Aim, error: M100Error | None) -> None:
        self._is_aiming = False
        if self._aim is not aim:
            self._result(error, "gimbal")
            return
        asked, self._asked = self._asked, None
        result = self._result(error, "gimbal")
        if error is not None:
            self._drop_aim()
        if asked is not None:
            self._answer(asked, result)

    def _order_of(self, aim: Aim) -> orders.Order | None:
        """The order that is due; None where the gimbal has its order already."""
        if aim.is_turn:
            rates = (0.0 if math.isnan(one) else one for one in (aim.yaw_deg_s, aim.pitch_deg_s))
            yaw, pitch = rates
            if not yaw and not pitch:
                self._aims_at = math.inf  # it stops by itself
            return orders.TurnGimbal(GimbalSpeed(yaw_deg_s=yaw, pitch_deg_s=pitch))
        wanted = self._angles_of(aim)
        if wanted is None:
            return None
        sent = self._sent
        if sent is not None and sent.mode == wanted.mode:
            pairs = zip(wanted.angles_deg, sent.angles_deg, strict=True)
            if all(abs(normalize_degrees(one - two)) < _FOLLOWS_DEG for one, two in pairs):
                return None
            wanted = replace(wanted, duration_s=_FOLLOWS_S)
        self._sent = wanted
        return orders.PointGimbal(wanted)

    def _angles_of(self, aim: Aim) -> GimbalAngle | None:
        """The angles of the wire; None while nobody knows where the aircraft is."""
        view = self._world.known.view
        if aim.place is not None:
            found = self._direction(aim.place)
            if found is None:
                return None
            aim = replace(aim, pitch_deg=found[0], yaw_deg=found[1])
        elif aim.follows and not math.isnan(aim.yaw_deg):
            heading = self._world.yaw_deg
            if heading is None:
                return None
            aim = replace(aim, yaw_deg=normalize_degrees(aim.yaw_deg + heading))
        mode = int(GimbalAngleMode.ABSOLUTE)
        for axis, angle in enumerate(aim.angles):
            mode |= (GimbalAngleMode.KEEP_YAW << axis) if math.isnan(angle) else 0
        yaw, roll, pitch = (0.0 if math.isnan(one) else one for one in aim.angles)
        seconds, seen = 1.0, view.get(records.Gimbal)
        if seen is not None:
            rates = (abs(aim.yaw_deg_s), math.nan, abs(aim.pitch_deg_s))
            now = seen.yaw_deg, seen.roll_deg, seen.pitch_deg
            seconds = max(
                abs(normalize_degrees(want - present)) / (rate if rate > 0.0 else _USUAL_DEG_S)
                for want, present, rate in zip(aim.angles, now, rates, strict=True)
                if not math.isnan(want)
            )
        return GimbalAngle(yaw, roll, pitch, mode, max(0.1, min(25.5, seconds)))

    def _direction(self, place: tuple[float, float, float]) -> tuple[float, float] | None:
        """Pitch and yaw to a place, °; yaw is NaN right above it. None while nobody knows."""
        position, height = self._world.known.view.place, self._world.height
        if position is None or height is None:
            return None
        frame = LocalFrame(position.latitude_deg, position.longitude_deg)
        north, east = frame.to_local(*place[:2])
        away = math.hypot(north, east)
        low, high = GIMBAL_LIMITS_DEG["pitch"]
        pitch = math.degrees(math.atan2(place[2] - height, away))
        yaw = math.nan if away < _ABOVE_M else math.degrees(math.atan2(east, north))
        return max(low, min(high, pitch)), yaw


_NOBODY = (0, 0)
_UNCHANGED, _ITSELF, _GIVEN_BACK = -1, -2, -3  # parameters of DO_GIMBAL_MANAGER_CONFIGURE


def _controller(
    present: tuple[int, int], wanted: tuple[float, ...], own: tuple[int, int]
) -> tuple[int, int]:
    """The holder of control afterwards. Raises UsageError: the parameters name nobody."""
    if any(one in (_UNCHANGED, _ITSELF, _GIVEN_BACK) for one in wanted):
        if wanted[0] == _ITSELF:
            return own
        return _NOBODY if wanted[0] == _GIVEN_BACK and present == own else present
    if not all(0.0 <= one <= 255.0 and one == int(one) for one in wanted):
        raise UsageError("gimbal: control for {:g}/{:g}".format(*wanted))
    system, component = map(int, wanted)
    return (system, component) if system and component else _NOBODY


def _require(part: str, known: tuple[float, ...], identity: float) -> None:
    if not (math.isnan(identity) or identity in (0.0, *known)):
        raise UsageError(f"{part}: there is no {part} {identity:g}")


_require_camera = partial(_require, "camera", (1.0, CAMERA))
_require_gimbal = partial(_require, "gimbal", (_DEVICE,))


def _checked(aim: Aim) -> Aim:
    """The aim, within the limits of the gimbal. Raises UsageError: the gimbal cannot do it."""
    rates = aim.pitch_deg_s, aim.yaw_deg_s
    if aim.is_turn and all(map(math.isnan, rates)):
        raise UsageError("gimbal: neither an angle nor a turn")
    for rate in rates:
        if abs(rate) > _MOST_DEG_S:  # which no NaN is
            raise UsageError(f"gimbal: {rate:.0f} deg/s; {_MOST_DEG_S:g} deg/s at most")
    if not aim.is_turn:
        for angle, rate in ((aim.pitch_deg, rates[0]), (aim.yaw_deg, rates[1])):
            if math.isnan(angle) and not math.isnan(rate):
                raise UsageError("gimbal: it cannot turn on one axis and point on the other")
    within = []
    for (axis, (low, high)), angle in zip(GIMBAL_LIMITS_DEG.items(), aim.angles, strict=True):
        nearest = min(high, max(low, angle)) if not math.isnan(angle) else angle
        if abs(nearest - angle) > _ROUNDED_DEG:
            raise UsageError(f"gimbal: {axis} {angle:.1f} deg; it has {low:g} to {high:g} deg")
        within.append(nearest)
    yaw, roll, pitch = within
    return replace(aim, yaw_deg=yaw, roll_deg=roll, pitch_deg=pitch)


def _aim_of(message: MavlinkMessage, peer: Peer) -> Aim:
    """The aim of a message, in degrees. Raises UsageError: it has no numbers, or no such angles."""
    if message.name == "GIMBAL_MANAGER_SET_ATTITUDE":
        q, rates = message["q"], [message[f"angular_velocity_{axis}"] for axis in "xyz"]
        if math.isfinite(rates[0]) and rates[0] != 0.0:
            raise UsageError("gimbal: it cannot be rolled by a rate")
        given, angles = [*q, *rates], Aim(peer)
        if not all(map(math.isnan, q)):
            size = math.hypot(*q)
            if not 0.9 <= size <= 1.1:
                raise UsageError("gimbal: the quaternion is not of length 1")
            turned = records.Attitude(*(one / size for one in q))
            angles = Aim(peer, turned.pitch_deg, turned.yaw_deg, turned.roll_deg)
        rate_of, pitch_rate, yaw_rate = math.degrees(1.0), rates[1], rates[2]
    else:
        pitch, yaw = message["pitch"], message["yaw"]
        pitch_rate, yaw_rate = message["pitch_rate"], message["yaw_rate"]
        given, rate_of = [pitch, yaw, pitch_rate, yaw_rate], math.degrees(1.0)
        angles = Aim(peer, math.degrees(pitch), math.degrees(yaw))
        if message.name == "GIMBAL_MANAGER_SET_MANUAL_CONTROL":
            if not (math.isnan(pitch) and math.isnan(yaw)):
                raise UsageError("gimbal: sticks turn it; an angle has no unit there")
            rate_of = _BY_STICKS_DEG_S
            pitch_rate, yaw_rate = (_within_one(one) for one in (pitch_rate, yaw_rate))
    if any(map(math.isinf, given)):
        raise UsageError("gimbal: a number is not finite")
    return replace(angles, pitch_deg_s=pitch_rate * rate_of, yaw_deg_s=yaw_rate * rate_of)


def _within_one(value: float) -> float:
    return value if math.isnan(value) else max(-1.0, min(1.0, value))


# -- what is said of them ------------------------------------------------------------------------


_VENDOR = b"DJI"
# It has no modes and takes both orders at any time. The one mode that it shows is "image".
_CAN = CameraCap.CAPTURE_VIDEO | CameraCap.CAPTURE_IMAGE | CameraCap.CAN_CAPTURE_VIDEO_IN_IMAGE_MODE
_TURNS = (
    GimbalCap.HAS_NEUTRAL
    | GimbalCap.HAS_ROLL_AXIS
    | GimbalCap.HAS_ROLL_LOCK
    | GimbalCap.HAS_PITCH_AXIS
    | GimbalCap.HAS_PITCH_LOCK
    | GimbalCap.HAS_YAW_AXIS
    | GimbalCap.HAS_YAW_FOLLOW
    | GimbalCap.HAS_YAW_LOCK
    | GimbalCap.SUPPORTS_YAW_IN_EARTH_FRAME
)
_SPANS = {
    f"{axis}_{end}": math.radians(angle)
    for axis, span in GIMBAL_LIMITS_DEG.items()
    for end, angle in zip(("min", "max"), span, strict=True)
}
_NOT_SUPPORTED = 3  # STORAGE_STATUS: the camera tells nothing of its storage
_INTERVAL_SET = 2  # image_status: an interval is set, and whether a photo is taken is not known


def camera_information(world: VehicleState, now: float) -> Fields:
    """Capabilities of the camera; its lens and resolution are not known."""
    unknown = dict.fromkeys(("focal_length", "sensor_size_h", "sensor_size_v"), math.nan)
    names = {"vendor_name": _VENDOR, "model_name": b"camera"}
    return {**unknown, **names, "flags": int(_CAN), "gimbal_device_id": _DEVICE}


def camera_settings(world: VehicleState, now: float) -> Fields:
    """It has no modes: the mode is "image", and zoom and focus are unknown."""
    return {"zoomLevel": math.nan, "focusLevel": math.nan}


def storage_information(world: VehicleState, now: float) -> Fields:
    """One storage, of which nothing is known."""
    return {"storage_id": 1, "storage_count": 1, "status": _NOT_SUPPORTED}


def capture_status(world: VehicleState, now: float) -> Fields:
    """Interval and video as they were ordered here."""
    state = world.payload
    return {
        "image_status": _INTERVAL_SET if state.interval_s else 0,
        "image_interval": state.interval_s,
        "video_status": int(state.is_recording),
        "available_capacity": math.nan,
    }


def manager_information(world: VehicleState, now: float) -> Fields:
    """Axes of the gimbal, with the limits that its commands have."""
    flags = int(_TURNS | GimbalCap.CAN_POINT_LOCATION_GLOBAL)
    return {"cap_flags": flags, "gimbal_device_id": _DEVICE} | _SPANS


def device_information(world: VehicleState, now: float) -> Fields:
    """The same of the device; its version and number are not known."""
    names = {"vendor_name": _VENDOR.decode()}
    return names | {"cap_flags": int(_TURNS), "gimbal_device_id": _DEVICE} | _SPANS


def _flags(state: PayloadState) -> GimbalFlag:
    level = GimbalFlag.ROLL_LOCK | GimbalFlag.PITCH_LOCK | GimbalFlag.YAW_IN_EARTH_FRAME
    return level | (GimbalFlag.YAW_LOCK if state.is_locked else GimbalFlag(0))


def manager_status(world: VehicleState, now: float) -> Fields:
    """The holders of control over the gimbal, and its flags."""
    state = world.payload
    named = zip(("primary", "secondary"), (state.primary, state.secondary), strict=True)
    held = {
        f"{name}_control_{part}": value
        for name, pair in named
        for part, value in zip(("sysid", "compid"), pair, strict=True)
    }
    return {"flags": int(_flags(state)), "gimbal_device_id": _DEVICE} | held


# Bits of the aircraft for pitch, roll and yaw at their stop, and those of MAVLink.
_FAILURES = ((1, 2), (2, 1), (4, 4))


def attitude_status(world: VehicleState, now: float) -> Fields | None:
    """The attitude of the gimbal, yaw from north."""
    seen = world.known.view.get(records.Gimbal)
    if seen is None:
        return None
    angles = map(math.radians, (seen.roll_deg, seen.pitch_deg, seen.yaw_deg))
    rates = dict.fromkeys((f"angular_velocity_{axis}" for axis in "xyz"), math.nan)
    heading, limits = world.yaw_deg, seen.limits or 0
    return {
        "flags": int(_flags(world.payload) | GimbalFlag.ACCEPTS_YAW_IN_EARTH_FRAME),
        "q": records.quaternion(*angles),
        **rates,
        "failure_flags": sum(bit for of_wire, bit in _FAILURES if limits & of_wire),
        "delta_yaw": math.nan if heading is None else math.radians(heading),
        "delta_yaw_velocity": math.nan,
        "gimbal_device_id": _DEVICE,
    }


Made = Callable[[VehicleState, float], Fields | None]

CAMERA_MESSAGES: Mapping[str, tuple[float, Made, str]] = {
    "CAMERA_INFORMATION": (0, camera_information, "photo and video; no lens, no resolution"),
    "CAMERA_SETTINGS": (0, camera_settings, "no modes; no zoom, no focus"),
    "STORAGE_INFORMATION": (0, storage_information, "one; nothing is known of it"),
    "CAMERA_CAPTURE_STATUS": (0, capture_status, "interval and video, as ordered here"),
}
"""Messages of component 100: how often each is sent, what makes it, and of what."""

GIMBAL_MESSAGES: Mapping[str, tuple[float, Made, str]] = {
    "GIMBAL_MANAGER_INFORMATION": (0, manager_information, "axes and limits"),
    "GIMBAL_DEVICE_INFORMATION": (0, device_information, "axes and limits; no version"),
    "GIMBAL_MANAGER_STATUS": (1, manager_status, "control of the gimbal"),
    "GIMBAL_DEVICE_ATTITUDE_STATUS": (5, attitude_status, "gimbal attitude, yaw from north"),
}
"""The same of the gimbal manager, which is the autopilot."""
