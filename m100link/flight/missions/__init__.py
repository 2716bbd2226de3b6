"""Missions that the flight controller flies by itself, begun, watched and ended by a program."""
