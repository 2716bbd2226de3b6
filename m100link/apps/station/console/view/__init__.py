"""What the page shows, as values: no page, no socket and no clock of its own."""
