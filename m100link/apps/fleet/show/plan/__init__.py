"""A show as values: tracks, documents, conflicts; no I/O, no clock, no chance."""
