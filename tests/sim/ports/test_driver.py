"""Aircraft on an event loop: cables in memory, TCP, sim://, many at once, nobody reading."""

from __future__ import annotations

import asyncio
import tracemalloc

import pytest

import m100link
from m100link import BadURL, UsageError, sync
from m100link.link import Link, parse_url
from m100link.protocol import GetVersion, TelemetryPacket
from m100link.sim import (
    DEFAULT_RATES_HZ,
    AssistantSettings,
    Driver,
    LineFaults,
    LockstepEventLoop,
    PtyPort,
    ScaledEventLoop,
    VirtualAircraft,
    VirtualClockEventLoop,
    loop_factory,
    open_sim,
    serve_tcp,
)
from m100link.sim.line import is_telemetry
from m100link.sim.orders import Scenario, ScenarioStep
from m100link.sim.ports.driver import (
    LINE_OPTIONS,
    MISSION_OPTIONS,
    SITE_OPTIONS,
    Backlog,
    StreamPort,
    aircraft_of,
    clock_of,
    speed_of,
)
from m100link.sim.vehicle.settings import AircraftSettings
from m100link.testing import ConnectableAircraft, VirtualClock
from m100link.wire import Frame, FrameDecoder, encode_frame
from tests.waiting import until

pytestmark = pytest.mark.anyio


class Listener(asyncio.Protocol):
    """Counts, and remembers nothing but the frames that are no telemetry."""

    def __init__(self) -> None:
        self.bytes = 0
        self.frames = 0
        self.decoder = FrameDecoder()
        self.lost: list[Exception | None] = []
        self.transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self.transport = transport

    def data_received(self, data: bytes) -> None:
        self.bytes += len(data)
        self.frames += len(self.decoder.feed(data))

    def connection_lost(self, exc: Exception | None) -> None:
        self.lost.append(exc)


async def test_a_connected_program_gets_telemetry_and_answers(
    virtual_aircraft: ConnectableAircraft,
) -> None:
    async with virtual_aircraft.connect() as aircraft:
        await asyncio.sleep(1.0)
        version = await aircraft.version()
        assert version.name == "SDK-v1.0 BETA M100-01.00.00.00"
        assert aircraft.statistics().frames_received >= 100


async def test_connect_again_and_again(virtual_aircraft: ConnectableAircraft) -> None:
    for _ in range(50):
        async with virtual_aircraft.connect() as aircraft:
            await aircraft.version()
    assert virtual_aircraft.driver.ports == []


async def test_time_passes_while_nobody_is_connected(
    virtual_aircraft: ConnectableAircraft, virtual_clock: VirtualClock
) -> None:
    virtual_aircraft.driver.start()
    await virtual_clock.sleep_until(12.0)
    assert virtual_aircraft.vehicle.time == pytest.approx(12.0, abs=0.011)


async def test_a_stopped_aircraft_does_not_age(virtual_aircraft: ConnectableAircraft) -> None:
    driver = virtual_aircraft.driver
    await asyncio.sleep(1.0)
    driver.stop()
    await asyncio.sleep(100.0)
    driver.start()
    await asyncio.sleep(1.0)
    assert virtual_aircraft.vehicle.time == pytest.approx(2.0, abs=0.03)


async def test_a_computer_that_slept_does_not_make_it_catch_up(
    virtual_aircraft: ConnectableAircraft,
) -> None:
    driver = virtual_aircraft.driver
    await asyncio.sleep(1.0)
    loop = asyncio.get_running_loop()
    loop._jumping.now += 3600.0  # type: ignore[attr-defined]  # the computer sleeps
    await asyncio.sleep(0.5)
    assert virtual_aircraft.vehicle.time < 2.0
    driver.stop()


