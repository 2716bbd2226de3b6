"""The module ``rospy`` of a program: one node, its topics and services, time, parameters, logs."""

from __future__ import annotations

import atexit
import os
import re
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

from m100link.apps.station.ros.messages import Message
from m100link.errors import LinkError, M100Error
from rospy_stand_in.bridge import RosbridgeClient, address_of, report
from rospy_stand_in.genpy import (
    RosDuration,
    RosMessage,
    RosTime,
    SerializationError,
    ServiceKind,
    from_json,
    to_json,
)
from rospy_stand_in.parameters import ParameterStore, value_of
from rospy_stand_in.peers import shared_parameters

DEBUG, INFO, WARN, ERROR, FATAL = 1, 2, 4, 8, 16
_NAMES = {DEBUG: "DEBUG", INFO: "INFO", WARN: "WARN", ERROR: "ERROR", FATAL: "FATAL"}
_STEP_S = 0.05  # of a wait that a shutdown ends
_REMAPPING = re.compile(r"^[~/\w]+:=")
_PATIENCE_S = 3.0  # of a wait for what does not exist, before the person hears of it


class ROSException(Exception):
    """Anything that goes wrong in ROS."""


class ROSSerializationException(ROSException):
    """A message cannot be sent as it is."""


class ROSInterruptException(ROSException, KeyboardInterrupt):
    """The node was shut down meanwhile."""


class ROSInitException(ROSException):
    """The node cannot begin."""


class ROSInternalException(ROSException):
    """The client library itself has failed."""


class ROSTimeMovedBackwardsException(ROSInterruptException):
    """Time of a simulation began anew, which it does not do here."""


class TransportException(ROSInternalException):
    """A connection between nodes has failed."""


class ServiceException(Exception):
    """A service refused, failed, or is not there."""


# -- the node --------------------------------------------------------------------------------------


class _Node:
    """The one node of a program."""

    def __init__(self) -> None:
        self.bridge: RosbridgeClient | None = None
        self.address = self.token = ""
        self.name, self.namespace = "/unnamed", "/"
        self.remaps: dict[str, str] = {}
        self.parameters = ParameterStore()
        self.services: dict[str, Callable[[RosMessage], Any]] = {}
        self.is_initialised = self.is_over = self._is_ending = False
        self.goals: set[str] = set()  # of action servers of the station, under way
        self.level = INFO
        self.lock = threading.RLock()
        self._hooks: list[Callable[[], Any]] = []
        self._said: set[str] = set()

    def connected(self) -> RosbridgeClient:
        """The connection, opened by the first who needs it.

        Raises ``ROSInitException``: no station answers.
        """
        with self.lock:
            if self.bridge is None:
                try:
                    self.bridge = RosbridgeClient(
                        self.address, self.token, on_lost=self._lost, on_status=report
                    )
                except LinkError as error:
                    raise ROSInitException(str(error)) from None
            return self.bridge

    def _lost(self, why: str) -> None:
        if not self.is_over:
            logerr("the station has gone: %s; the aircraft hovers", why)
            self.shut_down("the station has gone")

    def say_once(self, text: str) -> None:
        if text not in self._said:
            self._said.add(text)
            loginfo(text)

    def on_shutdown(self, hook: Callable[..., Any]) -> None:
        self._hooks.append(hook)

    def shut_down(self, reason: str) -> None:
        with self.lock:
            if self._is_ending:
                return
            self._is_ending = True
        while self._hooks:  # which may still publish and call, as in rospy
            hook = self._hooks.pop(0)
            try:
                hook()
            except Exception:  # noqa: BLE001 - whatever the program raises there
                traceback.print_exc()
        self.is_over = True
        if self.bridge is not None:
            self.bridge.close()


_node = _Node()


def configure(address: str, token: str) -> None:
    """Where the station is; before the program runs. A launch file has set its parameters."""
    _node.address, _node.token = address, token
    for name, value in shared_parameters(address_of(address)).items():
        set_param(name, value)


def opened() -> RosbridgeClient | None:
    """The connection, if the program has one by now."""
    return _node.bridge


def note_goal(name: str, *, is_under_way: bool) -> None:
    """Whether an action server has a goal of this program that is under way."""
    if is_under_way and _node.connected().is_of_station(f"{name}/goal"):
        _node.goals.add(name)
    else:
        _node.goals.discard(name)


