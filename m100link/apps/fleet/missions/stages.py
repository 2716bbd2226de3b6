"""How far the mission of one aircraft is (pure logic)."""

from __future__ import annotations

from enum import Enum

from m100link.errors import MissionRunning

__all__ = ["MissionInput", "MissionStage", "after"]


class MissionStage(Enum):
    """How far a mission is."""

    NONE = "none"  # there is no plan
    UPLOADED = "uploaded"  # it waits on board; the aircraft has not heard of it
    STARTING = "starting"  # it is told to the aircraft, which takes off first if it has to
    FLYING = "flying"
    OVER = "over"  # flown, stopped, or failed; the plan is there still


class MissionInput(Enum):
    """What happens to it."""

    UPLOADED = "uploaded"  # another plan is whole
    ASKED = "asked"  # to start it
    BEGUN = "begun"  # the aircraft flies it
    ENDED = "ended"  # however
    LEASE_ENDED = "lease ended"  # the agent ends what flew under it, and forgets the plan


_NEXT: dict[MissionStage, dict[MissionInput, MissionStage | None]] = {
    MissionStage.NONE: {
        MissionInput.UPLOADED: MissionStage.UPLOADED,
        MissionInput.ASKED: MissionStage.STARTING,  # of what came in pieces: the agent knows it
    },
    MissionStage.UPLOADED: {
        MissionInput.UPLOADED: MissionStage.UPLOADED,
        MissionInput.ASKED: MissionStage.STARTING,
        MissionInput.LEASE_ENDED: MissionStage.NONE,
    },
    MissionStage.STARTING: {
        MissionInput.UPLOADED: None,
        MissionInput.ASKED: None,
        MissionInput.BEGUN: MissionStage.FLYING,
        MissionInput.ENDED: MissionStage.OVER,
        MissionInput.LEASE_ENDED: MissionStage.OVER,
    },
    MissionStage.FLYING: {
        MissionInput.UPLOADED: None,
        MissionInput.ASKED: None,
        MissionInput.ENDED: MissionStage.OVER,
        MissionInput.LEASE_ENDED: MissionStage.OVER,
    },
    MissionStage.OVER: {
        MissionInput.UPLOADED: MissionStage.UPLOADED,
        MissionInput.ASKED: MissionStage.STARTING,
    },
}
"""What is not named changes nothing; None is refused."""


def after(stage: MissionStage, happens: MissionInput) -> MissionStage:
    """How far it is then.

    Raises:
        MissionRunning: It cannot be asked for while a mission flies, or begins.
    """
    found = _NEXT[stage].get(happens, stage)
    if found is None:
        what = "a plan" if happens is MissionInput.UPLOADED else "the start of a mission"
        raise MissionRunning(
            f"{what} came while a mission is {stage.value}; nothing was changed",
            cause="whoever has the lease flies one already",
            remedy="stop it first, or wait for its end",
        )
    return found
