"""Formations: every aircraft has a track that is timed, and flies it by itself.

:mod:`~m100link.apps.fleet.show.plan.document` reads, checks and draws a show,
:mod:`~m100link.apps.fleet.show.plan.track` is what one aircraft flies,
:mod:`~m100link.apps.fleet.show.performer` flies it on board, and
:mod:`~m100link.apps.fleet.show.conductor` lets all of them begin at one time.
"""
