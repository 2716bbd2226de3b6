"""A Matrice 100 for programs that speak MAVLink: a front of the agent, translated in both ways."""
