"""The bytes of a fleet: a version, and the messages between agent and client.

The first byte of every payload is :data:`VERSION`; a reader of another version says so and reads no
more. Behind it telemetry, events and setpoints are the messages of
:mod:`m100link.apps.agent.messages`, by :mod:`m100link.apps.agent.codec`. A fleet adds values as
JSON: :class:`OrderMessage`, :class:`OrderReply` and :class:`Card`. Proof and signature are over the
bytes of an order as they are sent: nobody encodes them again, and readers refuse ambiguous JSON.
"""

from __future__ import annotations

import hashlib
import hmac
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum
from functools import cache, cached_property
from typing import Any, ClassVar

from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey, X25519PublicKey

from m100link import errors
from m100link.apps.agent import orders
from m100link.apps.agent.codec import Fields, InvalidValue, decode, encode, parsed, write_json
from m100link.apps.agent.lease import Lease, LeaseHeld, LeaseRefused
from m100link.apps.agent.messages import Message, MessageError, RemoteError, Steer, fault_of
from m100link.apps.agent.orders import Right
from m100link.apps.bus.network import Question

# -- what became of an order: six answers, and none of them is silence -----------------------------


class Outcome(Enum):
    """The outcome of an order."""

    OK = "ok"  # carried out, and observed to be
    REFUSED = "refused"  # not carried out, or failed: the reason says which
    STALE_LEASE = "stale_lease"  # not carried out: its lease is not in force
    NOT_ALLOWED = "not_allowed"  # not carried out: this identity has no right to it
    UNREACHABLE = "unreachable"  # never sent: no agent of that name is present
    UNKNOWN = "unknown"  # sent; no outcome is known


# The first class that fits decides, so subclasses stand before their bases.
_OUTCOMES: tuple[tuple[type[errors.M100Error], Outcome], ...] = (
    (LeaseHeld, Outcome.REFUSED),  # by who has it: this side never had it
    (LeaseRefused, Outcome.STALE_LEASE),
    (errors.StaleLease, Outcome.STALE_LEASE),
    (errors.NotAllowed, Outcome.NOT_ALLOWED),
    (errors.Unreachable, Outcome.UNREACHABLE),
    (errors.OutcomeUnknown, Outcome.UNKNOWN),
    (errors.AckTimeout, Outcome.UNKNOWN),  # the aircraft itself did not answer
    # It had begun, and nobody saw how it went on.
    (errors.NotObserved, Outcome.UNKNOWN),
    (errors.AuthorityLost, Outcome.UNKNOWN),
    (errors.LinkLost, Outcome.UNKNOWN),
    (errors.LinkClosed, Outcome.UNKNOWN),
    (errors.M100Error, Outcome.REFUSED),
)


def outcome_of(error: errors.M100Error | None) -> Outcome:
    """The outcome that an error means; None means that all is well."""
    if error is None:
        return Outcome.OK
    return next(outcome for kind, outcome in _OUTCOMES if isinstance(error, kind))


@dataclass(frozen=True, slots=True)
class Result:
    """The result of an order to one aircraft."""

    name: str  #: the aircraft
    outcome: Outcome  #: what became of the order
    #: why it is not ``ok``, with what was seen, the likely cause, and what to do
    error: errors.M100Error | None = None
    value: object = None  #: the result of the order, if it has one

    @classmethod
    def of(cls, name: str, error: errors.M100Error | None, value: object = None) -> Result:
        """The result that an error means."""
        return cls(name, outcome_of(error), error, value)

    @property
    def is_ok(self) -> bool:
        """Whether it was carried out."""
        return self.outcome is Outcome.OK

    def __str__(self) -> str:
        if self.error is None:
            return self.outcome.value
        return f"{self.outcome.value} ({self.error.seen})"


# -- how far the mission of one aircraft is (pure logic) -------------------------------------------


class MissionStage(Enum):
    """The stage of a mission."""

    NONE = "none"  # there is no plan
    UPLOADED = "uploaded"  # the plan waits at the agent; the aircraft does not have it yet
    STARTING = "starting"  # the aircraft gets the plan, and takes off first if it has to
    FLYING = "flying"
    OVER = "over"  # flown, stopped or failed; the plan is still on board


