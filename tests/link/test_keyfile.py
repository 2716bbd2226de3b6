"""Files with a secret: what is read, what is refused, and what outlives a loss of power."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

import pytest

from m100link.errors import BadKey, UsageError
from m100link.link.keyfile import (
    MAX_SECRET_SIZE,
    locks,
    read_key,
    read_token,
    replace_file,
)
from tests.disk import Disk

KEY = bytes(range(32))


def write(path: Path, data: bytes, mode: int = 0o600) -> Path:
    path.touch(mode=0o600)
    path.write_bytes(data)
    path.chmod(mode)
    return path


@pytest.mark.parametrize(
    "data", [KEY, KEY.hex().encode(), b"  " + KEY.hex().upper().encode() + b"\r\n"]
)
def test_a_key_is_hex_or_raw(tmp_path: Path, data: bytes) -> None:
    assert read_key(write(tmp_path / "key", data)).reveal() == KEY


@pytest.mark.parametrize("data", [b"", b"00", b"g" * 64, b"0" * 65, KEY[:31]])
def test_what_is_not_a_key_is_not_quoted(tmp_path: Path, data: bytes) -> None:
    with pytest.raises(BadKey) as caught:
        read_key(write(tmp_path / "key", data))
    assert not data or data.decode("latin-1") not in str(caught.value)


@pytest.mark.parametrize("read", [read_key, read_token])
@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660])
def test_what_others_can_read_is_refused(tmp_path: Path, read: object, mode: int) -> None:
    assert callable(read)
    with pytest.raises(UsageError, match="read by others") as caught:
        read(write(tmp_path / "key", KEY.hex().encode(), mode))
    assert "chmod 600" in str(caught.value)


@pytest.mark.parametrize("read", [read_key, read_token])
def test_what_cannot_be_read_names_the_file(tmp_path: Path, read: object) -> None:
    assert callable(read)
    for path in (tmp_path / "none", tmp_path):
        with pytest.raises(UsageError, match=f"{path} cannot be read") as caught:
            read(path)
        assert "check the path" in caught.value.remedy
    with pytest.raises(UsageError, match="not ASCII"):
        read(write(tmp_path / "umlaut", "ü".encode() * 20))
    with pytest.raises(UsageError, match=f"more than {MAX_SECRET_SIZE} bytes"):
        read(write(tmp_path / "long", b"0" * (MAX_SECRET_SIZE + 1)))


def test_windows_has_no_such_locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.platform", "win32")
    with (tmp_path / "lock").open("w") as file, pytest.raises(UsageError, match="on Windows"):
        locks(file.fileno())


def test_a_token_has_no_white_space_around_it(tmp_path: Path) -> None:
    assert read_token(write(tmp_path / "token", b" 0123456789abcdef\n")) == "0123456789abcdef"


@pytest.mark.parametrize("before", [b"the list of before", None])
def test_what_is_put_in_the_place_of_a_file_outlives_a_loss_of_power(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, before: bytes | None
) -> None:
    path = tmp_path / "revoked.list"
    if before is not None:
        path.write_bytes(before)
    disk = Disk(monkeypatch, tmp_path)
    replace_file(path, b"anna is revoked")
    assert disk.files == {"revoked.list": b"anna is revoked"}
    assert all(one.get("revoked.list") != b"" for one in disk.moments), "never half of one"
    assert [one.name for one in tmp_path.iterdir()] == ["revoked.list"]


def test_nobody_else_may_read_it_at_any_moment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    modes: list[int] = []
    wait = os.fsync

    def look(handle: int) -> None:
        modes.extend(stat.S_IMODE(one.stat().st_mode) for one in tmp_path.iterdir())
        wait(handle)

    monkeypatch.setattr(os, "fsync", look)
    replace_file(tmp_path / "ca.key", b"secret")
    assert modes == [0o600, 0o600]


def test_a_disk_that_does_not_take_it_keeps_the_one_before_and_nothing_beside_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "revoked.list"
    path.write_bytes(b"before")

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        replace_file(path, b"after")
    assert [one.read_bytes() for one in tmp_path.iterdir()] == [b"before"]
