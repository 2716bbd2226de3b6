"""The ground station: one aircraft for many clients. Of its modules, ``config`` is promised.

:mod:`m100link.apps.agent.lease` says who may steer, :mod:`m100link.apps.agent.server.agent` owns
the aircraft, :mod:`m100link.apps.station.ros.client` speaks rosbridge v2 without knowing what
carries it, :mod:`m100link.apps.station.ros.node_2015` is DJI's ROS node of 2015, and
:mod:`m100link.apps.station.web.server` puts them on a WebSocket. The console for browsers stands in
:mod:`m100link.apps.station.console`.

Importing this package needs nothing beyond the library; the server needs the extra ``station``.
"""
