"""What the aircraft answers, and what becomes of it: activation, key, switch, authority."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import pytest

from m100link.apps.doctor import Stage, Verdict, diagnose
from m100link.apps.doctor.answers import _firmware
from m100link.protocol.firmware import PROFILES
from m100link.sim import VirtualAircraft
from m100link.sim.orders.actions import perform
from m100link.sim.ports.url import aircraft_of
from tests.apps.doctor.setups import APP

pytestmark = pytest.mark.anyio


@pytest.fixture
def ordered(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Has orders be given to each virtual aircraft that a URL makes."""

    def give(*orders: str) -> None:
        def made(url: str) -> VirtualAircraft:
            aircraft = aircraft_of(url)
            for order in orders:
                perform(aircraft, order.split())
            return aircraft

        monkeypatch.setattr("m100link.sim.ports.driver.aircraft_of", made)

    return give


@pytest.mark.parametrize("firmware", ["1.0", "2.3", "3.1"])
@pytest.mark.parametrize(
    ("order", "seen", "cause"),
    [
        ("api off", "the switch is in F", "API control is not enabled"),
        ("ioc on", "", ""),
    ],
)
async def test_control_is_refused(
    ordered: Callable[..., None], firmware: str, order: str, seen: str, cause: str
) -> None:
    ordered(order)
    report = await diagnose(f"sim://?firmware={firmware}", credentials=APP, authority=True)
    if order == "ioc on" and firmware == "3.1":
        assert report.failure is None  # which it does not mind
        return
    assert report.failure is not None
    assert report.failure.stage is Stage.AUTHORITY
    assert seen in report.failure.seen
    assert cause in report.failure.causes[0]
    assert report.failure.commands


@pytest.mark.parametrize("authority", [False, True])
async def test_control_is_not_asked_of_an_aircraft_in_the_air(
    ordered: Callable[..., None], authority: bool
) -> None:
    ordered("take-off")
    report = await diagnose("sim://", credentials=APP, authority=authority)
    last = report.findings[-1]
    assert (last.stage, last.verdict) == (Stage.AUTHORITY, Verdict.SKIPPED)
    assert last.seen == "it is not seen standing on the ground with its motors off"
    assert last.details == {"may_be_tried": False}


async def test_nobody_takes_control_unasked() -> None:
    report = await diagnose("sim://", credentials=APP)
    last = report.findings[-1]
    assert (last.verdict, last.details) == (Verdict.SKIPPED, {"may_be_tried": True})


async def test_telemetry_may_be_off(ordered: Callable[..., None]) -> None:
    items = "time quaternion acceleration velocity angular_velocity position magnetometer rc gimbal"
    rates = " ".join(f"{item}=0" for item in [*items.split(), "flight_status", "battery"])
    ordered(f"rates {rates} control_device=0")
    report = await diagnose("sim://", credentials=APP)
    verdicts = {one.stage: one.verdict for one in report.findings}
    assert report.failure is None
    assert verdicts[Stage.TELEMETRY] is Verdict.DOUBTFUL
    assert verdicts[Stage.MODE_SWITCH] is Verdict.SKIPPED


@pytest.mark.parametrize(("mismatches", "verdict"), [(2, Verdict.GOOD), (3, Verdict.FAILED)])
def test_three_packages_that_do_not_fit_are_another_firmware(
    mismatches: int, verdict: Verdict
) -> None:
    """Two may be what a line spoils: one in 65,536 damaged frames has a right checksum."""
    aircraft = SimpleNamespace(firmware=PROFILES["2.3"], telemetry_mismatches=mismatches)
    version = SimpleNamespace(profile=PROFILES["2.3"])
    told = _firmware(cast(Any, aircraft), cast(Any, version), is_forced=True)
    assert (told.stage, told.verdict) == (Stage.FIRMWARE, verdict)
