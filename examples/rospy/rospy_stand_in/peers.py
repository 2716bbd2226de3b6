"""Topics, services and parameters that programs on one station have between them.

Each has a socket and a card in a folder of the station that only this user can enter. The card
says what it hears and offers; a program that publishes or calls reads the cards. Where there are
no such sockets (Windows), a program is alone.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import socket
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from m100link.apps.station.ros.messages import Message
from m100link.errors import LinkError, LinkLost

PARAMETERS = "M100LINK_ROSPY_PARAMETERS"
"""The variable with the parameters of a launch file, as JSON, for the programs that it starts."""

_FRESH_S = 0.2  # how long what the cards said counts
_PATIENCE_S = 2.0  # within which another program takes a message
_ANSWER_S = 120.0  # within which it has to answer
_WAITING = 64  # messages that wait to be taken

Handler = Callable[[Message], Message]


def folder_of(station: str) -> Path | None:
    """Where the programs on a station meet; None if they cannot."""
    if not hasattr(socket, "AF_UNIX"):
        return None
    name = hashlib.sha256(station.rstrip("/").encode()).hexdigest()[:12]
    folder = Path(tempfile.gettempdir()) / f"m100link-rospy-{os.getuid()}" / name
    for one in (folder.parent, folder):
        one.mkdir(mode=0o700, exist_ok=True)
        found = one.lstat()
        if found.st_uid != os.getuid() or found.st_mode & 0o077:
            return None
    return folder


class Peers:
    """The other programs on a station. Everything here may be called from any thread.

    ``on_message``: called with the topic and each message of another program, in one thread.
    """

    def __init__(self, station: str, on_message: Callable[[str, Message], None]) -> None:
        self._folder, self._on_message = folder_of(station), on_message
        self._hears: set[str] = set()
        self._services: dict[str, Handler] = {}
        self._kept: dict[str, Message] = {}  # by topic: the latched one
        self._lock = threading.RLock()
        self._cards: dict[str, dict[str, Any]] = {}  # of the others, by name
        self._read_at, self._name = -_FRESH_S, ""
        if self._folder is None:
            return
        self._name = f"{os.getpid()}-{time.monotonic_ns():x}"
        self._server = socket.socket(socket.AF_UNIX)
        try:
            self._server.bind(str(self._folder / self._name))
        except OSError:  # too long a path, for one
            self._server.close()
            self._folder = None
            return
        self._server.listen(_WAITING)
        self._thread = threading.Thread(target=self._serve, name="peers", daemon=True)
        self._thread.start()
        self._write_card()

    def close(self) -> None:
        if self._folder is not None:
            _remove(self._folder, self._name)
            with contextlib.suppress(OSError):  # that wakes the thread, which closes it
                self._server.shutdown(socket.SHUT_RDWR)
            if threading.current_thread() is not self._thread:
                self._thread.join(_PATIENCE_S)

    def hear(self, topic: str) -> None:
        """From now on ``on_message`` gets that topic, and first what was latched."""
        with self._lock:
            if topic in self._hears:
                return
            self._hears.add(topic)
            self._write_card()
        self._send(self._others(), {"latched": topic, "to": self._name})

    def offer(self, service: str, handler: Handler) -> None:
        with self._lock:
            self._services[service] = handler
            self._write_card()

    def withdraw(self, service: str) -> None:
        with self._lock:
            self._services.pop(service, None)
            self._write_card()

    def listeners(self, topic: str) -> int:
        return len(self._who("hears", topic))

    def publish(self, topic: str, message: Message, *, latch: bool) -> None:
        if latch:
            self._kept[topic] = message
        self._send(self._who("hears", topic), {"topic": topic, "msg": message})

    def offers(self, service: str) -> bool:
        """Whether another program offers it."""
        return bool(self._who("offers", service))

    def call(self, service: str, request: Message, timeout: float = _ANSWER_S) -> Message:
        """Raises ``LinkError``: it refuses, with its reason. Raises ``LinkLost``: it has gone."""
        asked = {"service": service, "args": request}
        for name in self._who("offers", service):
            answer = self._ask(name, asked, timeout)
            if answer is not None:
                if "values" not in answer:
                    raise LinkError(str(answer.get("error")))
                values: Message = answer["values"]
                return values
        raise LinkLost(f"the program that offers {service} has gone, or does not answer")

    # -- cards and sockets -----------------------------------------------------------------------

    def _write_card(self) -> None:
        if self._folder is None:
            return
        card = json.dumps({"hears": sorted(self._hears), "offers": sorted(self._services)})
        part = self._folder / f"{self._name}.part"
        part.write_text(card, encoding="utf-8")
        part.rename(self._folder / f"{self._name}.card")

    def _others(self) -> list[str]:
        """The names of the others; their cards are fresh afterwards."""
        with self._lock:
            now = time.monotonic()
            if self._folder is not None and now - self._read_at >= _FRESH_S:
                self._read_at = now
                self._cards = {}
                for one in self._folder.glob("*.card"):
                    with contextlib.suppress(OSError, ValueError, TypeError):  # it ended meanwhile
                        if one.stem != self._name:
                            self._cards[one.stem] = dict(json.loads(one.read_text("utf-8")))
            return list(self._cards)

    def _who(self, what: str, name: str) -> list[str]:
        return [one for one in self._others() if name in self._cards.get(one, {}).get(what, ())]

    def _send(self, names: list[str], message: dict[str, Any]) -> None:
        for name in names:
            self._ask(name, message, 0.0)

    def _ask(self, name: str, message: dict[str, Any], timeout: float) -> dict[str, Any] | None:
        """Send a message, and wait for the answer if there is time for one."""
        assert self._folder is not None
        with socket.socket(socket.AF_UNIX) as connection:
            connection.settimeout(_PATIENCE_S)
            try:
                connection.connect(str(self._folder / name))
                connection.sendall(json.dumps(message).encode() + b"\n")
                if not timeout:
                    return None
                connection.settimeout(timeout)
                with connection.makefile("rb") as answer:
                    found: dict[str, Any] = json.loads(answer.readline())
                    return found
            except (ConnectionRefusedError, FileNotFoundError):  # killed: it left its files behind
                _remove(self._folder, name)
                with self._lock:
                    self._cards.pop(name, None)
            except (OSError, ValueError):
                pass  # it is slow, or ended meanwhile
        return None

    def _serve(self) -> None:
        while True:
            try:
                connection, _ = self._server.accept()
            except OSError:
                self._server.close()
                return
            try:
                self._take(connection)
            except (OSError, ValueError, LookupError, TypeError):  # broken off, or no message
                connection.close()

    def _take(self, connection: socket.socket) -> None:
        connection.settimeout(_PATIENCE_S)
        with connection.makefile("rb") as lines:
            message = json.loads(lines.readline())
        if "service" in message:
            asked = connection, self._services.get(message["service"]), message["args"]
            threading.Thread(target=self._answer, args=asked, daemon=True).start()
            return
        connection.close()
        if "topic" in message:
            self._on_message(message["topic"], message["msg"])
        elif message["latched"] in self._kept:
            kept = {"topic": message["latched"], "msg": self._kept[message["latched"]]}
            self._send([message["to"]], kept)

    def _answer(self, connection: socket.socket, handler: Handler | None, asked: Message) -> None:
        try:
            answer: dict[str, Any] = {"error": "it is not offered any more"}
            if handler is not None:
                answer = {"values": handler(asked)}
        except Exception as error:  # noqa: BLE001 - whatever the program raises there
            answer = {"error": str(error) or type(error).__name__}
        with connection, contextlib.suppress(OSError):  # its asker has gone
            connection.sendall(json.dumps(answer).encode() + b"\n")


@contextlib.contextmanager
def sharing(station: str, parameters: dict[str, Any]) -> Iterator[None]:
    """Programs that begin on a station while the block runs have these parameters, as JSON."""
    folder = folder_of(station)
    if folder is None:
        yield
        return
    file = folder / f"{os.getpid()}.parameters"
    file.write_text(json.dumps(parameters), encoding="utf-8")
    try:
        yield
    finally:
        file.unlink(missing_ok=True)


def shared_parameters(station: str) -> dict[str, Any]:
    """Parameters of the launch file that started this program, and of others on the station."""
    found: dict[str, Any] = json.loads(os.environ.get(PARAMETERS, "{}"))
    folder = folder_of(station)
    for one in sorted(folder.glob("*.parameters")) if folder else []:
        try:
            os.kill(int(one.stem), 0)
        except ProcessLookupError:  # killed: it left the file behind
            one.unlink(missing_ok=True)
        else:
            found |= json.loads(one.read_text(encoding="utf-8"))
    return found


def _remove(folder: Path, name: str) -> None:
    for one in (name, f"{name}.card"):
        (folder / one).unlink(missing_ok=True)
