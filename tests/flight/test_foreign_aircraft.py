"""The foreign aircraft itself: golden frames, and the library flies it on each firmware."""

from __future__ import annotations

import asyncio

import pytest

import m100link
from tests.flight.foreign_aircraft import APP_ID, KEY, ONBOARD, RC, foreign_aircraft, frame
from tests.rig import FIRMWARES, NORTH
from tests.support import load_vectors
from tests.waiting import PATIENCE


def test_its_plain_frames_are_the_golden_ones() -> None:
    golden = [vector for vector in load_vectors("frames") if not vector["key"] and vector["data"]]
    assert len(golden) > 10
    for vector in golden:
        made = frame(
            bytes.fromhex(vector["data"]),
            session=vector["session"],
            sequence=vector["seq"],
            is_ack=bool(vector["ack"]),
        )
        assert made.hex() == vector["frame"]


@pytest.mark.pty
@pytest.mark.parametrize("firmware", FIRMWARES)
def test_a_program_flies_it_and_gives_it_back(firmware: str) -> None:
    async def fly(port: str) -> None:
        async with m100link.connect(port) as aircraft:
            await aircraft.activate(m100link.Credentials(app_id=APP_ID, key=KEY))
            await aircraft.wait_for(lambda state: state.position is not None, timeout=PATIENCE)
            async with aircraft.control() as control:
                assert there.device == ONBOARD
                async for tick in control.ticks():
                    if tick.elapsed > 0.5:
                        break
                    control.send(NORTH)

    with foreign_aircraft(firmware) as there:
        asyncio.run(fly(there.name))
        assert there.device == RC
        assert all(movement.is_obeyed for movement in there.movements)
        assert {movement.values for movement in there.movements[-1:]} == {(0.0, 0.0, 0.0, 0.0)}
        assert sum(movement.values[0] == 2.0 for movement in there.movements) > 2
