"""What Foxglove and Lichtblick show of a flight while it is flown; nothing can be sent by it."""
