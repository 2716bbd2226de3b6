from __future__ import annotations

import threading
from collections.abc import Callable

import pytest

from m100link import (
    Attitude,
    Credentials,
    LinkClosed,
    M100Error,
    PortNotFound,
    Position,
    TelemetryStalled,
    UsageError,
    sync,
)
from m100link.sim.vehicle.activation import DEMO_APP_ID, DEMO_KEY
from m100link.sync.control import Subscription

Connect = Callable[[], sync.Aircraft]


def test_an_aircraft_answers_and_closes(connect: Connect) -> None:
    aircraft = connect()
    assert aircraft.version().name.startswith("SDK")
    assert aircraft.statistics().frames_received > 0
    assert repr(aircraft).startswith("<Aircraft sim://")
    assert aircraft.firmware.name == "1.0"
    aircraft.close()
    aircraft.close()
    with pytest.raises(UsageError, match="was closed"):
        aircraft.version()


def test_a_port_that_is_not_there_is_reported_and_leaves_no_thread(connect: Connect) -> None:
    before = threading.active_count()
    with pytest.raises(PortNotFound):
        sync.connect("/dev/does-not-exist")
    assert threading.active_count() == before


def test_rows_are_collected_for_as_long_as_asked(connect: Connect) -> None:
    with connect() as aircraft:
        table = aircraft.collect(Attitude, seconds=0.5)
        assert len(table) == pytest.approx(50, abs=2)
        assert table.rows[0][1] - table.rows[0][0] == pytest.approx(aircraft.utc_offset_s, abs=1e-3)


def test_activation_reports_its_progress_here(connect: Connect) -> None:
    aircraft = connect()
    threads: list[int] = []
    key = "00" * 32
    try:
        aircraft.activate(
            Credentials(app_id=1, key=key),
            timeout=5.0,
            progress=lambda _: threads.append(threading.get_ident()),
        )
    except M100Error as error:  # who is refused was tried too
        print(error)  # noqa: T201
    assert threads
    assert set(threads) == {threading.get_ident()}


def test_telemetry_is_iterated(connect: Connect) -> None:
    aircraft = connect()
    with aircraft.telemetry(Attitude, Position, timeout=5.0) as samples:
        for count, sample in enumerate(samples):
            assert sample.attitude is not None or sample.position is not None
            if count == 20:
                break
    assert samples.received > 20
    assert list(samples) == []  # closed


def test_a_stall_while_iterating_is_an_error(connect: Connect) -> None:
    aircraft = connect()
    with (
        aircraft.from_mobile(timeout=0.5) as data,
        pytest.raises(TelemetryStalled, match=r"0\.5 s"),
    ):
        next(iter(data))


def test_waiting_for_a_state(connect: Connect) -> None:
    aircraft = connect()
    aircraft.wait_for(lambda state: state.battery is not None, timeout=5.0)
    assert aircraft.state.battery is not None
    with pytest.raises(TelemetryStalled, match="pigs"):
        aircraft.wait_for(lambda state: False, timeout=0.2, what="pigs")


def test_a_subscription_ends_with_the_line(connect: Connect) -> None:
    aircraft = connect()
    samples: Subscription[object] = aircraft.telemetry()  # type: ignore[assignment]  # of samples
    assert samples.get(timeout=5.0)
    other = threading.Thread(target=aircraft.close)
    other.start()
    with pytest.raises((LinkClosed, UsageError)):
        for _ in samples:
            pass
    other.join()


def test_gimbal_and_camera(connect: Connect) -> None:
    with sync.connect("sim://?firmware=3.1") as aircraft:
        aircraft.activate(Credentials(DEMO_APP_ID, DEMO_KEY))
        aircraft.gimbal.set_angles(pitch=-45, seconds=1.0, wait=True)
        assert repr(aircraft.gimbal).startswith("<AircraftGimbal yaw 0.0°, pitch -4")
        with aircraft.gimbal.hold_angular_rates(pitch=20) as rates:
            aircraft.collect(Attitude, seconds=1.0)
            rates.set(yaw=20)
            with pytest.raises(UsageError, match="yaw rate 200"):
                rates.set(yaw=200)
            aircraft.collect(Attitude, seconds=1.0)
        aircraft.gimbal.set_angular_rates(yaw=20, seconds=1.0)
        assert (seen := aircraft.state.gimbal)
        assert seen.pitch_deg == pytest.approx(-23, abs=4.0)
        assert seen.yaw_deg == pytest.approx(40, abs=6.0)
        aircraft.camera.take_photo()
        aircraft.camera.start_video()
        aircraft.camera.stop_video()
