"""Applications of the library. Programs may rely on what docs/project/compatibility.md names."""
