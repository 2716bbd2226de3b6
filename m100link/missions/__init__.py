"""Missions that the flight controller flies by itself: values, which know no aircraft."""
