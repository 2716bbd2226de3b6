"""Command set 0x00: which firmware a version answer means, credentials, rates, mobile data."""

from __future__ import annotations

import logging
import pickle

import pytest
from hypothesis import given
from hypothesis import strategies as st

from m100link.errors import BadAck, BadKey, BadValue, PayloadTooLarge, UsageError
from m100link.protocol import (
    PROFILES,
    Activate,
    Credentials,
    FromMobile,
    GetVersion,
    SendToMobile,
    SetTelemetryRates,
    Version,
    VersionCode,
    profile,
)
from tests.support import KEY

FIRMWARE = profile("3.1")
NAME_2_3 = "SDK-v1.0 BETA M100-02.03.10.00"
NAME_3_1 = "SDK-v1.0 BETA M100-03.01.01.00"
NAME_A3 = "SDK-v1.0 BETA A3-03.01.100.00"
SERIAL = "041DA1B2C3"


def version(name: str, serial: str | None = None, crc: int = 0) -> Version:
    """An answer as it comes off the wire."""
    return GetVersion.parse_ack(Version(VersionCode.ACTIVATED, crc, name, serial).encode())


# -- version ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "crc"), [(NAME_2_3, 0xD3D21804), (NAME_3_1, 0xA6453AAC)])
def test_the_checksum_of_a_real_name_covers_its_nul(name: str, crc: int) -> None:
    assert version(name, crc=crc).crc_matches
    assert not version(name, crc=crc ^ 1).crc_matches
    assert not version(name + "X", crc=crc).crc_matches


@pytest.mark.parametrize(
    ("name", "serial", "firmware"),
    [
        (NAME_2_3, None, "2.3"),
        (NAME_3_1, SERIAL, "3.1"),
        ("SDK v1.0 M100", None, "1.0"),  # the only form that the document of 1.0 shows
        ("SDK v1.0", None, "1.0"),
        ("SDK v1.0 M100", SERIAL, None),
        ("SDK-v1.0 BETA M100-01.00.00.00", None, "1.0"),
        # Hardware versions of a form that nobody has seen are not the lack of one.
        ("SDK-v1.0 BETA M100-3.1.10.0", None, None),
        ("SDK-v1.0 BETA M100 v2", None, None),
        ("M100", None, None),
        ("", None, None),
        (NAME_A3, SERIAL, None),
        (NAME_A3, None, None),
        (NAME_2_3, SERIAL, None),  # 49 bytes and 2.3 do not go together
        ("SDK-v1.0 BETA M100-03.02.00.00", SERIAL, None),
        ("", SERIAL, None),
    ],
)
def test_the_profile_follows_from_length_and_name(
    name: str, serial: str | None, firmware: str | None
) -> None:
    chosen = version(name, serial).profile
    assert (chosen and chosen.name) == firmware


@pytest.mark.parametrize("firmware", PROFILES.values(), ids=str)
def test_the_name_that_a_profile_answers_leads_back_to_it(firmware: object) -> None:
    assert firmware in PROFILES.values()
    for known in PROFILES.values():
        serial = SERIAL if known.has_serial else None
        chosen = version(known.version_name, serial).profile
        assert chosen is not None
        # The document profile is never chosen by itself: no aircraft speaks it.
        assert chosen.name == known.name.removesuffix("-document")


def test_an_answer_has_38_bytes_or_49_with_a_serial() -> None:
    assert len(Version(VersionCode.ACTIVATED, 0, NAME_2_3).encode()) == 38
    assert len(Version(VersionCode.ACTIVATED, 0, NAME_3_1, SERIAL).encode()) == 49


@pytest.mark.parametrize("size", [2, 6, 37])
def test_an_answer_cut_short_is_a_bad_ack(size: int) -> None:
    with pytest.raises(BadAck, match=f"{size} bytes"):
        GetVersion.parse_ack(Version(VersionCode.ACTIVATED, 0, NAME_2_3).encode()[:size])


def test_an_aircraft_that_is_not_activated_gives_its_version_all_the_same() -> None:
    answer = GetVersion.parse_ack(
        Version(VersionCode(0xFF01), 0xA6453AAC, NAME_3_1, SERIAL).encode()
    )
    assert not answer.is_activated
    assert (answer.name, answer.serial) == (NAME_3_1, SERIAL)
    assert version(NAME_3_1, SERIAL).is_activated


@given(st.binary(min_size=38, max_size=70))
def test_no_bytes_of_an_answer_break_it(payload: bytes) -> None:
    answer = GetVersion.parse_ack(payload)
    assert answer.crc_matches in (True, False)
    assert answer.profile is None or answer.profile.name in PROFILES


# -- activation ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("firmware", "level", "word"),
    [("1.0", 1, 7), ("2.3", 1, 0x02030A00), ("3.1", 2, 0x03010A00)],
)
def test_the_request_is_the_one_that_the_firmware_expects(
    firmware: str, level: int, word: int
) -> None:
    credentials = Credentials(10086, KEY, level=1, app_version=7, bundle_id="bundle")
    request = Activate.from_credentials(credentials, profile(firmware))
    value = request.value(profile(firmware))
    numbers = [int.from_bytes(value[at : at + 4], "little") for at in (0, 4, 8)]
    assert numbers == [10086, level, word]
    assert value[12:] == b"bundle" + bytes(26)
    assert len(value) == 44


def test_the_key_is_not_in_the_request() -> None:
    credentials = Credentials(1, KEY)
    for firmware in PROFILES.values():
        assert KEY[:4] not in Activate.from_credentials(credentials, firmware).encode(firmware)


