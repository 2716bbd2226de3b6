"""What may go down the road, and what a type checker and the road itself refuse."""

from __future__ import annotations

import asyncio
import subprocess
import sys
from pathlib import Path
from typing import Any, cast

import pytest

from m100link import CommandNotSupported, UsageError
from m100link.protocol import (
    ActivationCode,
    GetVersion,
    Move,
    RequestAuthority,
    TaskResultCode,
    Version,
)
from m100link.protocol.commands.camera import TakePhoto
from m100link.protocol.commands.control import Arm, QueryTask
from m100link.protocol.commands.gimbal import GimbalAngle
from m100link.sim import VirtualClockEventLoop
from tests.rig import FIRMWARES, rig

pytestmark = pytest.mark.anyio

MOVE = Move(0x4B, 1.0, 0.0, 0.0, 0.0)


@pytest.fixture
def anyio_backend() -> object:
    return "asyncio", {"loop_factory": VirtualClockEventLoop}


@pytest.mark.parametrize("firmware", FIRMWARES)
async def test_an_answer_is_what_its_request_declares(firmware: str) -> None:
    async with rig(firmware=firmware) as flown:
        version = await flown.aircraft.execute(GetVersion())
        assert isinstance(version, Version)
        assert version.is_activated
        result = await flown.aircraft.execute(QueryTask(0))
        assert type(result) is TaskResultCode


async def test_a_version_answer_of_an_aircraft_that_is_not_activated_is_an_answer() -> None:
    async with rig(activated=False) as flown:
        version = await flown.aircraft.execute(GetVersion())
        assert not version.is_activated
        assert version.name == flown.virtual.autopilot.profile.version_name


async def test_a_movement_is_neither_executed_nor_pushed_past_the_control_block() -> None:
    """Executed, it would have been repeated twice: nothing ever answers it."""
    async with rig() as flown, flown.aircraft.control():
        with pytest.raises(UsageError, match="no ack"):
            await flown.aircraft.execute(cast("Any", MOVE))
        with pytest.raises(UsageError, match="cannot be pushed") as caught:
            flown.aircraft.push(cast("Any", MOVE))
        assert "control" in caught.value.remedy
        assert not flown.moves


async def test_a_request_is_not_pushed() -> None:
    async with rig() as flown:
        with pytest.raises(UsageError, match="cannot be pushed"):
            flown.aircraft.push(cast("Any", RequestAuthority(obtain=True)))


@pytest.mark.parametrize("firmware", FIRMWARES)
async def test_what_the_firmware_does_not_know_is_refused_here(firmware: str) -> None:
    """A push would vanish in silence, and 0xFF00 does not tell an old firmware from a wrong key."""
    async with rig(firmware=firmware) as flown:
        profile = flown.aircraft.firmware
        before = len(flown.virtual.autopilot.received_commands)
        if TakePhoto.is_known_to(profile):
            assert flown.aircraft.push(TakePhoto())
        else:
            with pytest.raises(CommandNotSupported, match="take_photo"):
                flown.aircraft.push(TakePhoto())
        if not Arm.is_known_to(profile):
            with pytest.raises(CommandNotSupported, match="arm") as caught:
                await flown.aircraft.execute(Arm(on=True))
            assert "3.1" in caught.value.cause
        await asyncio.sleep(0.1)
        commands = list(flown.virtual.autopilot.received_commands)[before:]
        assert [type(c.command) for c in commands] == [TakePhoto] * (firmware != "1.0")
        assert flown.virtual.autopilot.camera.photos == (firmware != "1.0")


async def test_gimbal_and_camera_are_sent_encrypted_and_plain_without_a_key() -> None:
    async with rig(firmware="3.1") as flown:
        flown.aircraft.push(GimbalAngle(pitch_deg=-45.0, duration_s=0.5))
        await asyncio.sleep(1.0)
        [command] = [c for c in flown.virtual.autopilot.received_commands if c.address == (1, 0x1B)]
        assert command.encrypted
        assert flown.virtual.autopilot.gimbal.pitch == pytest.approx(-45.0)
        async with flown.virtual.connect() as other:
            other.push(TakePhoto())
            await asyncio.sleep(0.1)
        command = flown.virtual.autopilot.received_commands[-1]
        assert (type(command.command), command.encrypted) == (TakePhoto, False)


async def test_activation_travels_plain_even_with_a_key() -> None:
    async with rig() as flown:
        await flown.aircraft.activate(flown.virtual.credentials)
        commands = flown.virtual.autopilot.received_commands
        last = [command for command in commands if command.address == (0x00, 0x01)][-1]
        assert (last.encrypted, last.code) == (False, ActivationCode.SUCCESS)


PROGRAM = """
from typing import assert_type

from m100link import Aircraft
from m100link.protocol import (
    Arm, ArmCode, AuthorityChanged, GetVersion, Move, QueryTask, TaskResultCode, Version
)
from m100link.requests import Requests


async def right(aircraft: Aircraft, requests: Requests, move: Move) -> None:
    assert_type(await aircraft.execute(GetVersion()), Version)
    assert_type(await aircraft.execute(Arm(on=True)), ArmCode)
    assert_type(await requests.execute(QueryTask(1)), TaskResultCode)
    assert_type(requests.push(move), bool)


async def wrong(aircraft: Aircraft, requests: Requests, move: Move) -> None:
    await aircraft.execute(move)  # wrong
    await requests.execute(move)  # wrong
    await aircraft.execute(AuthorityChanged())  # wrong
    aircraft.push(move)  # wrong
    aircraft.push(GetVersion())  # wrong
    requests.push(Arm(on=True))  # wrong
    requests.push(AuthorityChanged())  # wrong
"""


def test_mypy_refuses_what_would_fail_or_fly(tmp_path: Path) -> None:
    pytest.importorskip("mypy")
    file = tmp_path / "program.py"
    file.write_text(PROGRAM)
    run = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "--no-pretty", str(file)],
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
        cwd=Path(__file__).parents[1],
    )
    errors = {int(line.split(":")[1]) for line in run.stdout.splitlines() if "program.py" in line}
    lines = enumerate(PROGRAM.splitlines(), start=1)
    assert errors == {number for number, line in lines if line.endswith("# wrong")}, run.stdout
