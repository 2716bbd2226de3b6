"""What happens to frames: acks, repeats, sessions, encryption, system codes (document 1)."""

from __future__ import annotations

import json
from pathlib import Path
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from m100link.protocol import GetVersion, QueryTask, RequestAuthority, SendToMobile
from m100link.sim import DEMO_KEY, Undecodable, VirtualAircraft
from m100link.wire import Cipher, encode_frame

from .host import Host, aircraft

VERSION = b"\x00\x00\x00"
KEY, OTHER_KEY = Cipher(DEMO_KEY), Cipher(bytes(32))
FRAMES = json.loads((Path(__file__).parent.parent / "vectors" / "frames.json").read_text())


# --- damage ---------------------------------------------------------------------------------


@pytest.mark.parametrize("at", [0, 1, 3, 5, 8, 10, 12, 14, -1])
def test_a_frame_with_a_bad_checksum_is_dropped_in_silence(at: int) -> None:
    host = Host()
    frame = bytearray(encode_frame(VERSION, session=2, sequence=1))
    frame[at] ^= 0x10
    host.send_raw(bytes(frame))
    host.send_raw(bytes(1100))
    assert not [received for received in host.frames if received.frame.is_ack]


def test_good_frames_among_noise_are_answered() -> None:
    host, random = Host(), Random(7)
    for sequence in range(20):
        host.send_raw(random.randbytes(37) + encode_frame(VERSION, session=2, sequence=sequence))
    host.send_raw(bytes(1100))
    assert all(len(host.acks(2, sequence)) == 1 for sequence in range(20))


@given(st.lists(st.binary(max_size=80), max_size=20))
def test_no_bytes_make_it_raise(pieces: list[bytes]) -> None:
    autopilot = VirtualAircraft().autopilot
    for index, piece in enumerate(pieces):
        autopilot.receive_data(piece, index / 50)


@given(st.binary(min_size=0, max_size=120), st.integers(0, 31), st.booleans(), st.booleans())
def test_no_frame_makes_it_raise(
    data: bytes, session: int, encrypted: bool, is_active: bool
) -> None:
    host = Host(firmware="3.1")
    if is_active:
        host.ready()
    for prefix in (b"", b"\x00", b"\x01", b"\x02", b"\x03", b"\x05"):
        host.send(prefix + data, session=session, cipher=KEY if encrypted else None)
    host.wait(0.1)


def test_stray_acks_are_counted_and_change_nothing() -> None:
    host = Host()
    host.send_raw(encode_frame(b"\0\0", session=2, sequence=9, is_ack=True))
    assert host.autopilot.endpoint.statistics.foreign_acks == 1


# --- sessions -------------------------------------------------------------------------------


def test_session_0_is_executed_and_never_answered() -> None:
    host = Host()
    host.activate()
    assert host.ask(RequestAuthority(True), session=0) is None
    assert host.vehicle.authority.is_requested


def test_session_1_is_answered_once_and_nothing_is_stored() -> None:
    host = Host()
    host.activate()
    for message in (b"a", b"b"):
        host.send(SendToMobile(message).encode(host.profile), session=1, sequence=5)
    assert len(host.acks(1, 5)) == 2
    assert list(host.aircraft.app.received) == [b"a", b"b"], "both executed"


@pytest.mark.parametrize("session", range(2, 32))
def test_sessions_2_to_31_repeat_the_stored_ack_without_executing(session: int) -> None:
    host = Host()
    host.activate()
    for message in (b"a", b"b"):
        host.send(SendToMobile(message).encode(host.profile), session=session, sequence=5)
    first, second = host.acks(session, 5)
    assert first == second
    assert list(host.aircraft.app.received) == [b"a"]


def test_a_new_sequence_number_executes_and_replaces_the_memory() -> None:
    host = Host()
    host.activate()
    for sequence in (5, 6, 5):
        host.send(SendToMobile(b"x").encode(host.profile), session=3, sequence=sequence)
    assert len(host.aircraft.app.received) == 3


def test_each_session_has_a_memory_of_its_own() -> None:
    host = Host()
    host.activate()
    for session in (2, 3, 2, 3):
        host.send(SendToMobile(b"x").encode(host.profile), session=session, sequence=5)
    assert len(host.aircraft.app.received) == 2


def test_the_first_command_with_sequence_0_is_no_repetition() -> None:
    host = Host()
    host.send(VERSION, session=2, sequence=0)
    assert len(host.acks(2, 0)) == 1


