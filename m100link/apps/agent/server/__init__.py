"""The agent itself: the one owner of an aircraft, and its end of every client's connection."""
