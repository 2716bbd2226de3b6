"""Detect that the computer slept: the event loop's clock stopped, the aircraft did not."""

from __future__ import annotations

import time

__all__ = ["SuspendWatch"]

_WITH_SLEEP = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)  # on macOS the other one
_NOTICED_S = 0.1
_READINGS = 3


def asleep_s() -> float:
    """Return the seconds for which the computer was suspended since it started, plus a constant.

    The order matters, because the process may be stopped between the two readings. That makes the
    result smaller, so no sleep is seen where there was none.
    """
    with_sleep = time.clock_gettime(_WITH_SLEEP)
    return with_sleep - time.monotonic()


class SuspendWatch:
    """Notices a suspend after it was made.

    The event loop's clock counts every age and lifetime of a flight. It is CLOCK_MONOTONIC, which
    stops while the computer is suspended: on waking, a setpoint of an hour ago is a tenth of a
    second old. So nothing relies on ages after a suspend.
    """

    def __init__(self) -> None:
        self._before_s = max(asleep_s() for _ in range(_READINGS))

    def slept_s(self) -> float:
        """Return for how long the computer was suspended, s; 0 when it was not."""
        slept = asleep_s() - self._before_s
        return slept if slept > _NOTICED_S else 0.0
