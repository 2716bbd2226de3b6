"""Flight logs, and files that the bridge makes, for peers to fetch: LOG_* and MAVLink FTP.

All of it is read-only, and no path leads out of the folder of logs. The disk is read in one thread,
a block at a time, each peer has one question of a kind under way, and all streams share one pace: a
flood, or a disk that hangs, costs those that fetch files an answer, and nobody who flies anything.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable, Coroutine, Iterable
from contextlib import suppress
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any

from m100link.apps.agent.client import AgentClient
from m100link.apps.mavlink.translator.codec import MOST_PEERS, Address, MavlinkMessage, Peer
from m100link.errors import UsageError
from m100link.log.folder import LogDirectory, LogEntry

_LOG_DATA = 90  # bytes of LOG_DATA
_AT_ONCE, _PAUSE_S = 48, 0.02  # messages of logs to all peers, and the pause behind: 216 kB/s
_BLOCK = 15 * _AT_ONCE * _LOG_DATA  # bytes that are read at once
_MOST_LOGS = 1000  # that a list names, the newest
_LOOKED_S = 1.0  # seconds for which the folder counts as it was seen
_U32 = 0xFFFFFFFF

_MOST_DATA = 239  # bytes of data in FILE_TRANSFER_PROTOCOL
_BURST = 24  # answers to one BurstReadFile
_MOST_SESSIONS, _SESSIONS_OF_PEER = 16, 4
_REPEATED_S = 2.0  # seconds in which the same question again asks for a lost answer
_IDLE_S = 10.0  # seconds without a question after which a session makes room for another one

Answer = tuple[bytes, int]  # data, and where in the file, or which entry of the folder, they begin


class _Op(IntEnum):
    """MAV_FTP_OPCODE: those that have a meaning here."""

    NONE = 0
    TERMINATE_SESSION = 1
    RESET_SESSIONS = 2
    LIST_DIRECTORY = 3
    OPEN_FILE_RO = 4
    READ_FILE = 5
    CREATE_FILE = 6
    RENAME = 13
    BURST_READ_FILE = 15
    ACK = 128
    NAK = 129


class _Error(IntEnum):
    """MAV_FTP_ERR."""

    INVALID_DATA_SIZE = 3
    INVALID_SESSION = 4
    NO_SESSIONS_AVAILABLE = 5
    END_OF_FILE = 6
    UNKNOWN_COMMAND = 7
    FILE_PROTECTED = 9
    FILE_NOT_FOUND = 10


class _Refused(Exception):
    """Why a question is answered by NAK."""


@dataclass(slots=True)
class _Session:
    peer: Peer
    name: str  # of the file
    used_at: float  # s


@dataclass(slots=True)
class _Transfer:
    number: int  # of the log, in the list of its peer
    at: int
    end: int


class FileService:
    """Answers the questions of known peers.

    ``made``: files that the bridge makes itself, by their path without a slash in front.
    """

    def __init__(
        self,
        folder: Path | None,  # of the flight logs; None where nothing is recorded
        send: Callable[[MavlinkMessage, Peer | tuple[Address, ...]], None],
        agent: AgentClient,  # whose tasks run beside the bridge
    ) -> None:
        self._directory = LogDirectory(folder)
        self._seen: tuple[float, list[LogEntry]] | None = None  # when, s; the oldest first
        self._folders: dict[str, list[bytes]] = {}  # their entries, as they were then
        # Held by the one that reads the disk, and by the one that streams; others wait in a row.
        self._disk, self._pace = asyncio.Lock(), asyncio.Lock()
        self._send, self._agent = send, agent
        # Called with each answer: its peer asks the next question when it has that one.
        self.on_answer: Callable[[], None] = lambda: None
        self.made: dict[str, bytes] = {}
        # The newest list of each peer: numbers of logs are places in it.
        self._lists: dict[Peer, list[LogEntry]] = {}
        self.transfers: dict[Peer, _Transfer] = {}  # parts of logs that are on their way
        self._asking: set[tuple[Peer, str]] = set()  # whose question of which kind is under way
        self._sessions: dict[int, _Session] = {}
        # When each peer asked last, its question and the answers: one that was lost is sent again.
        self._answered: dict[Peer, tuple[float, bytes, list[bytes]]] = {}
        self.handlers: dict[str, Callable[[MavlinkMessage, Peer, float], None]] = {
            "LOG_REQUEST_LIST": self._list_wanted,
            "LOG_REQUEST_DATA": self._data_wanted,
            "LOG_REQUEST_END": lambda _, peer, __: self._end(peer),
            "FILE_TRANSFER_PROTOCOL": self._asked,
        }

    def _ask(self, peer: Peer, kind: str, work: Callable[[], Coroutine[Any, Any, None]]) -> None:
        """Do it beside the bridge, unless this peer has one of the kind under way."""
        asking = peer, kind
        if asking in self._asking:
            return

        async def do() -> None:
            try:
                await work()
            finally:
                self._asking.discard(asking)

        self._asking.add(asking)
        self._agent.background.spawn(do(), f"MAVLink {kind}")

    async def _entries(self) -> list[LogEntry]:
        """The logs, the oldest first."""
        async with self._disk:
            now = asyncio.get_running_loop().time()
            if self._seen is None or now - self._seen[0] >= _LOOKED_S:
                entries, self._folders = await asyncio.to_thread(self._look)
                self._seen = now, entries
            return self._seen[1]

    def _look(self) -> tuple[list[LogEntry], dict[str, list[bytes]]]:
        """The logs, and what ListDirectory says of each folder. Takes as long as the disk."""
        entries = self._directory.entries(_MOST_LOGS)[::-1]
        sizes = {path: len(data) for path, data in self.made.items()}
        sizes |= {f"{_FOLDER}/{entry.log}": entry.size for entry in entries}
        folders: dict[str, list[bytes]] = {"": [], _FOLDER: []}
        for path, size in sizes.items():
            above, _, name = path.rpartition("/")
            folders.setdefault(above, []).append(f"F{name}\t{size}\0".encode())
        for folder in sorted(folders.keys() - {""}, reverse=True):
            above, _, name = folder.rpartition("/")
            folders.setdefault(above, []).insert(0, f"D{name}\0".encode())
        return entries, folders

    async def _piece(self, log: str, at: int, size: int) -> tuple[bytes, int]:
        """Bytes of a log, and its size now. Raises UsageError: it is not there."""
        async with self._disk:
            data, entry = await asyncio.to_thread(self._directory.piece, log, at, size)
        return data, entry.size

    # -- LOG_REQUEST_LIST and the others -----------------------------------------------------------

    def _list_wanted(self, message: MavlinkMessage, peer: Peer, now: float) -> None:
        self._ask(peer, "list of logs", lambda: self._list(message["start"], message["end"], peer))

    async def _listed(self, peer: Peer, *, anew: bool) -> list[LogEntry]:
        if anew or peer not in self._lists:
            self._lists.pop(peer, None)
            self._lists[peer] = await self._entries()
            _forget_oldest(self._lists)
        return self._lists[peer]

    async def _list(self, start: int, end: int, peer: Peer) -> None:
        entries = await self._listed(peer, anew=start == 0)
        found = [
            {
                "id": number,
                "num_logs": len(entries),
                "last_log_num": len(entries) - 1,
                "time_utc": max(0, min(_U32, int(entry.at))),
                "size": min(_U32, entry.size),
            }
            for number, entry in enumerate(entries[start : end + 1], start)
        ]
        # Without an answer programs wait for ever.
        await self._stream("LOG_ENTRY", found if entries else [{}], peer)

    async def _stream(
        self, name: str, messages: list[dict[str, Any]], peer: Peer, wanted: _Transfer | None = None
    ) -> bool:
        """Send at the one pace, at no cost of the peer's reading; False if it is wanted no more."""
        for first in range(0, len(messages), _AT_ONCE):
            some = messages[first : first + _AT_ONCE]
            async with self._pace:
                if wanted is not None and self.transfers.get(peer) is not wanted:
                    return False
                for fields in some:
                    self._send(MavlinkMessage(name, fields), (peer.address,))
                await asyncio.sleep(_PAUSE_S * len(some) / _AT_ONCE)
        return True

    def _data_wanted(self, message: MavlinkMessage, peer: Peer, now: float) -> None:
        begin, number = message["ofs"], message["id"]
        # The newest request replaces the one before it.
        self.transfers[peer] = _Transfer(number, begin, min(_U32, begin + message["count"]))
        self._ask(peer, "log", lambda: self._transfer(peer))

    def _end(self, peer: Peer) -> None:
        self.transfers.pop(peer, None)

    def forget_gone(self, present: Iterable[tuple[Peer, ...]]) -> None:
        """Send no more of a log to a peer that has gone; ``present``: the others, by address."""
        there = {peer for peers in present for peer in peers}
        for peer in self.transfers.keys() - there:
            self._end(peer)

    async def _transfer(self, peer: Peer) -> None:
        """Send the part that the peer wants, until it wants no more."""
        entries = await self._listed(peer, anew=False)
        while (wanted := self.transfers.get(peer)) is not None:
            data, size, begin = b"", min(_BLOCK, wanted.end - wanted.at), wanted.at
            if wanted.number < len(entries):
                with suppress(UsageError):  # it made room for a newer one: that is its end
                    data, _ = await self._piece(entries[wanted.number].log, begin, size)
            parts = [data[at : at + _LOG_DATA] for at in range(0, len(data) or 1, _LOG_DATA)]
            messages = [
                {"id": wanted.number, "ofs": begin + at * _LOG_DATA, "count": len(one), "data": one}
                for at, one in enumerate(parts)
            ]
            wanted.at += len(data)
            is_last = len(data) < size or wanted.at >= wanted.end
            is_sent = await self._stream("LOG_DATA", messages, peer, wanted)
            if is_sent and is_last and self.transfers.get(peer) is wanted:
                self._end(peer)

    # -- MAVLink FTP -------------------------------------------------------------------------------

    def _asked(self, message: MavlinkMessage, peer: Peer, now: float) -> None:
        question = bytes(message["payload"])
        at, known, answers = self._answered.get(peer, (now, b"", []))
        if question == known and now - at < _REPEATED_S:
            self._tell(answers, peer)
        else:
            self._ask(peer, "file transfer", lambda: self._answer(question, peer, now))

    def _tell(self, answers: list[bytes], peer: Peer) -> None:
        for one in answers:
            fields = {"payload": one} | peer.target
            self._send(MavlinkMessage("FILE_TRANSFER_PROTOCOL", fields), peer)

    async def _answer(self, question: bytes, peer: Peer, now: float) -> None:
        session, op = question[2], question[3]
        found: list[Answer]
        try:
            session, found = await self._found(question, peer, now)
            packed = [(_Op.ACK, *one) for one in found]
        except _Refused as refused:
            packed = [(_Op.NAK, bytes(refused.args), int.from_bytes(question[8:12], "little"))]
        answers = []
        for number, (kind, data, at) in enumerate(packed, 1):
            sequence = int.from_bytes(question[:2], "little") + number & 0xFFFF
            is_last = op == _Op.BURST_READ_FILE and number == len(packed)
            head = bytes((session, kind, len(data), op, is_last, 0))
            answers.append(sequence.to_bytes(2, "little") + head + at.to_bytes(4, "little") + data)
        self._answered.pop(peer, None)
        self._answered[peer] = now, question, answers
        _forget_oldest(self._answered)
        self._tell(answers, peer)
        self.on_answer()

    async def _found(self, question: bytes, peer: Peer, now: float) -> tuple[int, list[Answer]]:
        """The session, and the answers. Raises _Refused: there is none."""
        session, op, size = question[2:5]
        at, data = int.from_bytes(question[8:12], "little"), question[12 : 12 + size]
        if size > _MOST_DATA:
            raise _Refused(_Error.INVALID_DATA_SIZE)
        if op == _Op.NONE:
            return session, [(b"", 0)]
        if op == _Op.RESET_SESSIONS:
            self._sessions = {key: one for key, one in self._sessions.items() if one.peer != peer}
            return session, [(b"", 0)]
        if op == _Op.LIST_DIRECTORY:
            return session, [(await self._names(_path(data), at), at)]
        if op == _Op.OPEN_FILE_RO:
            name = _path(data)
            _, length = await self._read(name, 0, 0)
            return self._opened(peer, name, now), [(min(_U32, length).to_bytes(4, "little"), 0)]
        if op in (_Op.TERMINATE_SESSION, _Op.READ_FILE, _Op.BURST_READ_FILE):
            return session, await self._of_session(session, op, at, size, peer, now)
        is_written = _Op.CREATE_FILE <= op <= _Op.RENAME
        raise _Refused(_Error.FILE_PROTECTED if is_written else _Error.UNKNOWN_COMMAND)

    async def _of_session(
        self, session: int, op: int, at: int, size: int, peer: Peer, now: float
    ) -> list[Answer]:
        opened = self._sessions.get(session)
        if opened is None or opened.peer != peer:
            raise _Refused(_Error.INVALID_SESSION)
        if op == _Op.TERMINATE_SESSION:
            del self._sessions[session]
            return [(b"", 0)]
        opened.used_at = now
        step = size or _MOST_DATA
        count = _BURST if op == _Op.BURST_READ_FILE else 1
        data, _ = await self._read(opened.name, at, count * step)
        if not data:
            raise _Refused(_Error.END_OF_FILE)
        return [(data[one : one + step], at + one) for one in range(0, len(data), step)]

    def _opened(self, peer: Peer, name: str, now: float) -> int:
        sessions = self._sessions
        theirs = [key for key, one in sessions.items() if one.peer == peer]
        if len(sessions) >= _MOST_SESSIONS or len(theirs) >= _SESSIONS_OF_PEER:
            among = theirs if len(theirs) >= _SESSIONS_OF_PEER else [*sessions]
            held = Counter(one.peer for one in sessions.values())
            free = [
                key
                for key in among
                if now - sessions[key].used_at >= _IDLE_S
                or held[sessions[key].peer] > len(theirs) + 1  # a greedy one's, for one with fewer
            ]
            if not free:
                raise _Refused(_Error.NO_SESSIONS_AVAILABLE)
            del sessions[min(free, key=lambda key: sessions[key].used_at)]
        number = next(key for key in range(_MOST_SESSIONS) if key not in sessions)
        sessions[number] = _Session(peer, name, now)
        return number

    async def _read(self, name: str, at: int, size: int) -> Answer:
        """Bytes of a file, and its size. Raises _Refused: there is none."""
        if name in self.made:
            return self.made[name][at : at + size], len(self.made[name])
        folder, _, log = name.partition("/")
        with suppress(UsageError):  # it is none of ours, or is gone
            if folder == _FOLDER:
                return await self._piece(log, at, size)
        raise _Refused(_Error.FILE_NOT_FOUND)

    async def _names(self, name: str, first: int) -> bytes:
        """Entries of a folder from one on, as many as fit. Raises _Refused: there are none."""
        await self._entries()
        if name not in self._folders:
            raise _Refused(_Error.FILE_NOT_FOUND)
        data = b""
        for entry in self._folders[name][first : first + _MOST_DATA]:
            if len(data) + len(entry) > _MOST_DATA:
                break
            data += entry
        if not data:
            raise _Refused(_Error.END_OF_FILE)
        return data


_FOLDER = "log"  # where the flight logs are, for peers


def _path(data: bytes) -> str:
    """A path without the slashes that mean nothing. Raises _Refused: it may lead somewhere else."""
    text = data.split(b"\0", 1)[0].decode(errors="replace")  # no file of ours has other letters
    parts = [one for one in text.split("/") if one not in ("", ".")]
    if ".." in parts:
        raise _Refused(_Error.FILE_NOT_FOUND)
    return "/".join(parts)


def _forget_oldest(table: dict[Peer, Any]) -> None:
    while len(table) > 2 * MOST_PEERS:
        del table[next(iter(table))]
