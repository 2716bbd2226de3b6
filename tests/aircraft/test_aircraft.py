"""Connecting, version, activation, keys and codes, data of the mobile device."""

from __future__ import annotations

import asyncio
import copy
import math
import re
from collections.abc import Callable
from dataclasses import replace

import pytest

import m100link
from m100link import (
    AckTimeout,
    ActivationCode,
    ActivationProgress,
    ActivationRefused,
    Aircraft,
    AuthorityEvent,
    AuthorityRefused,
    BadURL,
    CommandNotSupported,
    CommandRefused,
    ConnectionEvent,
    Credentials,
    KeyRejected,
    LevelTooLow,
    LinkClosed,
    LinkLost,
    NoAircraft,
    NoAnswer,
    NotActivated,
    NoValidFrame,
    PayloadTooLarge,
    SilentLine,
    UsageError,
)
from m100link.errors import M100Error
from m100link.link import Link, connect_in_memory
from m100link.protocol.command import encode_code
from m100link.protocol.commands.activation import Activate, GetVersion
from m100link.protocol.commands.control import Arm, RequestAuthority
from m100link.protocol.firmware import FIRMWARE_1_0, Generation, profile
from m100link.protocol.items import ItemLayout
from m100link.sim import AircraftSettings, LineFaults, VirtualClockEventLoop
from m100link.sim.vehicle.settings import Undecodable
from m100link.testing import ConnectableAircraft
from m100link.wire import encode_frame
from m100link.wire.frame import FrameDecoder
from tests.rig import FIRMWARES, rig

pytestmark = pytest.mark.anyio

each_firmware = pytest.mark.parametrize("firmware", FIRMWARES)


# -- connect --------------------------------------------------------------------------------------


@pytest.fixture
def anyio_backend() -> object:
    return "asyncio", {"loop_factory": VirtualClockEventLoop}


async def test_a_forgotten_await_is_distinguished_from_a_missing_name() -> None:
    connecting = m100link.connect("sim://")
    assert repr(connecting) == "<connection to sim://, to be made by `async with` or `await`>"
    with pytest.raises(AttributeError, match=r"has no 'version' yet.*aircraft = await connect"):
        await connecting.version()  # type: ignore[attr-defined] # what is tested
    with pytest.raises(UsageError, match=r"m100link\.sync\.connect"):
        with connecting:  # type: ignore[attr-defined] # what is tested
            raise AssertionError("entered")
    assert not hasattr(connecting, "state")
    assert repr(copy.copy(connecting)) == repr(connecting)
    async with connecting as aircraft:
        assert aircraft.is_connected


class Peer(asyncio.Protocol):
    """The other end of the cable, as simple as the test needs it."""

    def __init__(self, answer: Callable[[bytes], bytes] | None = None) -> None:
        self.answer = answer
        self.decoder = FrameDecoder(None)
        self.received = b""
        self.transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self.transport = transport

    def data_received(self, data: bytes) -> None:
        self.received += data
        if self.answer is not None:
            reply = self.answer(data)
            if reply:
                self.say(reply)

    def say(self, data: bytes) -> None:
        assert self.transport is not None
        self.transport.write(data)


async def attach_to(peer: Peer, *, timeout: float = 3.0) -> Aircraft:
    link = Link()
    connect_in_memory(link, peer)
    await link.wait_connected()
    return await m100link.connect(link, timeout=timeout)


def answering(
    code: int, *, to: tuple[int, int] | None = None, is_active: bool = False
) -> Callable[[bytes], bytes]:
    """A peer that answers the version like firmware 1.0, and ``to`` (or all else) with a code."""
    decoder = FrameDecoder(None)
    version = (
        (b"\x00\x00" if is_active else b"\x01\xff")
        + bytes(4)
        + FIRMWARE_1_0.version_name.encode().ljust(32, b"\0")
    )

    def answer(data: bytes) -> bytes:
        out = b""
        for frame in decoder.feed(data):
            address = (frame.data[0], frame.data[1])
            payload = version if address == GetVersion.ADDRESS else encode_code(code)
            if address != GetVersion.ADDRESS and to is not None and address != to:
                payload = encode_code(0)
            out += encode_frame(
                payload, session=frame.session, sequence=frame.sequence, is_ack=True
            )
        return out

    return answer