async def test_unplugging_loses_the_link_and_replugging_lets_one_connect_again(
    virtual_aircraft: ConnectableAircraft,
) -> None:
    link = await virtual_aircraft.open_link()
    virtual_aircraft.unplug()
    await asyncio.sleep(0.1)
    assert not link.is_open
    with pytest.raises(ConnectionError):
        await virtual_aircraft.open_link()
    virtual_aircraft.replug()
    async with virtual_aircraft.connect() as aircraft:
        await aircraft.version()


@pytest.mark.aircraft(faults=LineFaults(delay=0.2))
async def test_a_delayed_line_delays_the_answer(virtual_aircraft: ConnectableAircraft) -> None:
    link = await virtual_aircraft.open_link()
    loop = asyncio.get_running_loop()
    began = loop.time()
    await link.request(GetVersion().encode(virtual_aircraft.autopilot.profile), name="version")
    assert loop.time() - began == pytest.approx(0.4, abs=0.03)


class Recorder(asyncio.Protocol):
    """When which bytes came."""

    def __init__(self) -> None:
        self.loop = asyncio.get_running_loop()
        self.decoder = FrameDecoder()
        self.arrived: list[tuple[float, Frame]] = []

    def data_received(self, data: bytes) -> None:
        self.arrived += [(self.loop.time(), frame) for frame in self.decoder.feed(data)]

    def acks(self) -> list[tuple[float, Frame]]:
        return [(when, frame) for when, frame in self.arrived if frame.is_ack]


def size(frame: Frame) -> int:
    """Bytes on the line."""
    return len(frame.data) + 16


@pytest.mark.parametrize("baud_rate", [57_600, 115_200, 230_400])
@pytest.mark.parametrize("firmware", ["1.0", "3.1"])
@pytest.mark.usefixtures("virtual_clock")
async def test_no_frame_of_a_paced_line_arrives_before_its_bytes_could(
    firmware: str, baud_rate: int
) -> None:
    assistant = AssistantSettings(baud_rate=baud_rate)
    driver = Driver(VirtualAircraft(firmware=firmware, assistant=assistant, paced=True))
    host = Recorder()
    transport = driver.connect(host)
    for sequence in range(100):
        transport.write(encode_frame(bytes(3), session=2, sequence=sequence))
        await asyncio.sleep(0.05)
    driver.stop()
    end = 0.0
    for when, frame in host.arrived:
        assert when >= end + size(frame) * 10 / baud_rate - 1e-6
        end = when
    assert len(host.acks()) == 100


@pytest.mark.parametrize("firmware", ["1.0", "3.1"])
@pytest.mark.usefixtures("virtual_clock")
async def test_an_answer_takes_the_time_of_both_frames_and_hardly_more(firmware: str) -> None:
    quiet = AssistantSettings(rates_hz=dict.fromkeys(DEFAULT_RATES_HZ, 0))
    for assistant, at_most in ((quiet, 0.0), (AssistantSettings(), 0.04)):
        driver = Driver(VirtualAircraft(firmware=firmware, assistant=assistant, paced=True))
        host = Recorder()
        transport = driver.connect(host)
        await asyncio.sleep(2.003)
        request = encode_frame(bytes(3), session=2, sequence=7)
        began = host.loop.time()
        transport.write(request)
        await asyncio.sleep(0.2)
        driver.stop()
        ((when, ack),) = host.acks()
        fastest = (len(request) + size(ack)) * 10 / 230_400
        assert fastest - 1e-6 <= when - began <= fastest + at_most + 1e-6