def test_a_host_that_starts_anew_at_sequence_0_is_answered_from_memory() -> None:
    """The trap that the document's rule sets; a random first number avoids it."""
    host = Host(aircraft(settings={"forget_acks_after": None}))
    host.activate()
    host.send(SendToMobile(b"old").encode(host.profile), session=2, sequence=0)
    host.wait(600.0, step=60.0)
    host.send(SendToMobile(b"new").encode(host.profile), session=2, sequence=0)
    assert list(host.aircraft.app.received) == [b"old"]


def test_stored_acks_are_forgotten_after_5_s() -> None:
    host = Host()
    host.activate()
    host.send(SendToMobile(b"1").encode(host.profile), session=2, sequence=0)
    host.wait(4.0)
    host.send(SendToMobile(b"2").encode(host.profile), session=2, sequence=0)
    host.wait(2.0)
    host.send(SendToMobile(b"3").encode(host.profile), session=2, sequence=0)
    assert list(host.aircraft.app.received) == [b"1", b"3"]


def test_a_version_query_forgets_every_stored_ack() -> None:
    host = Host(aircraft(settings={"forget_acks_after": None}))
    host.activate()
    for text in (b"1", b"2"):
        host.send(SendToMobile(text).encode(host.profile), session=3, sequence=0)
    assert list(host.aircraft.app.received) == [b"1"]
    for _ in range(2):  # the second is a repeat by its number, and begins anew all the same
        host.send(VERSION, session=2, sequence=0)
        host.send(SendToMobile(b"3").encode(host.profile), session=3, sequence=0)
    assert list(host.aircraft.app.received) == [b"1", b"3", b"3"]
    assert len(host.acks(2, 0)) == 2


def test_what_comes_together_with_a_version_query_is_answered_and_carried_out_once() -> None:
    """As over a line that stood still for a moment: both are read at once."""
    host = Host()
    host.activate()
    message = SendToMobile(b"1").encode(host.profile)
    query = encode_frame(VERSION, session=2, sequence=7)
    host.send_raw(query + encode_frame(message, session=3, sequence=8))
    assert len(host.acks(3, 8)) == 1
    host.send(message, session=3, sequence=8)
    assert list(host.aircraft.app.received) == [b"1"]
    assert len(host.acks(3, 8)) == 2


def test_reboot_forgets_stored_acks() -> None:
    host = Host()
    host.send(VERSION, session=2, sequence=0)
    host.aircraft.reboot()
    host.wait(3.0)
    host.send(VERSION, session=2, sequence=0)
    assert host.autopilot.endpoint.statistics.repeated_commands == 0
    assert len(host.acks(2, 0)) == 2


def test_an_aircraft_that_restarts_hears_nothing_and_says_nothing() -> None:
    host = Host()
    host.activate()
    host.aircraft.reboot()
    host.frames.clear()
    host.send(VERSION, session=2, sequence=9)
    host.send(SendToMobile(b"1").encode(host.profile), session=0)
    host.wait(0.5)
    assert (host.frames, list(host.aircraft.app.received)) == ([], [])
    host.wait(4.0)
    assert host.frames
    assert host.acks(2, 9) == [], "what was sent meanwhile is lost"


def test_an_ack_has_session_and_sequence_of_its_command_and_no_set_and_id() -> None:
    host = Host()
    host.send(VERSION, session=17, sequence=54321)
    (ack,) = host.acks(17, 54321)
    assert ack.data[:2] == b"\x01\xff"


def test_the_aircraft_counts_its_own_pushes_in_16_bits() -> None:
    host = Host(aircraft(assistant={"rates_hz": {"time": 100}}))
    host.autopilot._sequence = 65534
    host.wait(5.0)
    assert [frame.sequence for _, frame in host.frames][:4] == [65534, 65535, 0, 1]
    host.frames.clear()
    host.aircraft.reboot()
    host.wait(5.0)
    assert [frame.sequence for _, frame in host.frames][:3] == [0, 1, 2], "anew with each start"


# --- encryption -----------------------------------------------------------------------------


@pytest.mark.parametrize("encrypted", [False, True])
def test_an_ack_is_encrypted_as_its_command_was(encrypted: bool) -> None:
    host = Host()
    host.activate()
    ack = host.ask_raw(QueryTask(1).encode(host.profile), encrypted=encrypted)
    assert ack is not None
    assert ack.encrypted is encrypted
    assert ack.data == b"\x01\x00"


def test_acks_of_version_query_and_activation_are_plain() -> None:
    host = Host()
    host.activate()
    ack = host.ask_raw(GetVersion().encode(host.profile), encrypted=True)
    assert ack is not None
    assert not ack.encrypted
    assert len(ack.data) == 38
    ack = host.ask_raw(host.activation().encode(host.profile))
    assert ack is not None
    assert not ack.encrypted