def wait_for_goals() -> None:
    """Stay while a goal of the program is under way: in ROS it goes on without the program."""
    if _node.goals and not _node.is_over:
        loginfo("the program has ended, its goal has not: Ctrl-C stops the aircraft")
    while _node.goals and not _node.is_over:
        time.sleep(_STEP_S)


def init_node(
    name: str,
    argv: list[str] | None = None,
    anonymous: bool = False,
    log_level: int | None = None,
    disable_rostime: bool = False,
    disable_rosout: bool = False,
    disable_signals: bool = False,
    xmlrpc_port: int = 0,
    tcpros_port: int = 0,
) -> None:
    if _node.is_initialised:
        if _node.name.rpartition("/")[2] != name:
            raise ROSException("rospy.init_node() has already been called with different arguments")
        return
    if not name or "/" in name:
        raise ValueError("a name of a node has no slash and is not empty")
    if log_level is not None:
        _node.level = log_level
    special, private = {}, {}
    for argument in sys.argv[1:] if argv is None else argv:
        if not _REMAPPING.match(argument):
            continue
        before, _, after = argument.partition(":=")
        if before.startswith("__"):
            special[before] = after
        elif before.startswith("_"):
            private[before[1:]] = value_of(after)
        else:
            _node.remaps[before] = after
    _node.namespace = "/" + special.get("__ns", os.environ.get("ROS_NAMESPACE", "")).strip("/")
    name = special.get("__name", f"{name}_{os.getpid()}" if anonymous else name)
    _node.name = f"{_node.namespace.rstrip('/')}/{name}"
    _node.remaps = {resolve_name(a, remap=False): b for a, b in _node.remaps.items()}
    for key, value in private.items():
        set_param(f"~{key}", value)
    _node.is_initialised = True
    _node.connected()
    if not disable_signals and threading.current_thread() is threading.main_thread():
        for one in (signal.SIGINT, signal.SIGTERM):
            signal.signal(one, _on_signal)
    atexit.register(_node.shut_down, "the program has ended")


def _on_signal(number: int, frame: object) -> None:
    _node.shut_down(f"signal {number}")
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    raise SystemExit(128 + number)


def myargv(argv: list[str] | None = None) -> list[str]:
    given = sys.argv if argv is None else argv
    return [one for one in given if not _REMAPPING.match(one)]


def is_initialized() -> bool:
    return _node.is_initialised


def is_shutdown() -> bool:
    return _node.is_over


def signal_shutdown(reason: str) -> None:
    _node.shut_down(str(reason))


def on_shutdown(hook: Callable[..., Any]) -> None:
    if not callable(hook):
        raise TypeError("a shutdown hook has to be callable")
    _node.on_shutdown(hook)


def spin() -> None:
    if not _node.is_initialised:
        raise ROSInitException("client code must call rospy.init_node() first")
    try:
        while not _node.is_over:
            time.sleep(_STEP_S)
    except KeyboardInterrupt:
        _node.shut_down("keyboard interrupt")


def get_name() -> str:
    return _node.name


def get_caller_id() -> str:
    return _node.name


def get_namespace() -> str:
    return _node.namespace if _node.namespace.endswith("/") else f"{_node.namespace}/"


def get_node_uri() -> str:
    return f"http://localhost/{_node.name.strip('/')}"


def get_ros_root(*_: object, **__: object) -> str:
    return os.environ.get("ROS_ROOT", "")


def resolve_name(name: str, caller_id: str | None = None, *, remap: bool = True) -> str:
    if not name:
        return get_namespace()
    if name.startswith("~"):
        found = f"{_node.name}/{name[1:].lstrip('/')}"
    elif name.startswith("/"):
        found = name
    else:
        found = f"{_node.namespace.rstrip('/')}/{name}"
    found = "/" + found.strip("/")
    if remap and found in _node.remaps:
        return resolve_name(_node.remaps[found], remap=False)
    return found


remap_name = resolve_name


def get_published_topics(namespace: str = "/") -> list[list[str]]:
    return [[n, kind] for n, kind in _node.connected().topics.items() if n.startswith(namespace)]


# -- topics ----------------------------------------------------------------------------------------


