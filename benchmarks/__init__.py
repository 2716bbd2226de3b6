"""Benchmarks; each prints figures beside those of a rival in the same run."""
