"""Flight logs of a fleet: they lie on board, and whoever may watch an aircraft fetches its own.

:mod:`~m100link.apps.fleet.logs.words` is what goes over the network,
:mod:`~m100link.apps.fleet.logs.service` the agent's end with the folder on board, and
:mod:`~m100link.apps.fleet.logs.fetching` the other one.
"""