@pytest.mark.usefixtures("virtual_clock")
@pytest.mark.parametrize(
    ("firmware", "baud_rate", "least", "most"),
    [
        ("1.0", 230_400, 0.0, 0.0),
        ("3.1", 230_400, 0.0, 0.0),
        ("1.0", 115_200, 0.0, 0.0),
        ("3.1", 115_200, 0.02, 0.06),  # 11961 bytes per second, and the line carries 11520
        ("1.0", 57_600, 0.45, 0.55),
    ],
)
async def test_telemetry_that_does_not_fit_is_thinned(
    firmware: str, baud_rate: int, least: float, most: float
) -> None:
    assistant = AssistantSettings(baud_rate=baud_rate)
    driver = Driver(VirtualAircraft(firmware=firmware, assistant=assistant, paced=True))
    host = Recorder()
    driver.connect(host)
    await asyncio.sleep(20.0)
    driver.stop()
    assert least <= driver.aircraft.line.skipped / 2000 <= most
    assert driver.aircraft.line.to_host.lost == 0
    assert host.arrived[-1][0] > 19.9


@pytest.mark.usefixtures("virtual_clock")
async def test_without_pacing_an_answer_takes_no_time() -> None:
    driver = Driver(VirtualAircraft())
    host = Recorder()
    transport = driver.connect(host)
    await asyncio.sleep(1.003)
    transport.write(encode_frame(bytes(3), session=2, sequence=7))
    began = host.loop.time()
    await asyncio.sleep(0.1)
    driver.stop()
    ((when, _),) = host.acks()
    assert when == began


@pytest.mark.parametrize("seed", range(8))
async def test_a_bad_line_is_survived_by_repeats(seed: int, virtual_clock: VirtualClock) -> None:
    faults = LineFaults(loss=0.2, damage=0.1, duplicate=0.1, jitter=0.03, noise=5.0)
    print(f"seed {seed}")  # noqa: T201
    aircraft = ConnectableAircraft(seed=seed, faults=faults)
    link = await aircraft.open_link()
    for _ in range(20):
        payload = await link.request(
            GetVersion().encode(aircraft.autopilot.profile), name="version", tries=12, timeout=0.2
        )
        assert len(payload) == 38
    aircraft.stop()


async def test_two_ports_hear_the_same(virtual_aircraft: ConnectableAircraft) -> None:
    listeners = [Listener(), Listener()]
    for listener in listeners:
        virtual_aircraft.connect_protocol(listener)
    await asyncio.sleep(1.0)
    assert listeners[0].bytes == listeners[1].bytes > 10_000


async def test_a_scenario_happens_in_time(virtual_aircraft: ConnectableAircraft) -> None:
    driver = virtual_aircraft.driver
    driver.scenario = Scenario(
        [ScenarioStep(2.0, "gps 1"), ScenarioStep(1.0, "rc-mode P"), ScenarioStep(1.5, "key xx")]
    )
    await asyncio.sleep(1.2)
    assert virtual_aircraft.remote.mode.name == "P"
    assert virtual_aircraft.gps_health == 5
    await asyncio.sleep(1.0)
    assert virtual_aircraft.gps_health == 1
    assert any("key" in entry.text for entry in virtual_aircraft.vehicle.events)


# --- a reader who does not keep up ----------------------------------------------------------


def test_the_backlog_drops_the_oldest_telemetry_first() -> None:
    telemetry = [
        encode_frame(b"\x02\x00" + bytes(40), session=0, sequence=number) for number in range(400)
    ]
    ack = encode_frame(b"\x00\x00", session=2, sequence=9, is_ack=True)
    backlog = Backlog()
    backlog.extend([*telemetry[:10], ack, *telemetry[10:]])
    kept = backlog.take()
    assert len(kept) == Backlog.LIMIT
    assert backlog.dropped == 401 - Backlog.LIMIT
    assert kept[0] == ack
    assert kept[1:] == telemetry[-255:]
    assert all(is_telemetry(frame) for frame in kept[1:])


def test_a_backlog_without_telemetry_is_bounded_too() -> None:
    ack = encode_frame(b"\x00\x00", session=2, sequence=9, is_ack=True)
    backlog = Backlog()
    backlog.extend([ack] * 1000)
    assert len(backlog) == Backlog.LIMIT


