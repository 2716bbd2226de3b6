"""Missions of a fleet: a plan goes up in one piece, is named by its digest, and flies on board.

:mod:`~m100link.apps.fleet.payloads` is how far one may be,
:mod:`~m100link.apps.fleet.missions.board` the agent's end and what it tells, and
:mod:`~m100link.apps.fleet.missions.flight` the pilot's end.
"""