async def test_a_silent_line_says_that_not_one_byte_came() -> None:
    await asyncio.sleep(5.0)
    start = asyncio.get_running_loop().time()
    with pytest.raises(SilentLine, match=r"not one byte arrived \(.*, 3 s\)") as caught:
        await attach_to(Peer(), timeout=3.0)
    assert asyncio.get_running_loop().time() - start == pytest.approx(3.0, abs=0.01)
    error = caught.value
    assert (error.bytes_received, error.frames_received) == (0, 0)
    assert "TX and RX" in error.remedy
    assert isinstance(error, TimeoutError)
    assert isinstance(error, ConnectionError)


async def test_bytes_without_a_frame_point_to_the_baud_rate() -> None:
    peer = Peer(lambda data: bytes(7) * 4)
    with pytest.raises(NoValidFrame, match="not one valid frame") as caught:
        await attach_to(peer)
    assert caught.value.bytes_received > 0
    assert "baud rate" in caught.value.cause
    assert "230400, 115200, 921600" in caught.value.remedy


async def test_a_few_frames_among_garbage_point_to_the_baud_rate() -> None:
    virtual = ConnectableAircraft(seed=1)
    virtual.set_faults(LineFaults(damage=0.9), to_aircraft=LineFaults(loss=1.0))
    with pytest.raises(NoAnswer, match="were part of no frame") as caught:
        async with virtual.connect():
            pytest.fail("connected")
    assert caught.value.frames_received > 0
    assert "baud rate" in caught.value.cause
    assert "115200" in caught.value.remedy
    virtual.stop()


async def test_frames_without_an_answer_point_to_the_other_wire() -> None:
    virtual = ConnectableAircraft(seed=1)
    virtual.set_faults(LineFaults(), to_aircraft=LineFaults(loss=1.0))
    with pytest.raises(NoAnswer, match="no answer to a version query") as caught:
        async with virtual.connect():
            pytest.fail("connected")
    assert caught.value.frames_received > 100
    assert "our TX" in caught.value.cause
    virtual.stop()


@pytest.mark.parametrize("timeout", [0, -1.0, math.nan, math.inf])
async def test_a_time_in_which_nothing_can_answer_is_no_fault_of_the_wires(timeout: float) -> None:
    peer = Peer()
    with pytest.raises(UsageError, match=f"within {timeout} s") as caught:
        await attach_to(peer, timeout=timeout)
    assert caught.value.remedy == "give seconds, above 0"
    assert not peer.received


async def test_connecting_that_fails_closes_the_line() -> None:
    peer = Peer()
    with pytest.raises(SilentLine):
        await attach_to(peer, timeout=0.5)
    assert peer.transport is not None
    assert peer.transport.is_closing()


async def test_an_aircraft_that_answers_late_is_found_within_the_deadline() -> None:
    virtual = ConnectableAircraft(seed=1)
    virtual.stall_line()
    asyncio.get_running_loop().call_later(2.0, virtual.stall_line, False)
    async with virtual.connect(timeout=3.0) as aircraft:
        assert aircraft.firmware.name == "1.0"
    virtual.stop()


@pytest.mark.parametrize("loss", [0.2, 0.5])
async def test_a_bad_line_is_no_reason_not_to_connect(loss: float) -> None:
    virtual = ConnectableAircraft(seed=3, faults=LineFaults(loss=loss, damage=0.1, noise=5.0))
    async with virtual.connect(timeout=10.0) as aircraft:
        assert aircraft.firmware.name == "1.0"
    virtual.stop()


@pytest.mark.parametrize(
    ("url", "why"),
    [
        ("ttyUSB0", "names neither"),
        ("", "names neither"),
        ("serial:///dev/ttyUSB0:fast", "not a number"),
        ("serial:///dev/ttyUSB0:0", "not a number"),
        ("tcp://somewhere", "no port number"),
        ("carrier-pigeon://coop", "no transport called"),
    ],
)
async def test_a_wrong_url_prints_three_that_work(url: str, why: str) -> None:
    with pytest.raises(BadURL, match=why) as caught:
        async with m100link.connect(url):
            pytest.fail("connected")
    lines = caught.value.remedy.splitlines()
    schemes = [line.strip().split("://")[0] for line in lines[1:]]
    assert schemes == ["serial", "/dev/ttyUSB0", "tcp", "sim", "replay"]


