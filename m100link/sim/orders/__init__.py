"""What people and scripts do to a virtual aircraft: actions, scenarios, a control socket."""