def test_telemetry_is_plain() -> None:
    host = Host().ready()
    host.wait(1.0)
    pushes = [frame for _, frame in host.frames if not frame.is_ack]
    assert pushes
    assert not any(frame.encrypted for frame in pushes)


@pytest.mark.parametrize("state", ["no key", "another key"])
def test_an_undecodable_command_is_answered_0xff00_plain(state: str) -> None:
    host = Host()
    if state == "another key":
        host.activate()
    host.decoder.cipher = None
    data = RequestAuthority(True).encode(host.profile)
    sequence = host.send(data, session=4, cipher=OTHER_KEY)
    (ack,) = host.acks(4, sequence)
    assert ack.data == b"\x00\xff"
    assert not ack.encrypted
    assert host.autopilot.counters.undecodable == 1


def test_an_undecodable_command_may_be_met_with_silence() -> None:
    host = Host(aircraft(settings={"undecodable": Undecodable.SILENCE}))
    host.activate()
    sequence = host.send(RequestAuthority(True).encode(host.profile), cipher=OTHER_KEY)
    host.wait(1.0)
    assert host.acks(2, sequence) == []
    assert host.ask(GetVersion()).code == 0, "plain requests are answered all the time"


def test_what_is_as_long_as_an_activation_is_none_where_there_is_a_key() -> None:
    """Activation has 44 bytes: before it, code 7 says that it could not be decrypted."""
    host = Host()
    host.activate()
    data = b"\x00\x01" + bytes(44)
    sequence = host.send(data, cipher=OTHER_KEY)
    [ack] = host.acks(2, sequence)
    assert ack.data == b"\x00\xff"


def test_plain_and_encrypted_commands_are_both_accepted_after_activation() -> None:
    host = Host()
    host.activate()
    assert host.ask(RequestAuthority(True), encrypted=False) == 2
    assert host.ask(RequestAuthority(False), encrypted=True) == 1


# --- system codes ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    "data",
    [b"\x00", b"\x00\x02\x00", b"\x01\x06\x00", b"\x02\x00\x00", b"\x04\x00\x00", b"\xff\xff"],
)
@pytest.mark.parametrize("is_active", [False, True])
def test_0xff00_for_what_is_no_command(data: bytes, is_active: bool) -> None:
    host = Host()
    if is_active:
        host.activate()
    ack = host.ask_raw(data, encrypted=False)
    assert ack is not None
    assert ack.data == b"\x00\xff"


def test_0xff00_for_a_header_without_data() -> None:
    ack = Host().ask_raw(b"")
    assert ack is not None
    assert ack.data == b"\x00\xff"


@pytest.mark.parametrize("command_id", [0x10])
@pytest.mark.parametrize("firmware", ["1.0", "2.3"])
def test_0xff00_for_commands_of_later_firmware(command_id: int, firmware: str) -> None:
    ack = Host(firmware=firmware).ask_raw(bytes((0x00, command_id)) + bytes(16))
    assert ack is not None
    assert ack.data == b"\x00\xff"


# --- golden frames --------------------------------------------------------------------------


