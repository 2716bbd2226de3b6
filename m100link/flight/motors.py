"""Starting and stopping the motors on the ground, without taking off (firmware 3.1)."""

from __future__ import annotations

from collections.abc import Callable

from m100link.errors import TaskRefused, TelemetryStalled
from m100link.flight.guards import GuardKeeper
from m100link.flight.known import known
from m100link.flight.tasks import Commander, describe_situation
from m100link.protocol.codes import ArmCode
from m100link.protocol.commands.control import Arm
from m100link.protocol.records import FlightPhase, FlightStatus

__all__ = ["Motors", "is_on_ground", "switch_motors"]


def is_on_ground(commander: Commander) -> bool | None:
    """Whether the flight status says so; None when nobody knows."""
    status = known(commander.state, FlightStatus)
    return None if status is None else status.status == FlightPhase.STANDBY


async def switch_motors(commander: Commander, *, on: bool) -> None:
    """Start or stop them; that they run, or stand, already is no error.

    Raises:
        TaskRefused: With the code.
        CommandNotSupported, NotActivated, LevelTooLow, KeyRejected, AckTimeout, LinkError: See each
            class.
    """
    code = await commander.requests.execute(Arm(on), timeout=0.2, tries=3, refusal=TaskRefused)
    if code not in (ArmCode.DONE, ArmCode.ALREADY):
        raise _refused("arm" if on else "disarm", commander, code, code.meaning)


def _refused(what: str, commander: Commander, code: ArmCode, seen: str) -> TaskRefused:
    situation = commander.state.situation()
    return TaskRefused(
        f"{what} was refused: {seen} (code {int(code)}; {describe_situation(situation)})",
        command=what,
        code=int(code),
        situation=situation,
        cause=code.cause,
        remedy=code.remedy,
    )


class Motors:
    """The motors of the aircraft of one control block.

    Args:
        commander: The aircraft.
        guards: Asked before the motors start, as before a take-off.
        make_way: Called before either; raises when something else is flying, and ends setpoints.
        on_armed: Told when they may run because of this block, and when they do not.
    """

    def __init__(
        self,
        commander: Commander,
        guards: GuardKeeper,
        make_way: Callable[[str], None],
        on_armed: Callable[[bool], None],
    ) -> None:
        self._commander = commander
        self._guards = guards
        self._make_way = make_way
        self._on_armed = on_armed

    async def arm(self) -> None:
        """Start the motors on the ground; they idle, and the aircraft stays where it is.

        Only for programs that take off by setpoints of their own: a setpoint with thrust, height or
        a climb rate lifts it from there. ``take_off()`` starts the motors itself, and **fails while
        they run** (facts K7). With nothing commanded they stop by themselves after about 20 s; when
        the block ends on the ground they are stopped. Firmware 3.1.

        Raises:
            NoAuthority: Authority is not held.
            GuardRefused: As for a take-off.
            TaskRefused: With the code; or another task, or a closed loop, is under way.
            CommandNotSupported: The firmware is older; nothing was sent.
            AckTimeout: Nobody knows whether they run.
        """
        self._make_way("arm")
        await self._guards.admit_take_off()
        self._on_armed(True)  # whatever becomes of the ack
        await switch_motors(self._commander, on=True)

    async def disarm(self) -> None:
        """Stop the motors on the ground; landing stops them by itself.

        **In the air nothing is sent**: the aircraft would refuse it (facts A2), and this does not
        rely on that.

        Raises:
            NoAuthority: Authority is not held.
            TaskRefused: It is in the air (code 3), or another task is under way.
            TelemetryStalled: Nobody knows whether it is on the ground; nothing was sent.
            CommandNotSupported: The firmware is older; nothing was sent.
            AckTimeout: Nobody knows whether they stand.
        """
        self._make_way("disarm")
        on_ground = is_on_ground(self._commander)
        if on_ground is None:
            raise TelemetryStalled(
                "disarm was not sent: nobody knows whether the aircraft is on the ground",
                cause="the flight status is not among the telemetry items, or old",
                remedy="set_telemetry_rates(flight_status=10), or in the PC assistant",
            )
        if not on_ground:
            raise _refused(
                "disarm", self._commander, ArmCode.IN_THE_AIR, "the aircraft is in the air"
            )
        await switch_motors(self._commander, on=False)
        self._on_armed(False)
