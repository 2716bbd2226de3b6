"""Six newcomers follow the manual from nothing to a program of their own.

What needs nothing but the library runs on virtual time. Slow tests type everything, in real time;
those of MAVSDK and rclpy are in ``tests/interop``.
"""

from __future__ import annotations

import re
import socket
from pathlib import Path

import pytest

from tests.tutorials import PAGES, ROOT, Reader, Virtual, blocks


@pytest.mark.parametrize("tutorial", PAGES)
def test_a_tutorial_begins_with_nothing_and_grows(tutorial: str) -> None:
    found = blocks(tutorial)
    first = found[0].text.splitlines()
    assert first[:2] == ["python3 -m venv .venv", ". .venv/bin/activate"]
    assert first[2].startswith("pip install '.[cli,")
    programs = [one for one in found if one.kind == "python"]
    assert len(programs) >= 1
    lines = "".join(one.text for one in found).splitlines()
    # `m100link docs` would break a longer one, and what is copied from there would not run.
    assert [line for line in lines if len(line) > 98] == []
    saved = {one.name for one in programs}
    typed = "".join(one.text for one in found if one.kind == "sh")
    assert set(re.findall(r"python (\w+\.py)", typed)) <= saved


def test_the_front_pages_lead_each_newcomer_to_a_page() -> None:
    for front, folder in (("README.md", ROOT), ("docs/index.md", ROOT / "docs")):
        text = (ROOT / front).read_text(encoding="utf-8")
        for page, _ in PAGES.values():
            link = (ROOT / page).relative_to(folder).as_posix()
            assert f"({link}" in text, (front, page)


@pytest.mark.parametrize(("tutorial", "programs"), [("offboard", 2), ("notebook", 8)])
def test_programs_of_a_tutorial_do_what_it_says(
    tutorial: str,
    programs: int,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    if tutorial == "notebook":
        for needed in ("pandas", "matplotlib"):
            pytest.importorskip(needed, reason=f"{needed} is not installed, nor needed otherwise")
    virtual = Virtual(tmp_path, capsys, monkeypatch)
    virtual.follow(tutorial)
    assert virtual.ran == programs


@pytest.mark.pty
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("tutorial", ["offboard", "tests", "fleet"])
def test_a_tutorial_is_typed_as_it_stands(tutorial: str, tmp_path: Path) -> None:
    if tutorial == "fleet":
        pytest.importorskip("zenoh", reason="the extra fleet is not installed")
    with socket.create_server(("127.0.0.1", 0)) as one:
        port = str(one.getsockname()[1])
    Reader(tmp_path, {"port = 7447": f"port = {port}"}).follow(tutorial)
