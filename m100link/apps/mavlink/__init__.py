"""A Matrice 100 for programs that speak MAVLink, a front of the agent. Not promised."""
