"""Wireshark's dissector, by tshark, against every golden vector; skipped where there is none."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

from m100link.link import Direction
from m100link.log.pcapng import begin_pcapng, cut, dissector, packet
from m100link.protocol.firmware import PROFILES
from m100link.wire import encode_frame

pytestmark = pytest.mark.skipif(shutil.which("tshark") is None, reason="tshark is not installed")


def framed(data: bytes, **others: Any) -> bytes:
    return encode_frame(data, **{"session": 0, "sequence": 0} | others)


VECTORS = Path(__file__).parent.parent / "vectors"
RX, TX = Direction.RECEIVED, Direction.SENT


def rows(name: str) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads((VECTORS / f"{name}.json").read_text("utf-8"))
    return found


class Tshark:
    """Reads packets and gives the layers of each."""

    def __init__(self, place: Path) -> None:
        self._place = place
        (place / "m100.lua").write_text(dissector(), encoding="utf-8")

    def __call__(
        self, pieces: Iterable[tuple[Direction, bytes]], firmware: str = "1.0", *options: str
    ) -> list[dict[str, list[Any]]]:
        path = self._place / "test.pcapng"
        with path.open("wb") as stream:
            begin_pcapng(stream, PROFILES[firmware])
            for number, (way, data) in enumerate(pieces):
                stream.write(packet(0, data, number * 1_000_000, way))
        script = f"lua_script:{self._place / 'm100.lua'}"
        command = ["tshark", "-X", script, "-r", str(path), "-T", "ek", *options]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        assert "Lua: " not in done.stderr, done.stderr
        lines = [json.loads(line) for line in done.stdout.splitlines()]
        layers = [line["layers"] for line in lines if "layers" in line]
        assert not [one for one in layers if "_ws_malformed" in one]
        return [self._flat(one["m100"]) for one in layers]

    def _flat(self, tree: Any) -> dict[str, list[Any]]:
        """All fields by abbreviation, however deep they stand."""
        found: dict[str, list[Any]] = {}
        for each in tree if isinstance(tree, list) else [tree]:
            for key, value in each.items():
                if isinstance(value, dict) or (
                    isinstance(value, list) and value and isinstance(value[0], dict)
                ):
                    for inner, more in self._flat(value).items():
                        found.setdefault(inner, []).extend(more)
                else:
                    name = key.removeprefix("m100_").replace("m100_", "m100.", 1)
                    found.setdefault(name, []).extend(value if isinstance(value, list) else [value])
        return found


@pytest.fixture
def tshark(tmp_path: Path) -> Tshark:
    return Tshark(tmp_path)


def key(*parts: str) -> str:
    """As ``-T ek`` writes an abbreviation."""
    return "m100." + "_".join(parts)


def same(shown: Any, value: Any) -> bool:
    if isinstance(value, str):
        return bool(shown == value)
    if isinstance(value, float) and value != value:
        return "nan" in str(shown).lower()
    return float(shown) == pytest.approx(float(value), rel=1e-6, abs=1e-30)


@pytest.mark.parametrize("firmware", PROFILES)
def test_every_field_of_telemetry_is_that_of_the_vector(tshark: Tshark, firmware: str) -> None:
    wanted = [row for row in rows("telemetry") if row["firmware"] == firmware]
    if not wanted:
        pytest.skip("there are no vectors of it")
    frames = [(RX, framed(b"\x02\x00" + bytes.fromhex(row["value"]))) for row in wanted]
    found = tshark(frames, firmware)
    assert len(found) == len(wanted)
    for layer, row in zip(found, wanted, strict=True):
        for item, fields in row["items"].items():
            for name, value in fields.items():
                [shown] = layer[key("telemetry", item, name)]
                assert same(shown, value), (item, name, shown, value)


def test_every_movement_is_that_of_the_vector(tshark: Tshark) -> None:
    names = {
        "flag": "control_flag",
        "x": "roll_or_x",
        "y": "pitch_or_y",
        "throttle": "throttle_or_z",
        "yaw": "yaw",
    }
    for firmware, form in (("1.0", "value"), ("1.0-document", "value_in_document_order")):
        wanted = rows("movement")
        found = tshark(
            [(TX, framed(b"\x01\x03" + bytes.fromhex(row[form]))) for row in wanted], firmware
        )
        for layer, row in zip(found, wanted, strict=True):
            for ours, theirs in names.items():
                [shown] = layer[key("move", ours)]
                assert same(shown, row[theirs]), (ours, shown, row[theirs])


def test_every_later_command_ack_and_push_is_that_of_the_vector(tshark: Tshark) -> None:
    wanted = [row for row in rows("later-commands") if row["kind"] != "dialogue"]
    frames = []
    for row in wanted:
        if row["kind"] == "ack":
            frames.append((TX, bytes.fromhex(row["request"])))
        frames.append((TX if row["kind"] == "command" else RX, bytes.fromhex(row["frame"])))
        if "value_in_document_layout" in row:
            value = bytes((row["set"], row["id"])) + bytes.fromhex(row["value_in_document_layout"])
            frames.append((TX, framed(value)))
    found = iter(tshark(frames, "3.1"))
    checked = 0
    for row in wanted:
        if row["kind"] == "ack":
            next(found)
        layer = next(found)
        if "value_in_document_layout" in row:
            next(found)
        for name, value in row["fields"].items():
            checked += check(layer, row, name, value)
        assert not any("size_wrong" in one for one in layer), (row["name"], layer)
    assert checked > 1000


# Fields that are called otherwise here.
OURS = {("arm", "arm"): "on", ("hotpoint_start", "max_radius"): "largest_radius"}


def check(layer: dict[str, list[Any]], row: dict[str, Any], name: str, value: Any) -> int:
    middle = ("ack",) if row["kind"] == "ack" else ()
    command = row["name"]
    for push in ("mission_status", "waypoint_event"):  # vectors have the kind in the name
        command = push if command.startswith(push) else command
    place = key(command, *middle, OURS.get((row["name"], name), name))
    if row["kind"] == "ack" and name == "code":
        place = "m100.ack_code"
    shown = layer.get(place)
    assert shown is not None, (row["name"], name, sorted(layer))
    values = value if isinstance(value, list) else [value]
    shown = [int(one, 16) if str(one).startswith("0x") else one for one in shown]
    assert len(shown) == len(values), (row["name"], name, shown, values)
    assert all(map(same, shown, values)), (row["name"], name, shown, values)
    return len(values)


def test_frames_of_every_kind_are_taken_apart(tshark: Tshark) -> None:
    wanted = rows("frames")
    found = tshark([(RX, bytes.fromhex(row["frame"])) for row in wanted])
    for layer, row in zip(found, wanted, strict=True):
        assert [int(one) for one in layer["m100.session"]] == [row["session"]]
        assert [int(one) for one in layer["m100.sequence"]] == [row["seq"]]
        is_sealed = row["key"] is not None and bool(row["data"])
        assert ("m100.ciphertext" in layer) is is_sealed
        assert ("m100.data" in layer) is (bool(row["data"]) and not is_sealed)
        assert not any("crc" in name and "wrong" in name for name in layer)


def test_a_wrong_checksum_is_an_error_of_experts(tshark: Tshark) -> None:
    good = framed(b"\x00\x00\x00", session=2, sequence=3)
    for at, name in ((3, "crc16_wrong"), (len(good) - 1, "crc32_wrong"), (13, "crc32_wrong")):
        bad = good[:at] + bytes([good[at] ^ 1]) + good[at + 1 :]
        [layer] = tshark([(TX, bad)])
        assert any(name in field for field in layer), (at, layer)
        assert "m100.command" not in layer
    [layer] = tshark([(TX, good[:10])])
    assert any("no_frame" in field for field in layer)


def test_what_is_not_known_is_said(tshark: Tshark) -> None:
    unknown = framed(b"\x77\x01\x02")
    too_short = framed(b"\x01\x03\x02")
    orphan = framed(b"\x02\x00", session=2, sequence=9, is_ack=True)
    wrong_firmware = next(row for row in rows("telemetry") if row["firmware"] == "3.1")
    telemetry = framed(b"\x02\x00" + bytes.fromhex(wrong_firmware["value"]))
    found = tshark([(TX, unknown), (TX, too_short), (RX, orphan), (RX, telemetry)])
    names = ["command_unknown", "size_wrong", "ack_orphan", "size_wrong"]
    for layer, name in zip(found, names, strict=True):
        assert any(name in field for field in layer), (name, layer)
    # By preference instead of by the capture.
    [layer] = tshark([(RX, telemetry)], "1.0", "-o", "m100.firmware:3.1")
    assert key("telemetry", "time", "tick") in layer


def test_noise_breaks_nothing(tshark: Tshark) -> None:
    pieces = [
        (RX, piece) for row in rows("streams") for piece in cut(bytes.fromhex(row["bytes"]))[0]
    ]
    assert len(tshark(pieces)) == len(pieces)
