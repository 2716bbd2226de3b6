"""Flight logs of a fleet: they stay on board until an operator with the right fetches them."""
