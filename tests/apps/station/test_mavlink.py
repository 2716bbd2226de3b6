"""MAVLink of the station: what is kept of signatures while it serves, over a socket."""

from __future__ import annotations

import asyncio
import json
import logging
import socket
from contextlib import AsyncExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from m100link.apps.mavlink.bridge import signature_time
from m100link.apps.mavlink.translator.codec import MavlinkMessage, PacketSigner, write_frame
from m100link.apps.station.config import Settings
from m100link.apps.station.mavlink import prepare, serving_mavlink
from m100link.errors import UsageError
from tests.waiting import PATIENCE

KEY = bytes(range(32))
PING = MavlinkMessage("PING", {}, component=190)


@pytest.fixture
def settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Settings:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    key = tmp_path / "key"
    key.write_text(KEY.hex())
    key.chmod(0o600)
    return Settings(mavlink=("udp://127.0.0.1:0",), signing_key_file=key)


async def served(settings: Settings, *frames: bytes) -> int:
    """Serve, send, and end. Returns how many were refused."""
    async with AsyncExitStack() as stack:
        [bound] = sockets = prepare(stack, settings)
        bridge = await stack.enter_async_context(serving_mavlink({}, settings, sockets))
        signer: Any = bridge._signer
        before = dict(signer.newest)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
            for frame in frames:
                one.sendto(frame, bound.getsockname())
        async with asyncio.timeout(PATIENCE):
            while not signer.refused and before == signer.newest:  # noqa: ASYNC110 - a socket
                await asyncio.sleep(0.01)
        return int(signer.refused)


def test_what_was_recorded_is_refused_at_the_next_start(settings: Settings, tmp_path: Path) -> None:
    recorded = write_frame(
        PING, system=245, sequence=0, signer=PacketSigner(KEY), now=signature_time()
    )
    assert asyncio.run(served(settings, recorded)) == 0
    [file] = (tmp_path / "m100link" / "mavlink").iterdir()
    assert list(json.loads(file.read_text())["newest"]) == ["245.190.0"]
    assert asyncio.run(served(settings, recorded)) == 1


def test_what_came_before_it_serves_is_not_obeyed(settings: Settings) -> None:
    """Who sent a command while nobody listened does not expect it to be flown now."""

    async def served_late() -> list[Any]:
        async with AsyncExitStack() as stack:
            [bound] = sockets = prepare(stack, settings)
            one = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))

            def send(component: int) -> None:
                ping = replace(PING, component=component)
                signer, now = PacketSigner(KEY), signature_time()
                frame = write_frame(ping, system=245, sequence=0, signer=signer, now=now)
                one.sendto(frame, bound.getsockname())

            send(190)
            bridge = await stack.enter_async_context(serving_mavlink({}, settings, sockets))
            signer: Any = bridge._signer
            send(191)
            async with asyncio.timeout(PATIENCE):
                while not signer.newest:  # noqa: ASYNC110 - a socket
                    await asyncio.sleep(0.01)
            return list(signer.newest)

    [(system, component, *_)] = asyncio.run(served_late())
    assert (system, component) == (245, 191)


@pytest.mark.parametrize("field", ["mavlink", "mavlink_to"])
@pytest.mark.parametrize("host", ["127.0.0.1", "0.0.0.0", "192.0.2.7"])
def test_no_other_machine_is_let_in_or_sent_to_unsigned(field: str, host: str) -> None:
    address: dict[str, Any] = {field: (f"udp://{host}:{0 if field == 'mavlink' else 9}",)}
    if host == "127.0.0.1":
        [bound] = prepare(AsyncExitStack(), Settings(**address))
        bound.close()
        return
    with pytest.raises(UsageError, match=f"{host} lets other machines fly"):
        prepare(AsyncExitStack(), Settings(**address))


def test_a_folder_that_cannot_be_written_is_reported_and_it_serves(
    settings: Settings, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "m100link").write_text("a file")
    later = signature_time() + 100_000
    frame = write_frame(PING, system=245, sequence=0, signer=PacketSigner(KEY), now=later)
    with caplog.at_level(logging.WARNING):
        assert asyncio.run(served(settings, frame)) == 0
    assert "signatures are not remembered" in caplog.text
