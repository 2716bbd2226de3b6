"""A virtual aircraft for the tests of your own programs: pytest fixtures and what they stand on.

In your ``conftest.py``::

    pytest_plugins = ["m100link.testing"]

and then::

    @pytest.mark.anyio
    async def test_it_stops_when_the_pilot_takes_over(virtual_aircraft):
        async with virtual_aircraft.connect() as aircraft:
            await aircraft.activate(virtual_aircraft.credentials)
            ...
            virtual_aircraft.leave_f()

Fixtures:

``virtual_aircraft``
    A Matrice 100 that stands ready to fly, on virtual time: ten minutes take seconds.
``virtual_clock``
    Virtual time alone. Tests that use it, or ``virtual_aircraft``, run on an event loop whose time
    jumps to the next timer instead of waiting.
``virtual_serial_pair``
    Two serial ports joined by a cable, in real time, for code that opens a port by name.
``virtual_aircraft_port``
    The name of a serial port with a virtual aircraft behind it, in real time, for code that opens a
    port by name. It runs in a thread, so it answers synchronous programs, too.
``anyio_backend``
    The backend of anyio's pytest plugin: asyncio, with the virtual clock for tests that use it.

The seed of the aircraft is printed when a test fails; set it with the marker
``@pytest.mark.aircraft(seed=7)``, which takes every argument of
:class:`~m100link.sim.VirtualAircraft`.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import selectors
import threading
import warnings
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Any

try:
    import pytest
except ModuleNotFoundError as error:  # pragma: no cover - every test has pytest
    raise ModuleNotFoundError(
        "m100link.testing is fixtures for pytest, which is not installed\n"
        "  what to do:   pip install pytest",
        name=error.name,
        path=error.path,
    ) from None

from m100link.aircraft import Aircraft, connect
from m100link.link import Link
from m100link.sim import Driver, PtyPort, VirtualAircraft, VirtualClockEventLoop
from m100link.sim.ports.pty import open_terminal

if TYPE_CHECKING:
    from m100link.link import MemoryTransport
    from m100link.protocol.firmware import FirmwareProfile

__all__ = [
    "ConnectableAircraft",
    "VirtualClock",
    "VirtualPort",
    "VirtualSerialPair",
    "anyio_backend",
    "virtual_aircraft",
    "virtual_aircraft_port",
    "virtual_clock",
    "virtual_serial_pair",
]


class ConnectableAircraft(VirtualAircraft):
    """A virtual aircraft with the other end of the cable in reach.

    Time passes for it from the first :meth:`connect` on, by the clock of the event loop.
    """

    __slots__ = ("_driver",)

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self._driver: Driver | None = None

    @property
    def driver(self) -> Driver:
        """The driver that lets its time pass on the running event loop."""
        loop = asyncio.get_running_loop()
        if self._driver is None or self._driver.loop is not loop:
            self._driver = Driver(self, loop)
            self._driver.start()
        return self._driver

    @asynccontextmanager
    async def connect(
        self, *, firmware: str | FirmwareProfile | None = None, timeout: float | None = None
    ) -> AsyncIterator[Aircraft]:
        """The same as :func:`m100link.connect`, over a cable in memory."""
        link = await self.open_link()
        async with connect(link, firmware=firmware, timeout=timeout) as aircraft:
            yield aircraft

    async def open_link(self) -> Link:
        """A link to it and nothing above: no version query, no activation."""
        link = Link()
        link.name = "virtual aircraft"
        self.connect_protocol(link)
        await link.wait_connected()
        return link

    def connect_protocol(self, protocol: asyncio.Protocol) -> MemoryTransport:
        """Join any asyncio protocol to it by a cable in memory."""
        return self.driver.connect(protocol)

    def stop(self) -> None:
        """Let its time stand still and hang up."""
        if self._driver is not None:
            self._driver.stop()
            self._driver = None


class VirtualClock:
    """The time of a test on the virtual clock."""

    @property
    def now(self) -> float:
        """Virtual seconds since the test's event loop was made."""
        return asyncio.get_running_loop().time()

    async def sleep_until(self, time: float) -> None:
        """Let time pass until then; the past is not waited for."""
        await asyncio.sleep(max(0.0, time - self.now))