async def test_a_profile_that_does_not_exist_is_reported_before_anything_is_opened() -> None:
    with pytest.raises(UsageError, match=r"no firmware profile is called '9\.9'") as caught:
        async with m100link.connect("/dev/does-not-exist", firmware="9.9"):
            pytest.fail("connected")
    assert "1.0, 2.3, 3.1" in caught.value.remedy


async def test_an_aircraft_may_be_closed_more_than_once_and_is_closed_then() -> None:
    aircraft = await m100link.connect("sim://")
    await aircraft.aclose()
    await aircraft.aclose()
    with pytest.raises(LinkClosed):
        await aircraft.version()


def test_outside_of_asyncio_the_error_says_asyncio() -> None:
    """As where a program of trio awaits it."""
    with pytest.raises(UsageError, match="no event loop of asyncio") as caught:
        m100link.connect("sim://").__await__().send(None)
    assert "anyio.run(main, backend='asyncio')" in caught.value.remedy


async def test_an_aircraft_says_what_it_is_and_in_which_state() -> None:
    async with rig(firmware="3.1") as flown:
        text = repr(flown.aircraft)
        assert re.fullmatch(
            r"<Aircraft .+, firmware 3\.1, authority none, telemetry 0\.0\d s old>", text
        )
        flown.virtual.unplug()
        await asyncio.sleep(0.1)
        assert repr(flown.aircraft).endswith(", gone: virtual aircraft went away>")


async def test_events_tell_of_authority_and_of_the_end_of_the_line() -> None:
    async with rig() as flown, flown.aircraft.events() as events:
        connected_before = flown.aircraft.is_connected
        closed = asyncio.create_task(flown.aircraft.wait_closed())
        async with flown.aircraft.control():
            pass
        flown.virtual.unplug()
        seen = []
        with pytest.raises(LinkLost):
            async for event in events:
                seen.append(event)
        *authority, connection = seen
        assert [event.after.name for event in authority if isinstance(event, AuthorityEvent)] == [
            "OBTAINING",
            "HELD",
            "RELEASING",
            "NONE",
        ]
        assert isinstance(connection, ConnectionEvent)
        assert not connection.is_connected
        assert (connected_before, flown.aircraft.is_connected) == (True, False)
        assert isinstance(await closed, LinkLost)
        assert connection.error is flown.aircraft.link.failure


async def test_waiting_for_the_end_of_the_line_takes_as_long_as_it_lasts() -> None:
    async with rig() as flown:
        closed = asyncio.create_task(flown.aircraft.wait_closed())
        await asyncio.sleep(60.0)
        assert not closed.done()
        flown.virtual.unplug()
        assert isinstance(await closed, LinkLost)


async def test_closing_ends_events_too() -> None:
    async with rig() as flown, flown.aircraft.events() as events:
        await flown.aircraft.aclose()
        assert isinstance(await flown.aircraft.wait_closed(), LinkClosed)
        event = await anext(events)
        assert isinstance(event, ConnectionEvent)
        assert isinstance(event.error, LinkClosed)
        with pytest.raises(LinkClosed):
            await anext(events)


async def test_many_connections_in_a_row_leave_no_task_behind() -> None:
    before = asyncio.all_tasks()
    for _ in range(20):
        async with m100link.connect("sim://") as aircraft:
            await aircraft.version()
    await asyncio.sleep(1.0)
    assert asyncio.all_tasks() == before


# -- firmware -------------------------------------------------------------------------------------


@each_firmware
async def test_the_version_answer_chooses_the_profile(firmware: str) -> None:
    async with rig(activated=False, firmware=firmware) as flown:
        assert flown.aircraft.firmware.name == firmware
        version = await flown.aircraft.version()
        assert version.profile is flown.aircraft.firmware
        assert not version.is_activated