class MissionInput(Enum):
    UPLOADED = "uploaded"  # another plan is whole
    ASKED = "asked"  # to start it
    BEGUN = "begun"  # the aircraft flies it
    ENDED = "ended"  # however
    LEASE_ENDED = "lease ended"  # the agent ends what flew under it, and forgets the plan


# Of what came in pieces and is whole the agent knows before anybody here does: it may start.
_WAITS: dict[MissionInput, MissionStage | None] = {
    MissionInput.UPLOADED: MissionStage.UPLOADED,
    MissionInput.ASKED: MissionStage.STARTING,
}
_FLIES: dict[MissionInput, MissionStage | None] = {
    **dict.fromkeys((MissionInput.UPLOADED, MissionInput.ASKED)),
    **dict.fromkeys((MissionInput.ENDED, MissionInput.LEASE_ENDED), MissionStage.OVER),
}
_NEXT: dict[MissionStage, dict[MissionInput, MissionStage | None]] = {
    MissionStage.NONE: _WAITS,
    MissionStage.UPLOADED: _WAITS | {MissionInput.LEASE_ENDED: MissionStage.NONE},
    MissionStage.STARTING: _FLIES | {MissionInput.BEGUN: MissionStage.FLYING},
    MissionStage.FLYING: _FLIES,
    MissionStage.OVER: _WAITS,
}
"""An input without an entry changes nothing; None is refused."""


def after(stage: MissionStage, happens: MissionInput) -> MissionStage:
    """How far it is then; MissionRunning where it cannot be asked for."""
    found = _NEXT[stage].get(happens, stage)
    if found is None:
        what = "a plan" if happens is MissionInput.UPLOADED else "the start of a mission"
        raise errors.MissionRunning(
            f"{what} came while a mission is {stage.value}; nothing was changed",
            cause="the holder of the lease flies a mission already",
            remedy="stop it first, or wait for its end",
        )
    return found


# -- payloads --------------------------------------------------------------------------------------

VERSION = 4
"""Of these payloads."""

_SIGNED = b"m100link order 4\n"
_ABOUT = b"m100link lease 4\n"
_SIGNATURE, _PROOF = 64, 16
_MOST = 64 * 1024


class What(Enum):
    """The kinds of questions about the logs on board."""

    LIST = "list"
    PIECE = "piece"
    DIGEST = "digest"  # SHA-256 of the first bytes
    AUDIT = "audit"  # lines of the audit log, from the number in the offset on


@dataclass(frozen=True, slots=True)
class LogQuestion:
    """Something is asked of the logs of one aircraft."""

    right: ClassVar[Right] = Right.WATCH
    ends: ClassVar[bool] = False
    what: What  # what is wanted
    log: str = ""  # name of the log; empty for a list
    offset: int = 0  # first byte of a piece
    length: int = 0  # bytes of a piece, or over how many of them the digest is


@dataclass(frozen=True, slots=True)
class ShowOrder:
    """Something is asked of an aircraft that takes part in a show, or is to."""

    right: ClassVar[Right] = Right.FLY
    ends: ClassVar[bool] = False
    run: str  # which run of which conductor asks; another one is refused meanwhile


class AskShow(ShowOrder):
    """Tell where it stands."""


@dataclass(frozen=True, slots=True)
class SendTrack(ShowOrder):
    at: int  # first byte
    data: bytes


@dataclass(frozen=True, slots=True)
class LoadTrack(ShowOrder):
    leave: str  # ``"hover"`` or ``"land"`` behind the track, or when it has to leave
    show: str = ""  # names the show, for the others that fly it; empty to look at none
    least_m: float = 0.0  # least distance to another one, m
    others: int = 0  # how many others fly it


class TakePlace(ShowOrder):
    """Take off, and fly to the first point of its track."""


@dataclass(frozen=True, slots=True)
class StartShow(ShowOrder):
    digest: str  # of the track
    at: float  # when, by its own clock, s
    bound: float  # by how much that may be wrong, s


class LeaveShow(ShowOrder):
    """Leave the show, wherever it is."""

    ends = True


AboutShow = AskShow | SendTrack | LoadTrack | TakePlace | StartShow | LeaveShow
Asked = orders.Order | LogQuestion | AboutShow
"""The contents of an order. Each has the right that it needs."""


