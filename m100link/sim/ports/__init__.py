"""Where programs reach a virtual aircraft: memory, pseudo-terminals, TCP."""