async def test_a_firmware_of_ones_own_flies_without_being_listed() -> None:
    """It says other things than any listed one wherever a profile can say something."""
    like = profile("3.1")
    items = {**like.items, "battery": ItemLayout("xB", ("percent",))}
    del items["magnetometer"]
    own = replace(
        like,
        name="3.9",
        version_name="SDK-v1.0 BETA M100-03.09.01.00",
        hardware_versions=(),
        tick_hz=250,
        items=items,
        generation=Generation.V2_3,
    )
    virtual = ConnectableAircraft(firmware=own, seed=1)
    async with virtual.connect(firmware=own) as aircraft:
        await aircraft.activate(virtual.credentials)
        assert aircraft.firmware is own
        async with aircraft.control() as control:
            await control.take_off()
            assert virtual.height == pytest.approx(1.2, abs=0.2)
            await control.land()
        assert aircraft.telemetry_mismatches == 0
        assert aircraft.state.battery is not None
        assert aircraft.state.battery.percent >= 99
        assert aircraft.state.magnetometer is None
        clock, time = aircraft.device_clock, aircraft.state.time
        assert clock.tick_hz == 250
        assert time is not None
        assert time.seconds == pytest.approx(virtual.vehicle.time, abs=0.03)
    virtual.stop()


async def test_a_forced_profile_stays_forced() -> None:
    async with rig(activated=False, firmware="2.3") as flown:
        async with flown.virtual.connect(firmware="3.1") as forced:
            await forced.version()
            assert forced.firmware.name == "3.1"


@pytest.mark.parametrize(
    ("name", "is_told"), [("SDK v1.0 M100", True), (FIRMWARE_1_0.version_name, False)]
)
async def test_a_version_that_names_no_hardware_is_taken_for_1_0_and_that_is_said(
    name: str, is_told: bool, caplog: pytest.LogCaptureFixture
) -> None:
    virtual = ConnectableAircraft(firmware=replace(FIRMWARE_1_0, version_name=name), seed=1)
    async with virtual.connect() as aircraft:
        assert aircraft.firmware is FIRMWARE_1_0
        await aircraft.version()
        assert caplog.text.count("names no hardware: taken for firmware 1.0") == is_told
    virtual.stop()


async def test_an_unknown_firmware_gets_telemetry_and_no_command(
    caplog: pytest.LogCaptureFixture,
) -> None:
    version = b"\x00\x00" + bytes(4) + b"SDK-v9.9 BETA M999-09.09.09.09".ljust(32, b"\0")
    decoder = FrameDecoder(None)
    peer = Peer(
        lambda data: b"".join(
            encode_frame(version, session=f.session, sequence=f.sequence, is_ack=True)
            for f in decoder.feed(data)
        )
    )
    aircraft = await attach_to(peer)
    assert "unknown firmware" in caplog.text
    battery = b"\x02\x00" + (1 << 10).to_bytes(2, "little") + b"\x2a"
    peer.say(encode_frame(battery, session=0, sequence=1))
    await aircraft.wait_for(lambda state: state.battery is not None, timeout=1)
    assert aircraft.state.battery == (42,)
    count = len(peer.received)
    with pytest.raises(UsageError, match="unknown firmware") as caught:
        async with aircraft.control():
            pytest.fail("entered")
    assert "firmware='3.1'" in caught.value.remedy
    assert len(peer.received) == count, "something was sent"
    assert caplog.text.count("unknown firmware") == 1, "a refused block says nothing of it again"
    await aircraft.aclose()


# -- activation -----------------------------------------------------------------------------------


@each_firmware
async def test_activation_asks_for_the_version_first(firmware: str) -> None:
    """The request depends on the firmware (and DJI told ROS users: version first)."""
    async with rig(activated=False, firmware=firmware) as flown:
        commands = flown.virtual.autopilot.received_commands
        commands.clear()
        await flown.aircraft.activate(flown.virtual.credentials)
        assert [c.address for c in commands][:2] == [GetVersion.ADDRESS, Activate.ADDRESS]
        assert all(not c.encrypted for c in commands)
        assert flown.aircraft.is_activated
        assert (await flown.aircraft.version()).is_activated