class VirtualSerialPair:
    """Two pseudo-terminals joined by a cable: what one program writes the other reads.

    Attributes:
        first, second: Names of the two ports, such as ``/dev/pts/3``.
    """

    def __init__(self) -> None:
        ends = [open_terminal() for _ in range(2)]
        self._ends = [(master, slave) for master, slave, _ in ends]
        self.first, self.second = (device for *_, device in ends)
        self._stop_reader, self._stop_writer = os.pipe()
        self._thread = threading.Thread(target=self._pump, name="virtual serial pair", daemon=True)
        self._thread.start()

    def _pump(self) -> None:
        masters = [master for master, _ in self._ends]
        with selectors.DefaultSelector() as selector:
            for master in (*masters, self._stop_reader):
                selector.register(master, selectors.EVENT_READ)
            while True:
                for key, _ in selector.select():
                    if key.fd == self._stop_reader:
                        return
                    with contextlib.suppress(BlockingIOError):
                        other = masters[1] if key.fd == masters[0] else masters[0]
                        # A reader who does not keep up loses bytes, as on a line without
                        # flow control.
                        os.write(other, os.read(key.fd, 4096))

    def close(self) -> None:
        """Unplug both ends."""
        if self._thread.is_alive():
            os.write(self._stop_writer, b"x")
            self._thread.join()
            for descriptor in (*sum(self._ends, ()), self._stop_reader, self._stop_writer):
                os.close(descriptor)


class VirtualPort:
    """A virtual aircraft behind a pseudo-terminal, run by a thread in real time.

    Attributes:
        aircraft: The aircraft. Its methods may be called through :meth:`call` only, because its
            time passes in another thread.
        name: Name of the port to open.
    """

    def __init__(self, **options: Any) -> None:
        self.aircraft = VirtualAircraft(**options)
        self._loop = asyncio.new_event_loop()
        self._driver = Driver(self.aircraft, self._loop)
        self.name = PtyPort(self._driver).name
        self._thread = threading.Thread(target=self._run, name="virtual aircraft", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            self._loop.run_forever()
        finally:
            self._driver.stop()
            self._loop.close()

    def call(self, method: str, *arguments: Any, **options: Any) -> Any:
        """Call a method of the aircraft in its own thread: ``port.call("set_rc_mode", "P")``."""

        async def run() -> Any:
            return getattr(self.aircraft, method)(*arguments, **options)

        return asyncio.run_coroutine_threadsafe(run(), self._loop).result(timeout=60.0)

    def close(self) -> None:
        """Take the port away."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._loop.stop)
            self._thread.join()


def pytest_configure(config: pytest.Config) -> None:
    """Make the marker known."""
    config.addinivalue_line(
        "markers", "aircraft(**options): options of the fixtures' VirtualAircraft"
    )


def _options(request: pytest.FixtureRequest) -> dict[str, Any]:
    marker = request.node.get_closest_marker("aircraft")
    options: dict[str, Any] = {} if marker is None else dict(marker.kwargs)
    options.setdefault("seed", 1)
    return options


_VIRTUAL = ("virtual_clock", "virtual_aircraft")
_IN_REAL_TIME = (
    "this test flew in real time, on an event loop that is not anyio's: mark it pytest.mark.anyio, "
    "and with pytest-asyncio leave asyncio_mode at strict"
)


@pytest.fixture
def anyio_backend(request: pytest.FixtureRequest) -> object:
    """asyncio; on virtual time for tests that use a fixture which needs it."""
    names = request.fixturenames
    if any(name in names for name in _VIRTUAL):
        return "asyncio", {"loop_factory": VirtualClockEventLoop}
    return "asyncio"


@pytest.fixture
def virtual_clock() -> VirtualClock:
    """Virtual time: nothing in the test really waits."""
    return VirtualClock()


@pytest.fixture
def virtual_aircraft(request: pytest.FixtureRequest) -> Iterator[ConnectableAircraft]:
    """A Matrice 100 that stands ready to fly, on virtual time."""
    aircraft = ConnectableAircraft(**_options(request))
    print(f"virtual aircraft: {aircraft!r}")  # noqa: T201 (pytest shows it when the test fails)
    yield aircraft
    _end(aircraft)


def _end(aircraft: ConnectableAircraft) -> None:
    loop = None if aircraft._driver is None else aircraft._driver.loop
    if not isinstance(loop, VirtualClockEventLoop | None):
        warnings.warn(_IN_REAL_TIME, stacklevel=2)
    with contextlib.suppress(RuntimeError):  # the event loop is closed already
        aircraft.stop()


@pytest.fixture
def virtual_serial_pair() -> Iterator[VirtualSerialPair]:
    """Two serial ports joined by a cable, in real time."""
    pair = VirtualSerialPair()
    yield pair
    pair.close()


@pytest.fixture
def virtual_aircraft_port(request: pytest.FixtureRequest) -> Iterator[VirtualPort]:
    """A serial port with a virtual aircraft behind it, in real time."""
    port = VirtualPort(**_options(request))
    print(f"virtual aircraft behind {port.name}: {port.aircraft!r}")  # noqa: T201 (see above)
    yield port
    port.close()


if __name__ == "__main__":
    # A module of fixtures has nothing to run: show how it is used.
    print(__doc__)  # noqa: T201
