"""A fleet: many aircraft, many machines."""