class Progress(Enum):
    """How far an order is, as its agent knows."""

    DONE = "done"  # the outcome stands beside it
    RUNNING = "running"
    NEVER = "never"  # this id was not seen by this agent, nor by one of its name before


@dataclass(frozen=True)
class OrderMessage:
    id: str  # chosen by who asks, 32 hex digits. An order is carried out once for each id
    site: str  # where the aircraft is for which it is meant
    aircraft: str  # its name
    by: str  # who asks, for people; what a signature proves is in :attr:`signer`
    fence: int  # number of the lease that it is asked under; 0 for none
    at: float  # when it was made, POSIX time, s
    order: Asked  # what is asked
    # When it was made at the earliest, by the agent's own clock, s; 0: unknown.
    clock: float = 0.0
    boot: str = ""  # the run of the agent whose clock that is; empty: unknown
    signer: str = ""  # whose signature it is; empty for none
    # Public half of the secret of the lease that it asks for; see
    # :class:`Half`. Empty where it asks for none.
    key: bytes = b""
    # When the first step of its request was wanted, by the clock of `clock`: a STOP since then
    # overtakes it. 0: as `clock`.
    since: float = 0.0
    # Before the JSON, zeros for none: the signature, and the proof that the sender has the lease.
    signature: bytes = bytes(_SIGNATURE)
    proof: bytes = bytes(_PROOF)

    @property
    def wanted_at(self) -> float | None:
        """When it was wanted first, by the agent's clock, s; None: unknown."""
        at = self.clock if self.since == 0.0 else self.since
        return None if at == 0.0 else at

    @cached_property
    def document(self) -> bytes:
        """The order as JSON, in the bytes in which it came or goes."""
        return to_json(self)

    def signed(self) -> bytes:
        """The bytes that the signature is over, with the proof: nobody takes it away on the way."""
        return _SIGNED + self.proof + self.document

    @cached_property
    def digest(self) -> bytes:
        """The 16 bytes by which a reply names the order: an id is heard by all, and said again."""
        return hashlib.sha256(self.document).digest()[:16]

    def under(self, token: str) -> OrderMessage:
        """The order with the proof that its sender has the lease; unchanged without a token."""
        return self.sealed(proof=_proof(token, self.document)) if token else self

    def proves(self, token: str) -> bool:
        return hmac.compare_digest(self.proof, _proof(token, self.document))

    def sealed(self, document: bytes = b"", **seals: bytes) -> OrderMessage:
        """The order with proof or signature, in the same bytes or in those that came."""
        made = replace(self, **seals)  # type: ignore[arg-type]  # both are bytes
        vars(made)["document"] = document or self.document
        return made


_ENDING = "|".join(name for name, kind in orders.ORDERS.items() if kind.ends)
_ENDS = re.compile(rf'"order":\{{"kind":"(?:LeaveShow|{_ENDING})"'.encode())
_SHORT = 2048  # bytes of an order that is looked at


def ends(question: Question) -> bool:
    """Whether it looks like an order that ends something: nobody has read or verified it."""
    return len(question.payload) <= _SHORT and _ENDS.search(question.payload) is not None


class ShowStage(Enum):
    """The stage of an aircraft in a show."""

    EMPTY = "empty"
    LOADED = "loaded"
    PLACING = "placing"  # it takes off and flies to its first point
    READY = "ready"  # it hovers there
    FLYING = "flying"  # it waits for the beginning, or flies
    FLOWN = "flown"
    LEFT = "left"  # it left; `why` has the reason


@dataclass(frozen=True, slots=True)
class ShowCard:
    stage: ShowStage
    digest: str  # of its track; empty without one
    farthest_m: float  # farthest from it until now, by its own telemetry
    why: str  # why it left; empty where it did not


