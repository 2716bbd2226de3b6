"""The picture of a flight."""

from __future__ import annotations

import struct
import sys
from pathlib import Path

import pytest

from m100link.errors import UsageError
from m100link.log import read
from m100link.log.picture import picture
from m100link.log.story import Story, read_story
from tests.log.flight import fly


def size_of(png: bytes) -> tuple[int, int]:
    assert png.startswith(b"\x89PNG\r\n\x1a\n")
    width, height = struct.unpack(">II", png[16:24])
    return width, height


@pytest.mark.anyio
async def test_a_flight_is_a_picture(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="the extra `analysis` is not installed")
    await fly(tmp_path / "flight.mcap")
    story = read_story(read(tmp_path / "flight.mcap"))
    assert size_of(picture(story, width_px=700)) == (700, 450)
    assert size_of(picture(Story("$empty$.mcap"), width_px=700)) == (700, 450)


def test_without_matplotlib_it_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(UsageError, match="matplotlib") as caught:
        picture(Story("flight.mcap"))
    assert "'.[analysis]'" in str(caught.value)
