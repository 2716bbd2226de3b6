"""Programs, pilots and lines at random: what must hold in every flight, whatever happens in it.

(a) No setpoint arrives from a program that knows that it has no authority.
(b) Movement ends with the lifetime of the last wish, the neutral within its time after that.
(c) Never more than 50 frames a second on average.
(d) Half a second after the pilot left F nothing leaves, once the line works.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import struct
from collections.abc import Awaitable, Callable
from random import Random
from typing import Any

import pytest

from m100link import (
    AuthorityError,
    AuthorityState,
    CommandRefused,
    Control,
    Envelope,
    GuardRefused,
    Guards,
    M100Error,
    NotObserved,
    Setpoint,
    TelemetryError,
    UsageError,
)
from m100link.flight.setpoints import NEUTRAL_TIME
from m100link.protocol.commands.control import Move
from m100link.protocol.records import RcMode
from m100link.sim import NO_FAULTS, LineFaults
from tests.rig import FIRMWARES, Rig, rig

pytestmark = pytest.mark.anyio

EXPECTED = (AuthorityError, CommandRefused, GuardRefused, NotObserved, TelemetryError, UsageError)
SLOT = 0.02


class Witness:
    """Stands between the program and the line and sees each movement leave.

    Attributes:
        left: Time of each frame that left.
        violations: Of what must hold.
        quiet_from: Since when the pilot has it and the line says so, infinite while it is not so.
        wanted_until: When the newest wish expires.
    """

    def __init__(self, flown: Rig) -> None:
        self.flown = flown
        self.left: list[float] = []
        self.violations: list[str] = []
        self.quiet_from = math.inf
        self.wanted_until = 0.0
        link = flown.aircraft.link
        push = link.push

        def seen(data: bytes, *, encrypted: bool = False) -> bool:
            if data[:2] == bytes(Move.ADDRESS):
                self._judge(Move(*struct.unpack("<B4f", data[2:])))
            return push(data, encrypted=encrypted)

        link.push = seen  # type: ignore[method-assign]

    def _judge(self, move: Move) -> None:
        now = self.flown.now
        self.left.append(now)
        if self.flown.aircraft.authority.state is not AuthorityState.HELD:
            self.violations.append(f"{now:.3f} (a) {self.flown.aircraft.authority.state}")
        if now - self.quiet_from > 0.5:
            self.violations.append(f"{now:.3f} (d) out of F since {self.quiet_from:.3f}")
        # Once for the setpoint that ended, once more when the block ends meanwhile.
        patience = 2 * NEUTRAL_TIME + SLOT if self.flown.is_neutral(move) else 0.0
        if now > self.wanted_until + patience:
            self.violations.append(f"{now:.3f} (b) wanted until {self.wanted_until:.3f}: {move}")

    async def watch_the_pilot(self) -> None:
        line = self.flown.virtual.line
        while True:
            is_hearing = line.to_host.is_clean
            if self.flown.virtual.remote.sticks().mode is RcMode.F or not is_hearing:
                self.quiet_from = math.inf
            else:
                self.quiet_from = min(self.quiet_from, self.flown.now)
            await asyncio.sleep(0.01)

    def check_rate(self) -> None:
        for count in (10, 50, 500):
            for first, last in zip(self.left, self.left[count:], strict=False):
                if last - first < (count - 1) * SLOT - 1e-6:
                    self.violations.append(f"{first:.3f} (c) {count} frames until {last:.3f}")

    def renew(self, lifetime: float) -> None:
        self.wanted_until = max(self.wanted_until, self.flown.now + lifetime)


class Flight:
    """A control block in which a program does things at random while things happen to it."""

    def __init__(self, flown: Rig, seed: int) -> None:
        self.flown = flown
        self.random = Random(seed)
        self.witness = Witness(flown)
        self.log: list[str] = []

    def setpoint(self) -> Setpoint:
        random = self.random
        speed = random.choice([-8.0, -2.0, 0.0, 1.0, 3.0, 8.0])
        return random.choice(
            [
                Setpoint.velocity(north=speed, east=1.0, up=0.0, yaw_rate_deg_s=0.0),
                Setpoint.velocity(forward=0.0, right=0.0, up=speed / 4, yaw_rate_deg_s=20.0),
                Setpoint.position_offset(north=speed, east=0.0, height=6.0, yaw_deg=0.0),
                Setpoint.tilt(roll_deg=speed, pitch_deg=0.0, up=0.0, yaw_rate_deg_s=0.0),
                Setpoint.tilt(roll_deg=0.0, pitch_deg=speed, height=9.0, yaw_deg=3.0),
                Setpoint.velocity(north=0.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0),
            ]
        )

    def options(self) -> dict[str, Any]:
        random = self.random
        lifetime = random.choice([0.01, 0.05, 0.2, 0.2, 0.5, 1.0, 3.0, 10.0])
        rate_hz = random.choice([0.5, 2.0, 10.0, 33.0, 50.0, 50.0])
        return {"lifetime": lifetime, "rate_hz": rate_hz, "allow_long_lifetime": True}

    async def pause(self) -> None:
        await asyncio.sleep(self.random.choice([0.0, 0.001, 0.013, 0.02, 0.1, 0.4, 1.5]))

    # -- what the program does -------------------------------------------------------------------

    async def send(self, control: Control) -> None:
        for _ in range(self.random.randint(1, 30)):
            options = self.options()
            self.witness.renew(options["lifetime"])
            control.send(self.setpoint(), **options)
            self.narrow(options["lifetime"])
            await asyncio.sleep(self.random.choice([0.0, 0.004, 0.02, 0.02, 0.05]))

    def narrow(self, lifetime: float) -> None:
        """What is newer replaces what lived longer."""
        self.witness.wanted_until = self.flown.now + lifetime

    async def hold(self, control: Control) -> None:
        options = self.options()
        self.witness.renew(options["lifetime"])
        async with control.hold(self.setpoint(), **options) as hold:
            self.narrow(options["lifetime"])
            for _ in range(self.random.randint(0, 5)):
                await self.pause()
                self.witness.renew(options["lifetime"])
                hold.set(self.setpoint())
                self.narrow(options["lifetime"])
            await self.pause()
        self.narrow(0.0)

    async def stop(self, control: Control) -> None:
        self.narrow(0.0)
        await control.stop()

    async def climb(self, control: Control) -> None:
        self.witness.renew(30.0)
        try:
            await control.climb_to(self.random.uniform(2.0, 12.0), timeout=5.0)
        finally:
            self.witness.wanted_until = self.flown.now  # it has stopped, and waited for that

    async def circle(self, control: Control) -> None:
        self.witness.renew(30.0)
        try:
            async with asyncio.timeout(self.random.uniform(0.1, 8.0)):
                await control.orbit(center_north=4.0, center_east=0.0)
        except TimeoutError as error:
            if isinstance(error, M100Error):
                raise
        finally:
            self.witness.wanted_until = self.flown.now + 0.2

    async def resume(self, control: Control) -> None:
        with contextlib.suppress(AuthorityError):
            control.resume()

    async def program(self, control: Control) -> None:
        deeds: list[Callable[[Control], Awaitable[None]]] = [
            self.send,
            self.send,
            self.hold,
            self.stop,
            self.climb,
            self.circle,
            self.resume,
        ]
        for _ in range(self.random.randint(3, 12)):
            deed = self.random.choice(deeds)
            self.log.append(f"{self.flown.now:.3f} {deed.__name__}")
            try:
                await deed(control)
            except EXPECTED as error:
                self.log.append(f"{self.flown.now:.3f}   {type(error).__name__}: {error.seen}")
            await self.pause()

    # -- what happens to it ----------------------------------------------------------------------

    async def world(self) -> None:
        virtual, random = self.flown.virtual, self.random
        for _ in range(random.randint(0, 8)):
            await asyncio.sleep(random.expovariate(1 / 1.5))
            happening = random.choice(
                [
                    virtual.leave_f,
                    virtual.return_to_f,
                    virtual.return_to_f,
                    virtual.app_takes_control,
                    virtual.app_releases_control,
                    self.deafen,
                    self.lose_some,
                    self.lose_gps,
                    self.find_gps,
                    self.watch_device,
                ]
            )
            self.log.append(f"{self.flown.now:.3f} -> {happening.__name__}")
            happening()

    def deafen(self) -> None:
        """Nothing arrives from the aircraft for a while."""
        virtual, loop = self.flown.virtual, asyncio.get_running_loop()
        virtual.line.stall(to_host=True, to_aircraft=False)
        loop.call_later(self.random.uniform(0.05, 1.5), virtual.stall_line, False)

    def lose_some(self) -> None:
        virtual, loop = self.flown.virtual, asyncio.get_running_loop()
        virtual.set_faults(LineFaults(loss=0.3), to_aircraft=LineFaults(loss=0.1))
        loop.call_later(self.random.uniform(0.05, 1.0), virtual.set_faults, NO_FAULTS)

    def lose_gps(self) -> None:
        self.flown.virtual.gps_health = 1

    def find_gps(self) -> None:
        self.flown.virtual.gps_health = 5

    def watch_device(self) -> None:
        self.flown.virtual.set_rates(control_device=self.random.choice([0, 1, 50]))

    # -- all of it -------------------------------------------------------------------------------

    async def run(self) -> None:
        flown, virtual = self.flown, self.flown.virtual
        flight = virtual.vehicle.flight
        flight.start_motors()
        flight.dynamics.place(0.0, 0.0, 5.0)
        virtual.pilot_takes_off()
        await asyncio.sleep(3.0)
        watch = asyncio.create_task(self.witness.watch_the_pilot())
        guards = Guards(envelope=Envelope(max_radius_m=60, max_height_m=20))
        for _ in range(2):
            world = asyncio.create_task(self.world())
            try:
                async with flown.aircraft.control(
                    guards=guards, on_pause=self.random.choice(["raise", "wait"])
                ) as control:
                    await self.program(control)
                    self.narrow(0.0)
            except EXPECTED as error:
                self.log.append(f"{flown.now:.3f} block: {type(error).__name__}: {error.seen}")
            finally:
                world.cancel()
                await asyncio.wait([world])
            ended_at, count = flown.now, len(self.witness.left)
            virtual.set_faults()
            virtual.stall_line(False)
            virtual.app_releases_control()
            virtual.return_to_f()
            await asyncio.sleep(3.0)
            assert len(self.witness.left) == count, f"sent after the block, since {ended_at}"
        watch.cancel()
        self.witness.check_rate()
        assert self.witness.violations == []


@pytest.mark.parametrize("firmware", FIRMWARES)
@pytest.mark.parametrize("seed", range(8))
async def test_a_flight_at_random(firmware: str, seed: int) -> None:
    async with rig(firmware=firmware, seed=seed) as flown:
        flight = Flight(flown, seed)
        try:
            async with asyncio.timeout(600.0):
                await flight.run()
        except BaseException:
            print("\n".join(flight.log))  # noqa: T201 (pytest shows it when the test fails)
            raise
