"""Missions that the flight controller flies by itself: waypoints, hotpoint, follow (3.1)."""