@dataclass(frozen=True, slots=True)
class OrderReply:
    id: str  # of the order
    name: str
    boot: str  # which run of its agent this is
    progress: Progress  # how far it is
    outcome: Outcome = Outcome.UNKNOWN  # what became of it; means something when it is done
    fault: RemoteError | None = None  # why it is not ``ok``
    text: str = ""  # what was asked for, where that is a text
    number: int = 0  # what was asked for, where that is a number
    offer: str = ""  # what confirms a take-over that was asked for; no secret
    key: bytes = b""  # public half of the secret of a lease that was granted; empty otherwise
    clock: float = 0.0  # the agent's own clock, s; setpoints are stamped by it
    is_repeated: bool = False  # the order had been heard before
    # :meth:`OrderMessage.digest` of the order that was heard under the id; empty where none was.
    order: bytes = b""
    show: ShowCard | None = None  # where a show was asked

    @classmethod
    def done(
        cls, identity: str, name: str, boot: str, error: errors.M100Error | None, **more: Any
    ) -> OrderReply:
        """The reply to an order that is over; ``more``: the other fields that say something."""
        values: dict[str, Any] = more | {"outcome": outcome_of(error)}
        if error is not None:
            values["fault"] = fault_of(error)
        return cls(identity, name, boot, Progress.DONE, **values)


@dataclass(frozen=True, slots=True)
class Card:
    """The state of an agent and its aircraft, for a list."""

    name: str  #: the aircraft
    boot: str  #: which run of its agent this is
    at: float  #: when, POSIX time, s
    connection: str = "connecting"  #: ``"connecting"``, ``"connected"`` or ``"lost"``
    fault: RemoteError | None = None  #: why it is not connected, or cannot be activated
    firmware: str = ""  #: firmware profile; empty when not connected
    holder: str = ""  #: name of the operator who has the lease; empty without one
    fence: int = 0  #: number of the lease; 0 for none
    has_authority: bool = False  #: whether the aircraft obeys the agent
    task: str = ""  #: task, program or mission in flight; empty without one
    phase: str = ""  #: whether it is on the ground or in the air, in words; empty when unknown
    height_m: float | None = None  #: above the take-off point; None when unknown
    latitude_deg: float | None = None  #: None when unknown
    longitude_deg: float | None = None  #: likewise
    battery_percent: int | None = None  #: likewise
    lost: str = "hover"  #: ``"hover"``, ``"land"`` or ``"home"``, when the operator is lost
    lost_after: float = 10.0  #: seconds of hovering before that
    version: str = ""  #: release of its program


@dataclass(frozen=True, slots=True)
class MissionCard:
    """The state of an aircraft's mission."""

    name: str  #: the aircraft
    boot: str  #: which run of its agent this is
    stage: MissionStage = MissionStage.NONE  #: stage of the mission that came over the fleet
    by: str = ""  #: name of the operator who uploaded it
    digest: str = ""  #: digest of its plan; empty without one
    points: int = 0  #: waypoints of the newest plan; 0 without one
    reached: bytes = b""  #: waypoints reached, in order, a byte each; the last 1024
    reached_count: int = 0  #: how many were reached, also those before the last 1024
    is_paused: bool = False  #: whether it is paused, hovering
    is_finished: bool = False  #: whether every waypoint was flown
    fault: RemoteError | None = None  #: what ended it early
    #: kind of mission, of any program, that the aircraft reports; empty when unknown
    kind: str = ""
    index: int | None = None  #: waypoint that it flies to, counted from 0; None when unknown
    status: int | None = None  #: status of the mission as on the wire; None when unknown
    elapsed_s: float = 0.0  #: seconds since it began, until it ended
    distance_m: float | None = None  #: horizontally to that waypoint; None when unknown
    height_m: float | None = None  #: above the take-off point; None when unknown


Value = OrderMessage | OrderReply | Card | MissionCard


@cache
def _fields(kind: Any) -> Fields:
    return Fields(kind, ("signature", "proof") if kind is OrderMessage else ())


def _proof(token: str, data: bytes) -> bytes:
    return hmac.new(token.encode(), data, hashlib.sha256).digest()[:_PROOF]


def to_json(value: Any) -> bytes:
    """A value as JSON; MessageError where it cannot be written."""
    kind: Any = type(value)
    try:
        return write_json(_fields(kind).write(value)).encode()
    except ValueError as error:
        raise MessageError(f"{kind.__name__} cannot be sent: {error}") from None


def value_of(kind: Any, found: object) -> Any:
    """The value that JSON means; MessageError where it is none of that kind."""
    try:
        return _fields(kind).read(found)
    except InvalidValue as error:
        raise MessageError(f"not a {kind.__name__}: {error}") from None