async def test_a_program_that_stops_reading_costs_no_memory_and_gets_fresh_frames_later(
    virtual_aircraft: ConnectableAircraft,
) -> None:
    listener = Listener()
    transport = virtual_aircraft.connect_protocol(listener)
    await asyncio.sleep(0.1)
    transport.pause_reading()
    await asyncio.sleep(60.0)
    port = virtual_aircraft.driver.ports[0]
    assert isinstance(port, StreamPort)
    assert len(port.backlog) <= Backlog.LIMIT
    assert port.backlog.dropped > 4000
    assert transport.get_write_buffer_size() == 0
    transport.resume_reading()
    await asyncio.sleep(0.5)
    assert listener.decoder.discarded_bytes == 0, "whole frames only"


async def test_memory_is_flat_over_a_simulated_hour(virtual_clock: VirtualClock) -> None:
    """Ten minutes to settle, then twenty more: the rest of the hour would say the same."""
    aircraft = ConnectableAircraft(seed=1)
    link = await aircraft.open_link()
    await asyncio.sleep(1.0)
    tracemalloc.start()
    try:
        await asyncio.sleep(60.0)
        before, _ = tracemalloc.get_traced_memory()
        await asyncio.sleep(240.0)
        after, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert after - before < 50_000, "24 000 packets later"
    await link.close()
    aircraft.stop()


# --- many -----------------------------------------------------------------------------------


async def test_many_aircraft_in_one_process_do_not_mix(virtual_clock: VirtualClock) -> None:
    fleet = [ConnectableAircraft(seed=seed, firmware="3.1") for seed in range(20)]
    serials = []
    for aircraft in fleet:
        async with aircraft.connect() as connected:
            serials.append((await connected.version()).serial)
    assert serials == [aircraft.vehicle.serial_number for aircraft in fleet]
    assert len(set(serials)) == 20
    for aircraft in fleet:
        aircraft.stop()


# --- sim:// ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("url", "firmware"),
    [("sim://", "1.0"), ("sim://?firmware=2.3&seed=7", "2.3"), ("sim://?firmware=3.1", "3.1")],
)
async def test_sim_urls_make_an_aircraft(
    url: str, firmware: str, virtual_clock: VirtualClock
) -> None:
    link = Link()
    await open_sim(parse_url(url), link)
    await link.wait_connected()
    payload = await link.request(b"\x00\x00\x00", name="version")
    version = GetVersion.parse_ack(payload)
    assert version.profile is not None
    assert version.profile.name == firmware
    await link.close()


@pytest.mark.parametrize("url", ["sim://?speed=3", "sim://?seed=x", "sim://?firmware=9"])
async def test_bad_sim_urls_say_so(url: str, virtual_clock: VirtualClock) -> None:
    with pytest.raises(m100link.M100Error):
        await open_sim(parse_url(url), Link())


# --- pace -----------------------------------------------------------------------------------


async def test_two_minutes_of_flight_lose_nothing(virtual_aircraft: ConnectableAircraft) -> None:
    """Telemetry at default rates, movement at 50 Hz, through the event loop and a cable.

    How fast that is, the benchmark of the virtual aircraft measures.
    """
    listener = Listener()
    transport = virtual_aircraft.connect_protocol(listener)
    flight, loop = virtual_aircraft.vehicle.flight, asyncio.get_running_loop()
    flight.take_off()
    await asyncio.sleep(8.0)
    virtual_aircraft.vehicle.authority.is_requested = True
    move = encode_frame(bytes.fromhex("010348" + "0000803f" + 12 * "00"), session=0, sequence=1)
    left = 6_000

    def send() -> None:
        nonlocal left
        transport.write(move)
        left -= 1
        if left:
            loop.call_later(0.02, send)

    send()
    await asyncio.sleep(120.0)
    assert virtual_aircraft.autopilot.counters.movements == 6_000
    assert listener.frames >= 12_700


