"""Flying: control authority, setpoints, guards, tasks, closed loops, and how it all ends."""