def pack(value: Value | Message) -> bytes:
    """The bytes of a value of a fleet, or of a message of the agent; MessageError for none."""
    if isinstance(value, OrderMessage):
        return b"".join((bytes([VERSION]), value.signature, value.proof, value.document))
    return bytes([VERSION]) + (to_json(value) if isinstance(value, Value) else encode(value))


def body(payload: bytes, most: int = _MOST) -> bytes:
    """The bytes behind the version.

    Raises MessageError: nothing, more than ``most`` bytes, or what another version wrote.
    """
    if not payload or len(payload) > most:
        raise MessageError(f"{len(payload)} bytes are no payload of a fleet")
    if payload[0] != VERSION:
        raise MessageError(
            # Agent and operator both read this sentence: it has no "this side".
            f"version {payload[0]} of the fleet's messages came to a program that reads version "
            f"{VERSION}",
            cause="agent and operator have different releases",
            remedy="install the same release on both",
        )
    return payload[1:]


def unpack(kind: type[Any], payload: bytes) -> Any:
    """The value of these bytes; MessageError for another kind or version."""
    found, begin = body(payload), _SIGNATURE + _PROOF if kind is OrderMessage else 0
    value = value_of(kind, parsed(found[begin:], f"a {kind.__name__}"))
    if kind is not OrderMessage:
        return value
    signature, proof = found[:_SIGNATURE], found[_SIGNATURE:begin]
    return value.sealed(found[begin:], signature=signature, proof=proof)


def unpack_message(payload: bytes) -> Message:
    """The agent's message in these bytes; MessageError for none, or another version."""
    return decode(body(payload))


def pack_steer(steer: Steer, token: str, *, begins: bool) -> bytes:
    """The bytes of a setpoint, with the proof that its sender has the lease."""
    data = bytes([begins]) + encode(steer)
    return bytes([VERSION]) + _proof(token, data) + data


def unpack_steer(
    payload: bytes, token_of: Callable[[int], str | None]
) -> tuple[Steer, bool] | None:
    """The setpoint in these bytes, and whether it begins a stream.

    Returns None when the lease that it names is not proved. Raises MessageError: they are none.

    ``token_of``: secret of the lease of a number; None where none was granted.
    """
    found = body(payload)
    proof, data = found[:_PROOF], found[_PROOF:]
    steer = decode(data[1:])
    if not isinstance(steer, Steer):
        raise MessageError(f"{type(steer).__name__} is no setpoint")
    token = token_of(steer.fence)
    is_proved = token is not None and hmac.compare_digest(proof, _proof(token, data))
    return (steer, data[0] != 0) if is_proved else None


# -- the secret of a lease: its agent and the asker agree it, and neither sends it -----------------
# Everybody on the network may hear both sides. So each side sends a public half and keeps a private
# one: X25519. Every order under the lease carries a proof made with the secret.


class Half:
    """The private half of one side, for one order only."""

    def __init__(self) -> None:
        self._key = X25519PrivateKey.generate()
        self.public = self._key.public_key().public_bytes_raw()

    def secret(self, order: OrderMessage, theirs: bytes, agents: bytes) -> str:
        """Return the secret of the lease that an order asks for, 64 hexadecimal digits.

        ``theirs``: the public half of the other side, 32 bytes. ``agents``: the public half of the
        agent, 32 bytes. Raises MessageError: ``theirs`` is no half of a secret.
        """
        try:
            shared = self._key.exchange(X25519PublicKey.from_public_bytes(theirs))
        except ValueError:
            raise MessageError(
                "a request for a lease, and its answer, have an X25519 public key each",
                cause=f"{len(theirs)} bytes came that are not one",
                remedy="use the same release on both sides",
            ) from None
        return hmac.new(shared, _ABOUT + agents + order.document, hashlib.sha256).hexdigest()


def agree(order: OrderMessage) -> tuple[bytes, str]:
    """Return the agent's side: its public half, for the reply, and the secret."""
    half = Half()
    return half.public, half.secret(order, order.key, half.public)


class LeaseRequest:
    """The asker's side."""

    def __init__(self, order: OrderMessage, half: Half) -> None:
        self.order, self._half = order, half

    def lease(self, reply: OrderReply) -> Lease:
        secret = self._half.secret(self.order, reply.key, reply.key)
        return Lease(reply.text, secret, reply.number)
