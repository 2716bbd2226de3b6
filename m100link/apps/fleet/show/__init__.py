"""Formations: every aircraft has a track that is timed, and flies it by itself.

:mod:`~m100link.apps.fleet.show.document` reads a show, :mod:`~m100link.apps.fleet.show.track` is
what one aircraft flies, :mod:`~m100link.apps.fleet.show.checks` says what is wrong with all of them
together and :mod:`~m100link.apps.fleet.show.picture` draws them.
"""
