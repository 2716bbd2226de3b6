"""Connection strings."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from m100link.errors import BadURL
from m100link.link.url import (
    DEFAULT_BAUD_RATE,
    EXAMPLES,
    ConnectionString,
    parse_replay,
    parse_url,
)


@pytest.mark.parametrize(
    ("url", "device", "baud_rate"),
    [
        ("serial:///dev/ttyUSB0:230400", "/dev/ttyUSB0", 230400),
        ("serial:///dev/ttyUSB0", "/dev/ttyUSB0", 230400),
        ("/dev/ttyUSB0", "/dev/ttyUSB0", 230400),
        ("/dev/ttyUSB0:115200", "/dev/ttyUSB0", 115200),
        ("/dev/ttyUSB0,921600", "/dev/ttyUSB0", 921600),
        ("  /dev/ttyUSB0\n", "/dev/ttyUSB0", 230400),
        (
            "/dev/serial/by-path/pci-0000:00:14.0-usb:115200",
            "/dev/serial/by-path/pci-0000:00:14.0-usb",
            115200,
        ),
        (
            "/dev/serial/by-path/pci-0000:00:14.0-usb-0:1:1.0-port0",
            "/dev/serial/by-path/pci-0000:00:14.0-usb-0:1:1.0-port0",
            230400,
        ),
        ("./link", "./link", 230400),
        ("~/link", "~/link", 230400),
        ("COM3", "COM3", 230400),
        ("COM12:57600", "COM12", 57600),
    ],
)
def test_serial_ports(url: str, device: str, baud_rate: int) -> None:
    assert parse_url(url) == ConnectionString("serial", device, baud_rate)


def test_the_default_rate_is_the_documents_and_can_be_given_apart() -> None:
    assert DEFAULT_BAUD_RATE == 230_400
    assert parse_url("/dev/ttyUSB0", baud_rate=57600).number == 57600
    assert parse_url("/dev/ttyUSB0:115200", baud_rate=57600).number == 115200


@pytest.mark.parametrize(
    ("url", "host", "port"),
    [("tcp://192.168.1.5:7000", "192.168.1.5", 7000), ("tcp://[::1]:7000", "::1", 7000)],
)
def test_tcp(url: str, host: str, port: int) -> None:
    assert parse_url(url) == ConnectionString("tcp", host, port)


def test_any_other_scheme_is_left_to_its_transport() -> None:
    assert parse_url("sim://?wind=3") == ConnectionString("sim", "?wind=3")


BAD = [
    "",
    "   ",
    "ttyUSB0",
    "230400",
    "serial://",
    "serial://:9600",
    "/dev/ttyUSB0:fast",
    "/dev/ttyUSB0:0",
    "/dev/ttyUSB0:-9600",
    "/dev/ttyUSB0,",
    "tcp://",
    "tcp://host",
    "tcp://:7000",
    "tcp://host:port",
    "tcp://host:99999",
    "://x",
    "Ser ial://x",
]


@pytest.mark.parametrize("url", BAD)
def test_a_bad_url_is_quoted_beside_examples_that_work(url: str) -> None:
    with pytest.raises(BadURL) as caught:
        parse_url(url)
    assert repr(url) in caught.value.seen
    assert len(EXAMPLES) >= 3
    for example in EXAMPLES:
        assert example in str(caught.value)
        assert parse_url(example).scheme in ("serial", "tcp", "sim", "replay")


@pytest.mark.parametrize(
    ("url", "seen"),
    [
        ("replay://", "names no file"),
        ("replay://f?to=3", "has the option 'to'"),
        ("replay://f?from=5&until=5", "ends before it begins"),
        ("replay://f?speed=0", "has the speed '0', which is not"),
        ("replay://f?from=soon", "has from='soon', which is not a number of seconds"),
        ("replay://f?until=-1", "has until='-1', which is not a number of seconds"),
    ],
)
def test_a_recording_is_named_and_its_part_is_one(url: str, seen: str) -> None:
    with pytest.raises(BadURL) as refusal:
        parse_replay(url)
    assert seen in refusal.value.seen


@given(st.text(max_size=60))
def test_any_text_is_an_address_or_a_bad_url(text: str) -> None:
    try:
        address = parse_url(text)
    except BadURL:
        return
    assert address.target or address.scheme not in ("serial", "tcp", "sim")


def test_an_address_reads_as_people_say_it() -> None:
    assert str(parse_url("/dev/ttyUSB0")) == "/dev/ttyUSB0 at 230400 baud"
    assert str(parse_url("tcp://host:7000")) == "tcp://host:7000"
    assert str(parse_url("sim://")) == "sim://"


@pytest.mark.parametrize("name", ["key", "app-id", "app_id", "KEY"])
def test_a_secret_is_not_shown(name: str) -> None:
    shown = str(parse_url(f"sim://?seed=7&{name}=5a5a5a&loss=0.1"))
    assert shown == f"sim://?seed=7&{name}=…&loss=0.1"
