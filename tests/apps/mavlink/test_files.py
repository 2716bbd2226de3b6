"""Flight logs and files over MAVLink: what the definitions ask for, and nothing outside of them."""

from __future__ import annotations

import asyncio
import os
import struct
from collections.abc import AsyncIterator, Coroutine
from pathlib import Path
from random import Random
from types import SimpleNamespace
from typing import Any

import anyio
import pytest

from m100link.apps.mavlink import files
from m100link.apps.mavlink.files import FileService
from m100link.apps.mavlink.translator.codec import MavlinkMessage, Peer
from m100link.log.folder import LogDirectory, LogEntry
from tests.apps.mavlink.conftest import Ground, Rig

pytestmark = pytest.mark.anyio

OLD, NEW = "m100link-20260101-000000.mcap", "m100link-20260101-000001.mcap"
SIZES = {OLD: 46_170, NEW: 130_003}  # of the first, an even number of messages of LOG_DATA

# Codes of MAV_FTP_OPCODE and MAV_FTP_ERR.
TERMINATE, RESET, LIST, OPEN, READ, CREATE, WRITE, BURST, ACK, NAK = (
    1,
    2,
    3,
    4,
    5,
    6,
    7,
    15,
    128,
    129,
)
FTP = "FILE_TRANSFER_PROTOCOL"
SESSION, NO_SESSIONS, EOF, UNKNOWN, PROTECTED, NOT_FOUND = 4, 5, 6, 7, 9, 10


def content(name: str) -> bytes:
    return Random(name).randbytes(SIZES[name])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    logs = tmp_path / "flights"
    logs.mkdir()
    for at, name in enumerate(SIZES):
        (logs / name).write_bytes(content(name))
        os.utime(logs / name, (1_700_000_000 + at, 1_700_000_000 + at))
    (logs / "notes.txt").write_text("theirs")
    (tmp_path / NEW).write_bytes(b"secret")
    (logs / "m100link-20260101-000002.mcap").symlink_to(tmp_path / NEW)
    return logs


@pytest.fixture
async def rig(folder: Path) -> AsyncIterator[Rig]:
    async with Rig(logs=folder).running() as one:
        yield one


async def wait(rig: Rig, ground: Ground, name: str, count: int) -> list[MavlinkMessage]:
    await rig.until(lambda: len(ground.all(name)) >= count)
    return ground.all(name)


# -- LOG_REQUEST_LIST and LOG_REQUEST_DATA ---------------------------------------------------------


async def test_the_logs_are_listed_with_time_and_size(rig: Rig, ground: Ground) -> None:
    ground.send("LOG_REQUEST_LIST", target_system=1, target_component=1, end=0xFFFF)
    entries = await wait(rig, ground, "LOG_ENTRY", 2)
    assert [dict(one.fields) for one in entries] == [
        {"id": 0, "num_logs": 2, "last_log_num": 1, "time_utc": 1_700_000_000, "size": SIZES[OLD]},
        {"id": 1, "num_logs": 2, "last_log_num": 1, "time_utc": 1_700_000_001, "size": SIZES[NEW]},
    ]
    ground.send("LOG_REQUEST_LIST", target_system=1, target_component=1, start=1, end=1)
    await anyio.sleep(1.0)
    assert [one["id"] for one in ground.all("LOG_ENTRY")] == [0, 1, 1]


async def test_where_nothing_is_recorded_the_list_is_empty_at_once() -> None:
    async with Rig().running() as rig:
        rig.ground.send("LOG_REQUEST_LIST", target_system=1, target_component=1, end=0xFFFF)
        [entry] = await wait(rig, rig.ground, "LOG_ENTRY", 1)
        assert (entry["id"], entry["num_logs"]) == (0, 0)


