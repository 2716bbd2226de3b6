"""The folder on board: logs, and nothing else that is in it or near it."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

import pytest

from m100link.apps.fleet.logs.service import Shelf
from m100link.errors import UsageError
from m100link.log.recorder import Recorder
from tests.apps.fleet.logs.conftest import FIRST, SECOND, bytes_of


def wanted() -> bool:
    return True


def test_the_newest_stands_first_and_what_is_written_is_said(shelf: Path) -> None:
    os.utime(shelf / FIRST, (1000.0, 1000.0))
    recorder = Recorder(shelf)
    names = {one.log: one for one in Shelf(shelf).entries()}
    assert list(names) == [recorder.path.name, FIRST]
    assert (names[FIRST].size, names[FIRST].at, names[FIRST].is_written) == (300_000, 1000.0, False)
    assert names[recorder.path.name].is_written
    recorder._end()


def test_a_piece_ends_where_the_log_does(shelf: Path) -> None:
    data, entry = Shelf(shelf).piece(FIRST, 299_990, 64)
    assert data == bytes_of(300_000)[-10:]
    assert entry.size == 300_000
    assert Shelf(shelf).piece(FIRST, 400_000, 64)[0] == b""


def test_the_digest_is_of_the_first_bytes(shelf: Path) -> None:
    found = Shelf(shelf).digest(FIRST, 1000, wanted)
    assert found == hashlib.sha256(bytes_of(300_000)[:1000]).digest()
    with pytest.raises(UsageError, match="it has 300000 bytes"):
        Shelf(shelf).digest(FIRST, 300_001, wanted)
    with pytest.raises(UsageError, match="the agent ends"):
        Shelf(shelf).digest(FIRST, 1000, lambda: False)


def test_no_name_leads_out_and_no_link_anywhere(shelf: Path) -> None:
    secret = shelf.parent / FIRST
    secret.write_bytes(b"secret")
    (shelf / SECOND).symlink_to(secret)
    (shelf / "m100link-20260101-000002.mcap").mkdir()
    os.mkfifo(shelf / "m100link-20260101-000003.mcap")
    (shelf / "notes.mcap").write_bytes(b"theirs")
    one = Shelf(shelf)
    assert [entry.log for entry in one.entries()] == [FIRST]
    for name in (
        SECOND,
        f"../{FIRST}",
        str(secret),
        "notes.mcap",
        "m100link-20260101-000002.mcap",
        "m100link-20260101-000003.mcap",
        "m100link-20260101-000009.mcap",
        "",
    ):
        for ask in (
            lambda name=name: one.piece(name, 0, 9),
            lambda n=name: one.digest(n, 1, wanted),
        ):
            with pytest.raises(UsageError, match="no log"):
                ask()


def test_where_nothing_is_recorded_there_is_nothing(tmp_path: Path) -> None:
    assert Shelf(None).entries() == Shelf(tmp_path / "none").entries() == []
    with pytest.raises(UsageError):
        Shelf(None).piece(FIRST, 0, 1)
