"""Rows of equal width: names, missing values, times, collecting, and the recipe of the manual."""

from __future__ import annotations

import asyncio
import math
import random
import sys
import time
from typing import Any

import pytest

from m100link import (
    Attitude,
    Battery,
    Columns,
    FlightStatus,
    LinkLost,
    Magnetometer,
    Position,
    RemoteControl,
    Sample,
    Table,
    TelemetryOverflow,
    TelemetryStalled,
    Velocity,
)
from m100link.errors import UsageError
from m100link.protocol import encode_telemetry, profile
from m100link.protocol.items import ITEMS
from m100link.protocol.packet import telemetry_size
from m100link.telemetry.columns import columns_of
from m100link.telemetry.subscription import Hub, Lossless
from tests.rig import FIRMWARES, rig

pytestmark = pytest.mark.anyio


def sample(items: dict[str, tuple[Any, ...]], firmware: str = "3.1", at: float = 2.5) -> Sample:
    known = profile(firmware)
    return Sample(encode_telemetry(items, known), known, at)


def by_name(columns: Columns, package: Sample) -> dict[str, float]:
    return dict(zip(columns.names, columns.row(package), strict=True))


# -- rows -----------------------------------------------------------------------------------------


def test_the_columns_are_those_of_the_command_line_after_both_times() -> None:
    columns = Columns(Velocity, Battery, Velocity, utc_offset_s=0.0)
    assert columns.names == (
        *("received_at", "utc", "velocity.north_m_s", "velocity.east_m_s", "velocity.up_m_s"),
        *("velocity.status", "velocity.ground_speed_m_s", "battery.percent"),
    )
    every = Columns(utc_offset_s=0.0)
    assert every.names[2:] == tuple(columns_of(item.record for item in ITEMS))


def test_what_was_not_received_is_nan_and_never_zero() -> None:
    columns = Columns(Attitude, Battery, utc_offset_s=1e9)
    values = by_name(columns, sample({"battery": (0,)}))
    assert values["battery.percent"] == 0.0
    assert math.isnan(values["quaternion.yaw_deg"])
    assert (values["received_at"], values["utc"]) == (2.5, 1e9 + 2.5)


def test_what_the_firmware_does_not_have_is_nan() -> None:
    columns = Columns(Velocity, utc_offset_s=0.0)
    values = by_name(columns, sample({"velocity": (3.0, 4.0, 1.0)}, "1.0"))
    assert values["velocity.ground_speed_m_s"] == 5.0
    assert math.isnan(values["velocity.status"])


def test_an_enumeration_is_its_number_and_an_unknown_value_nan() -> None:
    columns = Columns(RemoteControl, FlightStatus, utc_offset_s=0.0)
    values = by_name(columns, sample({"rc": (0, 0, 0, 0, 8000, 0), "flight_status": (77,)}))
    assert values["rc.mode_switch"] == 8000.0
    assert values["flight_status.status"] == 77.0
    assert math.isnan(values["flight_status.phase"])


@pytest.mark.parametrize("firmware", [*FIRMWARES, "1.0-document"])
def test_any_bytes_that_are_a_package_are_a_row_of_floats(firmware: str) -> None:
    known, chance = profile(firmware), random.Random(11)
    columns = Columns(utc_offset_s=0.0)
    for _ in range(300):
        flags = chance.getrandbits(16) & known.item_flags
        size = telemetry_size(flags, known) - 2
        row = columns.row(Sample(flags.to_bytes(2, "little") + chance.randbytes(size), known, 0.0))
        assert len(row) == len(columns.names)
        assert {type(value) for value in row} == {float}


@pytest.mark.parametrize("wrong", [int, "attitude", [], None])
def test_what_is_not_a_record_is_refused(wrong: Any) -> None:
    with pytest.raises(UsageError, match="is not a telemetry record"):
        Columns(Attitude, wrong, utc_offset_s=0.0)


# -- collecting -----------------------------------------------------------------------------------


@pytest.mark.parametrize("firmware", FIRMWARES)
async def test_rows_come_at_the_rate_of_the_aircraft_for_as_long_as_asked(firmware: str) -> None:
    async with rig(firmware=firmware) as r:
        begin = r.now
        # Virtual time had hardly passed when this connected, wall time hardly since.
        assert r.aircraft.utc_offset_s + r.now == pytest.approx(time.time(), abs=60.0)
        table = await r.aircraft.collect(Attitude, Battery, seconds=3.0)
        assert r.now == pytest.approx(begin + 3.0, abs=0.02)
        assert len(table) == pytest.approx(300, abs=3)
        times = table.column("received_at")
        assert times == sorted(times)
        assert begin <= times[0]
        assert times[-1] < begin + 3.0
        offsets = [row[1] - row[0] for row in table.rows]
        assert offsets == pytest.approx([r.aircraft.utc_offset_s] * len(table), abs=1e-3)
        batteries = [value for value in table.column("battery.percent") if not math.isnan(value)]
        assert len(batteries) == 3
        assert set(batteries) == {100.0}