async def test_a_new_device_is_asked_again_with_progress_until_the_server_answers() -> None:
    settings = AircraftSettings(server_delay=5.0)
    seen: list[ActivationProgress] = []
    async with rig(activated=False, settings=settings) as flown:
        start = flown.now
        await flown.aircraft.activate(flown.virtual.credentials, timeout=60, progress=seen.append)
        assert flown.now - start == pytest.approx(6.0, abs=0.1)
    assert [p.attempt for p in seen] == [1, 2, 3, 4]
    assert [p.code for p in seen] == [ActivationCode.NEW_DEVICE] * 3 + [ActivationCode.SUCCESS]
    assert [p.next_attempt_in for p in seen] == [2.0, 2.0, 2.0, None]
    assert [round(p.remaining) for p in seen] == [60, 58, 56, 54]


async def test_a_server_that_never_answers_ends_activation_at_its_deadline() -> None:
    settings = AircraftSettings(server_delay=1e9)
    async with rig(activated=False, settings=settings) as flown:
        start = flown.now
        with pytest.raises(ActivationRefused, match="code 3") as caught:
            await flown.aircraft.activate(flown.virtual.credentials, timeout=7.0)
        assert flown.now - start == pytest.approx(7.0, abs=0.1)
        assert "DJI app" in caught.value.remedy
        assert not flown.aircraft.is_activated


async def test_already_active_is_success() -> None:
    async with rig() as flown:
        seen: list[ActivationProgress] = []
        await flown.aircraft.activate(flown.virtual.credentials, progress=seen.append)
        assert [p.code for p in seen] == [ActivationCode.SUCCESS]


async def test_an_active_aircraft_needs_no_phone_any_more() -> None:
    async with rig() as flown:
        flown.virtual.disconnect_app()
        async with flown.virtual.connect() as second:
            await second.activate(flown.virtual.credentials)
            assert second.is_activated


@pytest.mark.parametrize("code", [1, 2, 4, 5, 6, 7, 8, 77, 0x1234])
async def test_each_refusal_code_is_reported_with_cause_and_remedy(code: int) -> None:
    aircraft = await attach_to(Peer(answering(code)))
    with pytest.raises(ActivationRefused) as caught:
        await aircraft.activate(Credentials(app_id=7, key=bytes(32)))
    error = caught.value
    assert error.code == code
    assert error.command == "activate"
    assert f"(code {code}, attempt 1)" in error.seen
    assert error.cause == ActivationCode(code).cause != ""
    assert error.remedy == ActivationCode(code).remedy != ""
    assert not aircraft.is_activated
    assert bytes(32).hex() not in str(error)
    await aircraft.aclose()


@pytest.mark.parametrize("code", [ActivationCode.APP_NOT_CONNECTED, ActivationCode.NO_INTERNET])
async def test_an_active_aircraft_that_cannot_reach_the_server_is_active_all_the_same(
    code: ActivationCode,
) -> None:
    aircraft = await attach_to(Peer(answering(code, is_active=True)))
    await aircraft.activate(Credentials(app_id=7, key=bytes(32)))
    assert aircraft.is_activated
    await aircraft.aclose()


async def test_code_3_is_the_only_one_that_is_repeated() -> None:
    for code, attempts in ((3, 3), (6, 1)):
        peer = Peer(answering(code))
        aircraft = await attach_to(peer)
        seen: list[ActivationProgress] = []
        with pytest.raises(ActivationRefused):
            await aircraft.activate(
                Credentials(app_id=7, key=bytes(32)), timeout=3.9, progress=seen.append
            )
        assert len(seen) == attempts
        await aircraft.aclose()


@pytest.mark.parametrize(
    ("prepare", "code"),
    [
        (lambda virtual: virtual.disconnect_app(), ActivationCode.APP_NOT_CONNECTED),
        (lambda virtual: virtual.connect_app(internet=False), ActivationCode.NO_INTERNET),
        (lambda virtual: virtual.server_refuses(), ActivationCode.SERVER_REFUSED),
    ],
    ids=["no app", "no internet", "server"],
)
@each_firmware
async def test_what_keeps_an_aircraft_from_its_server_is_named(
    firmware: str, prepare: Callable[[ConnectableAircraft], None], code: ActivationCode
) -> None:
    async with rig(activated=False, firmware=firmware) as flown:
        prepare(flown.virtual)
        with pytest.raises(ActivationRefused) as caught:
            await flown.aircraft.activate(flown.virtual.credentials)
        assert caught.value.code == code