class SubscribeListener:
    def peer_subscribe(self, topic_name: str, publish: Any, peer: Any) -> None:
        """Nobody calls it here."""

    def peer_unsubscribe(self, topic_name: str, count: int) -> None:
        """Nobody calls it here."""


class Topic:
    """The common part of publishers and subscribers."""

    def __init__(self, name: str, data_class: type[RosMessage]) -> None:
        if not isinstance(name, str) or not name:
            raise ValueError("topic name is not a non-empty string")
        if not (isinstance(data_class, type) and issubclass(data_class, RosMessage)):
            raise ValueError(f"data_class is {data_class!r}, which is no message class")
        self.name = self.resolved_name = resolve_name(name)
        self.data_class, self.type, self.md5sum = data_class, data_class._type, "*"
        self._bridge = _node.connected()
        if not self._bridge.is_of_station(self.name):
            _node.say_once(f"{self.name} is no topic of the station: only programs here have it")

    def get_num_connections(self) -> int:
        return self._bridge.listeners(self.name)


class Publisher(Topic):
    def __init__(
        self,
        name: str,
        data_class: type[RosMessage],
        subscriber_listener: object = None,
        tcp_nodelay: bool = False,
        latch: bool = False,
        headers: object = None,
        queue_size: int | None = None,
    ) -> None:
        super().__init__(name, data_class)
        self._bridge.advertise(self.name, self.type)
        self._sequence = 0
        self._is_over, self._latch = False, latch

    def publish(self, *values: Any, **named: Any) -> None:
        if not _node.is_initialised:
            raise ROSException("ROS node has not been initialized yet. Call init_node() first")
        if _node.is_over or self._is_over:
            raise ROSException("publish() to a closed topic")
        is_whole = len(values) == 1 and not named and isinstance(values[0], RosMessage)
        message: Any = values[0] if is_whole else self.data_class(*values, **named)
        self._sequence += 1
        if self.data_class._has_header and hasattr(getattr(message, "header", None), "seq"):
            message.header.seq = self._sequence
        try:
            self._bridge.publish(self.name, to_json(message), latch=self._latch)
        except SerializationError as error:
            raise ROSSerializationException(f"{self.name}: {error}") from None
        except LinkError as error:
            raise ROSException(str(error)) from None

    def unregister(self) -> None:
        self._is_over = True


class Subscriber(Topic):
    def __init__(
        self,
        name: str,
        data_class: type[RosMessage],
        callback: Callable[..., Any] | None = None,
        callback_args: Any = None,
        queue_size: int | None = None,
        buff_size: int = 65536,
        tcp_nodelay: bool = False,
    ) -> None:
        super().__init__(name, data_class)
        self.callback, self._arguments = callback, callback_args
        if callback is not None:
            self._bridge.subscribe(self.name, self.type, self._take)

    def _take(self, message: Message) -> None:
        if _node.is_over or self.callback is None:
            return
        try:
            received = from_json(self.data_class, message)
            if self._arguments is None:
                self.callback(received)
            else:
                self.callback(received, self._arguments)
        except Exception:  # noqa: BLE001 - whatever the program raises there
            if not _node.is_over:
                logerr("bad callback: %s\n%s", self.callback, traceback.format_exc())

    def unregister(self) -> None:
        self._bridge.unsubscribe(self.name, self._take)


def wait_for_message(
    topic: str, topic_type: type[RosMessage], timeout: float | RosDuration | None = None
) -> RosMessage:
    found: list[RosMessage] = []
    subscriber = Subscriber(topic, topic_type, found.append)
    try:
        for _ in _waiting(timeout, f"messages on {topic}"):
            if found:
                return found[0]
    finally:
        subscriber.unregister()
    raise ROSException(f"timeout exceeded while waiting for message on topic {topic}")


def _seconds(value: Any) -> float:
    return float(value.to_sec() if hasattr(value, "to_sec") else value)


def _waiting(timeout: Any, what: str) -> Iterator[None]:
    """Pass until the time is over; a shutdown raises ROSInterruptException."""
    began = time.monotonic()
    seconds = None if timeout is None else _seconds(timeout)
    is_told = False
    while seconds is None or time.monotonic() - began < seconds:
        if _node.is_over:
            raise ROSInterruptException("rospy shutdown")
        yield
        time.sleep(_STEP_S)
        if not is_told and time.monotonic() - began > _PATIENCE_S:
            is_told = True
            logwarn("still waiting for %s", what)
    yield


