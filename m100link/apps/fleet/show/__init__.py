"""Formations: every aircraft has a track that is timed, and flies it by itself.

:mod:`~m100link.apps.fleet.show.plan.document` reads a show,
:mod:`~m100link.apps.fleet.show.plan.track` is what one aircraft flies,
:mod:`~m100link.apps.fleet.show.plan.document` says what is wrong with all of them together and
:mod:`~m100link.apps.fleet.show.plan.document` draws them.
"""
