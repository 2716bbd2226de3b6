"""Names of the graph of ROS 2 on zenoh, as rmw_zenoh has them: keys, tokens, attachments.

A topic or service is a key with its type and hash; a node and each of its ends is a liveliness
token that other nodes read. Texts in, texts out: nothing is sent here.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from struct import Struct, error

from m100link.apps.bus.network import DEPTH, Inbox, TokenChange
from m100link.errors import UsageError
from m100link.log.cdr import full_name, type_hash

ADMIN = "@ros2_lv"  # what tokens begin with
GID_SIZE = 16

_HEAD = Struct("<QQB")
_NODE_PARTS, _END_PARTS = 9, 13
_TOKEN = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


class EntityKind(Enum):
    NODE = "NN"
    PUBLISHER = "MP"
    SUBSCRIBER = "MS"
    SERVER = "SS"
    CLIENT = "SC"


@dataclass(frozen=True, slots=True)
class Qos:
    """Quality of service, as far as an end here chooses it."""

    is_reliable: bool = True  # else best effort, which sensors have
    is_latched: bool = False  # whether who comes late gets the last one: transient local
    depth: int = 10  # how many are kept

    def __str__(self) -> str:
        """As a token has it; what is the default stays empty."""
        reliability = "" if self.is_reliable else "2"
        durability = "1" if self.is_latched else ""
        return f"{reliability}:{durability}:,{self.depth}:,:,:,,"


def dds_name(name: str) -> str:
    """A type as keys have it: ``sensor_msgs::msg::dds_::Imu_``."""
    package, kind, last = full_name(name).split("/")
    return f"{package}::{kind}::dds_::{last}_"


def data_key(domain: int, topic: str, kind: str) -> str:
    """Where data of a topic goes, or requests to a service; a kind is ``sensor_msgs/Imu``."""
    return f"{domain}/{topic.strip('/')}/{dds_name(kind)}/{type_hash(kind)}"


def _mangled(name: str) -> str:
    return name.replace("/", "%") or "%"


@dataclass(frozen=True, slots=True)
class NodeName:
    domain: int  # ROS_DOMAIN_ID
    session: str  # id of the zenoh session
    namespace: str  # ``/`` or ``/drones/first``
    name: str
    number: int = 0  # its number within the session

    @property
    def full(self) -> str:
        return f"{self.namespace.rstrip('/')}/{self.name}"

    def _token(self, number: int, end: EntityKind) -> str:
        where = f"{ADMIN}/{self.domain}/{self.session}/{self.number}/{number}/{end.value}"
        return f"{where}/%/{_mangled(self.namespace)}/{self.name}"

    @property
    def token(self) -> str:
        return self._token(self.number, EntityKind.NODE)

    def token_of(self, number: int, end: EntityKind, topic: str, kind: str, qos: Qos) -> str:
        about = f"{_mangled(topic)}/{dds_name(kind)}/{type_hash(kind)}/{qos}"
        return f"{self._token(number, end)}/{about}"


@dataclass(frozen=True, slots=True)
class Seen:
    """A node or an end of somebody, as its token says."""

    node: tuple[str, str]  # which node: its session and number
    node_name: str  # its name with its namespace
    end: EntityKind
    topic: str  # of which topic or service; empty for the node itself


def read_token(key: str) -> Seen | None:
    """The entity that a token declares; None where it is not one as rmw_zenoh writes them."""
    parts = key.split("/")
    if len(parts) not in (_NODE_PARTS, _END_PARTS) or parts[0] != ADMIN:
        return None
    try:
        end = EntityKind(parts[5])
    except ValueError:
        return None
    if (end is EntityKind.NODE) != (len(parts) == _NODE_PARTS):
        return None
    namespace = parts[7].replace("%", "/").rstrip("/")
    topic = "" if end is EntityKind.NODE else parts[9].replace("%", "/")
    return Seen((parts[2], parts[3]), f"{namespace}/{parts[8]}", end, topic)


# -- attachments ----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Attachment:
    sequence: int  # counts what its sender sent
    at_ns: int  # when it was sent, POSIX time in ns by the clock of the sender
    gid: bytes  # id of the sender; an answer has that of the request


def gid_of(token: str) -> bytes:
    """The id of an end, which each node reckons from its token: XXH128, low half first."""
    from xxhash import xxh3_128_intdigest  # of the extra ``ros2``

    return xxh3_128_intdigest(token.encode()).to_bytes(GID_SIZE, "little")


def write_attachment(sequence: int, at_ns: int, gid: bytes) -> bytes:
    """The attachment of these values, see :class:`Attachment`; for each message that is sent."""
    return _HEAD.pack(sequence, at_ns, GID_SIZE) + gid


def read_attachment(data: bytes) -> Attachment:
    """The attachment of somebody else. Raises ValueError: it is not one."""
    try:
        sequence, at_ns, size = _HEAD.unpack_from(data)
    except error:
        raise ValueError("no attachment as rmw_zenoh writes it") from None
    gid = data[_HEAD.size : _HEAD.size + size]
    if size != GID_SIZE or len(gid) != size:
        raise ValueError("an attachment without an id of its sender")
    return Attachment(sequence, at_ns, gid)


# -- names ----------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Names:
    namespace: str  # ``/`` or ``/drones/first``
    node: str
    remaps: Mapping[str, str]  # full names by full names

    @classmethod
    def of(cls, namespace: str, node: str, remaps: tuple[str, ...] = ()) -> Names:
        """From what was asked for; rules ``from:=to`` have private (``~/imu``) or other names.

        Raises UsageError: a name or a rule cannot be.
        """
        words = [one for one in namespace.split("/") if one]
        for word in (*words, node):
            if not _TOKEN.fullmatch(word):
                raise UsageError(
                    f"{word!r} cannot be part of a name in ROS",
                    remedy="take letters, digits and underscores, no digit in front",
                )
        plain = cls("/" + "/".join(words), node, {})
        found = {}
        for rule in remaps:
            before, sign, after = rule.partition(":=")
            if not (sign and before and after):
                raise UsageError(f"{rule!r} is not a rule", remedy="write from:=to: ~/imu:=/imu")
            found[plain.full(before)] = plain.full(after)
        return cls(plain.namespace, node, found)

    def full(self, name: str) -> str:
        """A private, relative or full name with all of its namespaces, and remapped.

        Raises UsageError: it cannot be a name.
        """
        base = self.namespace.rstrip("/")
        if name.startswith("~/"):
            name = f"{base}/{self.node}/{name[2:]}"
        elif not name.startswith("/"):
            name = f"{base}/{name}"
        if not all(_TOKEN.fullmatch(word) for word in name[1:].split("/")):
            raise UsageError(f"{name!r} cannot be a name in ROS")
        return self.remaps.get(name, name)

    def frame(self, name: str) -> str:
        """A frame of this node: those of several nodes differ by their namespaces."""
        inner = self.namespace.strip("/")
        return f"{inner}/{name}" if inner else name


# -- who is in the graph: which nodes could have asked for something, and which are left -----------


_MOST = 4 * DEPTH  # tokens that are known: a graph of hundreds of nodes has fewer


class GraphDiscovery:
    def __init__(self, watch: Callable[[], Inbox[TokenChange]]) -> None:
        self._watch = watch
        self._inbox = watch()
        self._seen: dict[str, Seen] = {}

    def look(self) -> None:
        """Take what has changed. Of a flood some is lost: then all of them count as gone."""
        changes = self._inbox.take()
        if len(changes) >= DEPTH:
            self._seen.clear()
            self._inbox = self._watch()
            return
        for change in changes:
            if not change.is_there:
                self._seen.pop(change.key, None)
                continue
            seen = read_token(change.key)
            if seen is not None and len(self._seen) < _MOST:
                self._seen.setdefault(change.key, seen)

    def clients(self, service: str) -> Mapping[str, Seen]:
        self.look()
        return {
            key: one
            for key, one in self._seen.items()
            if one.end is EntityKind.CLIENT and one.topic == service
        }

    def has_duplicate(self, name: str, session: str) -> bool:
        """Whether a node of another session is called so, too: calls reach both."""
        return any(
            one.end is EntityKind.NODE and one.node_name == name and one.node[0] != session
            for one in self._seen.values()
        )

    def missing(self, clients: Mapping[str, Seen]) -> bool:
        """Whether any of them is gone, or was: who is back within a step is another one."""
        return any(self._seen.get(key) is not one for key, one in clients.items())
