"""The text of a rule."""

from __future__ import annotations

import pytest

from m100link.apps.doctor.machine import Adapter, rule
from m100link.errors import UsageError

FTDI = Adapter("ftdi_sio", "0403", "6001", "FTDI FT232R USB UART", "A50285BI", 16)
CP2102 = Adapter("cp210x", "10c4", "ea60", "Silicon Labs CP2102", "")


def test_a_rule_names_the_adapter_its_group_and_keeps_others_away() -> None:
    title, port, timer = rule(FTDI, "m100").splitlines()
    assert title == "# FTDI FT232R USB UART of the aircraft: /dev/m100"
    assert port.split(", ") == [
        'SUBSYSTEM=="tty"',
        'ATTRS{idVendor}=="0403"',
        'ATTRS{idProduct}=="6001"',
        'SYMLINK+="m100"',
        'GROUP="dialout"',
        'MODE="0660"',
        'ENV{ID_MM_DEVICE_IGNORE}="1"',
    ]
    assert timer.endswith('SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{latency_timer}="1"')


def test_only_ftdi_adapters_have_a_timer_and_only_this_one_its_number() -> None:
    assert "latency_timer" not in rule(CP2102, "m100")
    assert 'ATTRS{serial}=="A50285BI", ' in rule(FTDI, "left", group="plugdev", by_serial=True)
    assert 'GROUP="plugdev"' in rule(FTDI, "left", group="plugdev", by_serial=True)


@pytest.mark.parametrize(
    ("adapter", "name", "by_serial", "seen"),
    [
        (FTDI, 'm100", RUN+="rm', False, "cannot be the name"),
        (FTDI, "", False, "cannot be the name"),
        (FTDI, "../m100", False, "cannot be the name"),
        (Adapter("port"), "m100", False, "not on USB"),
        (CP2102, "m100", True, "tells no serial number"),
    ],
)
def test_what_cannot_be_a_rule_is_refused(
    adapter: Adapter, name: str, by_serial: bool, seen: str
) -> None:
    with pytest.raises(UsageError, match=seen):
        rule(adapter, name, by_serial=by_serial)