def test_packets_carry_what_the_driver_made(virtual_aircraft: ConnectableAircraft) -> None:
    virtual_aircraft.autopilot.advance(0.0)
    virtual_aircraft.autopilot.advance(0.01)
    (frame,) = FrameDecoder().feed(virtual_aircraft.autopilot.data_to_send())
    assert TelemetryPacket(frame.data[2:], virtual_aircraft.autopilot.profile).time is not None


def test_every_option_arrives_where_it_belongs() -> None:
    aircraft = aircraft_of(
        "sim://?firmware=3.1&seed=7&cold&level=1&app-id=5&baud=115200"
        "&loss=0.25&line-baud=57600&radio=1&noise=2"
        "&latitude=-33.5&wind_north=-3&sensor-noise=0.5&gimbal-follows=yes"
    )
    assert aircraft.seed == 7
    assert aircraft.vehicle.profile.name == "3.1"
    assert (aircraft.credentials.app_id, aircraft.credentials.level) == (5, 1)
    assert not aircraft.app.is_connected
    assert aircraft.vehicle.assistant.baud_rate == 115_200
    assert aircraft.line.to_host.faults == LineFaults(
        loss=0.25, baud_rate=57_600, radio=True, noise=2.0
    )
    settings = aircraft.vehicle.settings
    assert (settings.latitude_deg, settings.wind_north, settings.noise) == (-33.5, -3.0, 0.5)
    assert settings.gimbal_follows


def test_without_options_it_is_the_aircraft_by_default() -> None:
    aircraft = aircraft_of("sim://")
    assert aircraft.vehicle.settings == AircraftSettings()
    assert aircraft.line.to_host.faults == LineFaults()
    assert aircraft.app.is_connected


def test_options_of_missions() -> None:
    url = (
        "sim://?firmware=3.1&mission-status-hz=2&mission-takes-off=0&hotpoint-acks&radius-limit=90"
    )
    missions = aircraft_of(url).vehicle.settings.missions
    assert (missions.status_hz, missions.takes_off_by_itself) == (2.0, False)
    assert (missions.hotpoint_acks, missions.radius_limit) == (True, 90.0)
    with pytest.raises(BadURL, match="0 to 100 Hz"):
        aircraft_of("sim://?mission-status-hz=101")


def test_no_two_options_have_the_same_name() -> None:
    names = [*LINE_OPTIONS.values(), *SITE_OPTIONS.values(), *MISSION_OPTIONS.values()]
    assert len(names) == len(set(names))


@pytest.mark.parametrize(
    ("query", "words"),
    [
        ("sped=10", "no option 'sped'; it has acceleration, activated, "),
        ("seed=x", "seed is a number"),
        ("loss=much", "loss is a number"),
        ("loss=2", "loss is 0 to 1"),
        ("cold=maybe", "cold is 1 or 0"),
        ("rc-lost-reads=old", "rc-lost-reads is zeros or kept, not 'old'"),
        ("firmware=9", "no firmware profile"),
        ("key=short", "key"),
        ("level=7", "level"),
    ],
)
def test_what_cannot_be_is_refused_with_an_example(query: str, words: str) -> None:
    with pytest.raises((BadURL, m100link.M100Error), match=words) as caught:
        aircraft_of(f"sim://?{query}")
    assert isinstance(caught.value, m100link.M100Error)
    assert caught.value.remedy


@pytest.mark.parametrize("url", ["sim://m100", "sim:///dev/ttyUSB0", "sim://firmware=3.1"])
def test_no_name_stands_between_the_scheme_and_the_options(url: str) -> None:
    """It would be passed over, and another firmware would fly than the one that was meant."""
    with pytest.raises(BadURL, match="nothing stands between sim:// and its options") as caught:
        aircraft_of(url)
    assert "sim://?firmware=3.1" in (caught.value.remedy or "")


