"""The content of the page, as values: no page, no socket and no clock of its own."""
