"""Formations: every aircraft has a track that is timed, and flies it by itself."""
