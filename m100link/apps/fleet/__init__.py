"""Many aircraft on many machines, by zenoh.

::

    async with m100link.fleet.connect("tcp/base:7447") as fleet:
        results = await fleet.each(lambda aircraft: aircraft.take_off())
        async with fleet["a1"].control(stop="land") as control:
            await control.fly_to(latitude_deg=47.0, longitude_deg=8.0, height=10.0)

Control, guards, lease and log are on board, at the agent of each aircraft. When the network is
lost, the aircraft hovers.
"""

from m100link.apps.fleet.client import Change, Fleet, FleetAircraft, connect
from m100link.apps.fleet.control import FleetControl
from m100link.apps.fleet.payloads import Outcome, Result

__all__ = ["Change", "Fleet", "FleetAircraft", "FleetControl", "Outcome", "Result", "connect"]
