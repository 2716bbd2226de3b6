"""The reader of an MJPEG stream of strangers: what is whole is shown, and nothing keeps it busy."""

from __future__ import annotations

import json
import random
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed")

STATIC = Path(__file__).parents[4] / "m100link/apps/station/console/static"

# Feeds each stream in chunks; tells the pictures by their bytes, what it refused, and the processor
# time, ms, of the chunk that took longest.
PROGRAM = """
import {readFileSync} from "node:fs";
const text = readFileSync(process.argv[1], "utf8").replace(/^import .*$/gm, "");
const stubs = "const words = String, number = String, onChoose = () => {}, m100 = {};";
const {Parts} = await import("data:text/javascript," + encodeURIComponent(stubs + text));
const told = JSON.parse(readFileSync(0, "utf8")).map(({head, fill, count, chunk}) => {
  const stream = Buffer.concat([Buffer.from(head, "latin1"), Buffer.alloc(count, fill, "latin1")]);
  const parts = new Parts(), pictures = [];
  let longest = 0, refused = null;
  try {
    for (let at = 0; at < stream.length; at += chunk) {
      const began = process.cpuUsage();
      const picture = parts.add(stream.subarray(at, at + chunk));
      longest = Math.max(longest, process.cpuUsage(began).user / 1000);
      if (picture) pictures.push(Buffer.from(picture).toString("latin1"));
    }
  } catch (error) { refused = error.message; }
  return {pictures, refused, longest};
});
console.log(JSON.stringify(told));
"""


def fed(*streams: tuple[str, str, int, int]) -> Any:
    """The result of each stream: head, what fills the rest, of how many bytes, and the chunk."""
    given = [dict(zip(("head", "fill", "count", "chunk"), one, strict=True)) for one in streams]
    program = ["node", "--input-type=module", "-e", PROGRAM, str(STATIC / "pictures.js")]
    done = subprocess.run(
        program, input=json.dumps(given), capture_output=True, text=True, check=True
    )
    return json.loads(done.stdout)


def test_the_newest_whole_picture_counts_however_the_stream_is_cut() -> None:
    seed = 34
    chance = random.Random(seed)
    streams, expected = [], []
    for _ in range(60):
        pictures = [
            "".join(chance.choice("\r\n-xy") for _ in range(chance.randrange(1, 40)))
            for _ in range(6)
        ]
        text = ""
        for number, picture in enumerate(pictures):
            has_length = chance.random() < 0.5
            if not has_length:  # nothing else tells its end
                pictures[number] = picture = picture.replace("-", "x").rstrip("\r\n") + "z"
            length = f"\r\nContent-Length: {len(picture)}" if has_length else ""
            text += f"\r\n--b\r\nContent-Type: image/jpeg{length}\r\n\r\n{picture}"
        streams.append((text + "\r\n--b", "x", 0, 1 if chance.random() < 0.7 else 10_000))
        expected.append(pictures if streams[-1][3] == 1 else pictures[-1:])
    found = fed(*streams)
    assert [one["refused"] for one in found] == [None] * 60
    assert [one["pictures"] for one in found] == expected, seed


HEAD = "--b\r\n\r\n"
HOSTILE = {
    "a head that does not end": ("", "\r", 9_000_000, "> 4096 B"),
    "a picture that does not end": (HEAD, "\r", 9_000_000, "> 8 MB"),
    "almost the end, again and again": (HEAD, "\r\n-", 9_000_000, "> 8 MB"),
    "a length of 90 MB": ("--b\r\nContent-Length: 90000000\r\n\r\n", "x", 99, "> 8 MB"),
    "a length of no number": (f"--b\r\nContent-Length: {'9' * 400}\r\n\r\n", "x", 99, "> 8 MB"),
    "small parts": ("", "--b\r\nContent-Length: 1\r\n\r\nx", 600_000, None),
    "small parts without a length": ("", "\r\n\r\nx\r\n--", 600_000, None),
}


def test_no_stream_keeps_the_page_that_flies_busy() -> None:
    """A beat goes out every 50 ms, and lives for 300 ms."""
    found = fed(*((head, fill, count, 65_536) for head, fill, count, _ in HOSTILE.values()))
    for (name, (*_, refused)), one in zip(HOSTILE.items(), found, strict=True):
        assert one["refused"] == refused, name
        assert one["longest"] < 150, name