@pytest.mark.parametrize("speed", ["0", "-1", "fast", "nan"])
def test_a_speed_is_a_number_above_zero_or_max(speed: str) -> None:
    with pytest.raises(BadURL, match="speed is a number above 0, or max"):
        speed_of(f"sim://?speed={speed}")


def test_the_clock_that_a_url_asks_for() -> None:
    assert clock_of("sim://") is clock_of("/dev/ttyUSB0") is clock_of(object()) is None
    assert clock_of("sim://?speed=max") is LockstepEventLoop
    made = clock_of("sim://?speed=4")
    assert made is not None
    loop = made()
    assert isinstance(loop, ScaledEventLoop)
    assert loop.speed == 4.0
    loop.close()


def test_a_speed_that_the_event_loop_does_not_have_is_refused() -> None:
    async def connect() -> None:
        async with m100link.connect("sim://?speed=8"):
            pass

    with pytest.raises(UsageError, match="asks for a speed of 8") as caught:
        asyncio.run(connect())
    assert "loop_factory" in caught.value.remedy
    virtual = asyncio.Runner(loop_factory=VirtualClockEventLoop)
    with virtual, pytest.raises(UsageError, match="passes at inf"):
        virtual.run(connect())
    with asyncio.Runner(loop_factory=loop_factory(8.0)) as scaled:
        scaled.run(connect())


def test_without_await_the_speed_is_had() -> None:
    with sync.connect("sim://?speed=max") as aircraft:
        aircraft.activate(m100link.Credentials(app_id=10086, key=bytes(range(32))))
        with aircraft.control() as control:
            control.take_off()
            arrival = control.fly_to(north=50.0, east=0.0, up=0.0)
            control.land()
    assert arrival.elapsed > 5


# -- programs that reach a virtual aircraft by TCP, in real time -----------------------------------


async def test_tcp_serves_one_program_at_a_time_and_a_new_one_replaces_it() -> None:
    driver = Driver(VirtualAircraft(seed=1))
    server = await serve_tcp(driver)
    loop = asyncio.get_running_loop()
    listeners: list[Listener] = []
    for _ in range(2):
        _, listener = await loop.create_connection(Listener, "127.0.0.1", server.port)
        listeners.append(listener)
        await until(lambda: listeners[-1].frames > 5)
    await until(lambda: listeners[0].lost == [None])
    await server.stop()
    driver.stop()
    await until(lambda: bool(listeners[1].lost))
    assert server.port > 0


async def test_tcp_refuses_while_the_aircraft_is_unplugged() -> None:
    aircraft = VirtualAircraft(seed=1)
    driver = Driver(aircraft)
    server = await serve_tcp(driver)
    loop = asyncio.get_running_loop()
    listeners: list[Listener] = []
    for plugged in (True, False, True):
        aircraft.replug() if plugged else aircraft.unplug()
        _, listener = await loop.create_connection(Listener, "127.0.0.1", server.port)
        listeners.append(listener)
        await until(lambda: bool(listeners[-1].bytes or listeners[-1].lost))
    assert [listener.bytes > 0 for listener in listeners] == [True, False, True]
    await server.stop()
    driver.stop()


async def test_what_a_slow_reader_is_about_to_read_is_not_thrown_away(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It is full now and then, also a second apart; only one that stays full has no reader."""
    driver = Driver(VirtualAircraft(seed=1))
    driver.aircraft.stall_line()  # nothing but what is written here
    port = PtyPort(driver)
    now, unread = 100.0, 0
    monkeypatch.setattr(driver.loop, "time", lambda: now)
    monkeypatch.setattr(PtyPort, "unread", property(lambda _: unread))
    for hundredth in range(1000):
        now, unread = 100.0 + hundredth / 100, 4095 if hundredth % 100 < 40 else 2000
        port.write([])
    assert port.flushes == 0
    unread = 4095
    for hundredth in range(110):
        now = 110.0 + hundredth / 100
        port.write([])
    assert port.flushes == 1
    monkeypatch.undo()
    driver.stop()
