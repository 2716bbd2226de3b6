"""Orders from another shell: a Unix socket that takes lines of JSON.

A request is ``{"aircraft": 0, "order": ["rc-mode", "P"]}``, the answer
``{"ok": true, "status": {...}}`` or ``{"ok": false, "error": "..."}``. Each process has its socket
in a directory that belongs to its user.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import socket
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from m100link.errors import M100Error, UsageError
from m100link.errors.texts import read_json
from m100link.sim.orders.actions import perform, status
from m100link.sim.ports.driver import stop_listening

if TYPE_CHECKING:
    from m100link.sim.virtual import VirtualAircraft


_LIMIT = 65_536


def socket_directory() -> Path:
    """Where the sockets of this user's simulators are."""
    base = os.environ.get("XDG_RUNTIME_DIR")
    if base and Path(base).is_dir():
        return Path(base) / "m100link"
    return Path(tempfile.gettempdir()) / f"m100link-{os.getuid()}"


def find_sockets() -> list[Path]:
    """Sockets of simulators that run; what dead ones left is removed."""
    found = []
    for path in sorted(socket_directory().glob("sim-*.sock")):
        with socket.socket(socket.AF_UNIX) as probe:
            probe.settimeout(1.0)
            try:
                probe.connect(str(path))
            except OSError:
                with contextlib.suppress(OSError):
                    path.unlink()
            else:
                found.append(path)
    return found


class CtlServer:
    """Takes orders for the aircraft of one process."""

    def __init__(self, aircraft: list[VirtualAircraft], path: Path | None = None) -> None:
        self._aircraft = aircraft
        self.path = path or socket_directory() / f"sim-{os.getpid()}.sock"
        self._server: asyncio.Server | None = None
        self._serving: dict[asyncio.Task[Any], asyncio.StreamWriter] = {}

    async def start(self) -> None:
        """Listen."""
        self.path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        with contextlib.suppress(FileNotFoundError):
            self.path.unlink()
        self._server = await asyncio.start_unix_server(
            self._serve, path=str(self.path), limit=_LIMIT
        )

    async def stop(self) -> None:
        """Stop listening and remove the socket."""
        if self._server is not None:
            await stop_listening(self._server)
            self._server = None
            for writer in self._serving.values():
                writer.close()
            if self._serving:
                await asyncio.wait(list(self._serving), timeout=1.0)
        with contextlib.suppress(OSError):
            self.path.unlink()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._serving[task] = writer
        try:
            while line := await reader.readline():
                writer.write(json.dumps(self.answer(line)).encode() + b"\n")
                await writer.drain()
                await asyncio.sleep(0)  # lines may wait in a row: what flies has its turn
        except (ValueError, ConnectionError):
            pass  # a line beyond the limit, or the other side is gone: nobody to tell
        finally:
            writer.close()
            with contextlib.suppress(OSError):
                await writer.wait_closed()
            del self._serving[task]

    def answer(self, line: bytes) -> dict[str, Any]:
        """Carry out one request."""
        try:
            request = read_json(line)
            index, order = request.get("aircraft", 0), request["order"]
            aircraft = self._aircraft[index]
            perform(aircraft, order)
        except UsageError as error:
            return {"ok": False, "error": str(error)}
        except (ValueError, KeyError, IndexError, TypeError, AttributeError) as error:
            return {"ok": False, "error": f"a request that makes no sense: {error!r}"}
        return {"ok": True, "status": status(aircraft)}


class NoSimulator(
    M100Error,
    code="M100-NO-SIMULATOR",
    cause="no virtual aircraft runs, or another user's",
    remedy="start one: `m100link sim`",
):
    """No simulator runs, or it is not clear which one is meant."""


def send_order(
    order: list[str], *, path: Path | None = None, aircraft: int = 0, timeout: float = 5.0
) -> dict[str, Any]:
    """Send one order to a running simulator and return its answer.

    ``path``: socket; by default that of the only simulator that runs. ``aircraft``: which aircraft
    of a process with several, from 0. ``timeout``: seconds to wait. Raises ``NoSimulator``: none
    runs, or several do and ``path`` says nothing.
    """
    if path is None:
        path = _only_socket()
    with socket.socket(socket.AF_UNIX) as connection:
        connection.settimeout(timeout)
        try:
            connection.connect(str(path))
            request = {"aircraft": aircraft, "order": order}
            connection.sendall(json.dumps(request).encode() + b"\n")
            with connection.makefile("rb") as answers:
                answer: dict[str, Any] = read_json(answers.readline(_LIMIT))
        except (OSError, ValueError) as error:
            raise NoSimulator(
                f"the simulator at {path} does not answer: {error}",
                remedy="start one with `m100link sim`",
            ) from error
    return answer


def _only_socket() -> Path:
    found = find_sockets()
    if not found:
        raise NoSimulator("no simulator runs", remedy="start one with `m100link sim`")
    if len(found) > 1:
        names = "".join(f"\n      --socket {path}" for path in found)
        raise NoSimulator("several simulators run", remedy=f"say which:{names}")
    return found[0]