async def test_the_rate_thins_the_rows() -> None:
    async with rig() as r:
        table = await r.aircraft.collect(Position, seconds=2.0, rate_hz=10)
        assert len(table) == 20


async def test_nothing_received_is_reported_and_not_an_empty_table() -> None:
    async with rig() as r:
        with pytest.raises(TelemetryStalled, match="within 2 s") as caught:
            await r.aircraft.collect(Magnetometer, seconds=2.0)  # 0 Hz by default
        assert "m100link hz" in caught.value.remedy


@pytest.mark.parametrize("seconds", [0.0, -1.0, math.inf, math.nan])
async def test_a_time_that_is_none_is_refused(seconds: float) -> None:
    async with rig() as r:
        with pytest.raises(UsageError, match="collected"):
            await r.aircraft.collect(Attitude, seconds=seconds)


async def test_a_line_that_is_lost_meanwhile_is_an_error() -> None:
    async with rig() as r:
        asyncio.get_running_loop().call_later(1.0, r.virtual.unplug)
        with pytest.raises(LinkLost):
            await r.aircraft.collect(Attitude, seconds=5.0)


async def test_what_arrives_after_the_end_is_not_in_the_table() -> None:
    hub: Hub[Sample] = Hub()
    now = asyncio.get_running_loop().time()
    samples = hub.subscribe(Lossless(10))
    for at in (now, now + 0.99, now + 1.0, now + 5.0):
        hub.publish(sample({"battery": (50,)}, at=at), at)
    table = await Columns(Battery, utc_offset_s=0.0).collect(samples, 1.0)
    assert table.column("received_at") == [now, now + 0.99]


async def test_a_program_that_was_blocked_for_too_long_gets_an_error() -> None:
    hub: Hub[Sample] = Hub()
    samples = hub.subscribe(Lossless(1))
    for at in (0.0, 0.1):
        hub.publish(sample({"battery": (50,)}, at=at), at)
    with pytest.raises(TelemetryOverflow):
        await Columns(Battery, utc_offset_s=0.0).collect(samples, 1.0)


# -- tables ---------------------------------------------------------------------------------------

TABLE = Table(("received_at", "battery.percent"), [(float(n), math.nan) for n in range(12)])


def test_a_column_is_had_by_its_name() -> None:
    assert TABLE.column("received_at") == list(range(12))
    with pytest.raises(UsageError, match="altitude") as caught:
        TABLE.column("altitude")
    assert "battery.percent" in caught.value.remedy


def test_a_notebook_shows_the_first_rows_and_nothing_for_nan() -> None:
    assert repr(TABLE) == "<Table of 12 rows: received_at, battery.percent>"
    html = TABLE._repr_html_()
    assert "10 of 12 rows" in html
    assert html.count("<tr>") == 11
    assert "<td>9</td><td></td>" in html


def test_a_notebook_shows_the_track_of_a_table_with_positions() -> None:
    names = ("position.latitude_deg", "position.longitude_deg")
    table = Table(names, [(22.5, 113.9), (math.nan, math.nan), (22.5001, 113.9)])
    html = table._repr_html_()
    assert html.index("<svg") < html.index("<table>")
    assert "<svg" not in Table(names, [])._repr_html_()
    assert "<svg" not in Table(names[:1], [(22.5,)])._repr_html_()


def test_a_column_is_had_by_the_documents_name() -> None:
    table = Table(("velocity.north_m_s", "position.height_m", "height"), [(1.0, 2.0, 3.0)])
    assert table.column("vgx") == table.column("VEL.vgx") == [1.0]
    assert table.column("height") == [3.0]  # its own name first
    with pytest.raises(UsageError, match="vgy"):
        table.column("vgy")


def test_an_array_has_a_row_per_package() -> None:
    numpy = pytest.importorskip("numpy", reason="numpy is not installed, nor needed otherwise")
    array = TABLE.to_numpy()
    assert (array.shape, array.dtype) == ((12, 2), numpy.float64)
    assert array[3, 0] == 3.0
    assert numpy.isnan(array[:, 1]).all()
    assert Table(TABLE.names, []).to_numpy().shape == (0, 2)


def test_an_array_without_numpy_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "numpy", None)
    with pytest.raises(UsageError) as caught:
        TABLE.to_numpy()
    assert caught.value.remedy == "pip install numpy"
