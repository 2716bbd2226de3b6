"""The virtual aircraft without a line: how it flies, senses and obeys. It knows no frames."""
