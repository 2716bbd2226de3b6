"""MAVLink as messages in and messages out: no I/O, no clock, no chance."""