async def test_a_level_above_the_registered_one_is_refused() -> None:
    async with rig(activated=False, level=1) as flown:
        app = flown.virtual.credentials
        with pytest.raises(ActivationRefused) as caught:
            await flown.aircraft.activate(Credentials(app.app_id, app.key, level=2))
        assert caught.value.code == ActivationCode.LEVEL_TOO_HIGH


async def test_the_link_lost_while_waiting_for_the_server_is_reported_as_such() -> None:
    settings = AircraftSettings(server_delay=1e9)
    async with rig(activated=False, settings=settings) as flown:
        asyncio.get_running_loop().call_later(5.0, flown.virtual.unplug)
        with pytest.raises(LinkLost):
            await flown.aircraft.activate(flown.virtual.credentials, timeout=60)


async def test_activation_can_be_cancelled() -> None:
    settings = AircraftSettings(server_delay=1e9)
    async with rig(activated=False, settings=settings) as flown:
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(3.0):
                await flown.aircraft.activate(flown.virtual.credentials)
        assert not flown.aircraft.is_activated
        await flown.aircraft.version()


# -- keys and levels ------------------------------------------------------------------------------


async def enter_control(aircraft: Aircraft) -> None:
    async with aircraft.control():
        pytest.fail("entered")


@pytest.mark.parametrize("undecodable", Undecodable, ids=lambda u: u.name.lower())
@each_firmware
async def test_a_wrong_key_is_reported_as_a_wrong_key(
    firmware: str, undecodable: Undecodable
) -> None:
    """Plain requests are answered; encrypted ones get 0xFF00, or nothing at all."""
    settings = AircraftSettings(undecodable=undecodable)
    async with rig(firmware=firmware, settings=settings) as flown:
        async with flown.virtual.connect() as other:
            other.use_key(Credentials(flown.virtual.credentials.app_id, bytes(31) + b"\x01"))
            with pytest.raises(KeyRejected, match="plain requests are answered") as caught:
                await enter_control(other)
            assert "activate again" in caught.value.remedy
            assert caught.value.command == "request_authority"
            assert "00" * 16 not in str(caught.value)


async def test_a_dead_line_is_no_wrong_key() -> None:
    async with rig() as flown:
        flown.virtual.stall_line()
        with pytest.raises(AckTimeout) as caught:
            await enter_control(flown.aircraft)
        assert not isinstance(caught.value, KeyRejected)


async def test_a_key_that_was_understood_is_not_blamed_for_a_lost_frame() -> None:
    async with rig() as flown, flown.aircraft.control() as control:
        flown.virtual.set_faults(LineFaults(), to_aircraft=LineFaults(loss=1.0))
        asyncio.get_running_loop().call_later(1.5, flown.virtual.set_faults)
        with pytest.raises(AckTimeout):
            await control.take_off()


@pytest.mark.parametrize("is_proven", [False, True])
async def test_an_unknown_command_blames_the_key_only_while_nobody_knows_it(
    is_proven: bool,
) -> None:
    """Firmware 1.0 has no arm command; it answers 0xFF00 as for what it cannot decrypt."""
    async with rig() as flown, flown.virtual.connect(firmware="3.1") as aircraft:
        aircraft.use_key(flown.virtual.credentials)
        if is_proven:
            async with aircraft.control():
                pass
        with pytest.raises(CommandNotSupported if is_proven else KeyRejected):
            await aircraft.execute(Arm(on=True))


async def test_not_activated_is_reported_as_such() -> None:
    async with rig(activated=False) as flown:
        with pytest.raises(NotActivated, match="0xFF01") as caught:
            await enter_control(flown.aircraft)
        assert caught.value.remedy == "activate first"


async def test_a_level_too_low_for_flying_is_reported_as_such() -> None:
    """Level 1 watches and moves camera and gimbal; flying takes level 2 (document 2.1)."""
    async with rig(activated=False, level=1) as flown:
        await flown.aircraft.activate(flown.virtual.credentials)
        with pytest.raises(LevelTooLow, match="0xFF02") as caught:
            await enter_control(flown.aircraft)
        assert "level" in caught.value.remedy


