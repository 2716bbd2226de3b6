"""Applications of the library: each is a client of it, or of the agent, and it imports none."""