@pytest.mark.parametrize("index", range(0, len(FRAMES), max(1, len(FRAMES) // 60)))
def test_golden_frames_are_understood(index: int) -> None:
    """Frames made without this package reach the aircraft as what they are."""
    vector = FRAMES[index]
    host = Host()
    if vector["key"] is not None:
        host.autopilot.endpoint.cipher = Cipher(bytes.fromhex(vector["key"]))
    host.send_raw(bytes.fromhex(vector["frame"]))
    statistics = host.autopilot.endpoint.statistics
    if vector["ack"]:
        assert statistics.foreign_acks == 1
    else:
        assert statistics.commands == 1
        assert len(host.acks(vector["session"], vector["seq"])) == (vector["session"] != 0) or (
            host.autopilot.counters.movements == 1
        )


# --- gimbal, camera -------------------------------------------------------------------------


def test_gimbal_and_camera_of_2_3_need_level_1_and_no_authority() -> None:
    host = Host(firmware="2.3", level=1)
    host.activate()
    host.send(bytes.fromhex("011b 0000 0000 7cfe 01 0a".replace(" ", "")), session=0)
    host.wait(2.0)
    gimbal = host.packets()[-2].gimbal or host.packets()[-1].gimbal
    assert gimbal is not None
    assert gimbal.pitch_deg == pytest.approx(-38.8, abs=0.01)
    host.send(b"\x01\x20\x00", session=0)
    host.send(b"\x01\x21\x00", session=0)
    assert (host.vehicle.camera.photos, host.vehicle.camera.is_recording) == (1, True)
    host.send(b"\x01\x22\x00", session=0)
    assert not host.vehicle.camera.is_recording


def test_g1_before_activation_and_at_level_0_gimbal_and_camera_are_ignored() -> None:
    for level in (None, 0):
        host = Host(firmware="2.3", level=level or 0)
        if level is not None:
            host.activate()
        sent = host.send(bytes.fromhex("011b 0000 0000 7cfe 01 0a"), session=2)
        host.send(b"\x01\x20\x00", session=0)
        host.wait(2.0)
        assert (host.vehicle.gimbal.pitch, host.vehicle.camera.photos) == (0.0, 0)
        assert host.acks(2, sent) == [], "no ack in any session"


def test_s1_sync_is_ignored() -> None:
    host = Host(firmware="3.1")
    host.activate()
    host.send(b"\x04\x00" + bytes(4), session=0)
    host.send(b"\x04\x00" + bytes(6), session=0)
    host.wait(0.5)
    assert not any(one.frame.is_ack and one.frame.session == 0 for one in host.frames)


def test_gimbal_rate_acts_with_bit_7_only_and_for_a_moment() -> None:
    host = Host(firmware="2.3")
    host.activate()
    for flags, moved in ((0x00, False), (0x80, True)):
        host.send(b"\x01\x1a" + (100).to_bytes(2, "little") + bytes(4) + bytes((flags,)), session=0)
        host.wait(3.0)
        assert (host.vehicle.gimbal.yaw > 1.0) is moved
    assert host.vehicle.gimbal.yaw == pytest.approx(5.0, abs=0.6)


@pytest.mark.parametrize(("level", "moves"), [(0, False), (1, True), (2, True)])
@pytest.mark.parametrize("data", ["011a 6400 0000 0000 80", "011b 6400 0000 0000 01 02"])
def test_gimbal_needs_level_1(level: int, moves: bool, data: str) -> None:
    host = Host(firmware="2.3", level=level)
    host.activate()
    host.send(bytes.fromhex(data), session=0)
    host.wait(1.0)
    assert (host.vehicle.gimbal.yaw > 1.0) is moves


def test_gimbal_stops_at_its_limits_and_shows_them_in_3_1() -> None:
    host = Host(firmware="3.1")
    host.activate()
    host.send(bytes.fromhex("011b" + "0000" + "0000" + "7cfc" + "01" + "05"), session=0)
    host.wait(2.0)
    gimbal = host.packets()[-2].gimbal or host.packets()[-1].gimbal
    assert gimbal is not None
    assert gimbal.pitch_deg == -90.0
    assert gimbal.limits == 1


@pytest.mark.parametrize("data", [b"\x01\x1a\x00", b"\x01\x1b" + bytes(9)])
def test_malformed_gimbal_commands_are_ignored(data: bytes) -> None:
    host = Host(firmware="2.3")
    host.activate()
    host.send(data, session=0)
    host.wait(1.0)
    assert (host.vehicle.gimbal.yaw, host.vehicle.gimbal.pitch) == (0.0, 0.0)


# --- missions -------------------------------------------------------------------------------

LATER = json.loads((Path(__file__).parent.parent / "vectors" / "later-commands.json").read_text())
MISSION_ACKS = {row["id"]: row for row in LATER if row["kind"] == "ack" and row["set"] == 0x03}
MISSIONS = {row["id"]: row for row in LATER if row["kind"] == "command" and row["set"] == 0x03}


def read_as_djis_programs(ack: bytes) -> bool:
    """Whether DJI's libraries take it for success: they look at the first byte and nothing else."""
    return ack[0] == 0


@pytest.mark.parametrize("is_active", [True, False], ids=["active", "not activated"])
@pytest.mark.parametrize("firmware", ["1.0", "2.3"])
def test_a_mission_is_refused_so_that_djis_programs_read_a_refusal(
    firmware: str, is_active: bool
) -> None:
    """Answered 00 FF, they printed MISSION_SUCCESS and nothing moved. 3.1 flies missions."""
    host = Host(firmware=firmware)
    if is_active:
        host.ready()
    for number, row in MISSIONS.items():
        data = bytes((0x03, number)) + bytes.fromhex(row["value"])
        for encrypted in {False, is_active}:
            ack = host.ask_raw(data, encrypted=encrypted)
            if number == 0x33:
                assert ack is None
                continue
            assert ack is not None
            assert ack.encrypted is encrypted
            assert len(ack.data) == len(bytes.fromhex(MISSION_ACKS[number]["value"])), row["name"]
            assert ack.data[0] == 0xC8
            assert not read_as_djis_programs(ack.data)
    assert host.autopilot.received_commands[-1].code in (0xC8, None)


def test_a_mission_on_session_0_is_not_answered() -> None:
    host = Host(firmware="3.1")
    assert host.ask_raw(b"\x03\x12\x00", session=0) is None