# -- services --------------------------------------------------------------------------------------


class ServiceProxy:
    def __init__(
        self, name: str, service_class: type[ServiceKind], persistent: bool = False,
        headers: object = None,
    ) -> None:  # fmt: skip
        if not (isinstance(service_class, type) and issubclass(service_class, ServiceKind)):
            raise ValueError(f"{service_class!r} is no service class")
        self.name = self.resolved_name = resolve_name(name)
        self.service_class, self.type = service_class, service_class._type
        self.request_class = service_class._request_class
        self.response_class = service_class._response_class

    def wait_for_service(self, timeout: Any = None) -> None:
        wait_for_service(self.name, timeout)

    def call(self, *values: Any, **named: Any) -> Any:
        kind = self.request_class
        if len(values) == 1 and not named and isinstance(values[0], kind):
            request = values[0]
        else:
            try:
                request = kind(*values, **named)
            except AttributeError as error:
                raise TypeError(str(error)) from None
        offered = _node.services.get(self.name)
        if offered is not None:
            return offered(request)
        bridge = _node.connected()
        try:
            if bridge.peers.offers(self.name):
                answer = bridge.peers.call(self.name, to_json(request))
            else:
                answer = bridge.call(self.name, to_json(request))
        except SerializationError as error:
            raise ROSSerializationException(f"{self.name}: {error}") from None
        except M100Error as error:
            text = f"service [{self.name}] responded with an error: {error}"
            raise ServiceException(text) from None
        return from_json(self.response_class, answer)

    __call__ = call

    def close(self) -> None:
        """Nothing is open between calls."""


class Service:
    """A service that the program offers, to itself and to other programs on the station."""

    def __init__(
        self,
        name: str,
        service_class: type[ServiceKind],
        handler: Callable[[Any], Any],
        buff_size: int = 65536,
        error_handler: object = None,
    ) -> None:
        self.name = self.resolved_name = resolve_name(name)
        self.service_class, self.handler = service_class, handler
        _node.services[self.name] = self._serve
        _node.connected().peers.offer(self.name, self._answer)
        _node.say_once(f"{self.name} is offered to programs for rospy here alone")

    def _answer(self, request: Message) -> Message:
        return to_json(self._serve(from_json(self.service_class._request_class, request)))

    def _serve(self, request: RosMessage) -> Any:
        kind = self.service_class._response_class
        answer = self.handler(request)
        if isinstance(answer, RosMessage):
            return answer
        if answer is None:
            raise ServiceException(f"service [{self.name}] returned no response")
        if isinstance(answer, dict):
            return kind(**answer)
        return kind(*answer) if isinstance(answer, list | tuple) else kind(answer)

    def shutdown(self, reason: str = "") -> None:
        _node.services.pop(self.name, None)
        _node.connected().peers.withdraw(self.name)

    def spin(self) -> None:
        spin()


def wait_for_service(service: str, timeout: Any = None) -> None:
    name = resolve_name(service)
    for _ in _waiting(timeout, f"service {name}, which the station does not have"):
        if name in _node.services or _node.connected().peers.offers(name):
            return
        if _node.connected().call("/rosapi/service_type", {"service": name})["type"]:
            return
        time.sleep(_STEP_S)
    raise ROSException(f"timeout exceeded while waiting for service {name}")


# -- time ------------------------------------------------------------------------------------------


def get_rostime() -> Any:
    return RosTime.now()


def get_time() -> float:
    return time.time()


def sleep(duration: float | RosDuration) -> None:
    """Raises ROSInterruptException: the node was shut down meanwhile."""
    ends_at = time.monotonic() + _seconds(duration)
    while (rest := ends_at - time.monotonic()) > 0.0:
        if _node.is_over:
            raise ROSInterruptException("ROS shutdown request")
        time.sleep(min(rest, _STEP_S))


class Rate:
    def __init__(self, hz: float, reset: bool = False) -> None:
        self.sleep_dur = RosDuration.from_sec(1.0 / hz)
        self._period = 1.0 / hz
        self._last = time.monotonic()

    def remaining(self, curr_time: object = None) -> Any:
        return RosDuration.from_sec(self._last + self._period - time.monotonic())

    def sleep(self) -> None:
        rest = self._last + self._period - time.monotonic()
        if rest > 0.0:
            sleep(rest)
        elif _node.is_over:
            raise ROSInterruptException("ROS shutdown request")
        self._last += self._period
        if time.monotonic() - self._last > 2 * self._period:
            self._last = time.monotonic()


