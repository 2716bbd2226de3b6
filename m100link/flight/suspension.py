"""Whether the computer slept: the clock of the event loop stands still then, the aircraft not."""

from __future__ import annotations

import time

__all__ = ["SuspendWatch"]

_WITH_SLEEP = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)  # on macOS the other one
_NOTICED_S = 0.1
_READINGS = 3


def asleep_s() -> float:
    """Seconds that the computer has been suspended since it started, and a constant.

    In this order, since the process may be stopped between the two: that makes it less, and no
    sleep is seen where there was none.
    """
    with_sleep = time.clock_gettime(_WITH_SLEEP)
    return with_sleep - time.monotonic()


class SuspendWatch:
    """Notices a suspend between its making and a look.

    Every age and lifetime of a flight is counted by the clock of its event loop, which is
    CLOCK_MONOTONIC and stands still while the computer is suspended: on waking, a setpoint of an
    hour ago is a tenth of a second old. So none of them is asked after a suspend.
    """

    def __init__(self) -> None:
        self._before_s = max(asleep_s() for _ in range(_READINGS))

    def slept_s(self) -> float:
        """For how long the computer was suspended; 0 when it was not."""
        slept = asleep_s() - self._before_s
        return slept if slept > _NOTICED_S else 0.0
