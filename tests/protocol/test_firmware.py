"""Profiles are data; this is what the data must say."""

from __future__ import annotations

from dataclasses import replace

import pytest

from m100link.errors import LayoutMismatch, UsageError
from m100link.protocol import (
    PROFILES,
    Battery,
    FirmwareProfile,
    TelemetryPacket,
    encode_telemetry,
    profile,
)
from m100link.protocol.firmware import FlagBit0, names_hardware, reads_unknown, recognised
from m100link.protocol.items import ItemLayout
from m100link.protocol.packet import telemetry_size

# Bytes of each item on the wire, in flag-bit order; nothing where a firmware has it not.
FIRMWARES = ("1.0", "2.3", "3.1", "1.0-document")
SIZES: dict[str, tuple[int | None, ...]] = {
    "time": (4, 4, 9, 4),
    "quaternion": (16, 16, 16, 16),
    "acceleration": (12, 12, 12, 12),
    "velocity": (12, 13, 13, 12),
    "angular_velocity": (12, 12, 12, 12),
    "position": (25, 25, 25, 24),
    "magnetometer": (6, 6, 6, 12),
    "rc": (12, 12, 12, 10),
    "gimbal": (12, 12, 13, 12),
    "flight_status": (1, 1, 1, 1),
    "battery": (1, 1, 1, 1),
    "control_device": (1, 1, 2, 1),
}
TOTALS = dict(zip(FIRMWARES, (116, 117, 124, 119), strict=True))
"""Their sum, with the flag word."""


def test_there_are_four_profiles() -> None:
    assert tuple(PROFILES) == FIRMWARES


@pytest.mark.parametrize("name", FIRMWARES)
def test_items_have_the_sizes_of_their_firmware(name: str) -> None:
    column = {item: row[FIRMWARES.index(name)] for item, row in SIZES.items()}
    sizes = {item: layout.size for item, layout in PROFILES[name].items.items()}
    assert sizes == {item: size for item, size in column.items() if size is not None}
    assert list(sizes) == [item for item in SIZES if item in sizes]
    assert 2 + sum(sizes.values()) == TOTALS[name], "the sum in TOTALS is another one"


def test_activation_words_and_acks_differ_by_firmware() -> None:
    words = {name: firmware.activation_version for name, firmware in PROFILES.items()}
    assert words == {"1.0": None, "2.3": 0x02030A00, "3.1": 0x03010A00, "1.0-document": None}
    assert [name for name, firmware in PROFILES.items() if firmware.has_serial] == ["3.1"]
    assert {name: firmware.tick_hz for name, firmware in PROFILES.items()} == {
        "1.0": 600,
        "2.3": 600,
        "3.1": 400,
        "1.0-document": 600,
    }


def test_only_the_document_profile_sends_yaw_before_throttle() -> None:
    assert [n for n, firmware in PROFILES.items() if not firmware.throttle_before_yaw] == [
        "1.0-document"
    ]


def test_bit_0_of_the_control_flag_changed_its_meaning_with_3_1() -> None:
    for name, firmware in PROFILES.items():
        expected = FlagBit0.STABLE_MODE if name == "3.1" else FlagBit0.YAW_FRAME
        assert firmware.flag_bit0 is expected


def test_a_profile_is_found_by_name_or_is_itself() -> None:
    found = profile("3.1")
    assert isinstance(found, FirmwareProfile)
    assert str(found) == "3.1"
    assert profile(found) is found


def test_an_unknown_profile_lists_those_that_exist() -> None:
    with pytest.raises(UsageError, match=r"'4\.0'.*\n.*1\.0, 2\.3, 3\.1, 1\.0-document"):
        profile("4.0")


def test_every_listed_profile_is_recognised_by_at_most_one_answer() -> None:
    for has_serial in (False, True):
        for name in (*(p.version_name for p in PROFILES.values()), "no hardware version", ""):
            known = [p for p in PROFILES.values() if p.recognises(name, has_serial=has_serial)]
            assert len(known) <= 1, (name, has_serial)
            assert recognised(name, has_serial=has_serial) is (known[0] if known else None)


@pytest.mark.parametrize(("has_serial", "name"), [(False, "1.0"), (True, "3.1")])
def test_one_profile_reads_the_telemetry_of_an_unknown_firmware(
    has_serial: bool, name: str
) -> None:
    reading = [p.name for p in PROFILES.values() if p.reads_unknown and p.has_serial is has_serial]
    assert reading == [name]
    assert reads_unknown(has_serial=has_serial) is profile(name)


@pytest.mark.parametrize(
    ("field", "having"),
    [
        ("authority_refusal_has_reason", ["2.3", "3.1"]),
        ("shows_authority_request", ["2.3", "3.1"]),
        ("velocity_names_sensor", ["2.3"]),
    ],
)
def test_what_came_with_which_firmware(field: str, having: list[str]) -> None:
    assert [name for name, firmware in PROFILES.items() if getattr(firmware, field)] == having


# -- a profile of one's own ------------------------------------------------------------------------


def test_a_profile_of_ones_own_is_usable_without_being_listed() -> None:
    items = dict(profile("3.1").items)
    del items["magnetometer"]
    items["battery"] = ItemLayout("2xB", ("percent",))
    own = replace(profile("3.1"), name="3.2", items=items, tick_hz=1000)
    value = encode_telemetry({"time": [500, 0, 0], "battery": [55]}, own)
    packet = TelemetryPacket(value, own)
    assert packet.battery == Battery(55)
    assert packet.time is not None
    assert packet.time.seconds == 0.5
    assert telemetry_size(0xFFFF, own) == telemetry_size(0xFFFF, profile("3.1")) - 6 + 2
    with pytest.raises(LayoutMismatch, match=r"firmware 3\.2"):
        TelemetryPacket((1 << 6).to_bytes(2, "little") + bytes(6), own)
    with pytest.raises(KeyError, match="magnetometer"):
        encode_telemetry({"magnetometer": [1, 2, 3]}, own)


def test_two_profiles_of_one_name_are_two_profiles() -> None:
    longer = replace(
        profile("3.1"), items={**profile("3.1").items, "battery": ItemLayout("xB", ("percent",))}
    )
    assert telemetry_size(1 << 10, profile("3.1")) == 3
    assert telemetry_size(1 << 10, longer) == 4


@pytest.mark.parametrize(
    ("items", "seen"),
    [
        ({"speed": ItemLayout("f", ("x",))}, r"'speed'.*\n.*velocity"),
        ({"battery": ItemLayout("f", ("volts",))}, r"battery.*volts.*\n.*percent"),
    ],
)
def test_a_profile_with_items_that_do_not_exist_is_refused(
    items: dict[str, ItemLayout], seen: str
) -> None:
    with pytest.raises(UsageError, match=seen):
        replace(profile("3.1"), items=items)


@pytest.mark.parametrize(
    ("text", "says"),
    [("SDK-v1.0 BETA M100-01.00.00.00", True), ("SDK-v1.0 BETA", False), ("", False)],
)
def test_a_version_text_says_which_aircraft_it_is_or_not(text: str, says: bool) -> None:
    assert names_hardware(text) is says