class TimerEvent(SimpleNamespace):
    """When it was and is called, and how long the call before took."""


class Timer(threading.Thread):
    def __init__(
        self, period: RosDuration, callback: Callable[[Any], Any], oneshot: bool = False,
        reset: bool = False,
    ) -> None:  # fmt: skip
        super().__init__(daemon=True)
        self._period, self._callback, self._oneshot = period, callback, oneshot
        self._is_over = False
        self.start()

    def shutdown(self) -> None:
        self._is_over = True

    def run(self) -> None:
        rate = Rate(1.0 / max(1e-3, _seconds(self._period)))
        last: Any = None
        last_s = None
        while True:
            try:
                rate.sleep()
            except ROSInterruptException:
                return
            if self._is_over or _node.is_over:
                return
            now = RosTime.now()
            event = TimerEvent(
                last_expected=last,
                last_real=last,
                current_expected=now,
                current_real=now,
                last_duration=last_s,
            )
            began = time.monotonic()
            self._callback(event)
            last, last_s = now, time.monotonic() - began
            if self._oneshot:
                return


# -- parameters: those of the command line, and what the program sets ------------------------------

_NO_DEFAULT = object()


def get_param(param_name: str, default: Any = _NO_DEFAULT) -> Any:
    """Raises KeyError: it is not set, and there is no default."""
    try:
        return _node.parameters.get(resolve_name(param_name))
    except KeyError:
        if default is not _NO_DEFAULT:
            return default
        raise KeyError(
            f"{param_name} is not set: give ~name as _name:=value, others in a launch file"
        ) from None


def set_param(param_name: str, value: Any) -> None:
    _node.parameters.set(resolve_name(param_name), value)


def has_param(param_name: str) -> bool:
    return get_param(param_name, None) is not None


def delete_param(param_name: str) -> None:
    """Raises KeyError: it is not set."""
    get_param(param_name)
    set_param(param_name, {})


def search_param(param_name: str) -> str | None:
    name = resolve_name(param_name)
    return name if name in _node.parameters.values else None


def get_param_names() -> list[str]:
    return list(_node.parameters.values)


# -- logs ------------------------------------------------------------------------------------------


def _log(level: int, text: object, *values: object, **named: object) -> None:
    if level < _node.level:
        return
    said = str(text)
    if values:
        try:
            said = said % values
        except (TypeError, ValueError):
            said = " ".join(map(str, (said, *values)))
    stream = sys.stdout if level <= INFO else sys.stderr
    print(f"[{_NAMES[level]}] [{time.time():.6f}]: {said}", file=stream, flush=True)


def _logger(level: int) -> tuple[Callable[..., None], Callable[..., None], Callable[..., None]]:
    at: dict[object, float] = {}

    def log(text: object, *values: object, **named: object) -> None:
        _log(level, text, *values)

    def throttle(period: float, text: object, *values: object, **named: object) -> None:
        frame = sys._getframe(1)
        place, now = (frame.f_code, frame.f_lineno), time.monotonic()
        if now - at.get(place, -1e9) >= period:
            at[place] = now
            _log(level, text, *values)

    def once(text: object, *values: object, **named: object) -> None:
        frame = sys._getframe(1)
        place = (frame.f_code, frame.f_lineno)
        if place not in at:
            at[place] = time.monotonic()
            _log(level, text, *values)

    return log, throttle, once


logdebug, logdebug_throttle, logdebug_once = _logger(DEBUG)
loginfo, loginfo_throttle, loginfo_once = _logger(INFO)
logwarn, logwarn_throttle, logwarn_once = _logger(WARN)
logerr, logerr_throttle, logerr_once = _logger(ERROR)
logfatal, logfatal_throttle, logfatal_once = _logger(FATAL)
logdebug_throttle_identical = logdebug_throttle
loginfo_throttle_identical = loginfo_throttle
logwarn_throttle_identical = logwarn_throttle
logerr_throttle_identical = logerr_throttle


class AnyMsg(RosMessage):
    """Of any type: the station tells none without its type."""
