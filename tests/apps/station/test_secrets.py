"""No secret leaves a station by its log, at its lowest level, however somebody connects."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import json
import os
import random
import re
import string
import sys
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pytest

pytest.importorskip("nicegui")
pytest.importorskip("starlette")
from websockets.asyncio.client import ClientConnection
from websockets.exceptions import InvalidStatus

from tests.sockets import connect
from tests.waiting import PATIENCE

pytestmark = pytest.mark.anyio

# What a token may be made of: printable ASCII without the characters that it must not have.
_LETTERS = sorted(set(string.printable[:94]) - set(' ";,\\%&+#='))


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"  # processes are not virtual


class Secrets:
    """What a station must not tell, drawn by a seed.

    Attributes:
        all: By their names: those that were drawn, and those that the station gave.
    """

    def __init__(self, seed: int, folder: Path) -> None:
        chance = random.Random(seed)
        self.all = {
            "token": "".join(chance.choices(_LETTERS, k=chance.randint(16, 40))),
            "key": chance.randbytes(32).hex(),
            "signing key": chance.randbytes(32).hex(),
            "wrong token": "".join(chance.choices(_LETTERS, k=20)),
        }
        self.app_id = chance.randint(10**9, 2**32 - 1)
        self._folder = folder

    @property
    def token(self) -> str:
        return self.all["token"]

    def file(self, name: str) -> str:
        path = self._folder / name.replace(" ", "-")
        path.write_text(self.all[name], encoding="ascii")
        path.chmod(0o600)
        return str(path)

    def found_in(self, text: str) -> set[tuple[str, str]]:
        """The secrets that stand there, each with the form in which it does."""
        told = text.lower()
        return {
            (name, form)
            for name, secret in self.all.items()
            for form in forms_of(secret)
            if form.lower() in told
        }


def forms_of(secret: str) -> Iterator[str]:
    """A secret as it is written, quoted for an address or for JSON, in hex and in base64."""
    yield secret
    yield quote(secret)
    yield quote(secret, safe="")
    yield "".join(f"%{one:02x}" for one in secret.encode())
    yield json.dumps(secret)[1:-1]
    yield repr(secret)[1:-1]
    yield secret.encode().hex()
    if re.fullmatch("[0-9a-f]{64}", secret):
        yield repr(bytes.fromhex(secret))[2:-1]
    for begin in range(3):  # wherever in a longer text it began, but for letters at its ends
        told = base64.b64encode(b" " * begin + secret.encode()).decode().rstrip("=")
        yield told[2 * begin : -2]
        yield told[2 * begin : -2].replace("+", "-").replace("/", "_")


class Station:
    """One that runs in processes of its own, with everything that it serves, and its log."""

    def __init__(self, secrets: Secrets, process: asyncio.subprocess.Process) -> None:
        self.secrets, self.process = secrets, process
        self.told: dict[str, Any] = {}
        self.log = ""

    @property
    def console(self) -> str:
        """Host and port."""
        return str(self.told["console"].split("/")[2])

    @property
    def cookie(self) -> str:
        return f"m100link_token={self.secrets.all['cookie']}"

    async def get(self, path: str, *headers: str, server: str = "") -> str:
        """The whole answer to one request."""
        server = server or self.console
        reader, writer = await asyncio.open_connection(*server.split(":"))
        head = [f"GET {path} HTTP/1.1", f"Host: {server}", "Connection: close", *headers]
        writer.write("\r\n".join([*head, "", ""]).encode())
        async with asyncio.timeout(PATIENCE):
            answer = (await reader.read()).decode(errors="replace")
        writer.close()
        return answer


@contextlib.asynccontextmanager
async def station(secrets: Secrets) -> AsyncIterator[Station]:
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-c", "from m100link.apps.cli import main; main()", "console", "--sim"),
        *("--port=0", "--console-port=0", "--foxglove=0", "--metrics=0", "--no-open-browser"),
        *("--json", "--log-level=debug", "--no-record", "--mavlink=udp://127.0.0.1:0"),
        f"--token-file={secrets.file('token')}",
        f"--signing-key-file={secrets.file('signing key')}",
        f"--key-file={secrets.file('key')}",
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        env={**os.environ, "PYTHONUNBUFFERED": "1", "M100LINK_APP_ID": str(secrets.app_id)},
    )
    assert process.stdout is not None
    assert process.stderr is not None
    talk = asyncio.create_task(process.stderr.read())
    one = Station(secrets, process)
    try:
        async with asyncio.timeout(PATIENCE):
            one.told = json.loads(await process.stdout.readline())
        yield one
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.terminate()
        async with asyncio.timeout(PATIENCE):
            await process.wait()
            one.log = (await talk).decode()


async def _hears(url: str, **options: Any) -> None:
    async with connect(url, **options) as socket:
        await _ask(socket)


async def _ask(socket: ClientConnection) -> None:
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(0.3):
            await socket.recv()


async def _refused(url: str, **options: Any) -> None:
    with pytest.raises(InvalidStatus):
        await _hears(url, **options)


async def _come_in_every_way(one: Station) -> None:
    """Every way of the manual, right and wrong, whole and broken off."""
    token, wrong = quote(one.secrets.token, safe=""), quote(one.secrets.all["wrong token"], safe="")
    code = one.told["console"].split("code=")[1]
    one.secrets.all["code"] = code
    opened = await one.get(f"/?code={code}")
    one.secrets.all["cookie"] = re.findall(r"m100link_token=(\w+)", opened)[0]
    assert "303" in await one.get(f"/?token={token}&aircraft=x")
    assert "403" in await one.get(f"/?token={wrong}")
    bearer = f"Authorization: Bearer {one.secrets.token}"
    for path in (f"/nothing/{token}", f"/nothing?token={token}", f"/nothing?x={token}"):
        await one.get(path, bearer)
    for server in (one.console, one.told["metrics"].split("/")[2]):
        for header in (f"Cookie: {one.cookie}", bearer, f"Authorization: Bearer {wrong}"):
            await one.get("/metrics", header, server=server)
    sockets = [*one.told["rosbridge"], one.told["foxglove"]]
    for url in sockets:
        spoken: dict[str, Any] = {}
        if url == one.told["foxglove"]:
            spoken = {"subprotocols": ["foxglove.sdk.v1", "foxglove.websocket.v1"]}
        every = "".join(f"%{letter:02X}" for letter in one.secrets.token.encode())
        await _hears(f"{url}/?token={token}", **spoken)
        await _hears(f"{url}/?token={every}", **spoken)
        for name, value in (("Authorization", bearer[15:]), ("Cookie", one.cookie)):
            await _hears(url, additional_headers={name: value}, **spoken)
        await _refused(f"{url}/?token={wrong}", **spoken)
        # A handshake that is none, and bytes that are not HTTP.
        await one.get(f"/?token={token}", "Upgrade: websocket", bearer, server=url.split("/")[2])
        await one.get(f"/?token={token}", f"{bearer}\r\nbroken {wrong}", server=url.split("/")[2])
        await one.get(f"/{one.secrets.token} no", bearer, server=url.split("/")[2])
    await _fly_a_page(one)
    await _activate(f"{one.told['rosbridge'][0]}/?token={token}")


async def _fly_a_page(one: Station) -> None:
    """The sockets of a page: that of its texts and that which steers."""
    page = await one.get("/", f"Cookie: {one.cookie}")
    key = re.findall(r'steer(?:ing)?-key="([\w-]+)"|start\("([\w-]+)"\)', page)[0]
    client = re.findall(r"client_id\W+([\w-]{20,})", page)[0]
    one.secrets.all |= {"steering key": "".join(key), "client id": client}
    cookie = {"Cookie": one.cookie}
    await _hears(f"ws://{one.console}/steer/{''.join(key)}", additional_headers=cookie)
    await _refused(f"ws://{one.console}/steer/x{''.join(key)}", additional_headers=cookie)
    query = f"EIO=4&transport=websocket&client_id={client}&implicit_handshake=true"
    url = f"ws://{one.console}/_nicegui_ws/socket.io/?{query}"
    async with connect(url, additional_headers=cookie) as socket:
        await _ask(socket)
        await socket.send("40")
        await socket.send(f'42["handshake",{{"client_id":"{client}"}}]')
        await _ask(socket)
        said = {"client_id": client, "level": "error", "message": f"steer/{''.join(key)}"}
        await socket.send(f"42{json.dumps(['log', said])}")
        await _ask(socket)
    await one.get(f"/steer/{''.join(key)}", f"Cookie: {one.cookie}")  # no WebSocket: no such page


async def _activate(url: str) -> None:
    """An activation has the app id; its answer is what the virtual aircraft makes of it."""
    async with connect(url) as socket:
        await socket.send(json.dumps({"op": "call_service", "service": "/dji_sdk/activation"}))
        async with asyncio.timeout(PATIENCE):
            while json.loads(await socket.recv())["op"] != "service_response":
                pass


def command_lines(process: int) -> str:
    """What every user of the machine may read of a process and of its children."""
    found = Path(f"/proc/{process}/cmdline")
    told = [found.read_bytes().decode(errors="replace")] if found.exists() else []
    for children in Path(f"/proc/{process}/task").glob("*/children"):
        told += [command_lines(int(child)) for child in children.read_text().split()]
    return "\n".join(told)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [20261123, 20261124])
async def test_no_secret_stands_in_the_log_at_debug(seed: int, tmp_path: Path) -> None:
    secrets = Secrets(seed, tmp_path)
    async with station(secrets) as one:
        await _come_in_every_way(one)
        assert secrets.found_in(command_lines(one.process.pid)) == set()
    log = one.log
    assert " DEBUG m100link.link.link: > " in log  # it was at its lowest level, and something flew
    assert "activat" in log
    assert secrets.found_in(log) == set()
    assert str(secrets.app_id) not in log
    sent = "\n".join(line for line in log.splitlines() if ": > " in line)
    assert secrets.app_id.to_bytes(4, "little").hex() not in sent


def test_the_forms_of_a_secret_are_found_wherever_they_stand(tmp_path: Path) -> None:
    secrets = Secrets(1, tmp_path)
    token = secrets.token
    for told in (
        f'"WebSocket /?token={quote(token, safe="")}" [accepted]',
        f"authorization: Bearer {token}",
        base64.b64encode(f"user:{token}".encode()).decode(),
        base64.urlsafe_b64encode(f"Bearer {token} and more".encode()).decode(),
        f"bytearray({token.encode()!r})",
        token.encode().hex(),
    ):
        assert {name for name, _ in secrets.found_in(f"before {told} behind")} == {"token"}
    assert secrets.found_in("nothing is logged") == set()
