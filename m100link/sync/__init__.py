"""The same API without ``await``: for scripts, for teaching, for programs that have threads.

::

    with m100link.sync.connect("sim://") as aircraft:
        with aircraft.control() as control:
            control.take_off()
            control.fly_to(north=10.0, east=0.0, up=0.0)
            control.land()
"""

from m100link.sync.aircraft import Aircraft, connect
from m100link.sync.control import Control, Hold, Subscription, Ticks

__all__ = ["Aircraft", "Control", "Hold", "Subscription", "Ticks", "connect"]