@pytest.mark.parametrize("level", [-1, 3])
def test_a_level_that_does_not_exist_is_refused(level: int) -> None:
    with pytest.raises(UsageError, match=f"level {level}"):
        Credentials(1, KEY, level=level)


@pytest.mark.parametrize("number", [-1, 1 << 32])
def test_ids_and_versions_fit_into_32_bits(number: int) -> None:
    with pytest.raises(UsageError, match="app_id"):
        Credentials(number, KEY)
    with pytest.raises(UsageError, match="app_version"):
        Credentials(1, KEY, app_version=number)


@pytest.mark.parametrize("bundle_id", ["x" * 33, "ünïcode"])
def test_a_bundle_id_is_at_most_32_ascii_characters(bundle_id: str) -> None:
    with pytest.raises(UsageError, match="32 ASCII"):
        Credentials(1, KEY, bundle_id=bundle_id)


def test_credentials_with_a_bad_key_are_refused() -> None:
    with pytest.raises(BadKey):
        Credentials(1, "0123")


def test_credentials_show_no_key(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.DEBUG)
    secret = "c0ffee" + "5a" * 29
    credentials = Credentials(1_023_456, secret)
    logging.getLogger("m100link").info("activating %s %r", credentials, credentials)
    text = caplog.text + repr(credentials) + str(credentials)
    assert "1023456" in text
    assert "5a5a" not in text
    assert "ZZ" not in text
    with pytest.raises(TypeError):
        pickle.dumps(credentials)


# -- rates -----------------------------------------------------------------------------------------


def test_rates_are_codes_in_item_order_and_what_is_left_out_keeps_its_rate() -> None:
    rates = SetTelemetryRates({"time": 0, "quaternion": 1, "velocity": 50, "control_device": 100})
    keep = 5
    assert list(rates.value(FIRMWARE)) == [
        *(0, 1, keep, 3, keep, keep, keep, keep, keep, keep, keep, 4),
        *(0, 0, 0, 0),
    ]
    assert rates.fields() == {"rates_hz": rates.rates_hz}
    assert SetTelemetryRates.parse(rates.value(FIRMWARE), FIRMWARE).fields() == rates.fields()


def test_a_rate_or_an_item_that_does_not_exist_is_refused() -> None:
    with pytest.raises(BadValue, match="200 Hz") as caught:
        SetTelemetryRates({"time": 200}).value(FIRMWARE)
    assert (caught.value.field, caught.value.value) == ("time", 200)
    assert caught.value.limit == "0, 1, 10, 50, 100 Hz"
    with pytest.raises(UsageError, match="'speed'"):
        SetTelemetryRates({"speed": 50}).value(FIRMWARE)


@pytest.mark.parametrize(
    ("value", "field", "limit", "is_taken"),
    [
        (b"\0\6" + bytes(14), "rates[1]", "0 to 5", False),
        (bytes(12) + b"\0\0\7\0", "rates[14]", "0, reserved", True),
    ],
)
def test_rates_that_nobody_should_send_are_kept_as_they_came(
    value: bytes, field: str, limit: str, is_taken: bool
) -> None:
    """DJI's libraries from 3.3 on leave memory in the reserved bytes; the aircraft ignores it."""
    rates = SetTelemetryRates.parse(value, FIRMWARE)
    assert rates.raw() == {"rates": list(value)}
    assert rates.rates_hz["time"] == 0
    assert rates.is_taken is is_taken
    with pytest.raises(BadValue) as caught:
        rates.value(FIRMWARE)
    assert (caught.value.field, caught.value.limit) == (field, limit)


# -- mobile data -----------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [SendToMobile, FromMobile])
def test_a_message_has_1_to_100_bytes(kind: type[SendToMobile | FromMobile]) -> None:
    for size in (1, 100):
        assert kind(bytes(size)).value(FIRMWARE) == bytes(size)
    with pytest.raises(PayloadTooLarge, match="101 bytes"):
        kind(bytes(101)).value(FIRMWARE)
    with pytest.raises(UsageError, match="at least one byte"):
        kind(b"").value(FIRMWARE)


def test_a_message_that_comes_is_1_to_100_bytes_that_mean_nothing() -> None:
    for size in (1, 100):
        assert FromMobile.parse(bytes(size), FIRMWARE) == FromMobile(bytes(size))
    for size in (0, 101):
        with pytest.raises(ValueError, match=rf"1 to 100 bytes, not {size}$"):
            FromMobile.parse(bytes(size), FIRMWARE)


def test_the_data_of_a_message_are_shown_under_a_name_of_their_own() -> None:
    assert SendToMobile(b"\x01\xff").fields() == {"mobile_data": "01ff"}
    assert FromMobile(b"\x01\xff").fields() == {"mobile_data": "01ff"}


def test_whatever_a_version_query_carries_is_one() -> None:
    """Its one byte is arbitrary (errata 13), and some programs send none."""
    for value in (b"", b"\0", b"\x17\x2a"):
        assert GetVersion.parse(value, FIRMWARE) == GetVersion()


def test_the_fields_of_a_version_name_the_profile_that_it_calls_for() -> None:
    fields = GetVersion.ack_fields(version(NAME_3_1, SERIAL, 0xA6453AAC))
    assert (fields["firmware"], fields["crc_matches"]) == ("3.1", True)
    assert GetVersion.ack_fields(version(NAME_A3))["firmware"] is None


def test_the_codes_of_an_answer_mean_what_the_document_says() -> None:
    code = VersionCode.ACTIVATED
    assert code.meaning
    assert version(NAME_2_3).encode()[:2] == int(code).to_bytes(2, "little")
    assert GetVersion.encode_ack(version(NAME_2_3)) == version(NAME_2_3).encode()
    assert GetVersion.encode_ack(code) == int(code).to_bytes(2, "little")
