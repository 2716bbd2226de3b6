"""Flight logs of a fleet: they lie on board, and whoever may watch an aircraft fetches its own."""