@pytest.mark.parametrize(
    ("number", "begin", "count", "expected"),
    [
        (0, 0, 90, content(OLD)[:90]),
        (0, 0, 0xFFFFFFFF, content(OLD)),
        (1, 0, 0xFFFFFFFF, content(NEW)),
        (1, 46_080, 46_080, content(NEW)[46_080:92_160]),  # a chunk of MAVSDK
        (1, 130_000, 90, content(NEW)[-3:]),
        (1, 130_003, 90, b""),
        (1, 0xFFFFFFFF, 0xFFFFFFFF, b""),
        (0, 10, 0, b""),
        (2, 0, 90, b""),  # there is none
        (0xFFFF, 0, 90, b""),
    ],
)
async def test_a_part_of_a_log_comes_whole(
    rig: Rig, ground: Ground, number: int, begin: int, count: int, expected: bytes
) -> None:
    asked = {"id": number, "ofs": begin, "count": count}
    ground.send("LOG_REQUEST_DATA", target_system=1, target_component=1, **asked)
    await wait(rig, ground, "LOG_DATA", max(1, -(-len(expected) // 90)))
    await anyio.sleep(0.5)
    got, parts = b"", ground.all("LOG_DATA")
    for one in parts:
        assert (one["id"], one["ofs"]) == (number, begin + len(got))
        assert one["count"] == 90 or one is parts[-1]
        got += bytes(one["data"][: one["count"]])
    assert got == expected


async def test_a_new_request_replaces_the_one_before_and_an_end_ends_it(
    rig: Rig, ground: Ground
) -> None:
    for begin in (0, 90_000):
        asked = {"id": 1, "ofs": begin, "count": 40_003}
        ground.send("LOG_REQUEST_DATA", target_system=1, target_component=1, **asked)
    await rig.until(lambda: any(one["ofs"] + 90 > 130_000 for one in ground.all("LOG_DATA")))
    assert {one["ofs"] >= 90_000 for one in ground.all("LOG_DATA")} == {True}
    ground.send("LOG_REQUEST_DATA", target_system=1, target_component=1, id=1, count=130_003)
    await rig.until(lambda: any(one["ofs"] == 0 for one in ground.all("LOG_DATA")))
    ground.send("LOG_REQUEST_END", target_system=1, target_component=1)
    count = len(ground.all("LOG_DATA"))
    await anyio.sleep(2.0)
    assert len(ground.all("LOG_DATA")) - count <= 48


async def test_a_log_takes_no_more_of_the_network_than_its_pace(rig: Rig, ground: Ground) -> None:
    ground.send("LOG_REQUEST_DATA", target_system=1, target_component=1, id=1, count=130_003)
    await wait(rig, ground, "LOG_DATA", 1)
    before = len(ground.all("LOG_DATA"))
    await anyio.sleep(0.2)
    assert 90 * (len(ground.all("LOG_DATA")) - before) <= 60_000  # 216 kB/s
    # and it answers and flies meanwhile
    ground.send("PING", seq=7)
    assert ground.last("PING")["seq"] == 7


async def test_a_log_that_grows_is_sent_to_where_it_ends_then(rig: Rig, folder: Path) -> None:
    ground = rig.ground
    to = {"target_system": 1, "target_component": 1}
    ground.send("LOG_REQUEST_DATA", **to, id=1, count=0xFFFFFFFF)
    await wait(rig, ground, "LOG_DATA", 10)
    with (folder / NEW).open("ab") as log:
        log.write(b"more")
    await rig.until(lambda: ground.last("LOG_DATA")["count"] < 90)
    found = {one["ofs"]: bytes(one["data"])[: one["count"]] for one in ground.all("LOG_DATA")}
    assert b"".join(found[at] for at in sorted(found)) == content(NEW) + b"more"
    for at in (130_007, 0xFFFFFFFF):  # behind its end
        ground.heard.clear()
        ground.send("LOG_REQUEST_DATA", **to, id=1, ofs=at, count=90)
        (one,) = await wait(rig, ground, "LOG_DATA", 1)
        assert (one["ofs"], one["count"]) == (at, 0)


async def test_a_log_is_sent_no_further_to_a_peer_that_has_gone(folder: Path) -> None:
    (folder / NEW).write_bytes(bytes(4_000_000))
    async with Rig(logs=folder).running() as rig:
        ground = rig.ground
        ground.send("LOG_REQUEST_DATA", target_system=1, target_component=1, id=1, count=4_000_000)
        ground.is_silent = True
        await anyio.sleep(11.0)
        count = len(ground.all("LOG_DATA"))
        assert count < 11 * 2500
        await anyio.sleep(5.0)
        assert len(ground.all("LOG_DATA")) == count


async def test_logs_are_not_erased(rig: Rig, ground: Ground, folder: Path) -> None:
    ground.send("LOG_ERASE", target_system=1, target_component=1)
    await rig.until(lambda: "logs are not erased" in ground.texts)
    assert (folder / OLD).exists()


async def test_a_stranger_without_a_heartbeat_gets_nothing(rig: Rig) -> None:
    stranger = Ground(rig, ("127.0.0.1", 9), 77)
    stranger.is_silent = True
    stranger.send("LOG_REQUEST_LIST", target_system=1, target_component=1, end=0xFFFF)
    stranger.send("LOG_REQUEST_DATA", target_system=1, target_component=1, count=90)
    await anyio.sleep(1.0)
    assert stranger.heard == []


# -- MAVLink FTP -----------------------------------------------------------------------------------


class Client:
    """A reader of FILE_TRANSFER_PROTOCOL by its definition."""

    def __init__(self, rig: Rig, ground: Ground) -> None:
        self.rig, self.ground = rig, ground
        self.sequence = 0

    def send(
        self, op: int, data: bytes = b"", *, session: int = 0, at: int = 0, size: int | None = None
    ) -> None:
        self.sequence += 2
        length = len(data) if size is None else size
        head = struct.pack("<H6BI", self.sequence, session, op, length, 0, 0, 0, at)
        self.again(head + data)

    def again(self, payload: bytes) -> None:
        self.payload = payload
        fields = {"target_system": 1, "target_component": 1, "payload": tuple(payload)}
        self.ground.send("FILE_TRANSFER_PROTOCOL", **fields)

    async def answers(self, count: int = 1) -> list[tuple[int, int, int, bytes, int, int]]:
        """Sequence, session, ACK or NAK, data, offset and whether a burst is over."""
        known = len(self.ground.all("FILE_TRANSFER_PROTOCOL"))
        await self.rig.until(
            lambda: len(self.ground.all("FILE_TRANSFER_PROTOCOL")) >= known + count
        )
        found = []
        for one in self.ground.all("FILE_TRANSFER_PROTOCOL")[known:]:
            assert (one["target_system"], one["target_component"]) == (self.ground.system, 190)
            payload = bytes(one["payload"])
            sequence, session, op, size, asked, over, _, at = struct.unpack_from("<H6BI", payload)
            assert asked == self.payload[3]
            found.append((sequence, session, op, payload[12 : 12 + size], at, over))
        return found

    async def ask(self, op: int, data: bytes = b"", **more: int) -> tuple[int, bytes, int]:
        """ACK or NAK, data and session."""
        self.send(op, data, **more)
        [(sequence, session, answer, found, *_)] = await self.answers()
        assert sequence == self.sequence + 1
        return answer, found, session


@pytest.fixture
def ftp(rig: Rig, ground: Ground) -> Client:
    return Client(rig, ground)


async def test_folders_are_listed_from_any_entry(rig: Rig, ftp: Client) -> None:
    rig.vehicle.files.made = {"extras/general.json": b"{}"}
    assert await ftp.ask(LIST, b"/") == (ACK, b"Dextras\0Dlog\0", 0)
    assert await ftp.ask(LIST, b"/extras\0") == (ACK, b"Fgeneral.json\t2\0", 0)
    logs = [f"F{name}\t{SIZES[name]}\0".encode() for name in (OLD, NEW)]
    assert await ftp.ask(LIST, b"log/") == (ACK, b"".join(logs), 0)
    assert await ftp.ask(LIST, b"//./log", at=1) == (ACK, logs[1], 0)
    assert await ftp.ask(LIST, b"/log", at=2) == (NAK, bytes([EOF]), 0)
    assert await ftp.ask(LIST, b"/etc") == (NAK, bytes([NOT_FOUND]), 0)
    long = [f"F{letter * 100}\t7\0".encode() for letter in "abc"]  # 239 bytes hold two of them
    rig.vehicle.files._folders["long"] = long
    assert await ftp.ask(LIST, b"/long") == (ACK, b"".join(long[:2]), 0)


@pytest.mark.parametrize("name", [f"/log/{NEW}", "general.json"])
async def test_a_file_is_read_by_pieces_and_by_bursts(rig: Rig, ftp: Client, name: str) -> None:
    rig.vehicle.files.made["general.json"] = content(NEW)
    answer, size, session = await ftp.ask(OPEN, name.encode())
    assert (answer, size) == (ACK, SIZES[NEW].to_bytes(4, "little"))
    assert await ftp.ask(READ, session=session, at=100, size=50) == (
        *(ACK, content(NEW)[100:150], session),
    )
    end, past = (NAK, bytes([EOF]), session), SIZES[NEW]
    assert (await ftp.ask(READ, session=session, at=past - 5, size=239))[1] == content(NEW)[-5:]
    assert await ftp.ask(READ, session=session, at=past, size=9) == end
    got = b""
    while len(got) < SIZES[NEW]:
        ftp.send(BURST, session=session, at=len(got), size=239)
        count = min(24, -(-(SIZES[NEW] - len(got)) // 239))
        for number, one in enumerate(await ftp.answers(count), 1):
            assert one == (
                *(ftp.sequence + number, session, ACK),
                *(content(NEW)[len(got) : len(got) + 239], len(got), number == count),
            )
            got += one[3]
    assert await ftp.ask(BURST, session=session, at=len(got), size=239) == end
    assert (await ftp.ask(TERMINATE, session=session))[0] == ACK
    assert await ftp.ask(READ, session=session, size=9) == (NAK, bytes([SESSION]), session)


@pytest.mark.parametrize(
    "path",
    [
        *("../" + NEW, f"log/../../{NEW}", f"/log/../{NEW}", "log/..", "/log/notes.txt", "log"),
        *("/log/m100link-20260101-000002.mcap", f"/log//etc/{NEW}", "/etc/passwd", "", "\udcff"),
        *("log\\..\\" + NEW, f"log/{NEW}x", f"log/%2e%2e/{NEW}", "/proc/self/mem", "x" * 239),
    ],
)
async def test_no_path_leads_out_of_the_folder(ftp: Client, path: str) -> None:
    data = path.encode("utf-8", "surrogateescape")
    assert await ftp.ask(OPEN, data) == (NAK, bytes([NOT_FOUND]), 0)
    if ".." in path.split("/"):
        with pytest.raises(files._Refused):
            files._path(data)
    if path not in ("log", ""):
        assert await ftp.ask(LIST, data) == (NAK, bytes([NOT_FOUND]), 0)


@pytest.mark.parametrize("op", range(6, 14))
async def test_nothing_is_written(ftp: Client, folder: Path, op: int) -> None:
    assert await ftp.ask(op, f"/log/{OLD}".encode()) == (NAK, bytes([PROTECTED]), 0)
    assert (folder / OLD).read_bytes() == content(OLD)


async def test_what_means_nothing_is_refused(ftp: Client) -> None:
    assert await ftp.ask(14, f"/log/{OLD}".encode()) == (NAK, bytes([UNKNOWN]), 0)
    assert await ftp.ask(200) == (NAK, bytes([UNKNOWN]), 0)
    assert await ftp.ask(LIST, b"/", size=240) == (NAK, bytes([3]), 0)
    assert (await ftp.ask(0))[0] == ACK


async def test_the_number_of_an_answer_wraps(ftp: Client) -> None:
    ftp.sequence = 0xFFFD
    ftp.send(0)
    [(sequence, *_)] = await ftp.answers()
    assert sequence == 0


async def test_a_question_that_is_repeated_gets_the_same_answer(ftp: Client) -> None:
    ftp.send(OPEN, f"/log/{OLD}".encode())
    first = await ftp.answers()
    ftp.again(ftp.payload)
    await anyio.sleep(0.1)
    assert [one.fields["payload"][2] for one in ftp.ground.all("FILE_TRANSFER_PROTOCOL")] == [
        *(first[0][1], first[0][1])
    ]


async def test_sessions_of_a_peer_that_is_greedy_are_few_and_its_own(rig: Rig, ftp: Client) -> None:
    opened = [(await ftp.ask(OPEN, f"/log/{OLD}".encode())) for _ in range(6)]
    assert [one[0] for one in opened] == [ACK] * 4 + [NAK] * 2
    assert opened[-1][1] == bytes([NO_SESSIONS])
    other = Ground(rig, ("127.0.0.1", 9), 77)
    other.beat()
    theirs = Client(rig, other)
    answer, _, session = await theirs.ask(OPEN, f"/log/{NEW}".encode())
    assert answer == ACK
    assert await ftp.ask(READ, session=session, size=9) == (NAK, bytes([SESSION]), session)
    assert await ftp.ask(TERMINATE, session=session) == (NAK, bytes([SESSION]), session)
    assert (await ftp.ask(RESET))[0] == ACK
    assert (await theirs.ask(READ, session=session, size=9))[1] == content(NEW)[:9]
    assert (await ftp.ask(OPEN, f"/log/{OLD}".encode()))[0] == ACK


async def test_sessions_that_nobody_uses_make_room(rig: Rig, ftp: Client) -> None:
    for _ in range(4):
        assert (await ftp.ask(OPEN, f"/log/{OLD}".encode()))[0] == ACK
    await anyio.sleep(11.0)
    for number in range(4):
        ground = Ground(rig, ("127.0.0.1", 20 + number), 20 + number)
        ground.beat()
        client = Client(rig, ground)
        for _ in range(4):
            assert (await client.ask(OPEN, f"/log/{OLD}".encode()))[0] == ACK
    # Of sixteen in use, a peer with fewer gets those of the greedy: nobody keeps it out.
    opened = [(await ftp.ask(OPEN, f"/log/{OLD}".encode())) for _ in range(4)]
    assert [one[0] for one in opened] == [ACK] * 3 + [NAK]
    assert opened[3][1] == bytes([NO_SESSIONS])


# -- drawn questions of two peers ------------------------------------------------------------------

PATHS = [
    b"",
    b"/",
    b"log",
    b"/log/",
    b"../log",
    b"log/../../x",
    b"/log/\0x",
    b"\xff/",
    b"log/" * 59,
]
PATHS += [f"/log/{name}".encode() for name in (*SIZES, "notes.txt", ".")]


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(one, marks=pytest.mark.slow) for one in range(1, 40))]
)
async def test_drawn_questions_get_their_bytes_or_a_refusal(
    rig: Rig, ground: Ground, caplog: pytest.LogCaptureFixture, seed: int
) -> None:
    """Whatever two peers ask at once: no byte of another file, no error, and a pace that holds."""
    random, to = Random(seed), {"target_system": 1, "target_component": 1}
    other = Ground(rig, ("127.0.0.1", 9), 77)
    other.beat()
    clients = [Client(rig, ground), Client(rig, other)]
    places = (0, 1, 238, 239, 46_169, 46_170, 130_002, 130_003, 2**31, 2**32 - 1)
    for _ in range(300):
        one = random.choice(clients)
        at, number = random.choice(places), random.choice((0, 1, 2, 3, 0xFFFF))
        if random.random() < 0.6:
            size = random.choice((None, None, 0, 1, 239, 240, 255))
            data = random.choice((*PATHS, random.randbytes(random.randrange(100))))
            ops = (random.randrange(256), TERMINATE, RESET, LIST, OPEN, OPEN, READ, READ, BURST)
            session = random.choice((0, 1, 2, 3, 15, 255))
            one.send(random.choice(ops), data, session=session, at=at, size=size)
        elif random.random() < 0.5:
            count = random.choice((0, 1, 90, 5000, 2**32 - 1))
            one.ground.send("LOG_REQUEST_DATA", **to, id=number, ofs=at, count=count)
        else:
            one.ground.send("LOG_REQUEST_LIST", **to, start=number, end=random.choice((0, 1, 9)))
        await anyio.sleep(random.choice((0.0, 0.001, 0.02, 0.1)))
    await anyio.sleep(2.0)
    for message in [*ground.all("LOG_DATA"), *other.all("LOG_DATA")]:
        begin, count = message["ofs"], message["count"]
        whole = content([OLD, NEW][message["id"]]) if message["id"] < 2 else b""
        assert bytes(message["data"])[:count] == whole[begin : begin + count]
    for message in [*ground.all(FTP), *other.all(FTP)]:
        _, _, kind, size, op, _, _, at = struct.unpack_from("<H6BI", bytes(message["payload"]))
        data = bytes(message["payload"])[12 : 12 + size]
        if kind == ACK and op in (READ, BURST):
            assert data in [content(name)[at : at + size] for name in SIZES]
        assert b"secret" not in data
    assert len(rig.vehicle.files._sessions) <= 8
    assert [one for one in caplog.records if one.levelname == "ERROR"] == []
    clients[0].send(RESET)
    assert (await clients[0].answers())[-1][2] == ACK


# -- sixteen peers at once -------------------------------------------------------------------------


def peers(rig: Rig) -> list[Ground]:
    """The most that there may be, one of them the rig's own."""
    others = [Ground(rig, ("127.0.0.1", 20 + number), 20 + number) for number in range(15)]
    for one in others:
        one.beat()
    return [rig.ground, *others]


async def test_logs_leave_at_one_pace_whoever_fetches_them(folder: Path) -> None:
    """Sixteen peers with a pace each took a third of a processor from the loop that flies."""
    (folder / NEW).write_bytes(bytes(4_000_000))
    async with Rig(logs=folder).running() as rig:
        everybody = peers(rig)
        to = {"target_system": 1, "target_component": 1}
        for one in everybody:
            one.send("LOG_REQUEST_DATA", **to, id=1, count=4_000_000)
            one.send("LOG_REQUEST_LIST", **to, end=0xFFFF)
        await anyio.sleep(2.0)
        got = [len(one.all("LOG_DATA")) for one in everybody]
        assert sum(got) * 90 <= 2.1 * 216_000
        assert min(got) >= 2 * 48  # each has its turn; how often, depends on when it asked


@pytest.mark.slow
async def test_a_folder_of_ten_thousand_logs_is_seen_to_its_newest_thousand(tmp_path: Path) -> None:
    """A question costs the loop that flies the entries of its answer, and no look at them all."""
    for number in range(10_000):
        (tmp_path / f"m100link-20260101-{number:06d}.mcap").touch()
    looks = 0
    entries = LogDirectory.entries

    class Counted(LogDirectory):
        def entries(self, most: int | None = None) -> list[LogEntry]:
            nonlocal looks
            looks += 1
            return entries(self, most)

    async with Rig(logs=tmp_path).running() as rig:
        rig.vehicle.files._directory = Counted(tmp_path)
        clients = [Client(rig, one) for one in peers(rig)]
        _, first, _ = await clients[0].ask(LIST, b"/log")
        _, last, _ = await clients[0].ask(LIST, b"/log", at=999)
        assert first.startswith(b"Fm100link-20260101-009000.mcap\t0\0")
        assert last == b"Fm100link-20260101-009999.mcap\t0\0"
        for number in range(100):
            for one in clients:
                one.send(LIST, b"/log", at=number)
            await anyio.sleep(0.02)
        assert looks <= 4  # a second each


# -- a disk that hangs -----------------------------------------------------------------------------


async def test_a_disk_that_hangs_costs_its_peer_an_answer_and_nothing_else(folder: Path) -> None:
    """A thousand questions of a peer wait in one thread, and others are answered."""
    peer = Peer(("127.0.0.1", 5), 245, 190)
    begun = 0
    tasks: set[asyncio.Future[None]] = set()
    stuck = asyncio.Event()

    class Stuck(FileService):
        async def _piece(self, log: str, at: int, size: int) -> tuple[bytes, int]:
            nonlocal begun
            begun += 1
            await stuck.wait()
            return b"", 0

    def spawn(work: Coroutine[Any, Any, None], name: str) -> None:
        tasks.add(asyncio.ensure_future(work))

    agent: Any = SimpleNamespace(background=SimpleNamespace(spawn=spawn))
    service = Stuck(folder, lambda *_: None, agent)
    for number in range(1000):
        fields = {"id": 0, "ofs": 0, "count": 90}
        service.handlers["LOG_REQUEST_DATA"](MavlinkMessage("LOG_REQUEST_DATA", fields), peer, 0.0)
        payload = struct.pack("<H6BI", number, 0, OPEN, 5, 0, 0, 0, 0) + f"log/{OLD}".encode()
        asked = {"payload": tuple(payload.ljust(251, b"\0"))}
        service.handlers["FILE_TRANSFER_PROTOCOL"](
            MavlinkMessage("FILE_TRANSFER_PROTOCOL", asked), peer, 0.0
        )
    for _ in range(20):
        await asyncio.sleep(0.1)
    assert begun <= 2
    assert len(tasks) == 2
    stuck.set()
    await asyncio.gather(*tasks)