async def test_after_a_reboot_the_aircraft_wants_to_be_activated_again() -> None:
    async with rig() as flown:
        flown.virtual.reboot()
        await asyncio.sleep(3.0)
        with pytest.raises((NotActivated, KeyRejected)):
            await enter_control(flown.aircraft)
        await flown.aircraft.activate(flown.virtual.credentials)
        flown.virtual.leave_f()
        flown.virtual.return_to_f()
        async with flown.aircraft.control() as control:
            assert control.has_authority


@each_firmware
@pytest.mark.parametrize("obstacle", ["not in F", "api disabled", "app holds"])
async def test_authority_that_is_refused_says_why(firmware: str, obstacle: str) -> None:
    async with rig(firmware=firmware) as flown:
        if obstacle == "not in F":
            flown.virtual.leave_f()
        elif obstacle == "api disabled":
            flown.virtual.enable_api(False)
        else:
            flown.virtual.app_takes_control()
        await asyncio.sleep(0.1)
        with pytest.raises(AuthorityRefused) as caught:
            await enter_control(flown.aircraft)
        assert f"mode switch {'P' if obstacle == 'not in F' else 'F'}" in caught.value.seen
        assert caught.value.cause
        assert caught.value.remedy
        assert not flown.virtual.vehicle.authority.is_requested


@pytest.mark.parametrize("firmware", ["1.0", "2.3"])
async def test_ioc_is_a_reason_of_its_own_where_the_firmware_tells(firmware: str) -> None:
    async with rig(firmware=firmware) as flown:
        flown.virtual.set_ioc(True)
        with pytest.raises(AuthorityRefused) as caught:
            await enter_control(flown.aircraft)
        assert ("IOC" in caught.value.seen) is (firmware == "2.3")


async def test_f_since_power_on_does_not_count_before_firmware_3() -> None:
    """Quick start: the switch must be moved away and back (3.x differs)."""
    for firmware, is_given in (("1.0", False), ("2.3", False), ("3.1", True)):
        async with rig(firmware=firmware) as flown:
            flown.virtual.remote.moved_since_power_on = False
            if is_given:
                async with flown.aircraft.control() as control:
                    assert control.has_authority
            else:
                with pytest.raises(AuthorityRefused) as caught:
                    await enter_control(flown.aircraft)
                assert "out of F and back" in caught.value.remedy


async def test_an_unknown_code_keeps_its_number() -> None:
    peer = Peer(answering(0x0BAD, to=RequestAuthority.ADDRESS))
    aircraft = await attach_to(peer)
    with pytest.raises(AuthorityRefused, match="0x0BAD") as caught:
        await enter_control(aircraft)
    assert caught.value.code == 0x0BAD
    assert "no published source" in caught.value.seen
    await aircraft.aclose()


async def test_every_error_of_the_package_is_caught_by_one_except() -> None:
    for kind in (
        SilentLine,
        KeyRejected,
        AckTimeout,
        ActivationRefused,
        NoAircraft,
        CommandRefused,
    ):
        assert issubclass(kind, M100Error)


# -- data of the mobile device --------------------------------------------------------------------


@each_firmware
async def test_data_go_to_the_mobile_device_and_come_from_it(firmware: str) -> None:
    async with rig(firmware=firmware) as flown, flown.aircraft.from_mobile() as messages:
        await flown.aircraft.send_to_mobile(b"hello")
        assert flown.virtual.app.received[-1] == b"hello"
        flown.virtual.send_from_mobile(bytes(range(250)))
        received = [await anext(messages) for _ in range(3)]
        assert b"".join(received) == bytes(range(250))
        assert [len(message) for message in received] == [100, 100, 50]


@pytest.mark.parametrize("size", [0, 101, 1008])
async def test_too_much_and_nothing_at_all_are_refused_before_a_byte_is_sent(size: int) -> None:
    async with rig() as flown:
        sent = flown.aircraft.statistics().frames_sent
        with pytest.raises(PayloadTooLarge if size else UsageError):
            await flown.aircraft.send_to_mobile(bytes(size))
        assert flown.aircraft.statistics().frames_sent == sent


async def test_data_to_the_mobile_device_need_activation() -> None:
    async with rig(activated=False) as flown:
        with pytest.raises(NotActivated):
            await flown.aircraft.send_to_mobile(b"x")
